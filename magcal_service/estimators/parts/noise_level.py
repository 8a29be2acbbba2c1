"""The sensor's noise where nobody states it, followed by running means; the given one where somebody does."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.model import BIAS, D_ALL, Array, calibrate, d_matrix, field_jacobian

_MEMORY: Final = 600
"""Samples over which an unknown noise level is averaged: 3 % of its value."""

_SETTLED: Final = 30
"""Residuals from which on the second differences are used."""


@dataclass(init=False, repr=False, eq=False)
class NoiseLevelMemory:
    """What of ``NoiseLevel`` outlives a restart, saved and restored whole."""

    total_nt: float
    white_nt: float
    _count: int
    _before: list[float]


class NoiseLevel(Stateful, NoiseLevelMemory):
    """1 sigma of the residual, and of the part of it that is white.

    The second difference of white noise s has the variance 6 s^2 and leaves out what is slow, so physics that was left
    out does not count as sensor noise.

    Parameters
    ----------
    given_nt: 1 sigma per axis [nT], then never changed; None: learned.
    """

    def __init__(self, given_nt: float | None) -> None:
        self.given_nt = given_nt
        self.total_nt = self.white_nt = given_nt or 0.0
        self._count = 0
        self._before = []

    def set(self, total_nt: float) -> None:
        """Take a level found by a batch, where none was given; the white part stays below it."""
        if self.given_nt is None:
            self.total_nt = max(total_nt, 1e-3)
            self.white_nt = min(self.white_nt, self.total_nt) if self._count >= _SETTLED else self.total_nt

    def observe(self, residual_nt: Array, *, after_gap: bool = False) -> None:
        """Learn from scalar residuals e = |w| - |H| (n,) [nT], in order of time."""
        if self.given_nt is not None:
            return
        if after_gap:
            self._before.clear()
        for value in residual_nt.tolist():
            self._learn(value)

    def _learn(self, residual_nt: float) -> None:
        self._count = min(self._count + 1, _MEMORY)
        weight = 1.0 / self._count
        total = self.total_nt**2 + weight * (residual_nt**2 - self.total_nt**2)
        self.total_nt = math.sqrt(max(total, 1e-6))
        self._before.append(residual_nt)
        if len(self._before) < 3:
            return
        first, second, third = self._before
        self._before = [second, third]
        rough = min((third - 2.0 * second + first) ** 2 / 6.0, 9.0 * total)
        white = rough if self._count <= 3 else self.white_nt**2 + weight * (rough - self.white_nt**2)
        self.white_nt = min(math.sqrt(max(white, 1e-6)), self.total_nt)


def squared_innovations(
    x: Array, covariance: Array, field_nt: Array, residual_nt: Array, noise_nt: float, white_nt: float
) -> Array:
    """Normalised squares (n,) of scalar residuals that an estimate has not yet used; expectation 1 each.

    Parameters
    ----------
    x, covariance: state (9,) and covariance (9, 9) before the samples [nT, -].
    field_nt: measured vectors B (n, 3) [nT].
    residual_nt: e = |w| - |H| (n,) [nT].
    noise_nt, white_nt: sigma of the residual, and of its white part, whose square over |H| is the mean of e [nT].
    """
    w = calibrate(x, field_nt)
    length = np.linalg.norm(w, axis=1)
    rows = np.einsum("ni,nij->nj", w / length[:, None], field_jacobian(field_nt))
    variance = noise_nt**2 + np.einsum("ni,ij,nj->n", rows, covariance, rows)
    squares: Array = (residual_nt - white_nt**2 / length) ** 2 / variance
    return squares


def is_sound(x: Array, limits: tuple[float, float]) -> bool:
    """Whether a state (9,) is finite and the eigenvalues of I + D lie within ``limits``."""
    if not np.isfinite(x).all() or np.abs(x[D_ALL]).max() > 10.0 or np.abs(x[BIAS]).max() > 1e7:
        return False
    values = np.linalg.eigvalsh(np.eye(3) + d_matrix(x))
    return bool(limits[0] <= values[0] and values[-1] <= limits[1])
