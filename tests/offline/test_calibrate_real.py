"""Recordings made in orbit, through replay and calibrate: what must not be trusted is not."""

from pathlib import Path

import pytest

from magcal_service.base.errors import RecordingError
from magcal_service.offline.calibrate import Calibration, calibrate
from magcal_service.offline.replay import craft_of, replay
from magcal_service.recordings.reader import read_recording
from magcal_service.trust.reasons import Reason
from magcal_service.wire.messages import Verdict

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
IN_ORBIT = (
    "suchai3/2023-08-24",
    "suchai3/2023-11-13",
    "suchai3/2024-passes",
    "iss-2017/recording",
    "iss-2022-ir/recording",
)
_done: dict[str, Calibration] = {}


def path_of(name: str) -> Path:
    path = DATA / f"{name}.toml"
    if not path.exists():
        pytest.skip(f"the recording {name} is not in ../shared/data")
    return path


def calibrated(name: str) -> Calibration:
    path = path_of(name)
    if name not in _done:
        _done[name] = calibrate(path)
    return _done[name]


@pytest.mark.parametrize("name", IN_ORBIT)
def test_what_a_static_model_does_not_explain_is_not_trusted(name: str) -> None:
    result = calibrated(name)
    assert not result.trusted
    assert result.reasons
    assert result.remedy


@pytest.mark.parametrize("name", ["suchai3/2023-11-13", "iss-2017/recording", "suchai3/2024-passes"])
def test_a_replay_comes_to_the_same_state(name: str) -> None:
    recording = read_recording(path_of(name))
    state = replay(recording, craft_of(recording)).pipeline.estimator.estimate()
    assert state.x.tolist() == calibrated(name).x.tolist()


def test_an_orbit_of_suchai_leaves_what_nine_errors_cannot_hold() -> None:
    """A static fit leaves about 1900 nT at a sensor noise near 240 nT."""
    result = calibrated("suchai3/2023-08-24")
    assert result.residuals.before > 50_000.0
    assert 1_800.0 < result.residuals.after < 2_600.0
    assert result.residuals.noise_floor < 500.0
    assert result.verdict is Verdict.DOUBTFUL
    assert Reason.STRUCTURED_RESIDUAL in result.reasons


def test_the_station_leaves_thousands_of_nanotesla() -> None:
    result = calibrated("iss-2022-ir/recording")
    assert 3_000.0 < result.residuals.after < result.residuals.before
    assert Reason.STRUCTURED_RESIDUAL in result.reasons


def test_too_short_a_recording_is_refused_with_its_number(tmp_path: Path) -> None:
    source = path_of("iss-2017/recording")
    lines = (source.parent / "recording.csv").read_text().splitlines()
    (tmp_path / "recording.csv").write_text("\n".join(lines[:30]) + "\n")
    (tmp_path / "recording.toml").write_text(source.read_text())
    with pytest.raises(RecordingError, match=r"samples: 29 is refused; at least 50"):
        calibrate(tmp_path / "recording.toml")
