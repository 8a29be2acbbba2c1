"""IGRF-14 and its frames against other people's numbers."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import ppigrf
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_service.base.errors import InputRefusedError
from magcal_service.earth import geomagnetic as geo
from tests.main_field import igrf_ned_nt

HERE = Path(__file__).parent
DAY_NS = 86400 * 10**9


def utc_ns(*date: int) -> int:
    return round(datetime(*date, tzinfo=UTC).timestamp()) * 10**9


def decimal_year_ns(years: np.ndarray) -> np.ndarray:
    whole = np.floor(years).astype(int)
    first = np.array([utc_ns(int(year), 1, 1) for year in whole])
    after = np.array([utc_ns(int(year) + 1, 1, 1) for year in whole])
    return first + np.rint((years - whole) * (after - first)).astype(np.int64)


def sphere(n: int, radius_km: float, seed: int) -> np.ndarray:
    points = np.random.default_rng(seed).standard_normal((n, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True) * radius_km


def test_against_igrf14syn_geocentric() -> None:
    """Fortran's date is a share of five years, ours of their days: 0.3 nT covers that and its five digits."""
    date, radius, colatitude, longitude, north, east, down, _ = np.loadtxt(HERE / "igrf14_geocentric.txt").T
    theta, phi = np.radians(colatitude), np.radians(longitude)
    up_axis = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    north_axis = np.stack([-np.cos(theta) * np.cos(phi), -np.cos(theta) * np.sin(phi), np.sin(theta)], axis=-1)
    east_axis = np.cross(north_axis, up_axis)
    expected = north[:, None] * north_axis + east[:, None] * east_axis - down[:, None] * up_axis
    got = geo.igrf_ecef_nt(decimal_year_ns(date), radius[:, None] * up_axis)
    assert len(date) == 30
    np.testing.assert_allclose(got, expected, rtol=0.0, atol=0.3)


def test_against_igrf14syn_geodetic() -> None:
    date, altitude, colatitude, longitude, north, east, down, _ = np.loadtxt(HERE / "igrf14_geodetic.txt").T
    got = igrf_ned_nt(decimal_year_ns(date), 90.0 - colatitude, longitude, altitude)
    np.testing.assert_allclose(got, np.stack([north, east, down], axis=-1), rtol=0.0, atol=0.3)


def test_against_wmm2025_of_pygeomag() -> None:
    """Another model by other people (WMM2025, degree 12) with another library: 5 nT rms per component in low orbit."""
    from pygeomag import GeoMag

    model = GeoMag(coefficients_file="wmm/WMM_2025.COF")
    rng = np.random.default_rng(11)
    latitude, longitude = np.degrees(np.arcsin(rng.uniform(-0.99, 0.99, 200))), rng.uniform(-180.0, 180.0, 200)
    years = rng.uniform(2025.0, 2029.9, 200)
    results = [
        model.calculate(glat=float(a), glon=float(b), alt=612.0, time=float(t))
        for a, b, t in zip(latitude, longitude, years, strict=True)
    ]
    theirs = np.array([(r.x, r.y, r.z) for r in results])
    ours = igrf_ned_nt(decimal_year_ns(years), latitude, longitude, np.full(200, 612.0))
    assert np.sqrt(np.mean((ours - theirs) ** 2)) < 8.0
    assert np.max(np.abs(ours - theirs)) < 30.0


def test_a_mixed_series_equals_one_call_per_sample() -> None:
    """Times across several coefficient epochs, in any order."""
    times = np.array([utc_ns(y, m, 3) for y, m in ((2026, 1), (1999, 12), (2024, 12), (2025, 1), (2029, 12))])
    position = sphere(5, 6990.0, 3)
    together = geo.igrf_ecef_nt(times, position)
    alone = np.concatenate([geo.igrf_ecef_nt(times[i : i + 1], position[i : i + 1]) for i in range(5)])
    np.testing.assert_allclose(together, alone, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("year", [1905, 2000, 2025])
def test_no_step_where_the_coefficients_change_epoch(year: int) -> None:
    epoch = utc_ns(year, 1, 1)
    place = np.tile(np.array([[6990.0, 0.0, 0.0]]), (2, 1))
    before, after = geo.igrf_ecef_nt(np.array([epoch - 10**9, epoch]), place)
    np.testing.assert_allclose(before, after, rtol=0.0, atol=1e-4)


def test_the_last_instant_is_in_the_domain() -> None:
    place = np.array([[0.0, 6990.0, 0.0]])
    day_before = geo.igrf_ecef_nt(np.array([utc_ns(2029, 12, 31)]), place)
    np.testing.assert_allclose(geo.igrf_ecef_nt(np.array([utc_ns(2030, 1, 1)]), place), day_before, atol=0.5)


@pytest.mark.parametrize("z_km", [7000.0, -7000.0])
def test_the_poles_are_finite_and_continuous(z_km: float) -> None:
    times = np.full(2, utc_ns(2026, 1, 1))
    pole, beside = geo.igrf_ecef_nt(times, np.array([[0.0, 0.0, z_km], [0.0, 0.01, z_km]]))
    np.testing.assert_allclose(pole, beside, rtol=0.0, atol=0.5)


@pytest.mark.parametrize("date", [(1899, 12, 31), (2030, 1, 2)])
def test_a_time_outside_the_model_is_refused_by_name(date: tuple[int, int, int]) -> None:
    with pytest.raises(InputRefusedError, match=r"igrf: time.*1900-01-01 to 2030-01-01"):
        geo.igrf_ecef_nt(np.array([utc_ns(*date)]), np.array([[7000.0, 0.0, 0.0]]))


@pytest.mark.parametrize("x_km", [7.0, 7.0e6, float("nan")])
def test_a_place_outside_the_model_is_refused_by_name(x_km: float) -> None:
    with pytest.raises(InputRefusedError, match=r"igrf: position.*check the unit"):
        geo.igrf_ecef_nt(np.array([utc_ns(2026, 1, 1)]), np.array([[x_km, 0.0, 0.0]]))


def test_times_and_places_must_pair() -> None:
    with pytest.raises(InputRefusedError, match="one time for each position"):
        geo.igrf_ecef_nt(np.array([utc_ns(2026, 1, 1)]), np.ones((2, 3)) * 5000.0)


def test_against_a_second_implementation_of_the_harmonics() -> None:
    """ppigrf, at epochs of the table; and a position alone, which is computed apart, as one among many."""
    rng = np.random.default_rng(8)
    directions = rng.normal(size=(40, 3))
    position = directions / np.linalg.norm(directions, axis=1)[:, None] * rng.uniform(6371.0, 9000.0, (40, 1))
    radius = np.linalg.norm(position, axis=1)
    theta, phi = np.arccos(position[:, 2] / radius), np.arctan2(position[:, 1], position[:, 0])
    for year in (1900, 1965, 2025):
        parts = ppigrf.igrf_gc(radius, np.degrees(theta), np.degrees(phi), datetime(year, 1, 1))
        up, south, east = (part[0] for part in parts)
        across = up * np.sin(theta) + south * np.cos(theta)
        expected = np.stack([across * np.cos(phi) - east * np.sin(phi), across * np.sin(phi) + east * np.cos(phi)])
        times = np.full(40, utc_ns(year, 1, 1))
        field = geo.igrf_ecef_nt(times, position)
        np.testing.assert_allclose(field[:, :2].T, expected, rtol=0.0, atol=1e-6)
        np.testing.assert_allclose(field[:, 2], up * np.cos(theta) - south * np.sin(theta), rtol=0.0, atol=1e-6)
        alone = [geo.igrf_ecef_nt(times[:1], position[row : row + 1])[0] for row in range(40)]
        np.testing.assert_allclose(alone, field, rtol=0.0, atol=1e-7)


def test_fewer_degrees_leave_the_higher_ones_out() -> None:
    """Degree 1 alone is a dipole: at twice the distance an eighth, by its three published numbers."""
    times, position = np.full(2, utc_ns(2025, 1, 1)), np.array([[0.0, 0.0, 7000.0], [0.0, 0.0, 14000.0]])
    near, far = geo.igrf_ecef_nt(times, position, max_degree=1)
    np.testing.assert_allclose(near, 8.0 * far, rtol=1e-6)
    np.testing.assert_allclose(near[2], 2.0 * (6371.2 / 7000.0) ** 3 * -29350.0, rtol=1e-6)


@pytest.mark.parametrize("count", [1, 200, 4097])
def test_places_that_are_asked_again_have_the_same_bits(count: int) -> None:
    """At another date, across an epoch, and to fewer degrees, as of each asked for alone."""
    place = sphere(count, 6900.0, 5)
    places = geo.Places(place)
    across = utc_ns(2024, 12, 31) + np.arange(count) * 10**12
    for times in (np.full(count, utc_ns(2023, 5, 1)), across, np.full(count, utc_ns(1983, 5, 1))):
        for degree in (13, 4):
            alone = geo.igrf_ecef_nt(times, place, degree)
            assert places.field_nt(times, degree).tolist() == alone.tolist()


def test_sidereal_time_against_a_published_example() -> None:
    """Vallado 2013, example 3-5: 1992-08-20 12:14 UT1 has GMST 152.578788 deg."""
    got = np.degrees(geo.gmst_rad(np.array([utc_ns(1992, 8, 20, 12, 14)])))
    np.testing.assert_allclose(got, 152.578788, rtol=0.0, atol=1e-6)


def test_sidereal_time_against_sgp4() -> None:
    from sgp4.propagation import gstime

    times = utc_ns(1990, 1, 1) + np.arange(0, 40 * 365, 97, dtype=np.int64) * DAY_NS
    theirs = np.array([gstime(2440587.5 + time / DAY_NS) for time in times.tolist()])
    difference = np.angle(np.exp(1j * (geo.gmst_rad(times) - theirs)))
    assert np.max(np.abs(difference)) < 1e-8


@pytest.mark.parametrize(
    ("geodetic", "ecef_km"),
    [
        ((0.0, 0.0, 0.0), (6378.137, 0.0, 0.0)),
        ((0.0, 90.0, 100.0), (0.0, 6478.137, 0.0)),
        ((90.0, 0.0, 0.0), (0.0, 0.0, 6356.752314245)),
        ((-90.0, 0.0, 10.0), (0.0, 0.0, -6366.752314245)),
    ],
)
def test_geodetic_places_on_the_axes_of_wgs84(
    geodetic: tuple[float, float, float], ecef_km: tuple[float, float, float]
) -> None:
    got = geo.ecef_from_geodetic(*(np.array([value]) for value in geodetic))[0]
    np.testing.assert_allclose(got, ecef_km, rtol=0.0, atol=1e-9)


places = st.tuples(st.floats(-90.0, 90.0), st.floats(-179.999, 179.999), st.floats(-5.0, 50000.0))


@given(places)
def test_geodetic_coordinates_survive_a_round_trip(place: tuple[float, float, float]) -> None:
    columns = [np.array([value]) for value in place]
    position = geo.ecef_from_geodetic(*columns)
    again = geo.ecef_from_geodetic(*geo.geodetic_from_ecef(position))
    np.testing.assert_allclose(again, position, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(geo.geodetic_from_ecef(position)[0], place[0], rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(geo.geodetic_from_ecef(position)[2], place[2], rtol=0.0, atol=1e-6)


vectors = st.tuples(*[st.floats(-1e5, 1e5)] * 3)


@given(vectors, st.integers(0, 1_800_000_000))
def test_inertial_and_earth_fixed_vectors_survive_a_round_trip_with_their_norm(
    vector: tuple[float, float, float], second: int
) -> None:
    times, start = np.array([second * 10**9]), np.array([vector])
    fixed = geo.ecef_from_eci(times, start)
    np.testing.assert_allclose(np.linalg.norm(fixed), np.linalg.norm(start), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(geo.eci_from_ecef(times, fixed), start, rtol=0.0, atol=1e-9)


@given(vectors, st.floats(-90.0, 90.0), st.floats(-180.0, 180.0))
def test_local_vectors_survive_a_round_trip_with_their_norm(
    vector: tuple[float, float, float], latitude: float, longitude: float
) -> None:
    start, latitudes, longitudes = np.array([vector]), np.array([latitude]), np.array([longitude])
    fixed = geo.ecef_from_ned(latitudes, longitudes, start)
    np.testing.assert_allclose(np.linalg.norm(fixed), np.linalg.norm(start), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(geo.ned_from_ecef(latitudes, longitudes, fixed), start, rtol=0.0, atol=1e-9)


def test_the_earth_turns_eastward() -> None:
    """A place fixed in space moves west over the ground: its longitude falls by 15.041 deg an hour."""
    times = np.array([utc_ns(2026, 3, 1), utc_ns(2026, 3, 1, 1)])
    _, longitude, _ = geo.geodetic_from_ecef(geo.ecef_from_eci(times, np.tile([[7000.0, 0.0, 0.0]], (2, 1))))
    moved = (longitude[1] - longitude[0] + 180.0) % 360.0 - 180.0
    assert moved == pytest.approx(-15.0410686, abs=1e-5)


def test_local_down_points_to_the_ground() -> None:
    latitude, longitude = np.array([35.0]), np.array([-70.0])
    down = geo.ecef_from_ned(latitude, longitude, np.array([[0.0, 0.0, 1.0]]))
    high, low = (geo.ecef_from_geodetic(latitude, longitude, np.array([height])) for height in (101.0, 100.0))
    np.testing.assert_allclose(down, low - high, rtol=0.0, atol=1e-9)


def test_the_steepest_slopes_of_the_field_in_orbit() -> None:
    """What the texts say: 51 nT/s of |H| at 300 km; 25 nT/km up and 5.5 nT/km across at 500 km; 130 nT/s of the vector.

    By differences over 10 km at random places; the Earth's turn adds 0.5 km/s to a craft's 7.6 at most.
    """
    times, gradient = np.full(6000, utc_ns(2025, 6, 15)), {}
    for height in (300.0, 400.0, 500.0):
        place = sphere(6000, 6371.2 + height, 3)
        fields = [[geo.igrf_ecef_nt(times, place + sign * axis) for sign in (-5.0, 5.0)] for axis in np.eye(3)]
        vector = np.stack([(after - before) / 10.0 for before, after in fields], axis=-1)
        size = [np.linalg.norm(after, axis=1) - np.linalg.norm(before, axis=1) for before, after in fields]
        slope, up = np.stack(size, axis=-1) / 10.0, place / (6371.2 + height)
        radial = np.einsum("ni,ni->n", slope, up)
        level = vector - np.einsum("nij,nj->ni", vector, up)[:, :, None] * up[:, None]
        across = np.linalg.norm(slope - radial[:, None] * up, axis=1)
        gradient[height] = (np.abs(radial).max(), across.max(), np.linalg.norm(level, ord=2, axis=(1, 2)).max())
    assert gradient[500.0][:2] == pytest.approx((25.0, 5.5), rel=0.03)
    assert 7.6 * gradient[300.0][1] < 51.0 < 8.1 * gradient[300.0][1]
    assert 7.6 * gradient[400.0][2] == pytest.approx(130.0, rel=0.05)
