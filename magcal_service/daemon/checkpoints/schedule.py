"""When checkpoints are due: soon after the start, then more and more seldom up to the period, and sooner when asked."""

from __future__ import annotations

import math
import time
from typing import Final

FIRST_S: Final = 1.0
"""From the start to the first checkpoint [s]; each that was written doubles the pause, up to the period.

A daemon that is killed again and again, each time before its period is over, goes on all the same.
"""

HASTE_S: Final = 10.0
"""Between two checkpoints that were asked for [s], the shortest period there is: a verdict that comes and goes wears no
flash."""


class Schedule:
    """The times of a daemon's checkpoints, by the monotonic clock.

    Parameters
    ----------
    period_s: the longest pause [s]; infinite for none at all.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._pause_s = min(FIRST_S, period_s) if math.isfinite(period_s) else period_s
        self._next_s = time.monotonic() + self._pause_s
        self._sooner_s = math.inf  # when one that was asked for is due
        self._written_s = -math.inf
        self._under_way = self._asked_meanwhile = False

    def ask(self) -> None:
        """Have one written soon: something has come that is worth more than the samples since the last."""
        if math.isfinite(self._period_s):
            self._sooner_s = self._written_s + HASTE_S
            self._asked_meanwhile = self._under_way

    def due(self) -> bool:
        """Whether one is to be written now."""
        return time.monotonic() >= min(self._next_s, self._sooner_s)

    def begin(self) -> None:
        """One that is due takes a while: what is asked for from now on may come too late for it."""
        self._under_way, self._asked_meanwhile = True, False

    def done(self, written: bool) -> None:
        """One was due; ``written`` says whether there was anything to write, and the disk took it."""
        now_s = time.monotonic()
        if written:
            self._written_s = now_s
            self._sooner_s = now_s + HASTE_S if self._asked_meanwhile else math.inf
            self._pause_s = min(2.0 * self._pause_s, self._period_s)
        elif self._sooner_s <= now_s:
            self._sooner_s = now_s + HASTE_S
        self._next_s = now_s + self._pause_s
        self._under_way = self._asked_meanwhile = False
