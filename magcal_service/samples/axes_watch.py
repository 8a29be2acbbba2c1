"""Were axes of the magnetometer swapped or flipped in flight?  |B| cannot show it, the vector's own continuity can.

A field that turns evenly seen from the body follows, at even steps of time, d_{k+1} = 2 cos(phi) d_k - d_{k-1}, where
d_k = B_k - B_{k-1} and phi is the turn in a step.  The bias drops out, and so does the turn's axis, and a turn of more
than half a circle in a step is no other than a small one.  The two factors are fitted to the newest samples; a craft
that does not turn, or tumbles, gets those that predict it best.  What the prediction misses by has a usual size.

A change P of the axes at one sample makes three predictions in a row wrong, those that hold samples of both sides, and
none afterwards.  So a jump is suspected at one wrong prediction, and found when ``_CONFIRMED`` samples later it has
stayed and a P out of 48 makes the three predictions right again, and the sense in which the field turns as well.  An
outlier comes back, a step of the bias and a fast turn are undone by no P (but by rare chance: the page on trust has how
rare).  Where predictions have failed again and again lately, or jumps stayed that no P undoes, chance has many
tries and nothing is named: the samples do not follow each other at the steps of time that they claim, as rows do that
were logged in bursts with times made evenly.

Where it is blind: a P that hardly moves the vector at that moment; a change within a pause, or at uneven steps of time;
a craft whose tumbling the two factors do not predict to a quarter of the field.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.model import Array
from magcal_service.samples.signed_axes import PROPER, SAME, SIGNED_AXES, product_of
from magcal_service.wire.messages import Vector

_SHORTEST_S: Final = 0.099
"""Samples closer than this are thinned [s]: ten a second show every turn of a craft."""

_UNEVEN: Final = 0.1
"""Share by which a step of time may differ from the usual one: beyond, nothing is predicted over it."""

_MEMORY: Final = 128
"""Predictions from which factors and usual miss are known."""

_FEWEST: Final = 60
"""Predictions before any is judged: two factors and a median are known to a tenth."""

_USUAL: Final = 2.6
"""Times the median of the misses' squares, what is taken as usual: nine in ten Gaussian ones are below.

An outlier spoils three predictions, so that one sample in ten spoils a third: the median bears it.
"""

_SUSPECT: Final = 9.0
"""Times the usual square from which a miss is suspected: 7.5 sigma of Gaussian ones."""

_RESTORED: Final = 6.0
"""Times the usual square that three predictions may miss by together where P is right: 0.999 of Gaussian ones do."""

_LEAST_JUMP: Final = 0.25
"""Share of the vector's length that a jump has to have: 14 degrees; a smaller one is no swap that matters."""

_CONFIRMED: Final = 15
"""Samples after a jump that have to agree with it."""

_FAR: Final = 4.0
"""Times the usual square, what is far beyond: one Gaussian miss in 50 000 is."""

_FAR_ONES: Final = 3
"""Of the predictions in memory as many may lie far beyond where a P is named: one outlier's.

Of rows in bursts, turned by hand, twice as many do wherever the turn is fast; of even rows none in ten logs.
"""

_UNEXPLAINED: Final = 1.5
"""Jumps that stayed and no P undid, the newest counting most, from which on none is named; one may be a bias step."""

_UNEXPLAINED_MEMORY: Final = 256
"""Samples after which such a jump counts 1/e: two memories of the usual miss."""

_QUIET: Final = 0.8
"""Share of the later predictions that have to be as good as usual."""

_STEADY: Final = 0.7
"""Of sums of d x d to sums of |d x d|, from which on the field turns about a steady axis; of noise it is 0.2."""


@dataclass(init=False, repr=False, eq=False)
class AxesWatchMemory:
    """What of ``AxesWatch`` outlives a restart, saved and restored whole."""

    changes: list[int]
    since_s: float
    _step_s: float
    _times: list[float]
    _fields: list[Vector]
    _sums: list[float]
    _turn: list[float]
    _misses: deque[float]
    _usual: float
    _unexplained: float
    _seen: int


class AxesWatch(Stateful, AxesWatchMemory):
    """The continuity of one craft's measured vectors.

    Attributes
    ----------
    changes: numbers in ``SIGNED_AXES`` of what may have become of the axes, one where it is clear; empty: nothing.
    since_s: since when [s], in the ticks' time.
    """

    def __init__(self) -> None:
        self.changes = []
        self.since_s = 0.0
        self._step_s = 0.0
        self._times, self._fields = [], []  # the newest three, or those since three before a suspected jump
        self._sums = [0.0] * 5  # of d1.d1, d1.d0, d0.d0, d2.d1, d2.d0, newest counting most
        self._turn = [0.0] * 4  # sums of d1 x d2 and of its length
        self._misses = deque(maxlen=_MEMORY)
        self._usual = 0.0  # square of a usual miss [nT^2]
        self._unexplained = 0.0  # jumps that stayed and that no change of axes undoes
        self._seen = 0

    def interrupt(self) -> None:
        """A pause lies before the next sample."""
        self._times, self._fields = [], []

    def push(self, time_s: float, field_nt: Vector) -> None:
        """Take a measured vector (3,) [nT], in order of time [s]."""
        if self._times:
            step_s = time_s - self._times[-1]
            if step_s < _SHORTEST_S:
                return
            if abs(step_s - self._step_s) > _UNEVEN * self._step_s:
                self._step_s = step_s if not self._seen or step_s < self._step_s else 1.1 * self._step_s
                self.interrupt()
            else:
                self._step_s += 0.02 * (step_s - self._step_s)
        self._times.append(time_s)
        self._fields.append(field_nt)
        count = len(self._fields)
        if count < 4:
            return
        if count == 4:
            d = _differences(self._fields)
            miss, jump = self._miss(d)
            if not self._is_suspect(miss, jump):
                self._learn(d, miss)
                del self._times[0], self._fields[0]
            return
        if count >= 3 + _CONFIRMED:
            self._decide()

    # Prediction

    def _factors(self) -> tuple[float, float]:
        a, b, c, p, q = self._sums
        a, c = a * 1.001 + 1e-9, c * 1.001 + 1e-9
        determinant = a * c - b * b
        return (p * c - q * b) / determinant, (q * a - p * b) / determinant

    def _miss(self, d: tuple[Vector, Vector, Vector]) -> tuple[float, float]:
        """Square of the prediction's miss [nT^2], and its share of the vector's squared length."""
        first, then = self._factors()
        (x0, y0, z0), (x1, y1, z1), (x2, y2, z2) = d
        ex, ey, ez = x2 - first * x1 - then * x0, y2 - first * y1 - then * y0, z2 - first * z1 - then * z0
        x, y, z = self._fields[3]
        miss = ex * ex + ey * ey + ez * ez
        return miss, miss / max(x * x + y * y + z * z, 1.0)

    def _is_suspect(self, miss: float, share: float) -> bool:
        return self._seen >= _FEWEST and miss > _SUSPECT * self._usual and share > _LEAST_JUMP**2

    def _learn(self, d: tuple[Vector, Vector, Vector], miss: float) -> None:
        """Take one prediction into factors and usual miss; one beyond the usual counts by how far it is."""
        self._seen += 1
        self._misses.append(miss)
        self._unexplained *= 1.0 - 1.0 / _UNEXPLAINED_MEMORY
        if self._seen <= _FEWEST or self._seen % 8 == 0:
            self._usual = _USUAL * sorted(self._misses)[len(self._misses) // 2]
        weight = 1.0 if self._seen <= 10 or miss <= _FAR * self._usual else _FAR * self._usual / miss
        keep = 1.0 - weight / min(self._seen + 1, _MEMORY)
        (x0, y0, z0), (x1, y1, z1), (x2, y2, z2) = d
        d11, d10, d00, d21, d20 = self._sums
        self._sums = [
            keep * d11 + weight * (x1 * x1 + y1 * y1 + z1 * z1),
            keep * d10 + weight * (x1 * x0 + y1 * y0 + z1 * z0),
            keep * d00 + weight * (x0 * x0 + y0 * y0 + z0 * z0),
            keep * d21 + weight * (x2 * x1 + y2 * y1 + z2 * z1),
            keep * d20 + weight * (x2 * x0 + y2 * y0 + z2 * z0),
        ]
        x, y, z = y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2  # d1 x d2
        turn_x, turn_y, turn_z, length = self._turn
        self._turn = [
            keep * turn_x + weight * x,
            keep * turn_y + weight * y,
            keep * turn_z + weight * z,
            keep * length + weight * math.sqrt(x * x + y * y + z * z),
        ]

    # A suspected jump

    def _decide(self) -> None:
        """Enough samples have followed a suspected jump: what it was, and go on after it."""
        fields = np.array(self._fields)
        stays = self._stays(fields)
        found = self._changes(fields) if stays else []
        if stays and not found:
            self._unexplained += 1.0
        if found and self._is_continuous():
            before = self.changes or [SAME]
            self.changes = sorted({product_of(old, new) for old in before for new in found})
            self.since_s = self._times[3]
            if self.changes == [SAME]:
                self.changes = []
            turns = PROPER[found[0]] * SIGNED_AXES[found[0]] @ np.array(self._turn[:3])
            self._turn[:3] = turns.tolist() if len(found) == 1 else [0.0] * 3
            self._times, self._fields = self._times[-3:], self._fields[-3:]
            return
        waiting = list(zip(self._times, self._fields, strict=True))
        self._times, self._fields = [], []
        d = _differences([field for _, field in waiting[:4]])
        self._fields = [field for _, field in waiting[:4]]
        self._learn(d, self._miss(d)[0])
        self._times, self._fields = [], []
        for time_s, field in waiting[1:]:
            self.push(time_s, field)

    def _is_continuous(self) -> bool:
        """Whether the vector has gone on evenly of late, so that a jump is an event and not the rule."""
        far = sum(miss > _FAR * self._usual for miss in self._misses)
        return far <= _FAR_ONES and self._unexplained < _UNEXPLAINED

    def _stays(self, fields: Array) -> bool:
        """Whether all is as usual again from sample 3 of ``fields`` (n, 3) on."""
        later = _missed(fields[3:], np.array(self._factors()))
        return bool(np.mean(later <= _FAR * self._usual) >= _QUIET)

    def _changes(self, fields: Array) -> list[int]:
        """Changes of the axes (numbers) that undo a jump at sample 3 of ``fields`` (n, 3)."""
        factors = np.array(self._factors())
        undone = np.einsum("pij,ni->pnj", SIGNED_AXES, fields[3:6])  # P' B
        straddling = np.concatenate([np.broadcast_to(fields[:3], (len(undone), 3, 3)), undone], axis=1)
        missed = np.array([_missed(one, factors).sum() for one in straddling])
        good = np.flatnonzero(missed <= _RESTORED * self._usual)
        if SAME in good:
            return []
        return [int(one) for one in good if self._turns_as_before(int(one), fields[3:])]

    def _turns_as_before(self, change: int, fields: Array) -> bool:
        """Whether the field turns as it did, where it turned steadily and does so now."""
        d = np.diff(fields, axis=0)
        now = np.cross(d[:-1], d[1:])
        before = np.array(self._turn[:3])
        length, total = float(np.linalg.norm(now.sum(axis=0))), float(np.linalg.norm(now, axis=1).sum())
        if np.linalg.norm(before) < _STEADY * self._turn[3] or length < _STEADY * total:
            return True
        undone = PROPER[change] * now.sum(axis=0) @ SIGNED_AXES[change]
        return bool(undone @ before > _STEADY * length * np.linalg.norm(before))


def _missed(fields: Array, factors: Array) -> Array:
    """Squares of the predictions' misses (n - 3,) of fields (n, 3)."""
    d = np.diff(fields, axis=0)
    missed = d[2:] - factors[0] * d[1:-1] - factors[1] * d[:-2]
    return np.asarray(np.einsum("ni,ni->n", missed, missed))


def _differences(fields: list[Vector]) -> tuple[Vector, Vector, Vector]:
    (ax, ay, az), (bx, by, bz), (cx, cy, cz), (dx, dy, dz) = fields
    return (bx - ax, by - ay, bz - az), (cx - bx, cy - by, cz - bz), (dx - cx, dy - cy, dz - cz)
