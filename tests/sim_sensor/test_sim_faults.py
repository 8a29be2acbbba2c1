"""Each link fault does what its name says, to whom it concerns, and the same for the same seed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from magcal_service.wire.codec import decode, encode
from magcal_service.wire.messages import Frame, MagnetometerSample, Message, ReferenceSample, TelemetrySample
from sim_sensor.faults import Emission, FaultKind, LinkFault, Target, apply

N = 2500


def magnetometer(index: int) -> MagnetometerSample:
    return MagnetometerSample(
        craft="a", source="mag", sequence=index, time_ns=index * 10**9, field_body_nt=(float(index), 1.0, 2.0)
    )


@cache
def stream() -> list[Emission]:
    """A magnetometer, a reference and a temperature at 1 Hz."""
    emissions = []
    for index in range(N):
        common = {"craft": "a", "sequence": index, "time_ns": index * 10**9}
        reference = ReferenceSample(**common, source="ref", field_nt=(1.0, 2.0, float(index)), frame=Frame.ECI)
        telemetry = TelemetrySample(**common, source="t", channel="temperature", unit="degC", values=(20.0,))
        emissions += [Emission(float(index), message) for message in (reference, telemetry, magnetometer(index))]
    return emissions


def spoiled(*faults: LinkFault, seed: int = 3) -> list[Emission]:
    return list(apply(iter(stream()), faults, np.random.SeedSequence(seed)))


def of(kind: type[Message], emissions: Iterable[Emission]) -> list[Emission]:
    return [emission for emission in emissions if isinstance(emission.message, kind)]


EVERY = [
    LinkFault(FaultKind.DROPOUT, probability=0.1),
    LinkFault(FaultKind.DUPLICATE, probability=0.1),
    LinkFault(FaultKind.CORRUPTION, probability=0.1),
    LinkFault(FaultKind.JITTER, sigma_s=0.01),
    LinkFault(FaultKind.CLOCK_DRIFT, ppm=50.0),
    LinkFault(FaultKind.CLOCK_STEP, at_s=1000.0, step_s=-2.0),
    LinkFault(FaultKind.OUT_OF_ORDER, probability=0.1, delay_s=5.0),
    LinkFault(FaultKind.STUCK, at_s=100.0, for_s=50.0),
    LinkFault(FaultKind.GAP, at_s=100.0, for_s=240.0),
]
kinds = pytest.mark.parametrize("fault", EVERY, ids=[fault.kind.value for fault in EVERY])


def test_every_kind_is_tried_here() -> None:
    assert {fault.kind for fault in EVERY} == set(FaultKind)


@kinds
def test_the_same_seed_spoils_the_same_way(fault: LinkFault) -> None:
    assert spoiled(fault) == spoiled(fault)


@kinds
def test_a_fault_changes_the_stream(fault: LinkFault) -> None:
    assert spoiled(fault) != stream()


@kinds
def test_others_than_the_target_pass_untouched(fault: LinkFault) -> None:
    for kind in (ReferenceSample, TelemetrySample):
        assert of(kind, spoiled(fault)) == of(kind, stream())


@kinds
def test_messages_leave_in_order_of_sending(fault: LinkFault) -> None:
    times = [emission.emit_s for emission in spoiled(fault)]
    assert times == sorted(times)


@kinds
def test_whatever_a_fault_makes_can_travel(fault: LinkFault) -> None:
    for emission in spoiled(fault)[:1500]:
        assert decode(encode(emission.message)) == emission.message


@pytest.mark.parametrize(
    "fault",
    [LinkFault(kind) for kind in FaultKind],
    ids=[kind.value for kind in FaultKind],
)
def test_a_fault_of_size_zero_changes_nothing(fault: LinkFault) -> None:
    assert spoiled(fault) == stream()


def test_one_fault_does_not_change_what_another_draws() -> None:
    dropout = LinkFault(FaultKind.DROPOUT, Target.REFERENCE, probability=0.1)
    alone = of(ReferenceSample, spoiled(dropout))
    jitter = LinkFault(FaultKind.JITTER, sigma_s=0.01)
    assert of(ReferenceSample, spoiled(dropout, jitter)) == alone


def test_dropouts_come_at_their_probability_and_leave_gaps_in_the_sequence() -> None:
    kept = of(MagnetometerSample, spoiled(LinkFault(FaultKind.DROPOUT, probability=0.1)))
    assert len(kept) == pytest.approx(0.9 * N, abs=4 * np.sqrt(0.09 * N))
    sequences = [emission.message.sequence for emission in kept]
    assert [magnetometer(index) for index in sequences] == [emission.message for emission in kept]
    assert sequences == sorted(set(sequences))


def test_duplicates_are_equal_in_every_field() -> None:
    counts = Counter(
        e.message for e in of(MagnetometerSample, spoiled(LinkFault(FaultKind.DUPLICATE, probability=0.1)))
    )
    assert set(counts.values()) == {1, 2}
    assert len(counts) == N


def test_all_means_every_kind_of_message() -> None:
    gap = LinkFault(FaultKind.GAP, Target.ALL, at_s=100.0, for_s=240.0)
    assert len(spoiled(gap)) == 3 * (N - 240)


def test_corruption_is_absurd_but_within_what_the_wire_takes() -> None:
    clean, bad = of(MagnetometerSample, stream()), of(MagnetometerSample, spoiled(EVERY[2]))
    changed = [b.message.field_body_nt for a, b in zip(clean, bad, strict=True) if a != b]
    assert len(changed) == pytest.approx(0.1 * N, abs=4 * np.sqrt(0.09 * N))
    assert 4e5 < np.max(np.abs(changed)) <= 5e5


def test_jitter_moves_the_stamp_by_its_sigma_and_not_the_value() -> None:
    bad = of(MagnetometerSample, spoiled(LinkFault(FaultKind.JITTER, sigma_s=0.01)))
    off = np.array([e.message.time_ns * 1e-9 - e.emit_s for e in bad])
    assert np.std(off) == pytest.approx(0.01, rel=0.06)
    assert [e.message.field_body_nt[0] for e in bad] == [float(index) for index in range(N)]


def test_a_drifting_clock_runs_ahead_in_proportion() -> None:
    bad = of(MagnetometerSample, spoiled(LinkFault(FaultKind.CLOCK_DRIFT, ppm=50.0)))
    assert [e.message.time_ns for e in bad] == [i * 10**9 + round(i * 50e-6 * 1e9) for i in range(N)]


def test_a_clock_steps_at_its_time() -> None:
    bad = of(MagnetometerSample, spoiled(LinkFault(FaultKind.CLOCK_STEP, at_s=1000.0, step_s=-2.0)))
    assert [e.message.time_ns // 10**9 - e.emit_s for e in bad] == [0.0] * 1000 + [-2.0] * (N - 1000)


def test_late_messages_are_all_there_behind_others() -> None:
    bad = of(MagnetometerSample, spoiled(LinkFault(FaultKind.OUT_OF_ORDER, probability=0.1, delay_s=5.0)))
    order = [e.message.sequence for e in bad]
    assert sorted(order) == list(range(N))
    assert 0.05 * N < sum(later < earlier for earlier, later in pairwise(order)) < 0.15 * N
    assert max(e.emit_s - e.message.time_ns * 1e-9 for e in bad) <= 5.0


def test_a_stuck_sensor_repeats_its_last_good_value() -> None:
    bad = of(MagnetometerSample, spoiled(LinkFault(FaultKind.STUCK, at_s=100.0, for_s=50.0)))
    values = [e.message.field_body_nt[0] for e in bad]
    assert values[100:150] == [99.0] * 50
    assert values[99] == 99.0
    assert values[150] == 150.0
    assert [e.message.sequence for e in bad] == list(range(N))


def test_messages_still_held_at_the_end_are_sent() -> None:
    bad = of(MagnetometerSample, spoiled(LinkFault(FaultKind.OUT_OF_ORDER, probability=1.0, delay_s=5.0)))
    assert sorted(e.message.sequence for e in bad) == list(range(N))
