"""Times at every edge of 64 bits: refused by name outside of the window, and within it all arithmetic fits."""

from __future__ import annotations

from dataclasses import replace

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magcal_service.config.settings import TickConfig
from magcal_service.ticks.assembler import SECOND_NS
from magcal_service.ticks.rejection import Rejection
from magcal_service.ticks.time_window import EARLIEST_NS, FURTHEST_NS, LATEST_NS, LONGEST_NS
from magcal_service.wire.messages import MagnetometerSample
from tests.ticks.tick_streams import assembler, reference, sample

WIRE = (-(1 << 63), (1 << 63) - 1)


def at(time_ns: int, number: int = 0) -> MagnetometerSample:
    """A sample at a source time [ns]; each number has another vector."""
    return replace(sample(0.0), time_ns=time_ns, field_body_nt=(20_000.0 + number, 5_000.0 - number, number - 30_000.0))


@pytest.mark.parametrize(
    ("time_ns", "answer"),
    [
        (EARLIEST_NS, None),
        (EARLIEST_NS - 1, Rejection.TIME_OUT_OF_RANGE),
        (LATEST_NS, None),
        (LATEST_NS + 1, Rejection.TIME_OUT_OF_RANGE),
        (WIRE[0], Rejection.TIME_OUT_OF_RANGE),
        (WIRE[1], Rejection.TIME_OUT_OF_RANGE),
    ],
)
def test_the_window_ends_to_the_nanosecond(time_ns: int, answer: Rejection | None) -> None:
    target = assembler()
    assert target.add(at(time_ns)) is answer
    assert target.counters["time_out_of_range" if answer else "accepted"] == 1


def test_a_time_out_of_range_moves_nothing() -> None:
    """Neither first nor between others: the next sample is taken as if it had not come."""
    target = assembler()
    answers = [target.add(at(time_ns, n)) for n, time_ns in enumerate([WIRE[0], 0, WIRE[1], SECOND_NS, WIRE[0]])]
    assert [answer is None for answer in answers] == [False, True, False, True, False]
    assert target.newest_s == 1.0
    assert target.counters["time_out_of_range"] == 3


def hop(first_ns: int, numbers: range) -> list[MagnetometerSample]:
    return [at(first_ns + n * SECOND_NS, n) for n in numbers]


@pytest.mark.parametrize(("more_ns", "outcome"), [(0, "gap"), (1, "clock_step")])
def test_a_jump_beyond_a_century_is_a_step_of_the_clock(more_ns: int, outcome: str) -> None:
    target = assembler(TickConfig(step_confirm_s=600.0))
    target.add(at(0))
    answers = [target.add(one) for one in hop(FURTHEST_NS - 2 * SECOND_NS + more_ns, range(3))]
    assert answers == [Rejection.TIME_AHEAD, Rejection.TIME_AHEAD, None]
    assert target.counters["clock_step"] == (outcome == "clock_step")
    assert target.newest_s == (FURTHEST_NS * 1e-9 if outcome == "gap" else 1.0)


def test_beyond_the_longest_elapsed_time_the_clock_is_stepped_back_again_and_again() -> None:
    """Jumps that need no confirmation reach it; from there on elapsed time grows by a second with each step."""
    week_ns = 604_800 * SECOND_NS
    target = assembler(TickConfig(step_confirm_s=604_800.0, gap_s=3600.0))
    for number, elapsed_ns in enumerate([*range(0, LONGEST_NS, week_ns), LONGEST_NS]):
        assert target.add(at(elapsed_ns - LATEST_NS, number)) is None
    assert target.newest_s == LONGEST_NS * 1e-9
    answers = [target.add(one) for one in hop(LONGEST_NS - LATEST_NS + SECOND_NS, range(30))]
    assert answers == [Rejection.TIME_AHEAD, Rejection.TIME_AHEAD, None] * 10
    assert target.counters["clock_step"] == 10
    assert target.newest_s - LONGEST_NS * 1e-9 == pytest.approx(10.0, abs=1e-5)


times = st.one_of(
    st.sampled_from([*WIRE, EARLIEST_NS, LATEST_NS, 0, FURTHEST_NS, LONGEST_NS, -FURTHEST_NS, 1 << 32, 1 << 53]),
    st.integers(*WIRE),
)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(times, st.integers(-3, 3), st.integers(1, 5)), min_size=1, max_size=12))
def test_whatever_times_come_ticks_are_doubles_and_the_state_can_be_written(
    parts: list[tuple[int, int, int]],
) -> None:
    target, number, elapsed_s = assembler(), 0, -1.0
    for edge_ns, seconds, count in parts:
        for step in range(count):
            number += 1
            time_ns = min(max(edge_ns + (seconds + step) * SECOND_NS, WIRE[0]), WIRE[1])
            target.add_reference(replace(reference(0.0), time_ns=time_ns))
            target.add(at(time_ns, number))
            for tick in target.ready():
                assert tick.times_s.dtype == np.float64
                assert (tick.times_s > elapsed_s).all()
                elapsed_s = max(elapsed_s, *tick.times_s.tolist()) if tick.times_s.size else elapsed_s
    state = target.export_state()
    again = assembler()
    again.restore_state(msgpack.unpackb(msgpack.packb(state), strict_map_key=False))
    assert again.export_state() == state
