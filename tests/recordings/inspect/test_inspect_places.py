"""Places that are none are left out; heights, times and longitudes that go with no orbit are asked about."""

from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import RecordingError
from magcal_service.earth.free_fall import MU_KM3_S2
from magcal_service.recordings.inspect.finding import Code
from magcal_service.recordings.inspect.free_fall import falls_of
from magcal_service.recordings.reader import read_recording
from tests.recordings.inspect.clean_logs import CleanLog, Kind, clean_log

PLACE = "lat lon alt"


def igrf(**changes: object) -> CleanLog:
    return clean_log(Kind(reference="igrf", channels=False, **changes))  # type: ignore[arg-type]


def without_fix(log: CleanLog, rows: np.ndarray, value: float, columns: str = PLACE) -> CleanLog:
    def spoil(column: np.ndarray) -> np.ndarray:
        column[rows] = value
        return column

    return log.spoiled(columns, spoil)


@pytest.mark.parametrize("rows", [np.arange(120), np.arange(700, 760), np.array([5, 90, 91, 1500])])
@pytest.mark.parametrize("columns", [PLACE, "lat lon"])
def test_the_place_of_no_fix_is_left_out(rows: np.ndarray, columns: str, tmp_path: Path) -> None:
    inspection = without_fix(igrf(), rows, 0.0, columns).inspected(tmp_path)
    finding = {one.code: one for one in inspection.findings}[Code.POSITION_ZERO]
    assert (finding.certain, finding.rows, finding.first) == (True, len(rows), rows[0] + 2)
    assert len(inspection.findings) == (1 if columns == PLACE else len(inspection.findings))
    assert len(inspection.usable) == 1800 - len(rows)


def test_latitude_and_longitude_in_each_others_place_are_told_by_their_order(tmp_path: Path) -> None:
    log = igrf()
    turned = log.changed(lat=np.where(np.arange(1800) < 200, 120.5, log.columns["lat"]))
    finding = {one.code: one for one in turned.inspected(tmp_path).findings}[Code.POSITION_ZERO]
    assert (finding.certain, finding.rows) == (True, 200)
    assert "beyond a latitude of 90 degrees" in finding.says
    assert "'120.5'" in finding.says
    assert finding.remedy.endswith("the latitude comes first, then the longitude")


@pytest.mark.parametrize(("latitude", "longitude"), [(48.1, 11.6), (-33.4, -70.6)])
def test_a_place_that_no_orbit_reaches_is_left_out(latitude: float, longitude: float, tmp_path: Path) -> None:
    rows = np.arange(300, 360)
    log = without_fix(without_fix(igrf(), rows, latitude, "lat"), rows, longitude, "lon")
    inspection = without_fix(log, rows, 0.2, "alt").inspected(tmp_path)
    finding = {one.code: one for one in inspection.findings}[Code.POSITION_JUMP]
    assert (finding.certain, finding.rows, finding.first) == (True, 60, 302)
    assert len(inspection.usable) == 1740


def test_a_place_that_is_held_while_the_craft_flies_is_left_out(tmp_path: Path) -> None:
    def hold(column: np.ndarray) -> np.ndarray:
        column[500:620] = column[500]
        return column

    inspection = igrf().spoiled(PLACE, hold).inspected(tmp_path)
    finding = {one.code: one for one in inspection.findings}[Code.POSITION_STILL]
    assert (finding.certain, finding.rows, finding.first) == (True, 119, 503)
    assert len(inspection.usable) == 1681


def test_places_that_come_at_a_slower_rate_than_rows_are_none(tmp_path: Path) -> None:
    log = clean_log(Kind(step_s=0.25))
    held = np.arange(1800) // 20 * 20
    assert log.spoiled(PLACE, lambda column: column[held]).found(tmp_path) == {}


def test_one_place_for_a_craft_in_orbit_is_asked_about(tmp_path: Path) -> None:
    finding = clean_log().spoiled(PLACE, lambda column: column[:1].repeat(1800)).found(tmp_path)[Code.POSITION_STILL]
    assert not finding.certain


@pytest.mark.parametrize(
    ("factor", "unit", "right"),
    [(1.0, "m", "km"), (1e3, "km", "m")],
)
def test_a_height_in_another_unit_is_asked_about(factor: float, unit: str, right: str, tmp_path: Path) -> None:
    log = clean_log().spoiled("alt", lambda column: column * factor)
    position = f'[position]\ncolumns = ["lat", "lon"]\naltitude = {{ column = "alt", unit = "{unit}" }}'
    finding = log.described(position=position).found(tmp_path)[Code.ALTITUDE_UNIT]
    assert not finding.certain
    assert f'unit = "{right}" }}' in finding.remedy


def test_the_distance_from_the_earths_centre_is_no_height(tmp_path: Path) -> None:
    finding = clean_log().spoiled("alt", lambda column: column + 6371.0).found(tmp_path)[Code.ALTITUDE_UNIT]
    assert "Earth's centre" in finding.remedy


def test_an_aircraft_has_no_orbit(tmp_path: Path) -> None:
    time_s = np.arange(1800.0)
    log = clean_log().changed(lat=48.0 + 0.002 * time_s, lon=11.0 + 0.001 * time_s, alt=10.0 + 0.0 * time_s)
    assert log.found(tmp_path) == {}
    metres = log.changed(alt=10_000.0 + 0.0 * time_s)
    assert metres.found(tmp_path / "m")[Code.ALTITUDE_UNIT].certain is False


def test_a_rocket_is_high_and_slow_where_it_is_stated_to_be_in_no_orbit(tmp_path: Path) -> None:
    time_s = np.arange(1800.0)
    up = 60.0 + 0.6 * time_s * (1.0 - time_s / 1800.0)
    log = clean_log().changed(lat=68.0 + 2e-4 * time_s, lon=21.0 + 1e-4 * time_s, alt=up)
    assert Code.ALTITUDE_UNIT in log.found(tmp_path)
    assert Code.ALTITUDE_UNIT not in log.described(platform='[platform]\nkind = "air"').found(tmp_path / "air")


@pytest.mark.parametrize("inclination_deg", [51.6, 97.4])
def test_a_longitude_of_the_other_sign_is_asked_about(inclination_deg: float, tmp_path: Path) -> None:
    log = clean_log(Kind(inclination_deg=inclination_deg)).spoiled("lon", lambda column: -column)
    (finding,) = log.inspected(tmp_path).findings
    assert (finding.code, finding.certain) == (Code.LONGITUDE_SIGN, False)


def test_what_was_accepted_is_said_and_open_no_more(tmp_path: Path) -> None:
    log = clean_log().spoiled("lon", lambda column: -column)
    assert [one.code for one in log.inspected(tmp_path / "a").open] == [Code.LONGITUDE_SIGN]
    inspection = log.described(inspect='[inspect]\naccept = ["longitude_sign"]').inspected(tmp_path / "b")
    assert (len(inspection.findings), inspection.open) == (1, ())


def test_a_height_beyond_the_moon_is_refused_with_a_guess(tmp_path: Path) -> None:
    log = igrf().spoiled("alt", lambda column: column * 1e5)
    with pytest.raises(RecordingError, match="is the place in another unit"):
        read_recording(log.write(tmp_path))


def test_a_height_in_metres_declared_as_km_is_refused_with_a_guess(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"check \[reference\], \[position\]"):
        read_recording(igrf().spoiled("alt", lambda column: column * 1e3).write(tmp_path))


@pytest.mark.parametrize(("factor", "words"), [(1.609344, "km lower would fit"), (0.75, "km higher would fit")])
def test_a_height_that_gravity_contradicts_is_asked_about(factor: float, words: str, tmp_path: Path) -> None:
    """Miles for kilometres: the reference is a sixth too weak everywhere, which a scale of the sensor would explain."""
    inspection = igrf().spoiled("alt", lambda column: column * factor).inspected(tmp_path)
    (finding,) = inspection.open
    assert finding.code is Code.ORBIT_HEIGHT
    assert words in finding.says
    assert len(inspection.usable) == 1800


def test_a_height_that_is_a_little_off_is_none(tmp_path: Path) -> None:
    assert not igrf().spoiled("alt", lambda column: column + 30.0).inspected(tmp_path).findings


@pytest.mark.parametrize("eccentricity", [0.0, 0.02, 0.15])
def test_an_eccentric_orbit_falls_as_gravity_pulls(eccentricity: float) -> None:
    """Integrated by leapfrog, a second a step; with a height that is 300 km off the fall is as much off."""
    perigee = 6900.0
    place = np.array([perigee, 0.0, 0.0])
    speed = np.array([0.0, np.sqrt(MU_KM3_S2 * (1.0 + eccentricity) / perigee), 0.0])
    way = []
    for _ in range(8000):
        way.append(place)
        speed = speed - 0.5 * MU_KM3_S2 * place / np.linalg.norm(place) ** 3
        place = place + speed
        speed = speed - 0.5 * MU_KM3_S2 * place / np.linalg.norm(place) ** 3
    places, time_s = np.array(way), np.arange(8000.0)
    assert np.median(falls_of(time_s, places)) == pytest.approx(1.0, abs=0.004)
    radius = np.linalg.norm(places, axis=1)[:, None]
    off = np.median((1.0 + 300.0 / radius) ** 3)
    assert np.median(falls_of(time_s, places * (1.0 + 300.0 / radius))) == pytest.approx(off, abs=0.01)
