"""Is one axis of the magnetometer constant while the others change?  A dead axis, or one with lost bits.

Where the noise is known, and the axis has shown values far closer together than it, noise alone would have changed the
value: a few identical ones in a row are a fault.  Of a coarse sensor that points along a steady axis they show little;
there it is a fault when the value is constant for a minute while another component changes by a fifth of the field.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from magcal_service.base.snapshot import Stateful
from magcal_service.wire.messages import Vector

_FEWEST: Final = 60
"""Identical values in a row, at least, whatever the sample rate."""

_FINE: Final = 0.2
"""Resolution of an axis, as a share of the noise, below which noise changes it: two alike have a chance of 8 %."""

_COMPARED: Final = 64
"""Values whose closest two give the resolution."""

_MOVED: Final = 0.2
"""How far another component has to change meanwhile, as a share of the vector's length."""


@dataclass(init=False, repr=False, eq=False)
class AxisWatchMemory:
    """What of ``AxisWatch`` outlives a restart, saved and restored whole."""

    _last: list[float]
    _count: list[int]
    _since_ns: list[int]
    _fine: list[bool]
    _seen: list[list[float]]
    _low: list[list[float]]
    _high: list[list[float]]


class AxisWatch(Stateful, AxisWatchMemory):
    """Watches the three components of one sensor.

    Parameters
    ----------
    longest_ns: how long a component may keep one value while the others move [ns].
    fewest: identical values in a row that are a fault where noise would have changed them.
    noise_nt: the sensor's noise, 1 sigma [nT]; None: not known.
    """

    def __init__(self, longest_ns: int, fewest: int, noise_nt: float | None) -> None:
        self._longest_ns, self._fewest, self._noise_nt = longest_ns, fewest, noise_nt or 0.0
        self._fine = [False] * 3  # whether the resolution is known to be that fine
        self._seen = [[], [], []]  # the newest values, until it is
        self._last, self._count, self._since_ns = [0.0] * 3, [0] * 3, [0] * 3
        self._low, self._high = [[], [], []], [[], [], []]  # of the vectors since each axis took its value

    @property
    def is_fine(self) -> bool:
        """Whether noise is known to change every axis from one reading to the next."""
        return all(self._fine)

    def stands_still(self, elapsed_ns: int, field_nt: Vector) -> bool:
        """Take one vector [nT] with its elapsed time [ns], in order; whether an axis has been constant for too long."""
        still = [self._stands_still(axis, elapsed_ns, field_nt) for axis in range(3)]
        return any(still)

    def _stands_still(self, axis: int, elapsed_ns: int, field_nt: Vector) -> bool:
        low, high = self._low[axis], self._high[axis]
        if field_nt[axis] != self._last[axis] or not self._count[axis]:
            if not self._fine[axis]:
                self._learn_resolution(axis, field_nt[axis])
            self._last[axis], self._count[axis], self._since_ns[axis] = field_nt[axis], 1, elapsed_ns
            low[:], high[:] = field_nt, field_nt
            return False
        self._count[axis] += 1
        if self._count[axis] >= self._fewest and self._fine[axis]:
            return True
        for other, value in enumerate(field_nt):
            low[other], high[other] = min(low[other], value), max(high[other], value)
        long = self._count[axis] >= _FEWEST and elapsed_ns - self._since_ns[axis] >= self._longest_ns
        if not long:
            return False
        least_nt = _MOVED * max(map(abs, field_nt))
        return max(top - bottom for top, bottom in zip(high, low, strict=True)) >= least_nt

    def _learn_resolution(self, axis: int, value: float) -> None:
        if not self._noise_nt:
            return
        seen = self._seen[axis]
        self._fine[axis] = any(0.0 < abs(value - other) < _FINE * self._noise_nt for other in seen)
        seen.append(value)
        if self._fine[axis] or len(seen) > _COMPARED:
            del seen[: len(seen) if self._fine[axis] else 1]
