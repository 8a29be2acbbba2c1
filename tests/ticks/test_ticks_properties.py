"""What holds for every stream: the interleaving does not matter, and every sample is accounted for exactly once."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magcal_service.config.settings import SensorConfig, TickConfig
from magcal_service.ticks.assembler import SECOND_NS
from magcal_service.ticks.rejection import Rejection
from magcal_service.wire.messages import Clock, MagnetometerSample, ReferenceSample
from tests.ticks.tick_streams import (
    Sample,
    Stream,
    assembler,
    good,
    in_order,
    ns,
    offer,
    play,
    reference,
    same_ticks,
    sample,
)


@st.composite
def interleavings(draw: st.DrawFn, hold_s: float) -> tuple[Stream, Stream]:
    """A good stream, and the same with each stream in its own order but the two shifted against one another.

    The reference comes by its own delay, which changes from sample to sample and stays within the hold.
    """
    rate_hz = draw(st.sampled_from([1, 2, 10]))
    period_s = draw(st.sampled_from([1, 2, 5]))
    stream = good(30, rate_hz, period_s)
    references = [message for message in stream if isinstance(message, ReferenceSample)]
    delays = draw(st.lists(st.floats(-3.0, hold_s), min_size=len(references), max_size=len(references)))
    arrival = np.maximum.accumulate([m.time_ns + d * SECOND_NS for m, d in zip(references, delays, strict=True)])
    samples = [message for message in stream if isinstance(message, MagnetometerSample)]
    events = [(float(at), 0, m) for at, m in zip(arrival, references, strict=True)]
    events += [(float(m.time_ns), 1, m) for m in samples]
    return stream, [message for _, _, message in sorted(events, key=lambda event: event[:2])]


@settings(max_examples=80, deadline=None)
@given(interleavings(hold_s=3.0))
def test_the_interleaving_of_the_two_streams_does_not_change_a_bit(streams: tuple[Stream, Stream]) -> None:
    usual, shuffled = streams
    assert same_ticks(play(usual)[0], play(shuffled)[0])


@settings(max_examples=40, deadline=None)
@given(interleavings(hold_s=3.0), st.integers(1, 5))
def test_the_moments_at_which_ready_is_called_do_not_change_a_bit(streams: tuple[Stream, Stream], every: int) -> None:
    _, stream = streams
    target, ticks = assembler(), []
    for number, message in enumerate(stream):
        offer(target, message)
        if number % every == 0:
            ticks += target.ready()
    ticks += target.flush()
    assert same_ticks(ticks, play(stream)[0])


times = st.one_of(
    st.integers(0, 40).map(float),
    st.floats(0.0, 40.0),
    st.floats(-5000.0, 5000.0),
    st.sampled_from([-1e9, 1e9, 7.4e9]),
)
clocks = st.sampled_from([Clock.UTC] * 9 + [Clock.ELAPSED])
wild_samples = st.builds(sample, times, clocks)
frozen_samples = st.builds(
    lambda second: MagnetometerSample(
        craft="c", source="mag", sequence=0, time_ns=ns(second), field_body_nt=(1.0, 2.0, 3.0)
    ),
    times,
)
wild_references = st.builds(reference, times, clocks)
wild_streams = st.lists(st.one_of(wild_samples, frozen_samples, wild_references), max_size=80)
patience = st.sampled_from([TickConfig(), TickConfig(hold_s=0.0, late_s=0.0, gap_s=2.0, step_confirm_s=10.0)])


@settings(max_examples=300, deadline=None)
@given(wild_streams, patience, st.booleans())
def test_every_sample_is_refused_for_one_reason_or_ends_in_one_tick(
    stream: list[Sample], config: TickConfig, sort: bool
) -> None:
    target = assembler(config, SensorConfig(stuck_samples=3))
    answers = Counter[str]()
    ticks = []
    for message in in_order(stream) if sort else stream:
        if isinstance(message, MagnetometerSample):
            answers[target.add(message) or "accepted"] += 1
        else:
            target.add_reference(message)
        ticks += target.ready()
    ticks += target.flush()
    counters = target.counters
    paired = sum(len(tick.times_s) for tick in ticks)
    assert answers == {name: counters[name] for name in answers}
    assert set(answers) <= {"accepted", *Rejection}
    assert counters["accepted"] == paired + counters["no_reference"]
    assert counters["ticks"] == sum(len(tick.times_s) > 0 for tick in ticks)
    assert counters["ticks"] + counters["ticks_skipped"] == len(ticks) == target.closed


@settings(max_examples=300, deadline=None)
@given(wild_streams, patience)
def test_ticks_come_in_order_with_times_that_rise(stream: list[Sample], config: TickConfig) -> None:
    ticks, counters = play(stream, assembler(config, SensorConfig(stuck_samples=3)))
    indices = [tick.index for tick in ticks]
    assert indices == sorted(set(indices))
    times = np.concatenate([tick.times_s for tick in ticks]) if ticks else np.empty(0)
    assert np.all(np.diff(times) > 0.0)
    assert min(counters.values(), default=0) >= 0


@settings(max_examples=100, deadline=None)
@given(st.lists(wild_references, max_size=60))
def test_every_reference_is_accepted_or_refused_for_one_reason(stream: list[ReferenceSample]) -> None:
    target = assembler()
    for message in stream:
        target.add_reference(message)
    for message in (reference(1e5), reference(1e5 + 1), reference(1e5 + 2), reference(1e5 + 3)):
        target.add_reference(message)  # whatever was in the air is settled by now
    kinds = ("reference", "reference_doubled", "reference_jump", "reference_zero")
    assert sum(target.counters[kind] for kind in kinds) == len(stream) + 4


@pytest.mark.parametrize("rate_hz", [1, 10, 50])
def test_ready_hands_each_tick_out_once(rate_hz: int) -> None:
    target = assembler()
    for message in good(10, rate_hz):
        offer(target, message)
    first, second = target.ready(), target.ready()
    assert len(first) > 5
    assert second == []
