"""Do positions fall as an orbit at their height does?

A height in miles scales |H| almost evenly, as a scale error of the sensor does, and no residual shows it.  The way of
the positions does (``earth.free_fall``), on any orbit; what moves slowly, as on the ground or in air, says nothing.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.earth.free_fall import OFF, falls
from magcal_service.residuals import median_and_sigma

_SLOT_S: Final = 15.0
"""Of which one position is kept [s]; choice: an eighth of the step between three."""

_STEP_S: Final = 120.0
"""Between the three positions [s]: rounded to a kilometre each fall is 0.6 % off, and the first answer comes before a
spinning craft can be trusted."""

_REACH_S: Final = (80.0, 400.0)
"""Between two of them where positions are rare [s]: closer ones are rounded too coarsely, farther ones need a longer
series."""

_EVEN: Final = 0.13
"""Share of their mean by which the two steps may differ, a slot: near the perigee of an eccentric orbit that is a
hundredth of the fall."""

_KEPT: Final = 64  # positions: three of the longest reach are at most 54 slots apart
_FALLS: Final = 20  # newest falls, five minutes of them; choice: after a correction they agree in half of that
_FEWEST: Final = 10  # choice: one false position is in three; the first answer comes after 375 s
_SCATTER: Final = 8.0  # the median has to be off by so many of its own sigma, which ten falls give to a third

Place = tuple[float, float, float, float]
"""Time [s], and x, y, z [km] in axes that do not turn."""


@dataclass(init=False, repr=False, eq=False)
class HeightSenseMemory:
    """What of ``HeightSense`` outlives a restart, saved and restored whole."""

    said: str
    _places: deque[Place]
    _falls: deque[float]


class HeightSense(Stateful, HeightSenseMemory):
    """The way of one craft's positions.

    Attributes
    ----------
    said: what was seen, in words; empty where positions fall as they should, or too few are known.
    """

    def __init__(self) -> None:
        self.said = ""
        self._places = deque(maxlen=_KEPT)
        self._falls = deque(maxlen=_FALLS)

    def wants(self, time_s: float) -> bool:
        """Whether a position of this time [s] would be kept: the first of its slot, or long before the newest."""
        if not self._places:
            return True
        newest_s = self._places[-1][0]
        return time_s // _SLOT_S > newest_s // _SLOT_S or time_s < newest_s - _REACH_S[1]

    def push(self, time_s: float, place_km: tuple[float, float, float]) -> None:
        """Take a position that is wanted, in axes that do not turn."""
        if self._places and not 0.0 < time_s - self._places[-1][0] <= _REACH_S[1]:
            self._places.clear()  # its clock has stepped, or a pause lies between
        self._places.append((time_s, *place_km))
        found = self._newest_fall()
        if found:
            self._falls.extend(found)
            self.said = self._say()

    def _newest_fall(self) -> list[float]:
        """Of the position a step before the newest, by that and by one as long before; none where there is no such."""
        if len(self._places) < 3:
            return []
        times_s = np.array([place[0] for place in self._places])
        middle = int(np.argmin(np.abs(times_s[1:-1] - (times_s[-1] - _STEP_S)))) + 1
        after_s = float(times_s[-1] - times_s[middle])
        first = int(np.argmin(np.abs(times_s[:middle] - (times_s[middle] - after_s))))
        before_s = float(times_s[middle] - times_s[first])
        if not all(_REACH_S[0] <= step_s <= _REACH_S[1] for step_s in (before_s, after_s)):
            return []
        if abs(after_s - before_s) > _EVEN * 0.5 * (after_s + before_s):
            return []
        before, here, after = (np.array([self._places[row][1:]]) for row in (first, middle, -1))
        found: list[float] = falls(np.array([before_s]), before, here, np.array([after_s]), after).tolist()
        return found

    def _say(self) -> str:
        if len(self._falls) < _FEWEST:
            return ""
        middle, sigma = median_and_sigma(np.array(self._falls))
        if abs(middle - 1.0) < max(OFF, _SCATTER * sigma):
            return ""
        return f"positions fall {middle:.3g} times as fast as an orbit at their height does"
