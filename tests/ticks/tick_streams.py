"""Small streams of magnetometer and reference samples, spoiled in one way each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from enum import Enum

from magcal_service.config.settings import SensorConfig, TickConfig
from magcal_service.ticks.assembler import SECOND_NS, Tick, TickAssembler
from magcal_service.ticks.rejection import Rejection
from magcal_service.wire.messages import Clock, Frame, MagnetometerSample, ReferenceSample

START_NS = 1_750_000_000 * SECOND_NS
Sample = MagnetometerSample | ReferenceSample
Stream = list[Sample]


def ns(seconds: float) -> int:
    """Source time [ns] of a time since the start [s]."""
    return START_NS + round(seconds * SECOND_NS)


def sample(seconds: float, clock: Clock = Clock.UTC) -> MagnetometerSample:
    """A sample whose vector follows from its time, so that no two are alike."""
    return MagnetometerSample(
        craft="c",
        source="mag",
        sequence=0,
        time_ns=ns(seconds),
        clock=clock,
        field_body_nt=(seconds, 1.0 + 0.01 * seconds, -2.0 - 0.01 * seconds),
    )


def reference(seconds: float, clock: Clock = Clock.UTC) -> ReferenceSample:
    """A reference that grows linearly with time: interpolation gives 30000 nT + 10 nT/s at any time."""
    return ReferenceSample(
        craft="c",
        source="ref",
        sequence=0,
        time_ns=ns(seconds),
        clock=clock,
        field_nt=(0.0, 0.0, 30_000.0 + 10.0 * seconds),
        frame=Frame.ECI,
    )


def in_order(*streams: Iterable[Sample]) -> Stream:
    """Streams merged by time; at the same time the reference comes first."""
    return sorted(
        (message for stream in streams for message in stream),
        key=lambda message: (message.time_ns, isinstance(message, MagnetometerSample)),
    )


def good(seconds: int = 100, rate_hz: int = 1, reference_period_s: int = 1) -> Stream:
    """``seconds`` of samples, and references from the first sample's time to beyond the last one's."""
    samples = [sample(step / rate_hz) for step in range(seconds * rate_hz)]
    references = [reference(second) for second in range(0, seconds + reference_period_s, reference_period_s)]
    return in_order(samples, references)


def assembler(ticks: TickConfig | None = None, sensor: SensorConfig | None = None) -> TickAssembler:
    """An assembler with default settings unless told otherwise."""
    return TickAssembler(ticks or TickConfig(), sensor or SensorConfig())


def offer(target: TickAssembler, message: Sample) -> Rejection | None:
    """Hand one message in; why it was rejected, if it was."""
    if isinstance(message, ReferenceSample):
        target.add_reference(message)
        return None
    return target.add(message)


def play(stream: Iterable[Sample], target: TickAssembler | None = None) -> tuple[list[Tick], Counter[str]]:
    """All ticks of a stream, as they close and at its end, and what was counted."""
    target = target or assembler()
    ticks: list[Tick] = []
    for message in stream:
        offer(target, message)
        ticks += target.ready()
    ticks += target.flush()
    return ticks, target.counters


def _samples_between(stream: Stream, first_s: float, end_s: float, change: Callable[[Sample], Sample]) -> Stream:
    """The stream with the magnetometer samples of a stretch changed, each in its place."""
    return [
        change(message)
        if isinstance(message, MagnetometerSample) and ns(first_s) <= message.time_ns < ns(end_s)
        else message
        for message in stream
    ]


def shifted(message: Sample, seconds: float) -> Sample:
    """The message with another time."""
    return replace(message, time_ns=message.time_ns + round(seconds * SECOND_NS))


def _all_from(stream: Stream, first_s: float, change: Callable[[Sample], Sample]) -> Stream:
    """The stream with everything from a time on changed, samples and references."""
    return [change(message) if message.time_ns >= ns(first_s) else message for message in stream]


def _moved(stream: Stream, taken_s: float, behind_s: float) -> Stream:
    """The stream with the sample of one time sent right after that of another."""
    late = next(m for m in stream if isinstance(m, MagnetometerSample) and m.time_ns == ns(taken_s))
    rest = [message for message in stream if message is not late]
    at = next(i for i, m in enumerate(rest) if isinstance(m, MagnetometerSample) and m.time_ns == ns(behind_s))
    return [*rest[: at + 1], late, *rest[at + 1 :]]


def _late(stream: Stream) -> Stream:
    return _moved(stream, 50, 55)


def _out_of_order(stream: Stream) -> Stream:
    return _moved(stream, 50, 51)


def _doubled(stream: Stream) -> Stream:
    return [copy for m in stream for copy in ([m, m] if m == sample(50) else [m])]


def _missing(stream: Stream) -> Stream:
    return [m for m in stream if isinstance(m, ReferenceSample) or not ns(50) <= m.time_ns < ns(55)]


def _stuck(stream: Stream) -> Stream:
    return _samples_between(stream, 40, 70, lambda m: replace(m, field_body_nt=(1.0, 2.0, 3.0)))


def _zero(stream: Stream) -> Stream:
    return _samples_between(stream, 40, 42, lambda m: replace(m, field_body_nt=(0.0, -0.0, 0.0)))


def _gap(stream: Stream) -> Stream:
    return [message for message in stream if not ns(30) <= message.time_ns < ns(95)]


def _step(seconds: float) -> Callable[[Stream], Stream]:
    return lambda stream: _all_from(stream, 50, lambda message: shifted(message, seconds))


def _other_clock(stream: Stream) -> Stream:
    return _all_from(stream, 50, lambda message: replace(message, clock=Clock.ELAPSED))


def _absurd(seconds: float) -> Callable[[Stream], Stream]:
    return lambda stream: _samples_between(stream, 50, 51, lambda message: shifted(message, seconds))


def _absurd_reference(seconds: float) -> Callable[[Stream], Stream]:
    return lambda stream: [shifted(m, seconds) if m == reference(50) else m for m in stream]


def _doubled_reference(stream: Stream) -> Stream:
    return [copy for m in stream for copy in ([m, m] if m == reference(50) else [m])]


def _no_reference(stream: Stream) -> Stream:
    return [message for message in stream if isinstance(message, MagnetometerSample)]


def _reference_stops(stream: Stream) -> Stream:
    return [m for m in stream if isinstance(m, MagnetometerSample) or m.time_ns < ns(60)]


def _reference_pauses(stream: Stream) -> Stream:
    return [m for m in stream if isinstance(m, MagnetometerSample) or not ns(40) <= m.time_ns < ns(60)]


def _crowded(stream: Stream) -> Stream:
    flood = [sample(50 + step * 1e-6) for step in range(1, 1501)]
    return in_order(stream, flood)


class Spoiling(Enum):
    """One thing gone wrong in 100 s of good samples and references at 1 Hz, and all that is counted for it.

    Each value: how the stream is spoiled, and what changes against the counts of the good stream.
    """

    NOTHING = (lambda stream: stream, {})
    LATE = (_late, {"late": 1, "accepted": 99, "ticks": 99, "ticks_empty": 1})
    OUT_OF_ORDER = (_out_of_order, {"out_of_order": 1})
    DOUBLED = (_doubled, {"doubled": 1})
    MISSING = (_missing, {"accepted": 95, "ticks": 95, "ticks_empty": 5})
    STUCK = (_stuck, {"stuck": 21, "accepted": 79, "ticks": 79, "ticks_empty": 21})
    ZERO = (_zero, {"zero": 2, "accepted": 98, "ticks": 98, "ticks_empty": 2})
    GAP = (_gap, {"gap": 1, "accepted": 35, "reference": 36, "ticks": 35})
    CROWDED = (_crowded, {"crowded": 501, "accepted": 1099})
    CLOCK_BACK_1_H = (
        _step(-3600),
        {"time_behind": 2, "clock_step": 1, "reference_step": 1, "accepted": 98, "no_reference": 1}
        | {"ticks": 97, "ticks_skipped": 1},
    )
    CLOCK_BACK_40_S = (
        _step(-40),
        {"time_behind": 2, "clock_step": 1, "reference_step": 1, "accepted": 98, "no_reference": 1}
        | {"ticks": 97, "ticks_skipped": 1},
    )
    CLOCK_AHEAD_1_H = (
        _step(3600),
        {"time_ahead": 2, "gap": 1, "reference_step": 1, "accepted": 98, "no_reference": 1}
        | {"ticks": 97, "ticks_skipped": 1},
    )
    CLOCK_KIND = (
        _other_clock,
        {"clock_changed": 2, "clock_step": 1, "reference_step": 1, "accepted": 98, "no_reference": 1}
        | {"ticks": 97, "ticks_skipped": 1},
    )
    ABSURD_AHEAD = (_absurd(1e9), {"time_ahead": 1, "accepted": 99, "ticks": 99, "ticks_empty": 1})
    ABSURD_BEHIND = (_absurd(-1e9), {"time_behind": 1, "accepted": 99, "ticks": 99, "ticks_empty": 1})
    REFERENCE_ABSURD_AHEAD = (_absurd_reference(1e9), {"reference_jump": 1, "reference": 100})
    REFERENCE_ABSURD_BEHIND = (_absurd_reference(-1e9), {"reference_jump": 1, "reference": 100})
    REFERENCE_DOUBLED = (_doubled_reference, {"reference_doubled": 1})
    NO_REFERENCE = (_no_reference, {"reference": 0, "no_reference": 100, "ticks": 0, "ticks_skipped": 100})
    REFERENCE_STOPS = (_reference_stops, {"reference": 60, "no_reference": 40, "ticks": 60, "ticks_skipped": 40})
    REFERENCE_PAUSES = (_reference_pauses, {"reference": 81, "no_reference": 20, "ticks": 80, "ticks_skipped": 20})

    def apply(self, stream: Stream) -> Stream:
        """The spoiled stream."""
        spoil: Callable[[Stream], Stream] = self.value[0]
        return spoil(stream)

    @property
    def counts(self) -> dict[str, int]:
        """Everything that is to be counted, without what is 0."""
        usual = {"accepted": 100, "reference": 101, "ticks": 100}
        return {name: count for name, count in (usual | self.value[1]).items() if count}


def counted(counters: Counter[str]) -> dict[str, int]:
    """Counters without those at 0."""
    return {name: count for name, count in counters.items() if count}


def same_tick(a: Tick, b: Tick) -> bool:
    """Whether two ticks are equal bit for bit."""
    arrays = ("times_s", "field_body_nt", "reference_magnitude_nt", "reference_eci_nt")
    plain = ("index", "after_gap", "time_ns", "clock")

    def raw(tick: Tick, name: str) -> bytes | None:
        value = getattr(tick, name)
        return None if value is None else value.tobytes()

    return all(raw(a, name) == raw(b, name) for name in arrays) and all(
        getattr(a, name) == getattr(b, name) for name in plain
    )


def same_ticks(a: Sequence[Tick], b: Sequence[Tick]) -> bool:
    """Whether two runs made the same ticks, bit for bit."""
    return len(a) == len(b) and all(map(same_tick, a, b))
