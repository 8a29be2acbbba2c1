"""Losses, doubles, late messages and restarts, from sequence numbers alone."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from magcal_service.links.inbox import Inbox
from magcal_service.links.sequence import SequenceTracker, SourceRecord
from tests.links.link_messages import SECOND_NS, sample


def record_of(numbers: list[int], times_s: list[int] | None = None) -> SourceRecord:
    """The record after messages of these numbers, one second apart by number unless times are given."""
    record = SourceRecord("alpha", "mag", "magnetometer")
    for number, time_s in zip(numbers, times_s or numbers, strict=True):
        record.note(number, time_s * SECOND_NS)
    return record


def sums(record: SourceRecord) -> dict[str, int]:
    names = ("received", "lost", "doubled", "late", "restarts")
    return {name: value for name in names if (value := getattr(record, name))}


TOP = 2**32


@pytest.mark.parametrize(
    ("numbers", "times_s", "expected"),
    [
        pytest.param([0, 1, 2], None, {"received": 3}, id="in order"),
        pytest.param([500, 501], None, {"received": 2}, id="joined in the middle"),
        pytest.param([0, 3], None, {"received": 2, "lost": 2}, id="gap"),
        pytest.param([0, 1, 1, 2], None, {"received": 4, "doubled": 1}, id="doubled"),
        pytest.param([0, 1, 2, 1], None, {"received": 4, "doubled": 1}, id="doubled later"),
        pytest.param([0, 2, 1, 3], None, {"received": 4, "late": 1}, id="out of order is not lost"),
        pytest.param([0, 4, 2], None, {"received": 3, "lost": 2, "late": 1}, id="one of three was late"),
        pytest.param([TOP - 2, TOP - 1, 0, 1], [1, 2, 3, 4], {"received": 4}, id="wraps"),
        pytest.param([TOP - 2, 1], [1, 4], {"received": 2, "lost": 2}, id="gap over the wrap"),
        pytest.param([0, TOP - 1], [5, 4], {"received": 2, "late": 1}, id="late over the wrap"),
        pytest.param([900, 901, 0, 1], [1, 2, 9, 10], {"received": 4, "restarts": 1}, id="restart"),
        pytest.param([0, 1, 2, 0, 1], [1, 2, 3, 9, 10], {"received": 5, "restarts": 1}, id="restart soon"),
        pytest.param([30, 0, 1], [1, 9, 10], {"received": 3, "restarts": 1}, id="restart within the window"),
        pytest.param([5000, 0], [5000, 0], {"received": 2, "restarts": 1}, id="restart with its clock"),
        pytest.param([7, 0, 3], [1, 9, 12], {"received": 3, "lost": 2, "restarts": 1}, id="gap after a restart"),
        pytest.param([100, 36], None, {"received": 2, "late": 1}, id="late by the whole window"),
        pytest.param([100, 35], None, {"received": 2, "restarts": 1}, id="restart beyond the window"),
        pytest.param([5, 4], [9, 9], {"received": 2, "late": 1}, id="late in the same instant"),
        pytest.param([0, TOP // 2 - 1], [1, 2], {"received": 2, "lost": TOP // 2 - 2}, id="longest gap"),
        pytest.param([0, TOP // 2], [1, 2], {"received": 2, "restarts": 1}, id="half the circle is behind"),
        pytest.param([*range(65), 1], None, {"received": 66, "doubled": 1}, id="doubled within the window"),
        pytest.param([*range(66), 1], None, {"received": 67, "late": 1}, id="forgotten beyond the window"),
    ],
)
def test_each_history_is_counted_for_what_it_is(
    numbers: list[int], times_s: list[int] | None, expected: dict[str, int]
) -> None:
    assert sums(record_of(numbers, times_s)) == expected


@pytest.mark.parametrize("seed", range(5))
def test_random_drops_are_counted_exactly_over_the_wrap(seed: int) -> None:
    kept = np.random.default_rng(seed).random(3000) < 0.7
    kept[0] = kept[-1] = True
    numbers = [(TOP - 1500 + int(i)) % TOP for i in np.flatnonzero(kept)]
    record = record_of(numbers, list(range(len(numbers))))
    assert sums(record) == {"received": len(numbers), "lost": 3000 - len(numbers)}


@pytest.mark.parametrize("seed", range(5))
def test_reordering_within_the_window_loses_nothing(seed: int) -> None:
    order = np.argsort(np.arange(1000) + np.random.default_rng(seed).uniform(0.0, 30.0, 1000))
    numbers = [int(i) for i in order]
    first = numbers.index(0)
    record = record_of(numbers[first:])
    assert record.lost + record.received == 1000
    assert record.restarts == record.doubled == 0


def test_sources_are_kept_apart_and_summed() -> None:
    counters: Counter[str] = Counter()
    tracker = SequenceTracker(counters, 10)
    for number in (0, 2):
        tracker.note(sample(number, source="one"))
    for number in (0, 4, 1):
        tracker.note(sample(number, source="two"))
    assert [(record.source, record.lost) for record in tracker.records()] == [("one", 1), ("two", 2)]
    assert (counters["lost"], counters["late"]) == (3, 1)


def test_invented_sources_take_bounded_memory() -> None:
    counters: Counter[str] = Counter()
    tracker = SequenceTracker(counters, 3)
    for number in range(10):
        tracker.note(sample(0, source=f"s{number}"))
    assert (len(tracker.records()), counters["untracked"]) == (3, 7)


def test_a_full_inbox_lets_the_oldest_go_and_says_so() -> None:
    gone: list[None] = []
    inbox: Inbox[int] = Inbox(3, lambda: gone.append(None))
    for item in range(5):
        inbox.put(item)
    assert (inbox.drain(0.0), len(gone)) == ([2, 3, 4], 2)
