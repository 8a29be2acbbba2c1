"""Every outcome in the table of ``magcal_service.ticks.assembler``: one good stream, spoiled in one way each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.config.settings import SensorConfig, TickConfig
from magcal_service.ticks.rejection import Rejection
from magcal_service.wire.messages import MagnetometerSample, ReferenceSample
from tests.ticks.tick_streams import Spoiling, assembler, counted, good, in_order, ns, play, reference, sample, shifted


@pytest.mark.parametrize("spoiling", Spoiling)
def test_each_spoiling_is_counted_by_kind_and_nothing_else_is(spoiling: Spoiling) -> None:
    _, counters = play(spoiling.apply(good()))
    assert counted(counters) == spoiling.counts


def test_a_history_sent_again_after_a_restart_is_doubled_and_no_step_of_the_clock() -> None:
    """A node's last 100 samples, 70 of them further behind than ``late_s``: each is known by its time and vector."""
    target = assembler()
    whole = in_order(good())
    for message in (*whole, *whole):
        if isinstance(message, ReferenceSample):
            target.add_reference(message)
        else:
            target.add(message)
        target.ready()
    assert (target.counters["doubled"], target.counters["clock_step"], target.counters["time_behind"]) == (100, 0, 0)


@pytest.mark.parametrize("spoiling", Spoiling)
def test_every_paired_sample_has_the_reference_of_its_own_time(spoiling: Spoiling) -> None:
    """The sample's x component is its true time and the reference grows linearly with it, whatever the labels say."""
    ticks, _ = play([m for m in spoiling.apply(good()) if not _is_changed(m)])
    times = np.concatenate([tick.field_body_nt[:, 0] for tick in ticks])
    magnitudes = np.concatenate([tick.reference_magnitude_nt for tick in ticks])
    np.testing.assert_allclose(magnitudes, 30_000.0 + 10.0 * times, rtol=0.0, atol=1e-6)


def _is_changed(message: MagnetometerSample | ReferenceSample) -> bool:
    """A stuck sample's x component is not its time."""
    return isinstance(message, MagnetometerSample) and message.field_body_nt == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("spoiling", Spoiling)
def test_ticks_come_in_order_and_one_a_second_at_most(spoiling: Spoiling) -> None:
    indices = [tick.index for tick in play(spoiling.apply(good()))[0]]
    assert indices == sorted(set(indices))


@pytest.mark.parametrize("spoiling", Spoiling)
def test_only_a_gap_or_a_step_breaks_the_ticks_apart(spoiling: Spoiling) -> None:
    broken = [tick for tick in play(spoiling.apply(good()))[0] if tick.after_gap]
    assert len(broken) == spoiling.counts.get("gap", 0) + spoiling.counts.get("clock_step", 0)


@pytest.mark.parametrize("rate_hz", [1, 10, 50])
def test_a_tick_holds_the_samples_of_one_second(rate_hz: int) -> None:
    ticks, counters = play(good(20, rate_hz))
    sizes = [len(tick.times_s) for tick in ticks]
    assert (sizes[1:-1], sum(sizes), counters["no_reference"]) == ([rate_hz] * (len(sizes) - 2), 20 * rate_hz, 0)


@pytest.mark.parametrize("rate_hz", [1, 10, 50])
def test_a_tick_is_centred_on_its_second(rate_hz: int) -> None:
    for tick in play(good(20, rate_hz))[0]:
        assert np.all((tick.times_s >= tick.index - 0.5) & (tick.times_s < tick.index + 0.5))


@pytest.mark.parametrize("rate_hz", [1, 10, 50])
def test_a_reference_every_10_s_is_enough_for_every_sample(rate_hz: int) -> None:
    _, counters = play(good(60, rate_hz, reference_period_s=10))
    assert counted(counters) == {"accepted": 60 * rate_hz, "reference": 7, "ticks": counters["ticks"]}


def test_a_reference_slower_than_the_greatest_gap_is_not_interpolated() -> None:
    _, counters = play(good(60, reference_period_s=12))
    assert (counters["ticks"], counters["ticks_skipped"]) == (5, 55)


def test_a_reference_faster_than_the_samples_is_taken_at_the_nearest_times() -> None:
    fast = [reference(step / 50) for step in range(20 * 50 + 1)]
    ticks, counters = play(in_order([sample(second + 0.013) for second in range(20)], fast))
    found = np.concatenate([tick.reference_magnitude_nt for tick in ticks])
    np.testing.assert_allclose(found, 30_000.13 + 10.0 * np.arange(20), atol=1e-6)
    assert counters["no_reference"] == 0


@pytest.mark.parametrize("delay_s", [0, 1, 2, 3])
def test_a_reference_late_by_up_to_hold_s_is_waited_for(delay_s: int) -> None:
    late = sorted(good(), key=lambda m: m.time_ns + isinstance(m, ReferenceSample) * delay_s * 10**9)
    assert counted(play(late)[1]) == Spoiling.NOTHING.counts


def test_a_reference_later_than_hold_s_comes_too_late() -> None:
    """Each tick closes ``hold_s`` after the reference is due, 1 s after the newest that is there."""
    late = sorted(good(), key=lambda m: m.time_ns + isinstance(m, ReferenceSample) * 6 * 10**9)
    _, counters = play(late, assembler(TickConfig(hold_s=3.0)))
    assert counters["ticks_skipped"] > 90


def test_without_any_reference_a_tick_closes_hold_s_after_its_end() -> None:
    target = assembler(TickConfig(hold_s=3.0))
    closed_at = {}
    for second in range(10):
        target.add(sample(second))
        for tick in target.ready():
            closed_at[tick.index] = second
    assert closed_at == {index: index + 4 for index in range(6)}


def test_a_tick_with_its_reference_closes_with_the_next_second() -> None:
    target = assembler()
    closed_at = {}
    for message in good(10):
        if isinstance(message, ReferenceSample):
            target.add_reference(message)
        else:
            target.add(message)
        for tick in target.ready():
            closed_at[tick.index] = (message.time_ns - ns(0)) // 10**9
    assert closed_at == {index: index + 1 for index in range(9)}


def test_a_sample_just_before_the_first_one_is_still_in_its_tick() -> None:
    ticks, counters = play([reference(-1), sample(0.0), sample(-0.2), reference(1), sample(1)])
    assert (counters["out_of_order"], ticks[0].times_s.tolist()) == (1, [-0.2, 0.0])


@pytest.mark.parametrize(
    ("step", "z", "reason", "taken"), [(0.0, 3.0, Rejection.STUCK, 2), (1.0, 50_000.0, Rejection.SATURATED, 0)]
)
def test_a_fault_of_the_sensor_lasts_beyond_the_time_after_which_a_jump_is_confirmed(
    step: float, z: float, reason: Rejection, taken: int
) -> None:
    """30 s of it, where a jump of 10 s has to be confirmed: the third to agree is believed in its time, and faulty."""
    target = assembler(TickConfig(step_confirm_s=10.0), SensorConfig(stuck_samples=3, range_nt=50_000.0))
    assert target.add(sample(0)) is None
    answers = [target.add(replace(sample(second), field_body_nt=(step * second, 2.0, z))) for second in range(1, 31)]
    unconfirmed = [Rejection.TIME_AHEAD] * 2
    assert answers == [None] * taken + [reason] * 10 + unconfirmed + [reason] * (18 - taken)
    assert target.add(sample(31)) is None
    assert target.counters["clock_step"] == 0


def test_a_stuck_sensor_is_believed_again_when_it_changes() -> None:
    target = assembler(sensor=SensorConfig(stuck_samples=3))
    frozen = [MagnetometerSample(**_fields(sample(second)) | {"field_body_nt": (1.0, 2.0, 3.0)}) for second in range(6)]
    assert [target.add(message) for message in [*frozen, sample(6)]] == [None] * 2 + [Rejection.STUCK] * 4 + [None]


def _fields(message: MagnetometerSample) -> dict[str, object]:
    return {name: getattr(message, name) for name in ("craft", "source", "sequence", "time_ns", "clock")}


def test_two_absurd_time_stamps_that_disagree_move_nothing() -> None:
    stream = [sample(0), sample(1e6), sample(2e6), sample(3e6), sample(1)]
    assert counted(play(stream)[1])["time_ahead"] == 3


def test_absurd_time_stamps_among_good_ones_confirm_nothing() -> None:
    stream = [sample(0), sample(1e6), sample(1), sample(1e6 + 1), sample(2), sample(1e6 + 2), sample(3)]
    assert counted(play(stream)[1])["time_ahead"] == 3


def test_reasons_of_different_kinds_do_not_confirm_each_other() -> None:
    target = assembler()
    ahead = [sample(1000), sample(1001)]
    other = MagnetometerSample(**_fields(sample(1002)) | {"clock": "elapsed", "field_body_nt": (1.0, 2.0, 3.0)})
    assert [target.add(message) for message in [sample(0), *ahead, other]] == [
        None,
        Rejection.TIME_AHEAD,
        Rejection.TIME_AHEAD,
        Rejection.CLOCK_CHANGED,
    ]


def test_an_absurd_first_sample_is_outvoted() -> None:
    stream = [shifted(message, -1e8) if message == sample(0) else message for message in good()]
    counts = counted(play(stream)[1])
    assert (counts["accepted"], counts["time_ahead"], counts["gap"]) == (98, 2, 1)


def test_a_source_that_babbles_does_not_fill_the_memory() -> None:
    target = assembler()
    for step in range(5000):
        target.add(sample(step * 1e-6))
    assert target.counters["accepted"] == 1000


def test_after_a_babbling_second_the_next_one_is_taken() -> None:
    target = assembler()
    for step in range(1001):
        target.add(sample(step * 1e-6))
    assert target.add(sample(1.0)) is None


def test_a_gap_is_seen_by_the_first_tick_that_has_a_reference_after_it() -> None:
    samples = [sample(second) for second in (*range(10), *range(100, 110))]
    references = [reference(second) for second in (*range(10), *range(105, 110))]
    ticks, counters = play(in_order(samples, references))
    assert [tick.index for tick in ticks if tick.after_gap and len(tick.times_s)] == [105]
    assert counters["ticks_empty"] == 0


def test_seconds_missing_after_a_gap_are_counted_though_no_reference_has_come() -> None:
    samples = [sample(second) for second in (*range(10), 100, 101, 104)]
    assert play(in_order(samples, [reference(second) for second in range(10)]))[1]["ticks_empty"] == 2
