"""A range that the descriptor states, in every command: what reaches it is named, and no fit uses it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import RecordingError
from magcal_service.config.settings import SensorConfig
from magcal_service.diagnosis.answer import diagnose
from magcal_service.model import Array, measure
from magcal_service.offline.apply import apply
from magcal_service.offline.calibrate import calibrate
from magcal_service.offline.given import Given, read_given
from magcal_service.offline.replay import craft_of
from magcal_service.recordings.defects import Code
from magcal_service.recordings.inspect.inspection import inspect
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording

RANGE_NT = 46_800.0
X = np.array([4000.0, -2500.0, 1200.0, 0.03, -0.05, 0.02, 0.01, -0.02, 0.015])
DESCRIPTOR = """version = 1
[samples]
file = "log.csv"
[time]
column = "t"
format = "elapsed_s"
[magnetometer]
columns = ["x", "y", "z"]
unit = "uT"
{range}[reference]
magnitude = "h"
unit = "nT"
[platform]
kind = "orbit"
"""


def flown() -> tuple[Array, Array, Array]:
    """Times [s], B (n, 3) of a turning craft on a lattice of 600 nT that ends at the range, and |H| [nT]."""
    rng = np.random.default_rng(94)
    time_s = np.arange(6000.0)
    angle, slow = 0.349 * time_s, 2.0 * np.pi * time_s / 2900.0
    size = 35_000.0 + 9000.0 * np.cos(2.0 * slow)
    across, along = np.cos(slow + 0.4), np.sin(slow + 0.4)
    field = size[:, None] * np.stack([across * np.cos(angle), across * np.sin(angle), along], axis=1)
    body = np.round(measure(X, field + rng.normal(0.0, 200.0, field.shape)) / 600.0) * 600.0
    return time_s, np.clip(body, -RANGE_NT, RANGE_NT), size


def written(folder: Path, stated: str) -> Path:
    time_s, body, size = flown()
    rows = np.column_stack([time_s, body / 1000.0, size])
    np.savetxt(folder / "log.csv", rows, delimiter=",", header="t,x,y,z,h", comments="", fmt="%.6g")
    (folder / "RECORDING.toml").write_text(DESCRIPTOR.format(range=stated))
    return folder / "RECORDING.toml"


@pytest.fixture(scope="module")
def stated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("stated"), f"range_nt = {RANGE_NT}\n")


def test_inspect_finds_what_reaches_it_and_not_without_it(stated: Path, tmp_path: Path) -> None:
    """It says that the descriptor states the range: the samples alone do not show it."""
    (found,) = inspect(read_recording(stated)).findings
    assert (found.code, found.certain) == (Code.SATURATED, True)
    assert "-46800 nT on y: the end of the range that the descriptor states" in found.says
    assert inspect(read_recording(written(tmp_path, ""))).findings == ()


def test_calibrate_and_replay_use_no_row_that_reaches_it(stated: Path) -> None:
    """The daemon's own limit is the same, for a session's messages and for what is live."""
    recording = read_recording(stated)
    assert craft_of(recording).sensor == SensorConfig(range_nt=RANGE_NT)
    assert inspect(recording).usable.field_body_nt.min(axis=0)[1] > -RANGE_NT
    result = calibrate(recording)
    assert result.rows.used == len(recording) - result.findings[0].rows
    assert np.abs(result.x[:3] - X[:3]).max() < 200.0


def test_apply_gives_no_vector_of_a_row_that_reaches_it(stated: Path, tmp_path: Path) -> None:
    recording = read_recording(stated)
    path = tmp_path / "result.json"
    path.write_text(calibrate(recording).as_json())
    given: Given = read_given(path)
    inspection = inspect(recording)
    assert len(apply(given, inspection).vectors) == len(recording) - inspection.findings[0].rows


def test_diagnose_names_it(stated: Path) -> None:
    """As sure as the data sheet is, with the rows left out of the fit."""
    answer = diagnose(stated)
    entry = next(one for one in answer.effects if one.effect == "saturation")
    assert entry.parameters["limit_nt"].value.tolist() == [-RANGE_NT]
    assert entry.probability > 0.99
    assert answer.content["rows"]["left_out"]["spoiled"] > 0


def test_readings_that_go_on_beyond_it_are_asked_about(tmp_path: Path) -> None:
    """A sensor reads no further than its range: the largest reading is said, and no row is left out."""
    path = written(tmp_path, "range_nt = 30000.0\n")
    inspection = inspect(read_recording(path))
    (found,) = inspection.open
    assert (found.code, found.remedy) == (Code.SATURATED, "check magnetometer.range_nt [nT]")
    assert "45600 nT" in found.says
    assert inspection.account.used == len(inspection.recording)
    answer = diagnose(path)
    assert (answer.trusted, answer.effects) == (False, ())
    assert "recording_doubtful" in answer.reasons


def test_a_range_a_little_below_the_largest_readings_leaves_these_out(tmp_path: Path) -> None:
    """As where the factory has set a factor for each axis."""
    inspection = inspect(read_recording(written(tmp_path, "range_nt = 45000.0\n")))
    assert not inspection.open
    assert {one.says.split(" nT on ")[1][0] for one in inspection.findings} == {"x", "y"}
    assert np.abs(inspection.usable.field_body_nt).max() < 45_000.0


def test_arrays_have_a_range_too() -> None:
    time_s, body, size = flown()
    recording = Recording.from_arrays(time_s, body, size, range_nt=RANGE_NT)
    assert [one.code for one in inspect(recording).findings] == [Code.SATURATED]
    with pytest.raises(RecordingError, match="range_nt: 10"):
        Recording.from_arrays(time_s, body, size, range_nt=10.0)
