"""Samples in, 1 s ticks out: pairing with the reference, gaps, late and doubled samples.  Time is the samples' time.

A tick is one second of sample time, centred on whole seconds after the first sample.  It closes when a later sample
has arrived and the reference covers it, or without, ``hold_s`` after it and after the time the next reference was due.
While each stream is in order and the reference no later than that, a tick's contents don't depend on how the two were
interleaved, which is why a replay equals the live run bit for bit.

What happens to a sample that is not the next in time (each outcome is counted under its name; ``Rejection`` has those
that reject it):

=====================  ===============================================================================================
``out_of_order``       older than its predecessor, its tick still open: accepted, sorted in.
``late``               its tick is closed: rejected.
``doubled``            the time of a sample already taken: rejected.
``stuck``              the same vector for ``stuck_samples`` samples: rejected from then on, until it changes.
``time_behind``        more than ``late_s`` behind: rejected; the third in a row that agree is a ``clock_step``
                       backwards.
``time_ahead``         more than ``step_confirm_s`` ahead: rejected; the third in a row that agree is believed, a
                       century ahead as a ``clock_step``.
``gap``                more than ``gap_s`` after its predecessor: accepted; nothing is carried over the gap.
``clock_changed``      other clock (UTC or elapsed) than the samples before: rejected; the third is a ``clock_step``.
``time_out_of_range``  its time is outside of ``ticks.time_window``: rejected.
``saturated``          a component reaches ``range_nt``: rejected.
``axis_stuck``         one component is constant while noise or the others should change it: rejected until it
                       changes.
``zero``               all three components are 0, as of a sensor that has not measured yet: rejected.
``crowded``            its second holds ``_MOST_IN_TICK`` samples already: rejected.
``held``               the vector of the sample before, where noise would have changed each axis, or all axes move
                       on together after repeats: the sensor had no new one; it is calibrated, but not used by the
                       estimator.
``no_reference``       no reference at its time when its tick closes: it is calibrated, but not used by the estimator.
=====================  ===============================================================================================

A tick of which no sample has a reference is skipped and counted under ``ticks_skipped``; a second without samples,
between two that are less than ``gap_s`` apart, under ``ticks_empty``.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import Counter
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.config.settings import SensorConfig, TickConfig
from magcal_service.model import Array
from magcal_service.ticks.axis_watch import AxisWatch
from magcal_service.ticks.held_watch import HeldWatch
from magcal_service.ticks.rate_track import RateTrack
from magcal_service.ticks.reference_track import ReferenceTrack
from magcal_service.ticks.rejection import Rejection
from magcal_service.ticks.time_window import FURTHEST_NS, LONGEST_NS, is_usable
from magcal_service.wire.messages import Clock, MagnetometerSample, ReferenceSample, TelemetrySample, Vector

SECOND_NS: Final = 1_000_000_000
"""Nanoseconds in a second: wire times are whole nanoseconds, a tick is one second."""

_AGREEING: Final = 3
"""Samples in a row that have to agree on a new time before it is accepted."""

_REMEMBERED: Final = 512
"""Times of accepted samples that a new one is compared with to find duplicates: 10 s at 50 Hz."""

_MOST_IN_TICK: Final = 1000
"""Samples in one second: 20 times the fastest sensor, so that a source out of control cannot fill the memory."""


@dataclass(frozen=True, slots=True)
class Tick:
    """The samples of one second of sample time, each paired with the reference at its time.

    A tick with n = 0 had samples but no reference for any of them: it is skipped and counted.

    Parameters
    ----------
    index: number of the second since the first sample (steps of the clock taken out).
    times_s: sample times since the first sample (n,) [s], rising.
    field_body_nt: measured vectors B (n, 3) [nT].
    reference_magnitude_nt: |H| (n,) [nT].
    reference_eci_nt: H (n, 3) [nT] in the inertial frame, where the reference is such a vector.
    after_gap: a gap or a clock step lies before this tick: nothing may be carried over from earlier ones.
    time_ns, clock: source time of the last sample, for labels.
    rate_body_rad_s: angular rate (n, 3) [rad/s] in the body, where a gyro's channel covers every sample.
    """

    index: int
    times_s: Array
    field_body_nt: Array
    reference_magnitude_nt: Array
    reference_eci_nt: Array | None = None
    after_gap: bool = False
    time_ns: int = 0
    clock: Clock = Clock.ELAPSED
    rate_body_rad_s: Array | None = None


@dataclass(init=False, repr=False, eq=False)
class TickAssemblerMemory:
    """What of ``TickAssembler`` outlives a restart, saved and restored whole."""

    counters: Counter[str]
    rates: RateTrack
    references: ReferenceTrack
    _clock: Clock | None
    _base_ns: int
    _newest_ns: int
    _closed_ns: int
    _open: list[tuple[int, MagnetometerSample]]
    _last_ns: int | None
    _broken: bool
    _recent: dict[int, Vector]
    _votes: list[tuple[Rejection, int]]
    _same: int
    _last_field: Vector | None
    _axes: AxisWatch
    _held: HeldWatch
    _done: list[Tick]


class TickAssembler(Stateful, TickAssemblerMemory):
    """Groups one craft's samples into ticks.

    Parameters
    ----------
    config: times of the tick stage.
    sensor: when a sensor counts as stuck.
    """

    worked_out = ("_hold_ns",)  # of the configuration and of the physics that is loaded

    def __init__(self, config: TickConfig, sensor: SensorConfig) -> None:
        self.sensor = sensor
        self.counters = Counter()
        self._gap_ns = round(config.gap_s * SECOND_NS)
        self._late_ns = round(config.late_s * SECOND_NS)
        self._configured_hold_ns = self._hold_ns = round(config.hold_s * SECOND_NS)
        self._jump_ns = round(config.step_confirm_s * SECOND_NS)
        max_gap_ns = round(config.reference_max_gap_s * SECOND_NS)
        self.rates = RateTrack(max_gap_ns)
        self.references = ReferenceTrack(max_gap_ns, self.counters, self._late_ns, self._jump_ns)
        self._clock = None
        self._base_ns = 0  # source time less elapsed time
        self._newest_ns = 0  # elapsed time of the newest accepted sample
        self._closed_ns = -SECOND_NS // 2  # elapsed time before which every tick is closed
        self._open = []  # by elapsed time
        self._last_ns = None  # elapsed time of the last sample in a closed tick, None after a clock step
        self._broken = False  # a gap or a clock step since the last tick that had a reference
        self._recent = {}  # accepted samples: their times and vectors
        self._votes = []
        self._same = 0
        self._last_field = None
        self._axes = AxisWatch(round(sensor.axis_stuck_s * SECOND_NS), sensor.stuck_samples, sensor.noise_nt)
        self._held = HeldWatch()
        self._done = []

    @property
    def closed(self) -> int:
        """Ticks closed so far, with and without a reference."""
        return self.counters["ticks"] + self.counters["ticks_skipped"]

    @property
    def newest_s(self) -> float:
        """Elapsed time of the newest accepted sample [s]."""
        return self._newest_ns * 1e-9

    @property
    def _repeats_are_held(self) -> bool:
        return self._axes.is_fine or self._held.is_held

    @property
    def repeats(self) -> bool:
        """Whether the newest sample is only the reading before it again, held by the sensor."""
        return self._same > 1 and self._repeats_are_held

    @property
    def held_factor(self) -> float:
        """Samples to a reading of the sensor, where it holds each for several; else 1."""
        factor = self._held.factor
        return factor if factor > 1.0 and self._repeats_are_held else 1.0

    def elapsed_s(self, sample: MagnetometerSample) -> float:
        """Time of a sample that was taken since the first one [s], as its tick has it."""
        return (sample.time_ns - self._base_ns) * 1e-9

    def wait_longer(self, seconds: float) -> None:
        """Wait so much longer for references than configured [s]: their time tags are shifted."""
        self._hold_ns = self._configured_hold_ns + round(seconds * SECOND_NS)

    def go_on_from(self, before: TickAssembler) -> None:
        """Know again as doubled what another has accepted, and go on with its counters; nothing else is taken."""
        self._recent = dict(before._recent)
        self.counters.update(before.counters)

    def add_reference(self, sample: ReferenceSample) -> None:
        """Take a reference sample; what is wrong with it is counted."""
        self.references.add(sample)

    def add_rate(self, sample: TelemetrySample) -> bool:
        """Take a telemetry sample if it is the craft's angular rate; whether it was."""
        return self.rates.add(sample)

    def add(self, sample: MagnetometerSample) -> Rejection | None:
        """Take a magnetometer sample; why it is rejected (and counted), None where it is accepted."""
        rejection = self.rejection(sample)
        if rejection is None:
            self.take(sample, sample)
        return rejection

    def rejection(self, sample: MagnetometerSample) -> Rejection | None:
        """Why a sample is rejected (and counted); None where it is acceptable: then ``take`` has to follow."""
        rejection = self._rejection(sample)
        if rejection is not None:
            self.counters[rejection.value] += 1
        return rejection

    def take(self, sample: MagnetometerSample, corrected: MagnetometerSample) -> None:
        """Take a sample that was not rejected; the measured one is kept to find duplicates, ``corrected`` is used."""
        self._votes.clear()
        elapsed_ns = sample.time_ns - self._base_ns
        if elapsed_ns < self._newest_ns:
            self.counters["out_of_order"] += 1
        elif elapsed_ns - self._newest_ns > self._gap_ns:
            self.counters["gap"] += 1
        self._newest_ns = max(self._newest_ns, elapsed_ns)
        self._held.push(sample.field_body_nt)
        if self.repeats:
            self.counters["held"] += 1
        elif not self._open or elapsed_ns >= self._open[-1][0]:
            self._open.append((elapsed_ns, corrected))
        else:
            insort(self._open, (elapsed_ns, corrected), key=_elapsed)
        self._recent[sample.time_ns] = sample.field_body_nt
        if len(self._recent) > _REMEMBERED:
            del self._recent[next(iter(self._recent))]
        self.counters["accepted"] += 1

    def _rejection(self, sample: MagnetometerSample) -> Rejection | None:
        if not is_usable(sample.time_ns):
            return Rejection.TIME_OUT_OF_RANGE
        if not any(sample.field_body_nt):
            return Rejection.ZERO
        if self._recent.get(sample.time_ns) == sample.field_body_nt and self._clock in (sample.clock, None):
            return Rejection.DOUBLED  # however far behind: a node's history after a restart, no step of its clock
        if self._clock is None:
            self._anchor(sample, 0)
        elapsed_ns = sample.time_ns - self._base_ns
        strange = self._strange_time(sample, elapsed_ns)
        if strange is not None:
            rejection = self._vote(sample, strange)
            if rejection is not None:
                return rejection
            elapsed_ns = sample.time_ns - self._base_ns
        elif sample.time_ns in self._recent:
            return Rejection.DOUBLED
        elif elapsed_ns < self._closed_ns:
            return Rejection.LATE
        elif self._is_crowded(elapsed_ns):
            return Rejection.CROWDED
        return self._sensor_fault(sample, elapsed_ns)

    def _strange_time(self, sample: MagnetometerSample, elapsed_ns: int) -> Rejection | None:
        """What is to be confirmed of a sample's time."""
        if sample.clock is not self._clock:
            return Rejection.CLOCK_CHANGED
        if elapsed_ns > self._newest_ns + self._jump_ns or elapsed_ns > LONGEST_NS:
            return Rejection.TIME_AHEAD
        return Rejection.TIME_BEHIND if elapsed_ns < self._newest_ns - self._late_ns else None

    def _sensor_fault(self, sample: MagnetometerSample, elapsed_ns: int) -> Rejection | None:
        """What is wrong with the sensor; asked after an outage and a step of the clock as well."""
        if self._is_stuck(sample):
            return Rejection.STUCK
        if self.sensor.range_nt is not None and max(map(abs, sample.field_body_nt)) >= self.sensor.range_nt:
            return Rejection.SATURATED
        return Rejection.AXIS_STUCK if self._axes.stands_still(elapsed_ns, sample.field_body_nt) else None

    def _is_crowded(self, elapsed_ns: int) -> bool:
        if len(self._open) < _MOST_IN_TICK:
            return False
        begin = bisect_left(self._open, _edge_after(elapsed_ns) - SECOND_NS, key=_elapsed)
        return len(self._open) - begin >= _MOST_IN_TICK

    def _is_stuck(self, sample: MagnetometerSample) -> bool:
        self._same = self._same + 1 if sample.field_body_nt == self._last_field else 1
        self._last_field = sample.field_body_nt
        return self._same >= self.sensor.stuck_samples

    def _vote(self, sample: MagnetometerSample, reason: Rejection) -> Rejection | None:
        """Reject a sample whose time does not fit; the third of a rising series moves the clock and is believed."""
        if self._votes:
            before, time_ns = self._votes[-1]
            if before is not reason or not 0 < sample.time_ns - time_ns <= self._gap_ns:
                self._votes.clear()
        self._votes = [*self._votes[1 - _AGREEING :], (reason, sample.time_ns)]
        if len(self._votes) < _AGREEING:
            return reason
        if reason is not Rejection.TIME_AHEAD or sample.time_ns - self._base_ns > FURTHEST_NS:
            # elapsed time goes on over the step
            self.counters["clock_step"] += 1
            self._close_all()
            self._anchor(sample, self._newest_ns + SECOND_NS)
            self._last_ns, self._broken = None, True
            self._recent.clear()
        return None

    def _anchor(self, sample: MagnetometerSample, elapsed_ns: int) -> None:
        self._clock = sample.clock
        self._base_ns = sample.time_ns - elapsed_ns

    def ready(self) -> list[Tick]:
        """The ticks that have closed since the last call, in order."""
        while self._open:
            edge_ns = _edge_after(self._open[0][0])
            if self._newest_ns < edge_ns:
                break
            count = bisect_left(self._open, edge_ns, key=_elapsed)
            last = self._open[count - 1][1]
            covered = self.references.covers(last.time_ns, last.clock)
            if not covered and self._newest_ns < self._patience_ns(edge_ns, last):
                break
            self._close(count, edge_ns)
        done, self._done = self._done, []
        return done

    def _patience_ns(self, edge_ns: int, last: MagnetometerSample) -> int:
        """Elapsed time up to which a tick waits for a reference that covers it."""
        due_ns = self.references.due_ns(last.clock)
        return self._hold_ns + (edge_ns if due_ns is None else max(edge_ns, due_ns - self._base_ns))

    def flush(self) -> list[Tick]:
        """Close every open tick with what is there: the end of a stream."""
        self._close_all()
        return self.ready()

    def _close_all(self) -> None:
        while self._open:
            edge_ns = _edge_after(self._open[0][0])
            self._close(bisect_left(self._open, edge_ns, key=_elapsed), edge_ns)

    def _close(self, count: int, edge_ns: int) -> None:
        """Pair the first ``count`` open samples with the reference and make a tick of those that have one."""
        members, self._open = self._open[:count], self._open[count:]
        self._closed_ns = edge_ns
        index = edge_ns // SECOND_NS
        paired = [
            (elapsed_ns, sample, found)
            for elapsed_ns, sample in members
            if (found := self.references.at(sample.time_ns, sample.clock)) is not None
        ]
        self.references.discard_before(members[-1][1].time_ns)
        if self._last_ns is not None and members[0][0] - self._last_ns > self._gap_ns:
            self._broken = True
        elif self._last_ns is not None:
            self.counters["ticks_empty"] += index - _edge_after(self._last_ns) // SECOND_NS - 1
        self._last_ns = members[-1][0]
        self.counters["no_reference"] += count - len(paired)
        self.counters["ticks" if paired else "ticks_skipped"] += 1
        vectors = [found.field_eci_nt for _, _, found in paired if found.field_eci_nt is not None]
        rates = [self.rates.at(sample.time_ns, sample.clock) for _, sample, _ in paired]
        known = [rate for rate in rates if rate is not None]
        self._done.append(
            Tick(
                index=index,
                times_s=np.array([elapsed_ns * 1e-9 for elapsed_ns, _, _ in paired]),
                field_body_nt=np.array([sample.field_body_nt for _, sample, _ in paired]).reshape(-1, 3),
                reference_magnitude_nt=np.array([found.magnitude_nt for _, _, found in paired]),
                reference_eci_nt=np.array(vectors) if paired and len(vectors) == len(paired) else None,
                after_gap=self._broken,
                time_ns=members[-1][1].time_ns,
                clock=members[-1][1].clock,
                rate_body_rad_s=np.array(known) if known and len(known) == len(rates) else None,
            )
        )
        self._broken = self._broken and not paired


def _elapsed(entry: tuple[int, MagnetometerSample]) -> int:
    return entry[0]


def _edge_after(elapsed_ns: int) -> int:
    """End of the tick that holds an elapsed time: ticks are centred on whole seconds [ns]."""
    half = SECOND_NS // 2
    return (elapsed_ns + half) // SECOND_NS * SECOND_NS + half
