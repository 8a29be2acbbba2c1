"""Adaptive process noise: none in the quiet, and where the errors have jumped, as much as the jump needs, once.

A filter without process noise weights its past fully, and follows a step of the errors ever more slowly; constant
process noise pays for quick following with accuracy all the time.  So the filter is tested, against its past, for
whether the errors have changed.  With x_k, P_k the estimate now, x_t, P_t the one at an earlier tick t and Y_t =
P_t^-1, a jump nu of the states at t shows in the innovations since with the signature of Willsky & Jones.  For a
constant state their recursions have a closed form in the two estimates alone:

    S = Y_t - Y_t P_k Y_t                     information of the innovations since t on a jump of all nine states
    d = Y_t (x_k - x_t)                       their correlation with its signature
    T = d_B' (S_BB + L_B)^-1 d_B              twice the log of the likelihood ratio, for a jump of the states B
    nu_B = (S_BB + L_B)^-1 d_B                the jump itself
    x_k + P_k Y_t B nu_B,   P_k + P_k Y_t B (S_BB + L_B)^-1 B' Y_t P_k           the estimate of a filter that knew

The last line is exactly the linear filter that was given the process noise L_B^-1 in the tick t, and none before and
after; L is the weak prior of a jump.  Without a jump x_k - x_t has the covariance P_t - P_k, so that T is at most
chi-square with as many degrees of freedom as B has states.  B runs over the bias, D, all nine, and each state alone.
What is set free is the bias, unless D fits better by far, because for some minutes the two may be indistinguishable.
Until one of them is ruled out, the decision is open: the estimate of the filter that never followed is computed back,
exactly as above, and all hypotheses are asked again.  With process noise in the configuration P_t is grown by it, and
the rest holds approximately.

Source: Willsky & Jones 1976, IEEE Trans. Automatic Control 21, 108-112 (generalised likelihood ratio, direct
compensation of estimate and covariance).  The closed form is original to this project.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.model import BIAS, D_ALL, STATE_SIZE, Array

EVERY_TICKS: Final = 16
"""Ticks between two tests, and between the newest candidates for the time of a jump."""

OLDEST_TICKS: Final = 16_384
"""Older candidates are dropped."""

_PER_OCTAVE: Final = 8
"""Candidates in a doubling of the age, at least: a time is known to an eighth of its age, or ``EVERY_TICKS``."""

_YOUNGEST_TICKS: Final = 2 * EVERY_TICKS
"""Least age of a candidate that is tested."""

JUMP_NT: Final = 2000.0
"""1 sigma of a jump of each bias in its prior [nT]; much larger ones the gate stops, and the filter restarts.

Choice: along what the samples do not show, the covariance after a jump grows to it, so a wider one takes longer to
settle; a narrower one shrinks what is found of a large jump.
"""

JUMP_D: Final = 0.03
"""The same of each element of D [-]: 0.03 of 50 uT is 1500 nT, as much as the bias is allowed."""

_PRIOR: Final = np.diag(np.concatenate([np.full(3, JUMP_NT), np.full(6, JUMP_D)]) ** -2.0)  # L

_ALL: Final = slice(0, STATE_SIZE)
_LEVELS: Final = {1: 32.84, 3: 40.13, 6: 48.36, 9: 55.45}
"""Chi-square levels that a quiet test exceeds with a chance of 1e-8, by degrees of freedom."""

_APART: Final = 18.4
"""T of the bias has to differ so much from that of D before one of them is ruled out: odds of 10^4."""

_TOGETHER: Final = 30.0
"""T of all nine exceeds both by so much where both have jumped; 6 more states gain 27.9 by chance once in 10^4."""

_HYPOTHESES: Final = (BIAS, D_ALL, _ALL, *(slice(i, i + 1) for i in range(STATE_SIZE)))
"""States that a jump is looked for in."""

_OPEN_TICKS: Final = 6000
"""About a low orbit: a jump not attributed for so long keeps its first attribution."""


@dataclass(frozen=True, slots=True)
class Change:
    """A jump that was found.

    Parameters
    ----------
    ticks_ago: when.
    jump: its estimate (9,) [nT, -]; zero for states that were not set free.
    x, covariance: state (9,) and covariance (9, 9) of the filter that follows it [nT, -].
    """

    ticks_ago: int
    jump: Array
    x: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class _Past:
    """The estimate of one tick, and the noise variance that its covariance is for [nT^2]."""

    tick: int
    time_s: float
    x: Array
    covariance: Array
    noise_variance: float


@dataclass(frozen=True, slots=True)
class _Evidence:
    """Y_t (c, 9, 9), S + L (c, 9, 9) and d (c, 9) of candidates."""

    known: Array
    information: Array
    score: Array

    def statistic(self, states: slice) -> Array:
        """T for a jump of these states at each candidate (c,)."""
        part = self.score[:, states]
        if part.shape[1] == 1:
            return part[:, 0] ** 2 / self.information[:, states.start, states.start]
        statistic: Array = np.einsum("ci,cij,cj->c", part, _inverse(self.information[:, states, states]), part)
        return statistic

    def followed(self, best: int, free: slice, now: _Past, ticks_ago: int) -> Change:
        """The estimate of a filter that knew of a jump of the states ``free`` at one candidate."""
        spread = _inverse(self.information[best][free, free])
        jump = np.zeros(STATE_SIZE)
        jump[free] = spread @ self.score[best][free]
        carried = (now.covariance @ self.known[best])[:, free]  # P_k Y_t B
        covariance = now.covariance + carried @ spread @ carried.T
        return Change(ticks_ago, jump, now.x + carried @ jump[free], 0.5 * (covariance + covariance.T))


class _Free(StrEnum):
    """What a jump is attributed to at first."""

    BIAS = "bias"
    D = "D"

    @property
    def states(self) -> slice:
        """Those of the nine."""
        return BIAS if self is _Free.BIAS else D_ALL

    @property
    def rival(self) -> _Free:
        """What it may be instead."""
        return _Free.D if self is _Free.BIAS else _Free.BIAS


@dataclass(frozen=True, slots=True)
class _Open:
    """A jump attributed to the states ``free`` at the tick of ``past``, while others are not ruled out yet."""

    past: _Past
    free: _Free


@dataclass(init=False, repr=False, eq=False)
class ChangeDetectorMemory:
    """What of ``ChangeDetector`` outlives a restart, saved and restored whole."""

    _tick: int
    _past: list[_Past]
    _open: _Open | None


class ChangeDetector(Stateful, ChangeDetectorMemory):
    """Tests one filter, tick by tick, for jumps of the errors.

    Parameters
    ----------
    walk: covariance of the random walk per second (9, 9) [nT, -]; None: no process noise.
    """

    def __init__(self, walk: Array | None = None) -> None:
        self._walk = walk
        self.clear()

    def clear(self) -> None:
        """Discard the past, as after a start."""
        self._tick = 0
        self._past = []
        self._open = None

    def push(self, time_s: float, x: Array, covariance: Array, noise_variance: float) -> Change | None:
        """Take the estimate after one tick; a jump where one is found, or turns out to be one of other states.

        Parameters
        ----------
        time_s: of the tick's last sample [s].
        x, covariance: state (9,) and covariance (9, 9) [nT, -].
        noise_variance: sensor noise that the covariance assumes [nT^2].
        """
        self._tick += 1
        if self._tick % EVERY_TICKS:
            return None
        now = _Past(self._tick, time_s, x, covariance, noise_variance)
        change = self._search(now) if self._open is None else self._reconsider(now, self._open)
        if change is not None:
            self._past.clear()
            return change
        self._past = [past for past in self._past if self._is_kept(past.tick)]
        self._past.append(now)
        return None

    def _is_kept(self, tick: int) -> bool:
        """Thinned with age, so that ages are spaced by at most an eighth of themselves."""
        age = self._tick - tick
        stride = 1 << max(0, (age // (EVERY_TICKS * _PER_OCTAVE)).bit_length() - 1)
        return age < OLDEST_TICKS and (tick // EVERY_TICKS) % stride == 0

    def _search(self, now: _Past) -> Change | None:
        """The likeliest jump since any of the candidates, or None where none exceeds its level."""
        candidates = [past for past in self._past if self._tick - past.tick >= _YOUNGEST_TICKS]
        if not candidates:
            return None
        evidence = self._evidence(candidates, now)
        jumped = any(evidence.statistic(states).max() > _LEVELS[states.stop - states.start] for states in _HYPOTHESES)
        if not jumped:
            return None
        bias, d = evidence.statistic(BIAS), evidence.statistic(D_ALL)
        free = _Free.D if d.max() - bias.max() > _APART else _Free.BIAS
        best = int(np.argmax(d if free is _Free.D else bias))
        self._open = _Open(candidates[best], free)
        return evidence.followed(best, free.states, now, self._tick - candidates[best].tick)

    def _reconsider(self, now: _Past, jump: _Open) -> Change | None:
        """The jump attributed to other states where these fit better by far; closed when the others are ruled out.

        A bias along a field that hardly turns is indistinguishable from a gain for some minutes.  The information that
        was set free is given back, which is the estimate of the filter that never followed; from there all hypotheses
        are tested again.
        """
        before = self._brought_forward(jump.past, now)
        known, freed = _inverse(before), _inverse(before + _prior_covariance(jump.free.states))
        given_back = known - freed
        information = _inverse(now.covariance)
        covariance = _inverse(information + given_back)
        x = now.x + covariance @ (given_back @ (jump.past.x - now.x))
        never = _Past(now.tick, now.time_s, x, covariance, now.noise_variance)
        evidence = self._evidence([jump.past], never)
        bias, d, everything = (float(evidence.statistic(states)[0]) for states in (BIAS, D_ALL, _ALL))
        own, other = (bias, d) if jump.free is _Free.BIAS else (d, bias)
        age = self._tick - jump.past.tick
        if everything - max(own, other) > _TOGETHER:
            self._open = None
            return evidence.followed(0, _ALL, never, age)
        if other - own > _APART:
            self._open = _Open(jump.past, jump.free.rival)
            return evidence.followed(0, jump.free.rival.states, never, age)
        if own - other > _APART or age > _OPEN_TICKS:
            self._open = None
        return None

    def _evidence(self, candidates: list[_Past], now: _Past) -> _Evidence:
        before = np.stack([self._brought_forward(past, now) for past in candidates])
        known = _inverse(before)
        information = known - known @ now.covariance @ known + _PRIOR
        score = (known @ (now.x - np.stack([past.x for past in candidates]))[:, :, None])[:, :, 0]
        return _Evidence(known, information, score)

    def _brought_forward(self, past: _Past, now: _Past) -> Array:
        """A past covariance for the noise level known now, with the random walk since (9, 9)."""
        covariance = past.covariance * (now.noise_variance / past.noise_variance)
        return covariance if self._walk is None else covariance + self._walk * (now.time_s - past.time_s)


def _prior_covariance(free: slice) -> Array:
    """Process noise of a jump of these states (9, 9)."""
    covariance = np.zeros((STATE_SIZE, STATE_SIZE))
    covariance[free, free] = np.diag(1.0 / np.diagonal(_PRIOR)[free])
    return covariance


def _inverse(matrix: Array) -> Array:
    """Inverse (..., m, m) of positive matrices, in units that give them a diagonal of ones: nT^2 stand beside 1e-8."""
    scale = np.sqrt(np.diagonal(matrix, axis1=-2, axis2=-1))
    units = scale[..., :, None] * scale[..., None, :]
    inverse: Array = np.linalg.inv(matrix / units) / units
    return inverse
