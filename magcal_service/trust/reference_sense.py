"""Does the reference vary, and does it go on?  By its magnitude alone, which is what a tick holds of any reference.

The spread is taken between quantiles of the newest 6000 s, so single false values neither make nor hide it; what is
long past is forgotten.  A reference repeats where it keeps one value to the last bit for so long that at its usual pace
it would have changed by much; and where it goes on in steps, each held for several ticks and larger than the noise.
"""

from __future__ import annotations

import itertools
from collections import deque
from dataclasses import dataclass
from typing import Final

from magcal_service.base.snapshot import Stateful

_EVERY: Final = 5
"""Ticks of which one is kept for the spread."""

_KEPT: Final = 1200
"""Values kept: 6000 ticks, an orbit at 1 Hz."""

_LOOK: Final = 10
"""Kept values between two evaluations of the spread."""

_TAIL: Final = 0.1
"""Share of values at either end that the spread leaves out."""

_AS_STD: Final = 0.36
"""Times the width between the tails: the standard deviation of values spread evenly; of Gaussian ones 0.92 of it."""

_HOLDS: Final = 20
"""Newest values whose time of holding is kept."""

_SHORTEST_S: Final = 30.0
"""A reference that keeps its value for less says nothing yet [s]."""

_MISSED: Final = 0.01
"""Share of |H| by which it would have changed at its usual pace where it repeats."""

_COARSE: Final = 200.0
"""The same in units of its resolution: at its turning points a coarse reference keeps its value for long."""

_STEP_TICKS: Final = 3
"""Ticks that a reference which goes on in steps keeps a value for."""

_HELD_TICKS: Final = 10
"""Ticks that one which repeats has kept its value for, at least."""

_FINE: Final = 0.3
"""Share of the usual step that the smallest difference of two steps has at most: else it is only coarse."""


@dataclass(init=False, repr=False, eq=False)
class ReferenceSenseMemory:
    """What of ``ReferenceSense`` outlives a restart, saved and restored whole."""

    held_s: float
    step_nt: float
    mean_nt: float
    spread_nt: float
    _kept: deque[float]
    _seen: int
    _value: float
    _since_s: float
    _count: int
    _holds: deque[tuple[int, float, float]]


class ReferenceSense(Stateful, ReferenceSenseMemory):
    """The course of one craft's reference magnitude.

    Attributes
    ----------
    mean_nt, spread_nt: middle between the tails and robust standard deviation over the last orbit [nT].
    held_s: for how long it repeats one value though it should have changed [s]; 0: it does not.
    step_nt: the usual step where it goes on in held steps [nT]; 0: it does not.
    """

    def __init__(self) -> None:
        self.held_s = self.step_nt = self.mean_nt = self.spread_nt = 0.0
        self._kept = deque(maxlen=_KEPT)
        self._seen = 0
        self._value = self._since_s = 0.0
        self._count = 0  # ticks with the present value
        self._holds = deque(maxlen=_HOLDS)  # ticks and time [s] that a value was held for, and the step after it [nT]

    def push(self, time_s: float, magnitude_nt: float) -> None:
        """Take a tick's |H| [nT], in order of time [s]."""
        if self._seen % _EVERY == 0:
            self._keep(magnitude_nt)
        self._seen += 1
        if magnitude_nt == self._value:
            self._count += 1
            seconds = time_s - self._since_s
            self.held_s = self._held(seconds) if self._count >= _HELD_TICKS and seconds >= _SHORTEST_S else 0.0
            return
        if self._count:
            self._change(time_s - self._since_s, abs(magnitude_nt - self._value))
        self._value, self._since_s, self._count, self.held_s = magnitude_nt, time_s, 1, 0.0

    def _change(self, held_s: float, step_nt: float) -> None:
        """A value was held and then left; one between two held ones is interpolated and belongs to the step."""
        count = self._count
        if count < _STEP_TICKS and self._holds and self._holds[-1][0] >= _STEP_TICKS:
            before, before_s, before_nt = self._holds.pop()
            count, held_s, step_nt = before + count, before_s + held_s, before_nt + step_nt
        self._holds.append((count, held_s, step_nt))
        self.step_nt = self._step()

    def _keep(self, magnitude_nt: float) -> None:
        self._kept.append(magnitude_nt)
        if len(self._kept) <= _LOOK or self._seen // _EVERY % _LOOK == 0:
            ordered = sorted(self._kept)
            count = len(ordered)
            tail = int(_TAIL * count)
            low, high = ordered[tail], ordered[count - 1 - tail]
            self.mean_nt, self.spread_nt = 0.5 * (low + high), _AS_STD * (high - low)

    def _held(self, seconds: float) -> float:
        if len(self._holds) < _HOLDS:
            return 0.0
        pace = sorted(step / held for _, held, step in self._holds)[_HOLDS // 2]
        steps = sorted(step for _, _, step in self._holds)
        resolution = min([steps[0], *_apart(steps)])
        return seconds if pace * seconds > max(_MISSED * self._value, _COARSE * resolution) else 0.0

    def _step(self) -> float:
        if len(self._holds) < _HOLDS:
            return 0.0
        short = 0
        for count, _, _ in self._holds:
            short += count < _STEP_TICKS
            if short > _HOLDS // 4:  # it is new at most ticks: nothing is held
                return 0.0
        steps = sorted(step for _, _, step in self._holds)
        usual = steps[_HOLDS // 2]
        apart = _apart(steps)
        return usual if apart and min(apart) <= _FINE * usual else 0.0


def _apart(steps: list[float]) -> list[float]:
    """Differences between sorted steps [nT] that are more than the last bits."""
    return [b - a for a, b in itertools.pairwise(steps) if b - a > 1e-6 * b]
