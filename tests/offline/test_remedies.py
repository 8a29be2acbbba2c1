"""Remedies of a calibration: what can be done about a recording, which is over."""

from __future__ import annotations

import re

import pytest

from magcal_service.offline.remedies import remedy_of
from magcal_service.trust.reasons import Reason

_OF_A_FLIGHT = re.compile(r"the status|\[craft|\[record\]|\breset\b|\bresume\b|\bwait\b|process_noise|sensor\.noise_nt")


@pytest.mark.parametrize("reason", Reason)
def test_no_remedy_of_a_recording_is_one_of_a_flight(reason: Reason) -> None:
    """A file has no status to look at, no [craft] and no command, and nothing comes any more."""
    assert remedy_of(reason)
    assert not _OF_A_FLIGHT.search(remedy_of(reason))


def test_at_one_place_a_longer_recording_is_not_advised() -> None:
    assert "record for longer" in remedy_of(Reason.NOT_SETTLED)
    assert "record for longer" not in remedy_of(Reason.NOT_SETTLED, of_one_place=True)
