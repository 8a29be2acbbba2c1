"""When a checkpoint is due, by a clock that the test turns."""

from __future__ import annotations

import math

import pytest

from magcal_service.daemon.checkpoints import schedule
from magcal_service.daemon.checkpoints.schedule import Schedule


class Clock:
    """A monotonic clock that stands still until it is turned."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    turned = Clock()
    monkeypatch.setattr(schedule, "time", turned)
    return turned


def times(clock: Clock, schedule: Schedule, seconds: int, *, written: bool = True) -> list[float]:
    """When checkpoints were due within so many seconds, looked at every half."""
    found = []
    for _ in range(2 * seconds):
        clock.now_s += 0.5
        if schedule.due():
            found.append(clock.now_s - 100.0)
            schedule.done(written)
    return found


def test_pauses_grow_from_a_second_to_the_period(clock: Clock) -> None:
    assert times(clock, Schedule(20.0), 80) == [1.0, 3.0, 7.0, 15.0, 31.0, 51.0, 71.0]


def test_where_nothing_is_written_the_pause_stays(clock: Clock) -> None:
    """Before the first sample, and while the disk fails, it is tried every second."""
    kept = Schedule(20.0)
    assert times(clock, kept, 4, written=False) == [1.0, 2.0, 3.0, 4.0]
    assert times(clock, kept, 4) == [5.0, 7.0]


def test_one_that_is_asked_for_comes_at_once_and_not_twice_in_ten_seconds(clock: Clock) -> None:
    kept = Schedule(3600.0)
    times(clock, kept, 1000)  # at 511 s, then at 1023 s
    kept.ask()
    assert kept.due()
    kept.done(True)
    kept.ask()
    assert times(clock, kept, 30) == [1010.0]


def test_one_that_is_asked_for_and_not_written_is_tried_every_ten_seconds(clock: Clock) -> None:
    kept = Schedule(3600.0)
    times(clock, kept, 1000)
    kept.ask()
    assert times(clock, kept, 21, written=False) == [1000.5, 1010.5, 1020.5]


def test_without_a_period_there_is_none(clock: Clock) -> None:
    kept = Schedule(math.inf)
    kept.ask()
    assert times(clock, kept, 1000) == []


def test_one_that_is_asked_for_while_another_is_being_written_comes_after_it(clock: Clock) -> None:
    kept = Schedule(3600.0)
    times(clock, kept, 1000)
    kept.ask()
    kept.begin()
    kept.done(True)
    assert times(clock, kept, 20) == []
    kept.ask()
    kept.begin()
    kept.ask()
    kept.done(True)
    assert times(clock, kept, 20) == [1030.0]
