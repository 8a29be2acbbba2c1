"""The reference field at the time of a magnetometer sample.

Rule: the reference is interpolated linearly between the two reference samples around the time asked for, when they
are at most ``reference_max_gap_s`` apart; a reference at exactly that time is taken as it is.  Nothing is extrapolated.
An inertial vector is interpolated as a vector.  In Earth-fixed and local frames, whose axes turn under the craft, and
for a magnitude alone, the magnitude is interpolated.

A reference whose time does not fit (other clock, more than ``late_ns`` behind or ``jump_ns`` ahead of the newest) is
held back; the third in a row that agree is a step of the clock, and the track restarts with the three.

Error: at most T^2/8 times the second derivative.  In a low orbit |d2H/dt2| is below 0.3 nT/s^2 (50 uT turning at twice
the orbital rate), so 0.04 nT at references 1 s apart and 4 nT at 10 s.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import Counter
from dataclasses import dataclass
from typing import Final

from magcal_service.base.snapshot import Stateful
from magcal_service.wire.messages import Clock, Frame, ReferenceSample, Vector

_MOST: Final = 8192
"""Reference samples kept at most; the oldest go first."""

REMEMBERED: Final = 128
"""Used references that are kept to recognise repeats when a node sends its history: 100 by default."""

SMALLEST_NT: Final = 1.0
"""A reference below this is a source that sends zeros, not a field: 1 nT is 1/20000 of the weakest at the ground."""

_AGREEING: Final = 3
"""References in a row that have to agree on a new time before it is accepted."""


@dataclass(frozen=True, slots=True)
class Reference:
    """|H| [nT] at one time, and H [nT] where it is known in the inertial frame."""

    magnitude_nt: float
    field_eci_nt: Vector | None


@dataclass(init=False, repr=False, eq=False)
class ReferenceTrackMemory:
    """What of ``ReferenceTrack`` outlives a restart, saved and restored whole."""

    _clock: Clock | None
    _times: list[int]
    _found: list[Reference]
    _votes: list[ReferenceSample]


class ReferenceTrack(Stateful, ReferenceTrackMemory):
    """Reference samples of one craft, by time.

    Parameters
    ----------
    max_gap_ns: two samples further apart are not interpolated between [ns].
    counters: where ``reference_*`` outcomes are counted.
    late_ns, jump_ns: a sample further behind or ahead of the newest has to be confirmed [ns].
    """

    worked_out = ("_counters",)  # the assembler's, which saves them

    def __init__(self, max_gap_ns: int, counters: Counter[str], late_ns: int, jump_ns: int) -> None:
        self._max_gap_ns, self._late_ns, self._jump_ns = max_gap_ns, late_ns, jump_ns
        self._counters = counters
        self._clear()

    def _clear(self, clock: Clock | None = None) -> None:
        self._clock = clock
        self._times = []
        self._found = []
        self._votes = []

    def add(self, sample: ReferenceSample) -> None:
        """Take a sample.

        ``reference`` accepted, ``reference_doubled`` rejected, ``reference_zero`` rejected because there is nothing to
        calibrate against, ``reference_jump`` rejected because its time did not fit and the next ones did not agree with
        it, ``reference_step`` the track restarted.
        """
        found = _reference_of(sample)
        if found.magnitude_nt < SMALLEST_NT:
            self._counters["reference_zero"] += 1
            return
        if not self._times or self._fits(sample) or self._is_repeated(sample, found):
            self._drop_votes()
            self._insert(sample, found)
            return
        if self._votes and not self._agree(self._votes[-1], sample):
            self._drop_votes()
        self._votes.append(sample)
        if len(self._votes) == _AGREEING:
            votes = self._votes
            self._clear(sample.clock)
            self._counters["reference_step"] += 1
            for vote in votes:
                self._insert(vote, _reference_of(vote))

    def _fits(self, sample: ReferenceSample) -> bool:
        ahead_ns = sample.time_ns - self._times[-1]
        return sample.clock is self._clock and -self._late_ns <= ahead_ns <= self._jump_ns

    def _is_repeated(self, sample: ReferenceSample, found: Reference) -> bool:
        """Whether it is known already, however far behind: a node's history after a restart, no step of its clock."""
        at = bisect_left(self._times, sample.time_ns)
        known = at < len(self._times) and self._times[at] == sample.time_ns and sample.clock is self._clock
        return known and self._found[at] == found

    def _agree(self, before: ReferenceSample, after: ReferenceSample) -> bool:
        step_ns = after.time_ns - before.time_ns
        return after.clock is before.clock and 0 < step_ns <= max(self._max_gap_ns, self._late_ns)

    def _drop_votes(self) -> None:
        self._counters["reference_jump"] += len(self._votes)
        self._votes = []

    def _insert(self, sample: ReferenceSample, found: Reference) -> None:
        time_ns, times = sample.time_ns, self._times
        self._clock = sample.clock
        at = len(times) if not times or time_ns > times[-1] else bisect_left(times, time_ns)
        if at < len(times) and times[at] == time_ns:
            self._counters["reference_doubled"] += 1
            return
        times.insert(at, time_ns)
        self._found.insert(at, found)
        self._counters["reference"] += 1
        if len(times) > _MOST:
            del times[0], self._found[0]

    def newest(self, clock: Clock) -> tuple[int, float] | None:
        """Time [ns] and length [nT] of the newest sample on a clock; None where there is none."""
        return (self._times[-1], self._found[-1].magnitude_nt) if self._times and clock is self._clock else None

    def due_ns(self, clock: Clock) -> int | None:
        """When the next reference is due by the interval of the last two; None where none is to be expected."""
        if clock is not self._clock:
            return None
        pace_ns = self._times[-1] - self._times[-2] if len(self._times) > 1 else self._max_gap_ns
        return self._times[-1] + min(pace_ns, self._max_gap_ns)

    def covers(self, time_ns: int, clock: Clock) -> bool:
        """Whether waiting longer can't bring a better reference for this time."""
        return clock is self._clock and not self._votes and self._times[-1] >= time_ns

    def at(self, time_ns: int, clock: Clock) -> Reference | None:
        """The reference at a time, or None where the rule gives none, or while a step of the clock is unconfirmed."""
        times = self._times
        after = bisect_left(times, time_ns)
        if clock is not self._clock or self._votes or after == len(times):
            return None
        if times[after] == time_ns:
            return self._found[after]
        if after == 0 or times[after] - times[after - 1] > self._max_gap_ns:
            return None
        share = (time_ns - times[after - 1]) / (times[after] - times[after - 1])
        return _between(self._found[after - 1], self._found[after], share)

    def discard_before(self, time_ns: int) -> None:
        """Discard what no later sample can need, but for the last ones, once there are many."""
        keep = bisect_left(self._times, time_ns) - 1 - REMEMBERED
        if keep > REMEMBERED:
            del self._times[:keep], self._found[:keep]


def _reference_of(sample: ReferenceSample) -> Reference:
    if sample.field_nt is None:
        return Reference(sample.magnitude_nt or 0.0, None)
    x, y, z = sample.field_nt
    return Reference(math.sqrt(x * x + y * y + z * z), sample.field_nt if sample.frame is Frame.ECI else None)


def _between(a: Reference, b: Reference, share: float) -> Reference:
    if a.field_eci_nt is None or b.field_eci_nt is None:
        return Reference(a.magnitude_nt + share * (b.magnitude_nt - a.magnitude_nt), None)
    (ax, ay, az), (bx, by, bz) = a.field_eci_nt, b.field_eci_nt
    x, y, z = ax + share * (bx - ax), ay + share * (by - ay), az + share * (bz - az)
    return Reference(math.sqrt(x * x + y * y + z * z), (x, y, z))
