"""Does compensation by ``physics.toml`` help or harm?  The magnitude's residual with it and without, block by block.

One tick in a few is kept twice, as the model corrects it and as it came, for about an orbit.  At the end of each block
both get nine errors of their own, fitted to all that is kept: those fitted with compensation do not fit without it, and
those of running filters hold what each has made of its past.  A block's score is

    q = 1/2 ln(mean e_with^2 / mean e_without^2)        e = |(I + D) B - b| - |H|     [nats a sample]

the gain of a Gaussian score whose scale is unknown.  Compensation harms where the mean of q over the blocks is above
``MARGIN`` and above ``SIGMAS`` of its error, which is the scatter over blocks: what a residual remembers within a block
is no evidence.

Source: Diebold & Mariano 1995, Comparing predictive accuracy; blocks in place of their autocovariances.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.estimators.parts.magnitude_fit import are_near, magnitude_fit
from magcal_service.model import Array

BLOCK_S: Final = 150.0
"""Length of a block [s]: many turns of a spinning craft, a fortieth of an orbit."""

KEPT: Final = 1080
"""Ticks that are kept: an orbit of 90 minutes at one in ``_SHARE`` of a sensor at 1 Hz or faster."""

_SHARE: Final = 5
"""One tick in so many is kept, at no regular times: regular ones would meet a spinning craft in the same places."""

_FEWEST: Final = 12
"""Blocks before anything is said: half an hour; in less the nine errors take up what is slow."""

_FEWEST_ROWS: Final = 10
"""Ticks in a block that counts: of the 30 that it has where none is missing."""

_TWICE: Final = 2.0
"""Times the fewest ticks, what a block should have: of random gaps, one in a hundred blocks has half."""

MARGIN: Final = 0.02
"""Nats a sample from which on it matters: 2 % of the residual's rms, a residual wrong by a fifth of the noise.

Choice: where a smooth field that the nine errors mostly take up is left in, chance lets it look better by up to 0.016.
"""

SIGMAS: Final = 3.0
"""Errors of the mean that it has to be above.

Choice: of 60 streams of an orbit whose model helps by a field of 0.3 to 2 sigma of the noise none was stopped; where it
harms, mean and scatter are of one size, and three of its errors take a quarter of an orbit.
"""

_LEAST_SCATTER: Final = 0.02
"""Of q over blocks: that of 30 samples of white noise whose residuals differ by a seventh of it."""

_LONGEST_WAIT_S: Final = 600.0
"""For the other's tick [s]: no reference comes later."""

Kept = tuple[float, float, float, float]
"""B (3) and |H| of a tick's newest sample [nT]."""


@dataclass(init=False, repr=False, eq=False)
class HarmWatchMemory:
    """What of ``HarmWatch`` outlives a restart, saved and restored whole."""

    _with: dict[float, Kept]
    _without: dict[float, Kept]
    _rows: deque[Array]
    _x_with: Array
    _x_without: Array
    _block: int


class HarmWatch(Stateful, HarmWatchMemory):
    """The comparison for one craft.

    Parameters
    ----------
    x: nine errors (9,) of the model, where the fits begin.
    """

    def __init__(self, x: Array) -> None:
        self._first = x
        self.reset()

    def reset(self) -> None:
        """Nothing is known."""
        self._with, self._without = {}, {}
        self._rows = deque(maxlen=KEPT)  # time [s], B and |H| with compensation, B and |H| without
        self._x_with, self._x_without = np.array(self._first), np.array(self._first)
        self._block = -1

    def compensated(self, time_s: float, field_nt: Array, magnitude_nt: float) -> None:
        """A tick's newest sample (3,) and its reference as they are compensated [nT], where all of it is."""
        self._take(self._with, time_s, field_nt, magnitude_nt)

    def plain(self, time_s: float, field_nt: Array, magnitude_nt: float) -> None:
        """The same as they came."""
        self._take(self._without, time_s, field_nt, magnitude_nt)

    def _take(self, ours: dict[float, Kept], time_s: float, field_nt: Array, magnitude_nt: float) -> None:
        if not _is_kept(time_s):
            return
        x, y, z = field_nt.tolist()
        ours[time_s] = (x, y, z, magnitude_nt)
        if time_s in self._with and time_s in self._without:
            row = (time_s, *self._with.pop(time_s), *self._without.pop(time_s))
            self._rows.append(np.array(row))
        for waiting in (self._with, self._without):
            for old in [one for one in waiting if one < time_s - _LONGEST_WAIT_S]:
                del waiting[old]

    def harm(self) -> str:
        """How much worse compensation makes the residual, in words; empty while it does not, or nothing is known."""
        if not self._rows:
            return ""
        block = int(self._rows[-1][0] // BLOCK_S)
        if block == self._block:
            return ""
        self._block = block
        scores = self._scores()
        if len(scores) < _FEWEST:
            return ""
        mean = float(scores.mean())
        error = max(float(scores.std(ddof=1)), _LEAST_SCATTER) / math.sqrt(len(scores))
        if mean <= max(MARGIN, SIGMAS * error):
            return ""
        minutes = len(scores) * _block_s(np.array([row[0] for row in self._rows])) / 60.0
        return f"{100.0 * math.expm1(mean):.0f} % more residual with it than without over {minutes:.0f} min"

    def _scores(self) -> Array:
        """q of each block (k,) that has enough ticks; none before there are ``_FEWEST``."""
        rows = np.array(self._rows)
        block = rows[:, 0] // _block_s(rows[:, 0])
        number, counts = np.unique(block, return_counts=True)
        number = number[counts >= _FEWEST_ROWS]
        if len(number) < _FEWEST:
            return np.zeros(0)
        ours = magnitude_fit(self._x_with, rows[:, 1:4], rows[:, 4])
        theirs = magnitude_fit(self._x_without, rows[:, 5:8], rows[:, 8])
        self._x_with, self._x_without = ours.x, theirs.x
        near = are_near(np.minimum(np.abs(ours.residual_nt), np.abs(theirs.residual_nt)))  # the sensor's hit both
        squares = [ours.residual_nt**2, theirs.residual_nt**2]
        found = []
        for one in number.tolist():
            inside = near & (block == one)
            if np.count_nonzero(inside) >= _FEWEST_ROWS:
                a, b = (max(float(part[inside].mean()), 1e-12) for part in squares)
                found.append(0.5 * math.log(a / b))
        return np.array(found)


def _block_s(time_s: Array) -> float:
    """Length of a block [s] for kept ticks at times (n,): longer where samples come more seldom than every second."""
    if len(time_s) < 2:
        return BLOCK_S
    usual_s = float(np.median(np.diff(time_s))) / math.log(
        2.0
    )  # gaps at no regular times: their median over their mean
    return max(BLOCK_S, _TWICE * _FEWEST_ROWS * usual_s)


def _is_kept(time_s: float) -> bool:
    """One second in ``_SHARE``, by the bits of its number times the golden ratio (Knuth's hash)."""
    return (round(time_s) * 2654435761 >> 8) % _SHARE == 0
