"""The limits of the tick stage, each from both sides: one nanosecond, one sample or one nanotesla more or less."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.config.settings import SensorConfig
from magcal_service.ticks.assembler import SECOND_NS, TickAssembler
from magcal_service.wire.messages import Clock, MagnetometerSample, ReferenceSample, Vector
from tests.ticks.tick_messages import CONFIG, answered, at, rate, referred
from tests.ticks.tick_streams import assembler, ns, offer, play, reference, sample

# Times of samples


@pytest.mark.parametrize(
    ("second", "more_ns", "answer"),
    [
        (1600.0, 0, ""),
        (1600.0, 1, "time_ahead"),
        (970.0, 0, ""),
        (970.0, -1, "time_behind"),
        (1000.0, 0, "doubled"),
        (999.0, 0, ""),
    ],
)
def test_a_time_may_be_so_far_from_the_newest(second: float, more_ns: int, answer: str) -> None:
    """The newest is 1000 s after the first; no tick has closed, so nothing is late."""
    target = assembler(CONFIG)
    for when in (0.0, 500.0, 1000.0):
        assert answered(target, at(when)) == ""
    assert answered(target, replace(at(second, more_ns), field_body_nt=(1.0, 2.0, 4.0))) == answer
    assert target.counters[answer or "accepted"] == (1 if answer else 4)


def test_a_sample_of_another_clock_is_never_the_double_of_one_of_ours() -> None:
    target = assembler(CONFIG)
    target.add(at(0.0))
    assert answered(target, at(0.0, clock=Clock.ELAPSED)) == "clock_changed"


@pytest.mark.parametrize(("more_ns", "answer"), [(-1, "late"), (0, "")])
def test_a_sample_is_late_once_its_tick_is_closed(more_ns: int, answer: str) -> None:
    """The tick of second 4 ends at 4.5 s and closes with the sample at 5 s, which its reference covers."""
    target = assembler(CONFIG)
    for second in range(6):
        target.add_reference(reference(second))
        target.add(at(second))
    assert [tick.index for tick in target.ready()] == [0, 1, 2, 3, 4]
    assert answered(target, at(4.5, more_ns)) == answer


def test_before_the_first_sample_half_a_second_is_open() -> None:
    assert [assembler_after_first(at(-0.5, more_ns)) for more_ns in (-1, 0)] == ["late", ""]


def assembler_after_first(second: MagnetometerSample) -> str:
    target = assembler(CONFIG)
    target.add(at(0.0))
    return answered(target, second)


@pytest.mark.parametrize(("more_ns", "gaps"), [(0, 0), (1, 1)])
def test_a_pause_is_a_gap_beyond_gap_s(more_ns: int, gaps: int) -> None:
    """Counted when the sample comes, and said in the tick; the seconds of a shorter pause are empty ticks."""
    stream = [reference(0.0), at(0.0), *map(reference, range(5, 75, 5)), at(60.0, more_ns), reference(75.0)]
    ticks, counters = play(stream, assembler(CONFIG))
    assert counters["gap"] == gaps
    assert [tick.after_gap for tick in ticks] == [False, bool(gaps)]
    assert counters["ticks_empty"] == (0 if gaps else 59)


def test_a_gap_is_told_once() -> None:
    stream = [reference(0.0), at(0.0), *map(referred, range(5, 110, 5)), at(100.0), at(101.0), at(102.0)]
    assert [tick.after_gap for tick in play(stream, assembler(CONFIG))[0]] == [False, True, False, False]


def test_newest_is_the_latest_time_whatever_comes_after_it() -> None:
    target = assembler(CONFIG)
    for second in (0.0, 12.5, 11.0):
        target.add(at(second))
    assert target.newest_s == 12.5
    assert target.counters["out_of_order"] == 1


def test_samples_at_the_newest_time_less_or_more_are_in_order() -> None:
    target = assembler(CONFIG)
    for more_ns in (0, 1, 2, 1 * SECOND_NS, 1 * SECOND_NS - 1):
        target.add(at(0.0, more_ns))
    assert target.counters["out_of_order"] == 1


# Steps of the clock


@pytest.mark.parametrize(
    ("steps_ns", "answers"),
    [
        ((1, 1), ["time_ahead", "time_ahead", ""]),
        ((60 * SECOND_NS, 60 * SECOND_NS), ["time_ahead", "time_ahead", ""]),
        ((60 * SECOND_NS + 1, 1), ["time_ahead"] * 3),
        ((1, 60 * SECOND_NS + 1), ["time_ahead"] * 3),
        ((0, 1), ["time_ahead"] * 3),
        ((-1, 1), ["time_ahead"] * 3),
    ],
)
def test_three_times_that_rise_by_at_most_gap_s_agree(steps_ns: tuple[int, int], answers: list[str]) -> None:
    target = assembler(CONFIG)
    target.add(at(0.0))
    times_ns = np.cumsum([ns(5000.0), *steps_ns]).tolist()
    assert [answered(target, replace(sample(5000.0 + n), time_ns=time)) for n, time in enumerate(times_ns)] == answers


@pytest.mark.parametrize("clock", [Clock.UTC, Clock.ELAPSED])
def test_over_a_step_elapsed_time_goes_on_by_one_second(clock: Clock) -> None:
    """Three samples an hour back, or of the other clock: the third is the first of the new time."""
    target = assembler(CONFIG)
    stream = [m for second in range(10) for m in (reference(second), at(second))]
    stream += [m for n in range(5) for m in (referred(-3600.0 + n, 0, clock), at(-3600.0 + n, 0, clock))]
    ticks, counters = play(stream, target)
    assert [tick.index for tick in ticks] == [*range(13)]
    assert [tick.index for tick in ticks if tick.after_gap] == [10]
    assert [tick.times_s.tolist() for tick in ticks[10:]] == [[10.0], [11.0], [12.0]]
    assert [tick.time_ns for tick in ticks[9:11]] == [ns(9.0), ns(-3598.0)]
    assert {tick.clock for tick in ticks[10:]} == {clock}
    assert (counters["clock_step"], counters["ticks_empty"]) == (1, 0)


def test_a_step_ahead_that_is_believed_is_a_gap_of_its_length() -> None:
    target = assembler(CONFIG)
    for second in (0.0, 5000.0, 5001.0, 5002.0):
        target.add(at(second))
    assert (target.newest_s, target.counters["clock_step"], target.counters["gap"]) == (5002.0, 0, 1)


def test_times_from_before_a_step_are_no_doubles_after_it() -> None:
    """The clock is set back by 100 s: the same labels come again."""
    target = assembler(CONFIG)
    for second in range(100):
        target.add(at(second))
    again = [replace(at(second), field_body_nt=(9.0, 8.0, second + 1.0)) for second in range(5)]
    assert [answered(target, message) for message in again] == ["time_behind", "time_behind", "", "", ""]


def test_a_good_sample_among_votes_ends_the_vote() -> None:
    target = assembler(CONFIG)
    answers = [answered(target, at(second)) for second in (0.0, 5000.0, 5001.0, 1.0, 5002.0, 5003.0, 5004.0)]
    assert answers == ["", "time_ahead", "time_ahead", "", "time_ahead", "time_ahead", ""]


# Values of samples


@pytest.mark.parametrize(
    ("field_nt", "answer"),
    [
        ((49_999.9, 1.0, 1.0), ""),
        ((50_000.0, 1.0, 1.0), "saturated"),
        ((1.0, -50_000.0, 1.0), "saturated"),
        ((1.0, 1.0, 50_000.1), "saturated"),
        ((40_000.0, 40_000.0, 40_000.0), ""),
        ((0.0, 0.0, 0.0), "zero"),
        ((0.0, 0.0, 1e-9), ""),
    ],
)
def test_a_component_that_reaches_the_range_is_saturated_and_three_zeros_are_no_sample(
    field_nt: Vector, answer: str
) -> None:
    target = TickAssembler(CONFIG, SensorConfig(range_nt=50_000.0))
    assert answered(target, replace(at(0.0), field_body_nt=field_nt)) == answer


def test_without_a_range_nothing_is_saturated() -> None:
    assert assembler(CONFIG).add(replace(at(0.0), field_body_nt=(1e9, 1.0, 1.0))) is None


@pytest.mark.parametrize("sensor_fewest", [3, 5])
def test_the_same_vector_is_stuck_from_the_configured_number_on(sensor_fewest: int) -> None:
    target = TickAssembler(CONFIG, SensorConfig(stuck_samples=sensor_fewest))
    fields = [(1.0, 2.0, 3.0)] * 6 + [(1.0, 2.0, 3.5)] + [(1.0, 2.0, 3.0)] * 6
    answers = [answered(target, replace(at(n), field_body_nt=field)) for n, field in enumerate(fields)]
    run = [""] * (sensor_fewest - 1) + ["stuck"] * (7 - sensor_fewest)
    assert answers == [*run, "", *run]


def test_an_axis_that_stands_still_is_refused_until_it_moves() -> None:
    """Noise of 10 nT and values 1 nT apart: the third of the same is a fault of that axis."""
    target = TickAssembler(CONFIG, SensorConfig(noise_nt=10.0, stuck_samples=3))
    values = [100.0, 101.0, 101.0, 101.0, 101.0, 102.0]
    answers = [answered(target, replace(at(n), field_body_nt=(x, 50.0 * n, -30.0 * n))) for n, x in enumerate(values)]
    assert answers == ["", "", "", "axis_stuck", "axis_stuck", ""]


def test_a_coarse_axis_is_refused_after_the_configured_time() -> None:
    target = TickAssembler(CONFIG, SensorConfig(axis_stuck_s=80.0))
    answers = [answered(target, replace(at(n), field_body_nt=(5.0, 50.0 * n + 1.0, -30.0 * n))) for n in range(100)]
    assert answers.index("axis_stuck") == 80


@pytest.mark.parametrize(("others", "again"), [(511, "doubled"), (512, "time_behind")])
def test_the_last_512_samples_are_known_again(others: int, again: str) -> None:
    """However far behind: the first of them is more than ``late_s`` old by then."""
    target = assembler(CONFIG)
    for second in range(others + 1):
        target.add(at(second))
    assert answered(target, at(0.0)) == again


def test_a_second_holds_1000_samples() -> None:
    target = assembler(CONFIG)
    target.add(at(0.0))
    answers = [answered(target, at(0.5 + 1e-4 * n)) for n in range(999)]
    answers += [answered(target, at(second)) for second in (1.2, 1.3, 1.49, 1.5)]
    assert answers == [""] * 1000 + ["crowded", "crowded", ""]


# Ticks


@pytest.mark.parametrize(("more_ns", "closed"), [(-1, 0), (0, 1)])
def test_a_tick_closes_when_a_sample_reaches_its_end(more_ns: int, closed: int) -> None:
    target = assembler(CONFIG)
    for message in (reference(0.0), at(0.0), reference(2.0), at(0.5, more_ns)):
        offer(target, message)
    assert len(target.ready()) == closed


def test_a_tick_that_its_reference_covers_does_not_wait_for_the_next_one() -> None:
    target = assembler(CONFIG)
    for message in (reference(0.0), at(0.0), at(1.0)):
        offer(target, message)
    assert [tick.index for tick in target.ready()] == [0]


@pytest.mark.parametrize(("more_ns", "closed"), [(-1, 0), (0, 1)])
def test_a_tick_waits_hold_s_for_a_reference_that_is_due(more_ns: int, closed: int) -> None:
    """References at 0 and 2 s, the next due at 4 s: the tick of second 3 is given up at 4 + 3 s."""
    target = assembler(CONFIG)
    for message in (reference(0.0), reference(2.0), at(3.0), at(7.0, more_ns)):
        offer(target, message)
    assert (len(target.ready()), target.counters["ticks_skipped"]) == (closed, closed)


@pytest.mark.parametrize(("longer_s", "seconds"), [(0.0, 7.0), (2.5, 9.5), (-1.0, 6.0)])
def test_a_reference_whose_tags_are_shifted_is_waited_for_longer(longer_s: float, seconds: float) -> None:
    closed = []
    for more_ns in (-1, 0):
        target = assembler(CONFIG)
        target.wait_longer(longer_s)
        for message in (reference(0.0), reference(2.0), at(3.0), at(seconds, more_ns)):
            offer(target, message)
        closed.append(len(target.ready()))
    assert closed == [0, 1]


def test_waiting_longer_is_told_anew_each_time_and_does_not_add_up() -> None:
    target = assembler(CONFIG)
    for _ in range(3):
        target.wait_longer(2.0)
    for message in (reference(0.0), reference(2.0), at(3.0), at(9.0)):
        offer(target, message)
    assert len(target.ready()) == 1


def test_a_tick_holds_what_it_is_made_of() -> None:
    """Three samples of one second, 0.3 s apart; gyro and inertial reference cover all of them."""
    target = assembler(CONFIG)
    for second in (9.0, 11.0):
        target.add_reference(reference(second))
        assert target.add_rate(rate(second, (second, 2.0 * second, -second)))
    samples = [at(0.0), at(9.7), at(10.0), at(10.3), at(10.6)]
    for message in samples:
        target.add(message)
    tick = target.flush()[1]
    times = np.array([9.7, 10.0, 10.3])
    assert (tick.index, tick.time_ns, tick.clock, tick.after_gap) == (10, ns(10.3), Clock.UTC, False)
    np.testing.assert_allclose(tick.times_s, times, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(tick.field_body_nt, [message.field_body_nt for message in samples[1:4]])
    np.testing.assert_allclose(tick.reference_magnitude_nt, 30_000.0 + 10.0 * times, rtol=1e-12)
    assert tick.reference_eci_nt is not None
    np.testing.assert_allclose(tick.reference_eci_nt[:, 2], tick.reference_magnitude_nt, rtol=1e-12)
    assert tick.rate_body_rad_s is not None
    np.testing.assert_allclose(tick.rate_body_rad_s, np.outer(times, (1.0, 2.0, -1.0)), rtol=1e-9)
    assert target.closed == 3


def test_a_sample_without_reference_is_left_out_and_takes_the_gyros_rate_along() -> None:
    """Reference from 10 s on: the sample at 9.7 s has none, so its missing rate does not matter either."""
    target = assembler(CONFIG)
    for second in (10.0, 11.0):
        target.add_reference(reference(second))
        target.add_rate(rate(second, (1.0, 1.0, 1.0)))
    for message in (at(9.7), at(10.0), at(10.3)):
        target.add(message)
    first, second = target.flush()
    assert (len(first.times_s), len(second.times_s)) == (1, 1)  # the first sample is the middle of its tick
    assert (target.counters["no_reference"], target.counters["ticks_skipped"]) == (1, 0)


def test_rates_and_inertial_vectors_are_given_for_all_samples_or_for_none() -> None:
    target = assembler(CONFIG)
    for message in (reference(0.0), reference(1.0)):
        target.add_reference(message)
    target.add_reference(ReferenceSample(craft="c", source="r", sequence=0, time_ns=ns(2.0), magnitude_nt=3e4))
    for second in (0.0, 1.0):
        target.add_rate(rate(second, (1.0, 1.0, 1.0)))
    for message in (at(0.0), at(0.9), at(1.1), at(1.9)):
        target.add(message)
    whole, mixed, neither = target.flush()
    assert (whole.reference_eci_nt is None, whole.rate_body_rad_s is None) == (False, False)
    assert (mixed.reference_eci_nt is None, mixed.rate_body_rad_s is None) == (True, True)
    assert (neither.reference_eci_nt is None, neither.rate_body_rad_s is None) == (True, True)


def test_a_tick_without_reference_has_neither_vectors_nor_rates() -> None:
    target = assembler(CONFIG)
    target.add_rate(rate(0.0, (1.0, 1.0, 1.0)))
    target.add(at(0.0))
    (tick,) = target.flush()
    assert (tick.field_body_nt.shape, tick.reference_eci_nt, tick.rate_body_rad_s) == ((0, 3), None, None)
    assert target.closed == 1


def test_what_a_compensation_makes_of_a_sample_goes_into_the_tick_and_the_measured_is_known_again() -> None:
    target = assembler(CONFIG)
    target.add_reference(reference(0.0))
    corrected = replace(at(0.0), field_body_nt=(7.0, 8.0, 9.0))
    assert target.rejection(at(0.0)) is None
    target.take(at(0.0), corrected)
    assert answered(target, at(0.0)) == "doubled"
    assert target.flush()[0].field_body_nt.tolist() == [[7.0, 8.0, 9.0]]
