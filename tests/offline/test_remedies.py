"""Remedies of a calibration: what can be done about a recording, which is over."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

import magcal_service as magcal
from magcal_service.diagnosis.diagnose import diagnose
from magcal_service.model import measure
from magcal_service.offline.remedies import BY_ATTITUDE, remedy_of
from magcal_service.recordings.recording import Recording
from magcal_service.trust.reasons import Reason
from tests.offline.hand_turned import TRUTH

_OF_A_FLIGHT = re.compile(r"the status|\[craft|\[record\]|\breset\b|\bresume\b|\bwait\b|process_noise|sensor\.noise_nt")


@pytest.mark.parametrize("reason", Reason)
def test_no_remedy_of_a_recording_is_one_of_a_flight(reason: Reason) -> None:
    """A file has no status to look at, no [craft] and no command, and nothing comes any more."""
    assert remedy_of(reason)
    assert not _OF_A_FLIGHT.search(remedy_of(reason))


def test_at_one_place_a_longer_recording_is_not_advised() -> None:
    assert "record for longer" in remedy_of(Reason.NOT_SETTLED)
    assert "record for longer" not in remedy_of(Reason.NOT_SETTLED, of_one_place=True)


@pytest.mark.parametrize(("count", "step_s"), [(500, 0.5), (1000, 1.0)])
def test_an_attitude_that_is_there_is_not_asked_for(count: int, step_s: float) -> None:
    """At one place, of a log taken as one batch and of a longer one: the next step is the command that uses it, and it
    gives errors that hold."""
    turn = Rotation.random(count // 20 + 2, random_state=9502)
    body_from_room = Slerp(20.0 * np.arange(count // 20 + 2), turn)(np.arange(count))
    field = body_from_room.apply([20_000.0, -3000.0, 42_000.0])
    time_s, size = step_s * np.arange(count), np.full(count, np.linalg.norm(field[0]))
    noisy = measure(TRUTH, field + np.random.default_rng(9501).normal(0.0, 50.0, field.shape))
    without = Recording.from_arrays(time_s, noisy, size)
    given = Recording.from_arrays(time_s, noisy, size, attitude=body_from_room.as_quat()[:, [3, 0, 1, 2]])
    asked, told = magcal.calibrate(without).remedy, magcal.calibrate(given).remedy
    assert asked != BY_ATTITUDE == told
    found = diagnose(given)
    assert found.trusted
    assert np.abs((found.fit.x[:9] - TRUTH) / np.sqrt(np.diag(found.fit.covariance)[:9])).max() < 4.0
