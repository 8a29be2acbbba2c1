"""Does the sensor repeat each reading until it has a new one?  Learnt from what follows a repeat, live.

After a held reading all three axes move on together by more than their resolution, while a craft that stands still
moves on by one step of one axis.  It is the rule of ``recordings.inspect`` (held readings), over the newest samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from magcal_service.base.snapshot import Stateful
from magcal_service.wire.messages import Vector

_FEWEST: Final = 10
"""Repeats from which readings are held."""

_OFTENER: Final = 5.0
"""Times oftener than chance lets three axes of this resolution repeat their values together."""

_LEARNT: Final = 256
"""Vectors from which the resolution is learnt: it is a property of the sensor."""

_COMPARED: Final = 8
"""Vectors before it that each is compared with."""

_MOST: Final = 1024
"""Samples after which all counts are halved: the newest thousand or two decide."""


@dataclass(init=False, repr=False, eq=False)
class HeldWatchMemory:
    """What of ``HeldWatch`` outlives a restart, saved and restored whole."""

    is_held: bool
    _last: Vector | None
    _pending: int
    _resolution: list[float]
    _learning: int
    _seen: list[Vector]
    _samples: float
    _repeats: float
    _held: float
    _moves: float
    _still: list[float]


class HeldWatch(Stateful, HeldWatchMemory):
    """Repeated vectors of one sensor.

    Attributes
    ----------
    is_held: whether repeats are held readings, no new information.
    """

    def __init__(self) -> None:
        self.is_held = False
        self._last = None
        self._pending = 0  # repeats since the vector last changed
        self._resolution = [0.0] * 3  # smallest difference of two values of each axis [nT]
        self._learning = _LEARNT  # vectors from which the resolution is still to be learnt
        self._seen = []  # the newest of them
        self._samples = self._repeats = self._held = self._moves = 0.0
        self._still = [0.0] * 3  # moves in which an axis kept its value

    @property
    def factor(self) -> float:
        """How many samples there are to a reading; 1 where too few are repeats."""
        return self._samples / (self._samples - self._repeats) if self._repeats >= _FEWEST else 1.0

    def push(self, field_nt: Vector) -> None:
        """Take a vector (3,) [nT], in order."""
        last, self._last = self._last, field_nt
        self._samples += 1.0
        if last is None:
            return
        if field_nt == last:
            self._pending += 1
            self._repeats += 1.0
            return
        if self._learning:
            self._learn_resolution(field_nt)
        together = True
        self._moves += 1.0
        for axis in range(3):
            step = abs(field_nt[axis] - last[axis])
            if step == 0.0:
                self._still[axis] += 1.0
            together = together and step >= 1.9 * self._resolution[axis] > 0.0
        if self._pending:
            if together:
                self._held += self._pending
            self._pending = 0
            self._judge()
        if self._samples >= _MOST:
            self._halve()

    def _learn_resolution(self, field_nt: Vector) -> None:
        self._learning -= 1
        for axis in range(3):
            apart = [abs(field_nt[axis] - other[axis]) for other in self._seen if other[axis] != field_nt[axis]]
            if apart and not 0.0 < self._resolution[axis] <= min(apart):
                self._resolution[axis] = min(apart)
        self._seen.append(field_nt)
        if len(self._seen) > _COMPARED or not self._learning:
            del self._seen[: 1 if self._learning else _COMPARED + 1]

    def _judge(self) -> None:
        chance = 1.0
        for still in self._still:
            chance *= (still + 1.0) / (self._moves + 1.0)
        enough = max(_FEWEST, 0.5 * self._repeats, _OFTENER * chance * self._samples)
        self.is_held = self._held >= (0.5 * enough if self.is_held else enough)

    def _halve(self) -> None:
        self._samples, self._repeats, self._held = 0.5 * self._samples, 0.5 * self._repeats, 0.5 * self._held
        self._moves, self._still = 0.5 * self._moves, [0.5 * one for one in self._still]
        if self._repeats < 0.5 * _FEWEST:
            self.is_held = False
