"""A raw log described: the columns, units and times that come out are those that went in, and doubts are asked."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import InputRefusedError
from magcal_service.earth.geomagnetic import eci_from_ecef, igrf_ecef_nt
from magcal_service.recordings.describe.describe import Described, describe
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from tests.recordings.describe import maker_logs
from tests.recordings.describe.maker_logs import MakerLog

DATA = Path(__file__).resolve().parents[4] / "shared" / "data"


def described(log: MakerLog | Path, **answers: str) -> Described:
    if isinstance(log, Path):
        return describe(log, {key.replace("__", "."): value for key, value in answers.items()})
    return describe(log.path, log.answers)


def read(log: Path, text: str | None) -> Recording:
    assert text is not None
    out = log.parent / "RECORDING.toml"
    out.write_text(text, encoding="utf-8")
    return read_recording(out)


def asked(result: Described) -> set[str]:
    return {question.key for question in result.needed}


@pytest.mark.parametrize("maker", maker_logs.MAKERS)
def test_a_maker_s_log_reads_as_it_was_written(maker: Callable[[Path], MakerLog], tmp_path: Path) -> None:
    log = maker(tmp_path)
    assert {key.split(".")[0] for key in asked(describe(log.path, {}))} == {key.split(".")[0] for key in log.answers}
    recording = read(log.path, described(log).text)
    assert recording.report.used == len(log.time_s)
    np.testing.assert_allclose(recording.field_body_nt, log.field_nt, atol=60.0)
    np.testing.assert_allclose(recording.time_ns / 1e9, log.time_s, atol=2e-3)


def test_a_header_that_names_the_wrong_columns_is_not_believed(tmp_path: Path) -> None:
    flight = maker_logs.orbit()
    rows = ["unix,mag_x,mag_y,mag_z,lat,lon,roll"]
    columns = (
        flight.time_s,
        flight.latitude_deg,
        flight.longitude_deg,
        *(flight.field_nt / 1e3).T,
        flight.time_s % 360,
    )
    rows += [",".join(f"{value:.4f}" for value in row) for row in zip(*columns, strict=True)]
    log = tmp_path / "shifted.csv"
    log.write_text("\n".join(rows))
    questions = {question.key: question for question in describe(log, {}).needed}
    assert questions["position.columns"].candidates[0][0] == "mag_x,mag_y"
    assert questions["magnetometer.columns"].candidates[0][0] == "mag_z,lat,lon"
    answers = {key: question.candidates[0][0] for key, question in questions.items()} | {"position.altitude_km": "500"}
    recording = read(log, describe(log, answers).text)
    np.testing.assert_allclose(recording.field_body_nt, flight.field_nt, atol=0.1)
    np.testing.assert_allclose(recording.reference.magnitude_nt, flight.magnitude_nt, atol=2.0)


def test_the_height_of_an_orbit_is_offered_by_its_motion(tmp_path: Path) -> None:
    flight = maker_logs.orbit()
    columns = (flight.time_s, flight.latitude_deg, flight.longitude_deg, *flight.field_nt.T)
    rows = [",".join(f"{value:.3f}" for value in row) for row in zip(*columns, strict=True)]
    log = tmp_path / "orbit.csv"
    log.write_text("\n".join(["unix,lat,lon,mx_nT,my_nT,mz_nT", *rows]))
    (question,) = describe(log, {}).needed
    assert question.key == "position.altitude_km"
    assert float(question.candidates[0][0]) == pytest.approx(500.0, abs=15.0)


@pytest.mark.parametrize("frame", ["eci", "ecef"])
def test_frames_are_told_by_the_orbit_s_plane_and_by_igrf(frame: str, tmp_path: Path) -> None:
    flight = maker_logs.orbit()
    time_ns = (flight.time_s * 1e9).astype(np.int64)
    place, field = flight.ecef_km, igrf_ecef_nt(time_ns, flight.ecef_km)
    if frame == "eci":
        place, field = eci_from_ecef(time_ns, place), eci_from_ecef(time_ns, field)
    columns = (flight.time_s, *place.T, *field.T, *flight.field_nt.T)
    rows = [",".join(f"{value:.3f}" for value in row) for row in zip(*columns, strict=True)]
    log = tmp_path / "orbit.csv"
    log.write_text("\n".join(["unix,x_km,y_km,z_km,ref_x_nT,ref_y_nT,ref_z_nT,mx_nT,my_nT,mz_nT", *rows]))
    text = describe(log, {}).text or ""
    assert f'columns = ["x_km", "y_km", "z_km"]\nunit = "km"\nframe = "{frame}"' in text
    assert f'columns = ["ref_x_nT", "ref_y_nT", "ref_z_nT"]\nunit = "nT"\nframe = "{frame}"' in text


def test_the_sensor_s_own_length_is_no_reference(tmp_path: Path) -> None:
    result = describe(maker_logs.phone(tmp_path).path, {})
    assert asked(result) == {"reference"}
    assert any("the sensor's own length" in line for line in result.said)


@pytest.mark.parametrize(
    ("content", "value"),
    [
        (b"", "empty"),
        (b"\n \n", "empty"),
        (b"t,mx,my,mz\n", "one line"),
        (b"t,mx,my,mz\n0,1,2,3\n1,2,\x003,4\n", "NUL"),
        (b"\x89PNG\r\n\x1a\n" + bytes(range(1, 32)) * 20, "binary"),
        (b"\xff\xfet\x00,\x00m\x00", "UTF-16"),
        (b"1," * 100_000, "a line of more than"),
        (b"all work and no play\n" * 9, "rows of the same number of cells"),
    ],
)
def test_what_is_no_log_is_refused_in_a_line(content: bytes, value: str, tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_bytes(content)
    with pytest.raises(InputRefusedError) as refusal:
        describe(log, {})
    assert value in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("answers", "named"),
    [
        ({"magnetometer.uni": "uT"}, "did you mean 'magnetometer.unit'"),
        ({"magnetometer.columns": "a,b,c"}, "'a'"),
        ({"magnetometer.unit": "Tesla"}, "known: G, T, mG, mT, nT, uT"),
        ({"reference": "strong"}, "'strong'"),
        ({"time.format": "stardate"}, "elapsed_s"),
        ({"position.altitude_km": "415"}, "nothing of this log asks for it"),
    ],
)
def test_an_answer_that_is_none_is_refused(answers: dict[str, str], named: str, tmp_path: Path) -> None:
    with pytest.raises(InputRefusedError) as refusal:
        describe(maker_logs.phone(tmp_path).path, {"reference": "49.2 uT"} | answers)
    assert named in str(refusal.value)


SHARED = {
    "aero-vista/recording": ({}, ("magnetometer", "reference", "channels.temperature")),
    "suchai3/2023-08-24": ({}, ("magnetometer", "reference", "position", "channels.gyro")),
    "ardupilot/log171": ({}, ("position", "channels.attitude", "channels.current")),
    "broad/control-01": ({"reference": "43.2 uT"}, ("magnetometer", "reference", "channels.attitude", "channels.gyro")),
    "ground/sphere": ({"reference": "48.5 uT"}, ("magnetometer", "reference")),
}


@pytest.mark.parametrize("name", SHARED)
def test_a_real_log_is_described_as_by_hand(name: str, tmp_path: Path) -> None:
    import tomllib

    log = DATA / f"{name}.csv"
    if not log.exists():
        pytest.skip(f"the recording {name} is not in ../shared/data")
    answers, same = SHARED[name]
    text = describe(log, answers).text
    assert text is not None
    by_hand = DATA / (f"{name}-internal-attitude.toml" if "ardupilot" in name else f"{name}.toml")
    wanted, made = tomllib.loads(by_hand.read_text()), tomllib.loads(text)
    for key in same:
        section, _, channel = key.partition(".")
        left, right = made[section], wanted[section]
        assert (left[channel], key) == (right[channel], key) if channel else (left, key) == (right, key)
    assert made["time"]["format"] == wanted["time"]["format"]


def test_an_answered_unit_is_for_the_columns_that_can_have_it(tmp_path: Path) -> None:
    milligauss, counts = np.round(maker_logs.ground() / 100.0), np.round(maker_logs.ground(seed=9) / 13.0)
    rows = [f"{0.5 * i},{','.join(f'{v:.0f}' for v in both)}" for i, both in enumerate(np.hstack([milligauss, counts]))]
    log = tmp_path / "two.csv"
    log.write_text("\n".join(["t,imu_mx,imu_my,imu_mz,mag_x,mag_y,mag_z", *rows]))
    result = describe(log, {"magnetometer.unit": "mG", "reference": "49.2 uT"})
    assert result.text is not None
    assert 'columns = ["imu_mx", "imu_my", "imu_mz"]\nunit = "mG"' in result.text
    assert "mag_x" not in result.text


def test_a_position_without_its_altitude_stays_out_where_nothing_needs_it(tmp_path: Path) -> None:
    rows = [f"{0.5 * i},{x:.1f},{y:.1f},{z:.1f},48.1,11.5" for i, (x, y, z) in enumerate(maker_logs.ground())]
    log = tmp_path / "still.csv"
    log.write_text("\n".join(["t,mx_nT,my_nT,mz_nT,lat,lon", *rows]))
    result = described(log, reference="48.2 uT")
    assert {question.key for question in result.questions} == {"position.altitude_km"}
    assert result.text is not None
    assert "[position]" not in result.text
    assert "altitude_km = 0.5" in (described(log, reference="48.2 uT", position__altitude_km="0.5").text or "")


def test_names_that_a_terminal_would_obey_are_escaped_and_found_again(tmp_path: Path) -> None:
    rows = [f"{0.5 * i},{x:.1f},{y:.1f},{z:.1f}" for i, (x, y, z) in enumerate(maker_logs.ground())]
    log = tmp_path / "log.csv"
    log.write_text("\n".join(["t,mag\x9b31m_x_nT,mag\x9b31m_y_nT,mag\x9b31m_z_nT", *rows]), encoding="utf-8")
    result = described(log, reference="49.2 uT")
    assert result.text is not None
    assert all(one.isprintable() for line in [*result.lines(), *result.text.splitlines()] for one in line)
    assert read(log, result.text).report.used == len(rows)


def test_a_reference_in_north_east_down_may_stand_still(tmp_path: Path) -> None:
    vectors = maker_logs.ground()
    rows = [f"{0.5 * i},{x:.1f},{y:.1f},{z:.1f},20000,800,44900" for i, (x, y, z) in enumerate(vectors)]
    log = tmp_path / "ned.csv"
    log.write_text("\n".join(["t,b_x_nT,b_y_nT,b_z_nT,b_ned_n,b_ned_e,b_ned_d", *rows]))
    text = describe(log, {}).text or ""
    assert 'columns = ["b_ned_n", "b_ned_e", "b_ned_d"]\nunit = "nT"\nframe = "ned"' in text
