"""The limits of the tracks of references and rates, each from both sides."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace

import pytest

from magcal_service.config.settings import SensorConfig
from magcal_service.ticks.assembler import SECOND_NS, TickAssembler
from magcal_service.ticks.rate_track import RateTrack
from magcal_service.ticks.reference_track import ReferenceTrack
from magcal_service.wire.messages import Clock
from tests.ticks.tick_messages import CONFIG, answered, at, rate, referred
from tests.ticks.tick_streams import START_NS, counted, ns, reference

# References


def track(max_gap_s: float = 10.0, late_s: float = 30.0, jump_s: float = 600.0) -> tuple[ReferenceTrack, Counter[str]]:
    counters: Counter[str] = Counter()
    return ReferenceTrack(
        *(round(max_gap_s * SECOND_NS), counters, round(late_s * SECOND_NS), round(jump_s * SECOND_NS))
    ), counters


@pytest.mark.parametrize(
    ("second", "more_ns", "kept"),
    [(700.0, 0, True), (700.0, 1, False), (70.0, 0, True), (70.0, -1, False)],
)
def test_a_reference_may_be_so_far_from_the_newest(second: float, more_ns: int, kept: bool) -> None:
    target, counters = track()
    target.add(reference(50.0))
    target.add(reference(100.0))
    target.add(referred(second, more_ns))
    assert counters["reference"] == (3 if kept else 2)
    assert (target.at(ns(100.0), Clock.UTC) is None) is not kept  # a vote is in the air


@pytest.mark.parametrize(
    ("max_gap_s", "late_s", "most_s"), [(10.0, 30.0, 30.0), (40.0, 30.0, 40.0)], ids=["late_s", "max_gap_s"]
)
@pytest.mark.parametrize(("more_ns", "steps"), [(0, 1), (1, 0)])
def test_three_references_at_most_so_far_apart_agree(
    max_gap_s: float, late_s: float, most_s: float, more_ns: int, steps: int
) -> None:
    target, counters = track(max_gap_s, late_s)
    target.add(reference(0.0))
    first, step_ns = referred(5000.0), round(most_s * SECOND_NS)
    for number in range(3):
        target.add(replace(first, time_ns=first.time_ns + number * (step_ns + more_ns)))
    assert counters["reference_step"] == steps
    assert counters["reference"] == 1 + 3 * steps


@pytest.mark.parametrize(("step_ns", "steps"), [(1, 1), (0, 0), (-1, 0)])
def test_references_that_agree_rise(step_ns: int, steps: int) -> None:
    target, counters = track()
    target.add(reference(0.0))
    for number in range(3):
        target.add(referred(5000.0, number * step_ns))
    assert counters["reference_step"] == steps


def test_votes_of_two_clocks_do_not_agree() -> None:
    target, counters = track()
    target.add(reference(0.0))
    for second, clock in ((5000.0, Clock.UTC), (5001.0, Clock.ELAPSED), (5002.0, Clock.ELAPSED)):
        target.add(referred(second, 0, clock))
    assert (counters["reference_step"], counters["reference_jump"]) == (0, 1)
    target.add(referred(5003.0, 0, Clock.ELAPSED))
    assert (counters["reference_step"], counters["reference_jump"]) == (1, 1)
    assert target.at(ns(5002.5), Clock.ELAPSED) is not None
    assert target.at(ns(0.0), Clock.UTC) is None


def test_a_reference_that_fits_ends_the_vote() -> None:
    target, counters = track()
    for second in (0.0, 5000.0, 5001.0, 1.0):
        target.add(reference(second))
    assert (counters["reference"], counters["reference_jump"]) == (2, 2)
    assert target.covers(ns(1.0), Clock.UTC)


@pytest.mark.parametrize(("magnitude_nt", "counter"), [(1.0, "reference"), (0.999, "reference_zero")])
@pytest.mark.parametrize("as_vector", [False, True])
def test_a_reference_of_less_than_1_nt_is_no_field(magnitude_nt: float, counter: str, as_vector: bool) -> None:
    target, counters = track()
    field_nt = (0.0, -magnitude_nt, 0.0) if as_vector else None
    magnitude = None if as_vector else magnitude_nt
    target.add(replace(reference(0.0), field_nt=field_nt, magnitude_nt=magnitude))
    assert counted(counters) == {counter: 1}


@pytest.mark.parametrize(("more_ns", "found"), [(0, True), (1, False)])
def test_references_at_most_the_gap_apart_are_interpolated_between(more_ns: int, found: bool) -> None:
    target, _ = track()
    target.add(reference(0.0))
    target.add(referred(10.0, more_ns))
    assert (target.at(ns(4.0), Clock.UTC) is not None) is found
    assert target.at(ns(10.0) + more_ns, Clock.UTC) is not None


@pytest.mark.parametrize(("at_second", "clock", "expected"), [(0.0, Clock.UTC, True), (2.0, Clock.UTC, True)])
def test_a_time_up_to_the_newest_is_covered(at_second: float, clock: Clock, expected: bool) -> None:
    target, _ = track()
    for second in (0.0, 2.0):
        target.add(reference(second))
    assert target.covers(ns(at_second), clock) is expected
    assert not target.covers(ns(2.0) + 1, clock)
    assert not target.covers(ns(at_second), Clock.ELAPSED)


def test_a_vector_is_interpolated_in_each_component() -> None:
    target, _ = track()
    target.add(replace(reference(0.0), field_nt=(10_000.0, -20_000.0, 5000.0)))
    target.add(replace(reference(4.0), field_nt=(12_000.0, 20_000.0, 9000.0)))
    found = target.at(ns(1.0), Clock.UTC)
    assert found is not None
    assert found.field_eci_nt == (10_500.0, -10_000.0, 6000.0)
    assert found.magnitude_nt == pytest.approx(math.sqrt(10_500.0**2 + 10_000.0**2 + 6000.0**2), rel=1e-15)


def test_the_magnitude_of_a_vector_is_its_length() -> None:
    target, _ = track()
    target.add(replace(reference(0.0), field_nt=(2000.0, -3000.0, 6000.0)))
    found = target.at(ns(0.0), Clock.UTC)
    assert found is not None
    assert found.magnitude_nt == 7000.0


@pytest.mark.parametrize(("more", "oldest"), [(0, 0), (1, 1), (5, 5)])
def test_8192_references_are_kept_and_the_oldest_go(more: int, oldest: int) -> None:
    target, _ = track()
    for second in range(8192 + more):
        target.add(reference(second))
    assert len(target._times) == len(target._found) == 8192
    assert target._times[0] == ns(oldest)
    assert [target.at(ns(second), Clock.UTC) is not None for second in (oldest - 1, oldest)] == [False, True]


@pytest.mark.parametrize(("second", "oldest"), [(257, 0), (258, 129), (300, 171)])
def test_of_many_used_references_the_last_128_stay(second: int, oldest: int) -> None:
    """Nothing is forgotten before there are twice as many."""
    target, _ = track()
    for each in range(400):
        target.add(reference(each))
    target.discard_before(ns(second))
    assert (target._times[0], len(target._found)) == (ns(oldest), 400 - oldest)
    assert target.at(ns(second - 0.5), Clock.UTC) is not None


@pytest.mark.parametrize("changed", ["field", "clock", "time"])
def test_only_the_very_same_reference_is_known_again(changed: str) -> None:
    """Far behind: the same is doubled, any other is a vote for another time."""
    target, counters = track()
    for second in range(100):
        target.add(reference(second))
    target.add(reference(40.0))
    assert counters["reference_doubled"] == 1
    other = {
        "field": replace(reference(40.0), field_nt=(0.0, 0.0, 4e4)),
        "clock": reference(40.0, Clock.ELAPSED),
        "time": referred(40.0, 1),
    }
    target.add(other[changed])
    assert counters["reference_doubled"] == 1
    assert target.at(ns(50.0), Clock.UTC) is None


# Rates


@pytest.mark.parametrize(("more_ns", "found"), [(0, True), (1, False)])
def test_rates_at_most_the_gap_apart_are_interpolated_between(more_ns: int, found: bool) -> None:
    target = RateTrack(10 * SECOND_NS)
    target.add(rate(0.0, (0.0, 10.0, -5.0)))
    target.add(replace(rate(10.0, (10.0, 0.0, 5.0)), time_ns=ns(10.0) + more_ns))
    value = target.at(ns(4.0), Clock.UTC)
    assert (value is not None) is found
    assert value is None or value == pytest.approx((4.0, 6.0, -1.0))


def test_rates_out_of_order_are_sorted_in_and_doubles_refused() -> None:
    target = RateTrack(10 * SECOND_NS)
    answers = [target.add(rate(second, (second, 0.0, 0.0))) for second in (0.0, 4.0, 2.0, 3.0)]
    answers += [target.add(rate(second, (9.0, 9.0, 9.0))) for second in (0.0, 3.0, 4.0)]
    assert answers == [True] * 4 + [False] * 3
    assert [target.at(ns(second), Clock.UTC) for second in (0.0, 1.0, 2.5, 4.0)] == [
        (0.0, 0.0, 0.0),
        (1.0, 0.0, 0.0),
        (2.5, 0.0, 0.0),
        (4.0, 0.0, 0.0),
    ]


def test_a_rate_of_another_clock_starts_the_track_anew() -> None:
    target = RateTrack(10 * SECOND_NS)
    target.add(rate(0.0, (1.0, 1.0, 1.0)))
    assert target.add(rate(5.0, (2.0, 2.0, 2.0), Clock.ELAPSED))
    assert [target.at(ns(0.0), clock) for clock in Clock] == [None, None]
    assert target.at(ns(5.0), Clock.ELAPSED) == (2.0, 2.0, 2.0)


@pytest.mark.parametrize(("more", "oldest"), [(0, 0), (1, 1)])
def test_8192_rates_are_kept_and_the_oldest_go(more: int, oldest: int) -> None:
    target = RateTrack(10 * SECOND_NS)
    for second in range(8192 + more):
        target.add(rate(second, (float(second), 0.0, 0.0)))
    assert len(target._times) == len(target._rates) == 8192
    assert target.at(START_NS + oldest * SECOND_NS, Clock.UTC) == (float(oldest), 0.0, 0.0)
    assert target.at(ns(oldest - 0.5), Clock.UTC) is None


@pytest.mark.parametrize(("noise_nt", "held"), [(50.0, True), (0.5, False), (None, False)])
def test_a_reading_that_is_held_is_answered_and_not_learned_from_again(noise_nt: float | None, held: bool) -> None:
    """Values 5 nT apart: noise of 50 nT changes them all, noise of half a nanotesla would not."""
    target = TickAssembler(CONFIG, SensorConfig(noise_nt=noise_nt, stuck_samples=30))
    for number in range(90):
        value = 5.0 * (number // 3 % 7) + 1000.0
        field = (value, value + 1.0, value + 2.0)
        assert answered(target, replace(at(number / 3.0), field_body_nt=field)) == ""
        target.add_reference(referred(number / 3.0))
    learned = sum(len(tick.times_s) for tick in target.flush())
    assert target.counters["accepted"] == 90
    assert learned == 90 - target.counters["held"]
    assert (55 <= target.counters["held"] <= 60) is held
    assert (target.counters["held"] == 0) is not held
