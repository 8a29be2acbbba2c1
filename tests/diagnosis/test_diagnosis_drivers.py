"""Channels that resemble one another, channels that drive nothing, and a quadrotor's current."""

from __future__ import annotations

import numpy as np
import pytest

from magcal_service.diagnosis.diagnose import Verdict, diagnose
from magcal_service.diagnosis.result import entries
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from tests.benchmarks.bench_drivers import driven, idle, named
from tests.benchmarks.bench_suchai3 import DATA

DRONE = DATA / "ardupilot"


@pytest.mark.parametrize("seed", [100, 101, 102])
def test_the_channel_that_drives_is_in_the_class(seed: int) -> None:
    """Of twenty that go along with one another by 0.9 to 0.99 no false one is given for sure."""
    truth, diagnosis = driven(seed)
    first = named(diagnosis)[0]
    assert first.effect == "current_loop"
    assert truth in [name for name, _ in first.drivers]
    assert all(chance < 0.95 for name, chance in first.drivers if name != truth)
    assert first.as_json()["drivers"][0]["driver"] == first.drivers[0][0]


@pytest.mark.parametrize("seed", [100, 101, 102])
def test_channels_that_drive_nothing_are_not_named(seed: int) -> None:
    assert named(idle(seed)) == []


def every_second(name: str) -> Recording:
    """Every second row, at 5 Hz, as quick as the current changes: half of the rows takes a third of the time."""
    recording = read_recording(DRONE / name)
    return recording.select(np.arange(len(recording)) % 2 == 0)


@pytest.mark.skipif(not DRONE.exists(), reason="the recording ardupilot/log171 is not in ../shared/data")
def test_the_compass_inside_a_quadrotor_follows_its_current() -> None:
    """Half of what is left without it is left with it at the most."""
    found = diagnose(every_second("log171-internal.toml"))
    first = entries(found)[0]
    assert (first.effect, first.driver) == ("current_loop", "channel:current")
    assert found.fit.held_out_rms_nt < 0.5 * found.prepared.baseline.held_out_rms_nt


@pytest.mark.skipif(not DRONE.exists(), reason="the recording ardupilot/log171 is not in ../shared/data")
def test_the_compass_on_its_mast_is_not_told_a_cause_to_act_on() -> None:
    found = diagnose(every_second("log171-external.toml"))
    assert found.verdict is Verdict.UNKNOWN
    assert not found.trusted
