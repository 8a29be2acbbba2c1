"""Positions as receivers, autopilots and orbit tools write them: in which unit, which way round, how high."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from magcal_service.base.errors import InputRefusedError
from magcal_service.earth.geomagnetic import ecef_from_geodetic, igrf_ecef_nt
from magcal_service.recordings.describe.describe import Described, describe
from magcal_service.recordings.reader import read_recording
from tests.recordings.describe import maker_logs

FloatArray = npt.NDArray[np.float64]

ORBITS = [(51.6, -70.0, 0.0), (97.5, 10.0, 20.0), (70.0, 40.0, 330.0), (98.0, -30.0, 200.0), (35.0, 60.0, 100.0)]
"""Inclination, node and place in the orbit at the beginning [deg]."""

MINUTES = [4.0, 30.0]


@dataclass(frozen=True)
class Way:
    """Where a log was made."""

    time_s: FloatArray
    latitude_deg: FloatArray
    longitude_deg: FloatArray
    height_km: FloatArray


def test_names_in_windows_1252_are_known(tmp_path: Path) -> None:
    """A spreadsheet of western Europe saves ``Länge`` and ``µT`` so."""
    flight = maker_logs.orbit()
    rows = [
        f"{t:.0f};{lat:.5f};{lon:.5f};500,0;{x:.3f};{y:.3f};{z:.3f}".replace(".", ",")
        for t, lat, lon, (x, y, z) in zip(
            flight.time_s, flight.latitude_deg, flight.longitude_deg, flight.field_nt / 1e3, strict=True
        )
    ]
    log = tmp_path / "log.csv"
    head = "unix;Breite;Länge;Höhe [km];Mag x (µT);Mag y (µT);Mag z (µT)"
    log.write_bytes("\n".join([head, *rows]).encode("cp1252"))
    text = describe(log, {}).text
    assert text is not None
    assert 'columns = ["Breite", "Länge"]' in text
    (tmp_path / "RECORDING.toml").write_text(text, encoding="utf-8")
    assert len(read_recording(tmp_path / "RECORDING.toml")) == len(rows)


def orbit(inclination: float, node: float, start: float, minutes: float, step_s: float = 2.0) -> Way:
    """A round orbit 500 km high over the turning Earth."""
    elapsed = np.arange(0.0, 60.0 * minutes, step_s)
    along, tilt = np.radians(start) + 2.0 * np.pi * elapsed / 5677.0, np.radians(inclination)
    latitude = np.degrees(np.arcsin(np.sin(tilt) * np.sin(along)))
    longitude = node + np.degrees(np.arctan2(np.cos(tilt) * np.sin(along), np.cos(along))) - 360.0 * elapsed / 86164.0
    longitude = (longitude + 180.0) % 360.0 - 180.0
    return Way(maker_logs.START_S + elapsed, latitude, longitude, np.full(len(elapsed), 500.0))


def drone(latitude: float, longitude: float, seed: int = 5) -> Way:
    """Two minutes in the air at 8 m/s and 10 Hz, 120 m above a place 500 m high, by a receiver of 5 Hz."""
    rng = np.random.default_rng(seed)
    elapsed = np.arange(0.0, 120.0, 0.1)
    held = np.floor(elapsed * 5.0) / 5.0
    north, east = 150.0 * np.sin(held / 19.0), 150.0 * np.cos(held / 19.0)
    up = 500.0 + 120.0 * (1.0 - np.exp(-held / 15.0)) + rng.normal(0.0, 0.15, len(held))[(5 * held).astype(int)]
    return Way(
        maker_logs.START_S + elapsed,
        latitude + north / 111e3,
        longitude + east / (111e3 * np.cos(np.radians(latitude))),
        up / 1e3,
    )


def field_of(way: Way) -> FloatArray:
    """IGRF's magnitude, turned in every direction, with a bias and noise [nT]."""
    model = igrf_ecef_nt(
        (way.time_s * 1e9).astype(np.int64), ecef_from_geodetic(way.latitude_deg, way.longitude_deg, way.height_km)
    )
    turned = maker_logs.ground(len(way.time_s)) - maker_logs.BIAS_NT
    length = np.linalg.norm(model, axis=1) / maker_logs.GROUND_NT
    return np.asarray(turned * length[:, None] + maker_logs.BIAS_NT)


def described(
    folder: Path, way: Way, head: str, columns: list[FloatArray], answers: dict[str, str] | None = None
) -> Described:
    """A log of a time, a magnetometer and these columns."""
    table = np.column_stack([way.time_s, field_of(way), *columns])
    lines = [",".join(f"{value:.12g}" for value in row) for row in table]
    log = folder / "log.csv"
    log.write_text("\n".join([f"unix,mx_nT,my_nT,mz_nT,{head}", *lines]))
    return describe(log, answers or {})


def keys(result: Described) -> list[str]:
    return [question.key for question in result.questions]


def offered(result: Described, key: str) -> list[str]:
    return [value for one in result.questions if one.key == key for value, _ in one.candidates]


@pytest.mark.parametrize(("orbit_of", "minutes"), list(itertools.product(ORBITS, MINUTES)))
def test_an_orbit_whose_latitude_and_longitude_are_exchanged_is_asked_about(
    orbit_of: tuple[float, float, float], minutes: float, tmp_path: Path
) -> None:
    way = orbit(*orbit_of, minutes)
    true = [way.latitude_deg, way.longitude_deg, way.height_km]
    assert keys(described(tmp_path, way, "lat,lon,alt_km", true)) == []
    exchanged = described(tmp_path, way, "lon,lat,alt_km", true)
    assert offered(exchanged, "position.columns") == ["lon,lat"]
    assert exchanged.text is None
    told = described(tmp_path, way, "lon,lat,alt_km", true, {"position.columns": "lon,lat"})
    assert 'columns = ["lon", "lat"]' in (told.text or "")


@pytest.mark.parametrize("unit", ["deg", "rad", "1e-7 deg", "1e-6 deg"])
@pytest.mark.parametrize("orbit_of", ORBITS)
def test_the_unit_of_an_orbit_s_places_is_told_by_its_motion(
    unit: str, orbit_of: tuple[float, float, float], tmp_path: Path
) -> None:
    way = orbit(*orbit_of, 10.0)
    factor = {"deg": 1.0, "rad": np.pi / 180.0, "1e-7 deg": 1e7, "1e-6 deg": 1e6}[unit]
    places = [way.latitude_deg * factor, way.longitude_deg * factor]
    places = [np.round(one) for one in places] if unit.startswith("1e") else places
    result = described(tmp_path, way, "lat,lon,alt_km", [*places, way.height_km])
    assert keys(result) == []
    assert (f'unit = "{unit}"\n' in (result.text or "")) is (unit != "deg")
    out = tmp_path / "RECORDING.toml"
    out.write_text(result.text or "")
    position = read_recording(out).position
    assert position is not None
    there = ecef_from_geodetic(way.latitude_deg, way.longitude_deg, way.height_km)
    np.testing.assert_allclose(position.km, there, atol=2e-3)
    wrong = described(tmp_path, way, "lat_deg,lon_deg,alt_km", [*places, way.height_km])
    assert offered(wrong, "position.unit")[:1] == ([unit] if unit != "deg" else [])


@pytest.mark.parametrize("place", [(47.4, 8.5), (-35.4, 149.2), (59.3, -120.0), (1.3, 103.8)])
@pytest.mark.parametrize(("unit", "factor"), [("m", 1e3), ("mm", 1e6), ("cm", 1e5)])
def test_the_places_of_an_autopilot_are_whole_parts_of_a_degree_and_its_height_is_asked(
    place: tuple[float, float], unit: str, factor: float, tmp_path: Path
) -> None:
    way = drone(*place)
    whole = [np.round(way.latitude_deg * 1e7), np.round(way.longitude_deg * 1e7), np.round(way.height_km * factor)]
    result = described(tmp_path, way, "lat,lon,alt", whole, {"reference": "48 uT"})
    assert any(line.startswith("position.unit = 1e-7 deg") for line in result.said)
    if unit == "m":  # metres are in line, and a thousand of them is needed before they could be else
        assert keys(result) == []
        assert 'altitude = {column = "alt", unit = "m"}' in (result.text or "").replace("{ ", "{").replace(" }", "}")
    else:
        assert unit in offered(result, "position.altitude.unit")
        assert "m" not in offered(result, "position.altitude.unit")
    named = described(tmp_path, way, f"lat_e7,lon_e7,alt_{unit}", whole, {"reference": "48 uT"})
    assert keys(named) == []


@pytest.mark.parametrize(("unit", "factor"), [("km", 1.0), ("m", 1e3), ("cm", 1e5), ("mm", 1e6), ("ft", 1e3 / 0.3048)])
@pytest.mark.parametrize("flies", ["orbit", "drone"])
def test_a_height_is_taken_in_the_unit_that_its_name_says_where_it_can_be_that(
    unit: str, factor: float, flies: str, tmp_path: Path
) -> None:
    way = orbit(*ORBITS[0], 10.0) if flies == "orbit" else drone(47.4, 8.5)
    columns = [way.latitude_deg, way.longitude_deg, way.height_km * factor]
    result = described(tmp_path, way, f"lat,lon,alt_{unit}", columns)
    assert keys(result) == []
    assert f'unit = "{unit}"' in (result.text or "").split("[position]")[1]
    other = "m" if unit in {"km", "mm", "cm"} else "km"
    if (flies, unit) not in {("drone", "km")}:  # half a unit high: as a metre it could be a room's floor
        wrong = described(tmp_path, way, f"lat,lon,alt_{other}", columns)
        assert "position.altitude.unit" in keys(wrong)


@pytest.mark.parametrize(
    ("label", "asks"),
    [
        ("hgt [nmi]", True),
        ("alt [MSL]", False),
        ("alt", False),
        ("alt_nmi", True),
        ("height_mi", True),
        ("alt_gps", False),
    ],
)
def test_a_height_in_a_unit_that_is_not_known_is_asked(label: str, asks: bool, tmp_path: Path) -> None:
    """Numbers would take 285 nautical miles for kilometres."""
    way = orbit(*ORBITS[1], 10.0)
    result = described(tmp_path, way, f"lat,lon,{label}", [way.latitude_deg, way.longitude_deg, way.height_km / 1.852])
    assert ("position.altitude.unit" in keys(result)) is asks


@pytest.mark.parametrize(("unit", "factor"), [("km", 1.0), ("m", 1e3), ("cm", 1e5), ("mm", 1e6)])
def test_the_height_of_an_orbit_has_one_unit_that_goes_with_its_speed(unit: str, factor: float, tmp_path: Path) -> None:
    way = orbit(*ORBITS[1], 10.0)
    result = described(tmp_path, way, "lat,lon,alt", [way.latitude_deg, way.longitude_deg, way.height_km * factor])
    assert keys(result) == []
    assert f'unit = "{unit}"' in (result.text or "").split("[position]")[1]


@pytest.mark.parametrize(("unit", "factor"), [("km", 1.0), ("m", 1e3), ("cm", 1e5), ("mm", 1e6)])
def test_three_coordinates_have_one_unit_that_leads_to_the_earth_s_surface(
    unit: str, factor: float, tmp_path: Path
) -> None:
    way = orbit(*ORBITS[1], 10.0)
    ecef = ecef_from_geodetic(way.latitude_deg, way.longitude_deg, way.height_km) * factor
    result = described(tmp_path, way, "ecef_x,ecef_y,ecef_z", list(ecef.T))
    assert keys(result) == []
    assert f'unit = "{unit}"\nframe = "ecef"' in (result.text or "")


@pytest.mark.parametrize("answer", ["degrees", "m", "1e7"])
def test_an_answer_that_is_no_unit_of_an_angle_is_refused(answer: str, tmp_path: Path) -> None:
    way = drone(47.4, 8.5)
    columns = [way.latitude_deg, way.longitude_deg]
    with pytest.raises(InputRefusedError, match="deg, rad, 1e-7 deg, 1e-6 deg are accepted"):
        described(tmp_path, way, "lat,lon", columns, {"position.unit": answer})


@pytest.mark.parametrize("place", [(48.1, 11.5), (-33.9, 18.4), (1.3, 60.0)])
@pytest.mark.parametrize("reference", ["", "in the log", "answered"])
def test_a_place_whose_field_is_that_of_the_other_way_round_is_asked_about(
    place: tuple[float, float], reference: str, tmp_path: Path
) -> None:
    way = drone(*place)
    model = np.linalg.norm(
        igrf_ecef_nt(
            (way.time_s * 1e9).astype(np.int64), ecef_from_geodetic(way.latitude_deg, way.longitude_deg, way.height_km)
        ),
        axis=1,
    )
    columns = [way.latitude_deg, way.longitude_deg, way.height_km, *([model] if reference == "in the log" else [])]
    tail = "alt_km,igrf_nT" if reference == "in the log" else "alt_km"
    answers = {"reference": f"{model[0]:.0f} nT"} if reference == "answered" else {}
    assert keys(described(tmp_path, way, f"lat,lon,{tail}", columns, answers)) == []
    assert offered(described(tmp_path, way, f"lon,lat,{tail}", columns, answers), "position.columns")[0] == "lon,lat"


@pytest.mark.parametrize(
    ("speed_km_s", "climb_m_s", "from_m"),
    [(0.24, 0.0, 11000.0), (0.01, 5.0, 400.0), (0.24, 12.0, 9500.0), (0.0, 0.0, 1609.0)],
)
@pytest.mark.parametrize("step_s", [0.2, 1.0])
def test_a_height_in_whole_metres_stays_one(
    speed_km_s: float, climb_m_s: float, from_m: float, step_s: float, tmp_path: Path
) -> None:
    elapsed = step_s * np.arange(600)
    height_m = np.round(from_m + climb_m_s * elapsed + np.random.default_rng(3).normal(0.0, 0.4, 600))
    way = Way(
        maker_logs.START_S + elapsed,
        40.0 + elapsed * speed_km_s / 111.0,
        np.full(600, -105.0) + elapsed * 1e-6,
        height_m / 1e3,
    )
    result = described(tmp_path, way, "lat,lon,alt", [way.latitude_deg, way.longitude_deg, height_m])
    assert keys(result) == []
    assert 'unit = "m"' in (result.text or "").split("[position]")[1]


def test_a_tenth_of_the_field_is_a_sensor_s_scale_and_no_other_place(tmp_path: Path) -> None:
    way = drone(35.2, -89.0)  # 50 uT, and about a tenth more the other way round
    columns = [way.latitude_deg, way.longitude_deg, way.height_km]
    assert keys(described(tmp_path, way, "lon,lat,alt_km", columns)) == []


def geocentric(folder: Path, head: str, *columns: object) -> Path:
    """An orbit's log with its places as directions from the Earth's centre, and further columns."""
    flight = maker_logs.orbit()
    east, north, up = flight.ecef_km.T
    latitude = np.degrees(np.arctan2(up, np.hypot(east, north)))
    table = np.column_stack([flight.time_s, flight.field_nt, latitude, flight.longitude_deg, *columns])
    path = folder / "log.csv"
    path.write_text("\n".join([head, *(",".join(f"{value:.12g}" for value in row) for row in table)]))
    return path


@pytest.mark.parametrize(("unit", "factor"), [("m", 1e3), ("km", 1.0)])
def test_a_radius_makes_latitude_geocentric(unit: str, factor: float, tmp_path: Path) -> None:
    """As a satellite's product has it: taken as geodetic, the places would be up to 21 km off."""
    flight = maker_logs.orbit()
    radius = np.linalg.norm(flight.ecef_km, axis=1)
    log = geocentric(tmp_path, "unix,Bx_nT,By_nT,Bz_nT,Latitude,Longitude,Radius", radius * factor)
    result = describe(log, {})
    assert f'radius = {{ column = "Radius", unit = "{unit}" }}' in (result.text or "")
    assert any("'Latitude' is taken as geocentric" in line for line in result.said)
    descriptor = tmp_path / "RECORDING.toml"
    descriptor.write_text(result.text or "")
    places = read_recording(descriptor).position
    assert places is not None
    assert np.abs(places.km - flight.ecef_km).max() < 1e-3


def test_a_latitude_called_geocentric_without_a_radius_is_asked_about(tmp_path: Path) -> None:
    log = geocentric(tmp_path, "unix,Bx_nT,By_nT,Bz_nT,lat_geocentric_deg,lon_deg,alt_km", np.full(1100, 500.0))
    result = describe(log, {})
    assert "position.radius" in {question.key for question in result.needed}
    told = describe(log, {"position.radius": "none"})
    assert 'altitude = { column = "alt_km", unit = "km" }' in (told.text or "")
    with pytest.raises(InputRefusedError, match="a distance from the Earth's centre"):
        describe(log, {"position.radius": "alt_km"})


def test_the_field_model_itself_is_no_magnetometer(tmp_path: Path) -> None:
    """Calibrated against itself it would have no errors at all."""
    flight = maker_logs.orbit()
    model = igrf_ecef_nt((flight.time_s * 1e9).astype(np.int64), flight.ecef_km)
    columns = (flight.time_s, flight.latitude_deg, flight.longitude_deg, np.full(len(model), 500.0), model)
    table = np.column_stack(columns)
    log = tmp_path / "log.csv"
    head = "unix,lat,lon,alt_km,Bx_nT,By_nT,Bz_nT"
    log.write_text("\n".join([head, *(",".join(f"{value:.12g}" for value in row) for row in table)]))
    (asked,) = describe(log, {}).needed
    assert asked.key == "magnetometer.columns"
    assert "a model's field, for no sensor is so near it" in asked.asks
    told = describe(log, {"magnetometer.columns": "Bx_nT,By_nT,Bz_nT"})
    assert any(line.startswith("warning: by your answer magnetometer.columns") for line in told.said)


@pytest.mark.parametrize(("frame", "unit_km"), [("ecef", 1.0), ("ecef", 1e-3)])
def test_coordinates_without_names_that_go_round_the_earth_are_offered(
    frame: str, unit_km: float, tmp_path: Path
) -> None:
    flight = maker_logs.orbit()
    table = np.column_stack([flight.time_s, flight.field_nt, flight.ecef_km / unit_km])
    log = tmp_path / "log.txt"
    log.write_text("\n".join(" ".join(f"{value:.10g}" for value in row) for row in table))
    assert offered(describe(log, {}), "position.columns") == ["5,6,7", "none"]
    answers = {"position.columns": "5,6,7", "magnetometer.columns": "2,3,4", "magnetometer.unit": "nT"}
    text = describe(log, answers).text or ""
    assert f'frame = "{frame}"' in text
    assert 'model = "igrf"' in text


def test_a_column_that_was_answered_to_be_the_height_is_no_reference(tmp_path: Path) -> None:
    """It was offered as the field in mG, and stood in the descriptor twice; the inspection had no defect."""
    way = orbit(97.0, 20.0, 10.0, 60.0)
    answers = {"position.columns": "d,e", "position.altitude": "f", "position.altitude.unit": "km"}
    result = described(tmp_path, way, "d,e,f", [way.latitude_deg, way.longitude_deg, way.height_km], answers)
    assert "f" not in offered(result, "reference")
    assert result.text is not None
    assert result.text.count('"f"') == 1
    assert 'model = "igrf"' in result.text


@pytest.mark.parametrize(("most", "first"), [(500.0, "mA"), (3.0, "A")])
def test_a_current_of_hundreds_is_offered_in_milliamperes_first(most: float, first: str, tmp_path: Path) -> None:
    """In ampere the inspection would doubt it, by the same hundred."""
    way = orbit(97.0, 20.0, 10.0, 60.0)
    places = [way.latitude_deg, way.longitude_deg, way.height_km]
    load = most * (0.5 + 0.4 * np.sin(way.time_s / 170.0))
    result = described(tmp_path, way, "lat,lon,alt_km,current", [*places, load])
    assert offered(result, "channels.current.unit")[0] == first
