from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import RecordingError
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.report import RowFault
from magcal_service.wire.messages import Frame
from tests.main_field import igrf_ned_nt
from tests.recordings.recording_logs import MAGNETOMETER, REFERENCE, descriptor, row, write_log

IGRF = '[reference]\nmodel = "igrf"\n'
GEODETIC = '[position]\ncolumns = ["lat", "lon"]\naltitude = { column = "alt", unit = "km" }\n'
PLACES = [(-36.27922, -60.89463, 466.412), (60.0, 150.0, 600.0), (0.1, -179.9, 350.0), (89.0, 10.0, 420.0)]
TIME_S = 1692888249  # 2023-08-24


@pytest.mark.parametrize("unit", ["nT", "uT", "mT", "T", "mG", "G"])
def test_every_unit_of_the_magnetometer_becomes_nanotesla(tmp_path: Path, unit: str) -> None:
    factor = {"nT": 1.0, "uT": 1e3, "mT": 1e6, "T": 1e9, "mG": 1e2, "G": 1e5}[unit]
    rows = [row(1, repr(12345.678 / factor), my=repr(-2e4 / factor), mz=repr(3e4 / factor))]
    path = write_log(tmp_path, descriptor(magnetometer=MAGNETOMETER.replace("uT", unit)), rows)
    np.testing.assert_allclose(read_recording(path).field_body_nt, [[12345.678, -2e4, 3e4]], rtol=1e-15)


@pytest.mark.parametrize("unit", ["nT", "uT", "mT", "T", "mG", "G"])
def test_every_unit_of_a_reference_magnitude_becomes_nanotesla(tmp_path: Path, unit: str) -> None:
    factor = {"nT": 1.0, "uT": 1e3, "mT": 1e6, "T": 1e9, "mG": 1e2, "G": 1e5}[unit]
    text = descriptor(reference=f'[reference]\nmagnitude = "f"\nunit = "{unit}"\n')
    recording = read_recording(write_log(tmp_path, text, [row(1, f=repr(41200.5 / factor))]))
    assert recording.reference.magnitude_nt[0] == pytest.approx(41200.5, rel=1e-15)


@pytest.mark.parametrize("frame", ["eci", "ecef", "ned"])
def test_a_vector_reference_keeps_its_frame_and_gives_its_magnitude(tmp_path: Path, frame: str) -> None:
    reference = read_recording(write_log(tmp_path, descriptor(reference=REFERENCE.replace("eci", frame)))).reference
    assert (reference.frame, reference.magnitude_nt[0]) == (Frame(frame), pytest.approx(11000.0 * 14**0.5))


@pytest.mark.parametrize(
    "form", ['magnitude = "f"\nunit = "nT"\n', 'constant = 41.2005\nunit = "uT"\n'], ids=["magnitude", "constant"]
)
def test_a_magnitude_reference_has_no_vector(tmp_path: Path, form: str) -> None:
    reference = read_recording(write_log(tmp_path, descriptor(reference=f"[reference]\n{form}"))).reference
    assert (reference.vector_nt, reference.frame) == (None, None)
    assert reference.magnitude_nt.tolist() == pytest.approx([41200.5] * 3)


def test_a_negative_magnitude_is_absurd(tmp_path: Path) -> None:
    text = descriptor(reference='[reference]\nmagnitude = "f"\nunit = "nT"\n')
    report = read_recording(write_log(tmp_path, text, [row(1), row(2, f="-1")])).report
    assert report.count("reference", RowFault.ABSURD) == 1


def igrf_log(folder: Path, *rows: str, position: str = GEODETIC) -> Path:
    return write_log(folder, descriptor(position, reference=IGRF), list(rows))


def place(latitude_deg: object, longitude_deg: object, altitude_km: object, time_s: object = TIME_S) -> str:
    return row(time_s, lat=str(latitude_deg), lon=str(longitude_deg), alt=str(altitude_km))


@pytest.mark.parametrize("where", PLACES)
def test_against_pygeomag_the_model_reference_has_the_same_magnitude(tmp_path: Path, where: tuple[float, ...]) -> None:
    pygeomag = pytest.importorskip("pygeomag")
    witness = pygeomag.GeoMag(coefficients_file="wmm/WMM_2020.COF")
    expected_nt = witness.calculate(glat=where[0], glon=where[1], alt=where[2], time=2023.646).f
    recording = read_recording(igrf_log(tmp_path, place(*where)))
    assert recording.reference.magnitude_nt[0] == pytest.approx(expected_nt, abs=100.0)


@pytest.mark.parametrize("where", PLACES)
def test_the_model_reference_is_the_local_field_turned_into_inertial_axes(
    tmp_path: Path, where: tuple[float, ...]
) -> None:
    from magcal_service.earth import geomagnetic

    latitude, longitude, altitude = (np.array([value]) for value in where)
    times = np.array([TIME_S * 10**9])
    local_nt = igrf_ned_nt(times, latitude, longitude, altitude)
    expected_nt = geomagnetic.eci_from_ecef(times, geomagnetic.ecef_from_ned(latitude, longitude, local_nt))
    reference = read_recording(igrf_log(tmp_path, place(*where))).reference
    assert reference.frame is Frame.ECI
    np.testing.assert_allclose(reference.vector_nt, expected_nt, atol=1e-6)


@pytest.mark.parametrize("frame", ["eci", "ecef"])
def test_the_model_reference_is_the_same_from_every_form_of_one_position(tmp_path: Path, frame: str) -> None:
    from magcal_service.earth import geomagnetic

    geodetic = read_recording(igrf_log(tmp_path, place(*PLACES[0])))
    assert geodetic.position is not None
    km = geodetic.position.km
    if frame == "eci":
        km = geomagnetic.eci_from_ecef(geodetic.time_ns, km)
    x, y, z = map(repr, km[0].tolist())
    position = f'[position]\ncolumns = ["x", "y", "z"]\nunit = "km"\nframe = "{frame}"\n'
    cartesian = read_recording(igrf_log(tmp_path, row(TIME_S, x=x, y=y, z=z), position=position))
    np.testing.assert_allclose(cartesian.reference.vector_nt, geodetic.reference.vector_nt, atol=1e-6)


@pytest.mark.parametrize("form", ["altitude_km = 466.412", 'altitude = { column = "alt", unit = "m" }'])
def test_an_altitude_is_the_same_constant_or_in_metres(tmp_path: Path, form: str) -> None:
    in_km = read_recording(igrf_log(tmp_path, place(*PLACES[0])))
    position = f'[position]\ncolumns = ["lat", "lon"]\n{form}\n'
    other = read_recording(igrf_log(tmp_path, place(*PLACES[0][:2], 466412.0), position=position))
    np.testing.assert_allclose(other.reference.vector_nt, in_km.reference.vector_nt, atol=1e-6)


@pytest.mark.parametrize("where", [("", 0, 400), (91, 0, 400), (0, 361, 400), (0, 0, -400), (0, 0, "nan")])
def test_a_row_without_a_usable_position_has_no_model_reference_and_is_kept(
    tmp_path: Path, where: tuple[object, object, object]
) -> None:
    recording = read_recording(igrf_log(tmp_path, place(*PLACES[0]), place(*where, TIME_S + 1)))
    assert np.isfinite(recording.reference.magnitude_nt).tolist() == [True, False]
    counted = {entry.part: entry.count for entry in recording.report.entries}
    assert (recording.report.used, counted) == (2, {"position": 1, "reference": 1})


@pytest.mark.parametrize("time_s", [-3_000_000_000, 1_900_000_000])
def test_a_date_that_the_model_does_not_cover_gives_no_reference(tmp_path: Path, time_s: int) -> None:
    recording = read_recording(igrf_log(tmp_path, place(*PLACES[0]), place(*PLACES[0], time_s)))
    assert recording.report.count("reference", RowFault.ABSURD) == 1


def test_dates_all_outside_the_model_are_refused_with_where_to_look(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"check \[reference\], \[position\] and \[time\].*absurd x 1"):
        read_recording(igrf_log(tmp_path, place(*PLACES[0], 1_900_000_000)))


def test_elapsed_time_with_a_start_finds_the_same_field_as_utc(tmp_path: Path) -> None:
    utc = read_recording(igrf_log(tmp_path, place(*PLACES[0])))
    time = '[time]\ncolumn = "time"\nformat = "elapsed_s"\nstart = "2023-08-24T14:44:00Z"\n'
    text = descriptor(GEODETIC, time=time, reference=IGRF)
    elapsed = read_recording(write_log(tmp_path, text, [place(*PLACES[0], "9.0")]))
    np.testing.assert_array_equal(elapsed.reference.vector_nt, utc.reference.vector_nt)
