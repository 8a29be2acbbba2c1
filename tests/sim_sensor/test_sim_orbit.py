"""Orbits, sunlight and the field along them."""

from __future__ import annotations

import math
import re
import sys
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_service.base.errors import ExtraMissingError, InputRefusedError, how_to_install
from magcal_service.earth import geomagnetic
from sim_sensor.field import DIPOLE_NORTH_ECEF, FieldModel
from sim_sensor.orbit import EARTH_GM_KM3_S2, KeplerOrbit, Sgp4Orbit
from sim_sensor.sunlight import lit_fraction, sun_direction_eci

START = round(datetime(2025, 6, 1, tzinfo=UTC).timestamp()) * 10**9
PAPER = KeplerOrbit(START, 6990.137, 6.4e-5, math.radians(74.0), 0.3, 0.5, 0.7)
LINE1 = "1 25544U 98067A   22010.08605869  .00001706  00000-0  38025-4 0  9993"
LINE2 = "2 25544  51.6438  39.5186 0005432  22.6155  73.7459 15.49885031320662"
TLE_DAY = round(datetime(2022, 1, 11, tzinfo=UTC).timestamp()) * 10**9
elements = st.builds(
    KeplerOrbit,
    epoch_utc_ns=st.just(START),
    semi_major_km=st.floats(6800.0, 42000.0),
    eccentricity=st.floats(0.0, 0.8),
    inclination_rad=st.floats(0.0, math.pi),
    raan_rad=st.floats(0.0, math.tau),
    argument_of_perigee_rad=st.floats(0.0, math.tau),
    mean_anomaly_rad=st.floats(0.0, math.tau),
)


def seconds(*values: float) -> np.ndarray:
    return START + np.rint(np.array(values) * 1e9).astype(np.int64)


def velocity_km_s(orbit: KeplerOrbit, at_s: np.ndarray, h_s: float = 0.5) -> np.ndarray:
    return (orbit.position_eci_km(seconds(*(at_s + h_s))) - orbit.position_eci_km(seconds(*(at_s - h_s)))) / (2 * h_s)


@given(elements)
def test_an_orbit_closes_after_keplers_period(orbit: KeplerOrbit) -> None:
    period_s = math.tau * math.sqrt(orbit.semi_major_km**3 / EARTH_GM_KM3_S2)
    first, last = orbit.position_eci_km(seconds(0.0, period_s))
    np.testing.assert_allclose(last, first, rtol=0.0, atol=1e-4)


@given(elements, st.floats(0.0, 1e5))
def test_the_radius_stays_between_perigee_and_apogee(orbit: KeplerOrbit, at_s: float) -> None:
    radius = np.linalg.norm(orbit.position_eci_km(seconds(at_s))[0]) / orbit.semi_major_km
    assert 1.0 - orbit.eccentricity - 1e-9 <= radius <= 1.0 + orbit.eccentricity + 1e-9


def test_energy_and_angular_momentum_are_constant_and_those_of_the_elements() -> None:
    orbit = replace(PAPER, eccentricity=0.1, semi_major_km=7500.0)
    at_s = np.linspace(0.0, 6000.0, 50)
    position, velocity = orbit.position_eci_km(seconds(*at_s)), velocity_km_s(orbit, at_s)
    energy = np.sum(velocity**2, axis=1) / 2 - EARTH_GM_KM3_S2 / np.linalg.norm(position, axis=1)
    np.testing.assert_allclose(energy, -EARTH_GM_KM3_S2 / (2 * 7500.0), rtol=2e-6)
    momentum = math.sqrt(EARTH_GM_KM3_S2 * 7500.0 * (1 - 0.1**2)) * orbit.normal_eci(START)
    np.testing.assert_allclose(np.cross(position, velocity), np.tile(momentum, (50, 1)), rtol=0.0, atol=0.1)


@given(elements)
def test_the_normal_is_perpendicular_to_the_orbit(orbit: KeplerOrbit) -> None:
    places = orbit.position_eci_km(seconds(0.0, 500.0, 3000.0))
    np.testing.assert_allclose(places @ orbit.normal_eci(START) / orbit.semi_major_km, 0.0, atol=1e-9)


def test_j2_turns_a_sun_synchronous_node_once_a_year() -> None:
    """Published: about 97.8 deg at 612 km gives 360 deg per 365.2422 days."""
    orbit = replace(PAPER, inclination_rad=math.radians(97.82), j2=True)
    assert math.degrees(orbit.rates_rad_s()[0]) * 86400.0 == pytest.approx(360.0 / 365.2422, rel=5e-3)


def test_j2_leaves_the_perigee_at_the_critical_inclination() -> None:
    orbit = replace(PAPER, inclination_rad=math.asin(math.sqrt(0.8)), j2=True)
    assert orbit.rates_rad_s()[1] == pytest.approx(0.0, abs=1e-18)


def test_sgp4_positions_are_those_of_the_sgp4_package() -> None:
    from sgp4.api import Satrec, jday

    code, theirs, _ = Satrec.twoline2rv(LINE1, LINE2).sgp4(*jday(2022, 1, 11, 3, 25, 45.5))
    ours = Sgp4Orbit(LINE1, LINE2).position_eci_km(np.array([TLE_DAY + round(12345.5e9)]))[0]
    assert code == 0
    np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-3)


def test_a_decayed_element_set_is_refused_with_sgp4s_reason() -> None:
    decades_later = TLE_DAY + 40 * 365 * 86400 * 10**9
    with pytest.raises(InputRefusedError, match=r"orbit\.tle.*SGP4 cannot propagate"):
        Sgp4Orbit(LINE1, LINE2).position_eci_km(np.array([decades_later]))


def test_without_sgp4_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sgp4.api", None)
    with pytest.raises(ExtraMissingError, match=re.escape(how_to_install("sim"))):
        Sgp4Orbit(LINE1, LINE2).normal_eci(TLE_DAY)


@pytest.mark.parametrize(
    ("date", "longitude_deg"),
    [((2025, 3, 20, 9, 1), 0.0), ((2025, 6, 21, 2, 42), 90.0), ((2025, 9, 22, 18, 19), 180.0)],
)
def test_the_sun_stands_at_the_published_equinoxes_and_solstice(date: tuple[int, ...], longitude_deg: float) -> None:
    year, month, day, hour, minute = date
    time = round(datetime(year, month, day, hour, minute, tzinfo=UTC).timestamp()) * 10**9
    tilt = math.radians(23.436)
    longitude = math.radians(longitude_deg)
    expected = [
        math.cos(longitude),
        math.cos(tilt) * math.sin(longitude),
        math.sin(tilt) * math.sin(longitude),
    ]
    got = sun_direction_eci(np.array([time]))[0]
    assert math.degrees(math.acos(min(1.0, float(got @ expected)))) < 0.012


def test_light_is_full_towards_the_sun_and_none_behind_the_earth() -> None:
    sun = sun_direction_eci(seconds(0.0))
    assert lit_fraction(seconds(0.0), 7000.0 * sun)[0] == 1.0
    assert lit_fraction(seconds(0.0), -7000.0 * sun)[0] == 0.0


def test_the_longest_eclipse_is_that_of_a_cylinder_to_within_the_penumbra() -> None:
    """An orbit in the Sun's plane: the shadow spans 2 asin(Re / r) of the orbit, 35.6 of 96.9 min here."""
    sun = sun_direction_eci(seconds(0.0))[0]
    side = np.cross(sun, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    angle = np.linspace(0.0, math.tau, 20001)[:-1, None]
    places = 6990.137 * (np.cos(angle) * sun + np.sin(angle) * side)
    dark = 1.0 - lit_fraction(np.full(20000, START), places).mean()
    assert dark == pytest.approx(math.asin(6378.137 / 6990.137) / math.pi, abs=2e-4)


def test_the_field_on_the_papers_orbit_is_that_of_a_low_polar_orbit() -> None:
    field = np.linalg.norm(FieldModel().true_eci_nt(PAPER, seconds(*range(0, 18000, 60))), axis=1)
    assert 17000.0 < field.min() < 20000.0
    assert 40000.0 < field.max() < 50000.0


def test_by_default_the_reference_is_the_truth() -> None:
    times = seconds(0.0, 100.0)
    np.testing.assert_array_equal(FieldModel().reference_eci_nt(PAPER, times), FieldModel().true_eci_nt(PAPER, times))


def test_a_time_offset_shifts_the_reference_and_nothing_else() -> None:
    times = seconds(*range(0, 6000, 100))
    late = FieldModel(reference_time_offset_s=2.0).reference_eci_nt(PAPER, times)
    np.testing.assert_array_equal(late, FieldModel().reference_eci_nt(PAPER, times + 2 * 10**9))


def test_along_track_is_a_time_offset_but_for_the_earths_turn() -> None:
    """7.55 km are one second of flight; the Earth turns by 0.5 km meanwhile, which is worth 10 nT at most."""
    times = seconds(*range(0, 6000, 100))
    speed_km_s = math.sqrt(EARTH_GM_KM3_S2 / 6990.137)
    ahead = FieldModel(reference_along_track_km=speed_km_s).reference_eci_nt(PAPER, times)
    later = FieldModel(reference_time_offset_s=1.0).reference_eci_nt(PAPER, times)
    here = FieldModel().reference_eci_nt(PAPER, times)
    assert np.linalg.norm(ahead - here, axis=1).max() > 50.0
    assert np.linalg.norm(ahead - later, axis=1).max() < 10.0


def test_a_higher_place_is_on_the_same_vertical() -> None:
    times = seconds(*range(0, 6000, 100))
    position = PAPER.position_eci_km(times)
    higher = position * (1.0 + 1.0 / np.linalg.norm(position, axis=1, keepdims=True))
    got = FieldModel(reference_radial_km=1.0).reference_eci_nt(PAPER, times)
    np.testing.assert_allclose(got, geomagnetic.igrf_eci_nt(times, higher), rtol=0.0, atol=1e-6)


def test_a_frozen_epoch_is_the_old_field_at_the_new_place() -> None:
    times = seconds(0.0, 1000.0)
    old = round(datetime(2020, 6, 1, tzinfo=UTC).timestamp()) * 10**9
    got = FieldModel(reference_epoch_ns=old).reference_eci_nt(PAPER, times)
    place = geomagnetic.ecef_from_eci(times, PAPER.position_eci_km(times))
    expected = geomagnetic.eci_from_ecef(times, geomagnetic.igrf_ecef_nt(np.full(2, old), place))
    np.testing.assert_array_equal(got, expected)
    assert np.linalg.norm(got - FieldModel().reference_eci_nt(PAPER, times), axis=1).min() > 50.0


def test_a_ring_current_is_uniform_along_the_dipole() -> None:
    times = seconds(0.0, 3000.0)
    added = FieldModel(ring_current_nt=-80.0).true_eci_nt(PAPER, times) - FieldModel().true_eci_nt(PAPER, times)
    expected = np.tile(-80.0 * DIPOLE_NORTH_ECEF, (2, 1))
    np.testing.assert_allclose(geomagnetic.ecef_from_eci(times, added), expected, rtol=0.0, atol=1e-9)


def test_the_dipole_axis_is_where_it_is_published() -> None:
    """IGRF-14 at 2025: geomagnetic north pole at 80.8 N, 72.8 W."""
    assert math.degrees(math.asin(DIPOLE_NORTH_ECEF[2])) == pytest.approx(80.8, abs=0.1)
    assert math.degrees(math.atan2(DIPOLE_NORTH_ECEF[1], DIPOLE_NORTH_ECEF[0])) == pytest.approx(-72.8, abs=0.1)
