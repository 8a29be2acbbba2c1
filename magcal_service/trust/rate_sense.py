"""Does the measured vector turn as the gyro says?  dB/dt + w x B = A dH/dt, and the right side is slow.

Over a step of one tick a steady rate w turns the field by exactly

    w_2 - w_1 = -tan(phi / 2) / (phi / 2) dt omega x (w_1 + w_2) / 2        phi = |omega| dt

(Cayley).  With omega replaced by G omega the miss is a quadratic form in the nine numbers of G, whose sums are kept;
from them the 48 signed permutations are compared at any time.  A gyro whose signs or axes do not fit the vector's is
named where one G explains the turn and the identity does not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.model import Array
from magcal_service.samples.signed_axes import SAME, SIGNED_AXES, any_of

_LARGEST_TURN: Final = 1.2
"""Turn in a step up to which it is used [rad]: beyond, half a percent of the rate is a degree."""

_LONGEST_S: Final = 3.0
"""Longest step that is used [s]."""

_MEMORY: Final = 300
"""Steps over which sums are kept."""

_FEWEST: Final = 120
"""Steps before anything is said."""

_EVERY: Final = 20
"""Steps between two comparisons."""

_WRONG: Final = 0.3
"""Share of the vector's change that the gyro as it is misses at least where it is wrong: 30 degrees."""

_RIGHT: Final = 0.15
"""Share that the named one misses at most."""

_APART: Final = 3.0
"""Times as much that another one misses: within it both are named."""

_LEAST_RAD_S: Final = 0.009
"""Rms rate from which it is judged: half a degree in a second, three times the field's own turn along the orbit."""


@dataclass(init=False, repr=False, eq=False)
class RateSenseMemory:
    """What of ``RateSense`` outlives a restart, saved and restored whole."""

    said: str
    _last_s: float | None
    _field: Array
    _rate: Array
    _normal: Array
    _right: Array
    _change: float
    _speed: float
    _seen: int


class RateSense(Stateful, RateSenseMemory):
    """One craft's gyro against its calibrated vectors.

    Attributes
    ----------
    said: what the gyro's axes look like, in words; empty where they agree, or that does not show.
    """

    def __init__(self) -> None:
        self.said = ""
        self._last_s = None
        self._field, self._rate = np.zeros(3), np.zeros(3)
        self._normal, self._right = np.zeros((9, 9)), np.zeros(9)
        self._change = self._speed = 0.0
        self._seen = 0

    def interrupt(self) -> None:
        """A pause lies before the next sample, or it has no rate."""
        self._last_s = None

    def push(self, time_s: float, calibrated_nt: Array, rate_rad_s: Array) -> None:
        """Take a calibrated vector (3,) [nT] with its rate (3,) [rad/s], in order of time [s]."""
        last_s, field, rate = self._last_s, self._field, self._rate
        self._last_s, self._field, self._rate = time_s, calibrated_nt, rate_rad_s
        if last_s is None or not 0.0 < time_s - last_s <= _LONGEST_S:
            return
        step_s = time_s - last_s
        turning = 0.5 * (rate + rate_rad_s)
        speed = math.sqrt(float(turning @ turning))
        half = 0.5 * speed * step_s
        if 2.0 * half > _LARGEST_TURN:
            return
        factor = -step_s * (math.tan(half) / half if half > 1e-6 else 1.0)
        x, y, z = (0.5 * (field + calibrated_nt)).tolist()
        crossing = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # columns e_i x B
        columns = factor * (crossing[:, :, None] * turning[None, None, :]).reshape(3, 9)
        change = calibrated_nt - field
        self._seen += 1
        share = 1.0 / min(self._seen, _MEMORY)
        self._normal += share * (columns.T @ columns - self._normal)
        self._right += share * (columns.T @ change - self._right)
        self._change += share * (float(change @ change) - self._change)
        self._speed += share * (speed * speed - self._speed)
        if self._seen >= _FEWEST and self._seen % _EVERY == 0:
            self.said = self._compared()

    def _compared(self) -> str:
        if self._speed < _LEAST_RAD_S**2:
            return ""
        turns = SIGNED_AXES.reshape(48, 9)
        missed = self._change - 2.0 * turns @ self._right + np.einsum("pi,ij,pj->p", turns, self._normal, turns)
        shares = missed / max(self._change, 1e-9)
        best = float(shares.min())
        if shares[SAME] < max(_WRONG, _APART * best) or best > _RIGHT:
            return ""
        near = np.flatnonzero((shares <= max(_APART * best, _RIGHT)) & (shares < shares[SAME])).tolist()
        return f"the gyro's axes do not fit the vector's turn, they would with {any_of(near)}"
