"""One magnetometer's residual as others of its craft see it: a disturbance that one alone sees is near that one.

The difference of two calibrated magnitudes is the difference of their residuals against the reference, so each keeps
its own, at its own times, and nothing is interpolated between sensors that are sampled at different ones.  What all see
is the reference's or the craft's; what one sees, and another would see and does not, is local.  Magnitudes need neither
attitude nor common axes; a disturbance across the field is seen only as the craft turns.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from operator import truediv
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.estimators.interface import Phase, StateEstimate, TickOutcome
from magcal_service.model import STATE_SIZE, Array, scalar_residual, vector_jacobian
from magcal_service.ticks.assembler import Tick
from magcal_service.wire.messages import Clock

WINDOW: Final = 30
"""Ticks that are averaged: a magnet is to be named within a minute."""

LOUD: Final = 3.5
"""Mean square of the residual in units of its variance; white noise: 3e-10 of windows (chi-squared, 30)."""

QUIET: Final = 2.0
"""Up to here nothing is seen; white noise exceeds it in one window of a thousand."""

_MOST: Final = 9.0
"""What one tick adds at the most: ten ticks in thirty are a disturbance, three spikes are not."""

_SINCE: Final = 10
"""Ticks of another magnetometer since this one was last quiet, before the other's silence says anything: in so many it
would have become loud."""

_TOGETHER_NS: Final = 10_000_000_000
"""Newest ticks of two magnetometers further apart than this are of different times: the one has fallen silent."""


@dataclass(init=False, repr=False, eq=False)
class WitnessMemory:
    """What of ``Witness`` outlives a restart, saved and restored whole."""

    local: bool
    _squares_nt2: deque[float]
    _variances_nt2: deque[float]
    _was_quiet: bool
    _runs: bool
    _x: Array
    _covariance: Array
    _noise_nt: float
    _times_ns: deque[int]
    _quiet_ns: int
    _time_ns: int
    _clock: Clock


class Witness(Stateful, WitnessMemory):
    """The newest residuals of one magnetometer.

    Attributes
    ----------
    local: a disturbance is seen by this one alone; until it has agreed with the others for a whole window again.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Back to the beginning, as the estimate: nothing is known of its residual."""
        self.local = False
        self._squares_nt2 = deque(maxlen=WINDOW)
        self._variances_nt2 = deque(maxlen=WINDOW)
        self._was_quiet = False  # it was trusted when it last agreed with its reference for a whole window
        self._runs = False  # the filter ran at the newest tick
        self._x, self._covariance, self._noise_nt = np.zeros(STATE_SIZE), np.zeros((STATE_SIZE, STATE_SIZE)), 0.0
        self._times_ns = deque(maxlen=WINDOW)
        self._quiet_ns = 0  # time of the newest tick at which it was quiet
        self._time_ns = 0
        self._clock = Clock.ELAPSED

    def push(self, tick: Tick, outcome: TickOutcome, state: StateEstimate, *, trusted: bool) -> None:
        """Take a tick that was learned from: its mean residual, and how far that may be from zero.

        ``trusted``: nothing was wrong with the estimate before this tick.  Only from such a one a disturbance stands
        out: where the reference is wrong, the estimates of several magnetometers are wrong in different ways.

        Where the filter has found itself contradicted and collects a new start, the estimate before is held against
        what follows, until there is another.
        """
        residual_nt = outcome.residual_nt
        if outcome.phase is Phase.RUNNING:
            if not self._runs:
                self._begin()
            self._runs = True
            self._x, self._covariance, self._noise_nt = state.x, state.covariance, state.noise_nt
        elif self._noise_nt > 0.0:
            self._runs = False
            residual_nt = scalar_residual(self._x, tick.field_body_nt, tick.reference_magnitude_nt)
        else:
            return
        field_nt = tick.field_body_nt[-1]
        along = field_nt.dot(vector_jacobian(*field_nt.tolist())) / max(math.sqrt(float(field_nt.dot(field_nt))), 1.0)
        noise_nt2 = max(self._noise_nt, 1e-9) ** 2 / len(tick.times_s)
        self._variances_nt2.append(noise_nt2 + max(0.0, float(along.dot(self._covariance).dot(along))))
        self._squares_nt2.append((float(np.add.reduce(residual_nt)) / len(residual_nt)) ** 2)
        self._time_ns, self._clock = tick.time_ns, tick.clock
        self._times_ns.append(tick.time_ns)
        if self.is_quiet:
            self._was_quiet, self._quiet_ns = trusted, tick.time_ns

    def _begin(self) -> None:
        """There is another estimate: what was seen was of the one before."""
        self._squares_nt2.clear()
        self._variances_nt2.clear()
        self._times_ns.clear()
        self._was_quiet = False

    @property
    def _level(self) -> float:
        """Mean square of the residual in units of its variance."""
        ratios = map(truediv, self._squares_nt2, self._variances_nt2)
        return sum([_MOST if one > _MOST else one for one in ratios]) / WINDOW

    @property
    def is_quiet(self) -> bool:
        """Whether a whole window agrees with the reference."""
        return len(self._squares_nt2) == WINDOW and self._level <= QUIET

    @property
    def is_loud(self) -> bool:
        """Whether the residual left a level at which it has been quiet before."""
        return self._was_quiet and self._level > LOUD

    @property
    def is_stirred(self) -> bool:
        """Whether it may be about to see something: it has been quiet, and is not any more."""
        return self._was_quiet and self._level > QUIET

    def _would_see(self, other: Witness) -> bool:
        """Whether what the other sees would make this one loud as well, which is quiet at the same time."""
        together = self._clock is other._clock and abs(self._time_ns - other._time_ns) <= _TOGETHER_NS
        since = sum(time_ns > other._quiet_ns for time_ns in self._times_ns)
        if not (together and since >= _SINCE and self.is_quiet and self._was_quiet):
            return False
        excess_nt2 = np.array(other._squares_nt2) - np.array(other._variances_nt2)
        here = 1.0 + excess_nt2 / float(np.median(self._variances_nt2))
        return float(np.clip(here, 0.0, _MOST).sum()) / WINDOW > LOUD

    def judge(self, others: Iterable[Witness]) -> bool:
        """Decide anew whether what it sees is local, beside the craft's others; whether that has changed."""
        before, others = self.local, list(others)
        if self.local:
            self.local = not self.is_quiet and not any(one.is_loud for one in others)
        elif self.is_loud and not any(one.is_stirred for one in others):
            self.local = any(one._would_see(self) for one in others)
        return self.local != before
