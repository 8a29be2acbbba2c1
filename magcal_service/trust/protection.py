"""Protection levels: how far a calibrated vector may be off by a hazard that would not have been seen yet.

A hazard with the amplitudes a (k,) adds the columns X a to the scalar residuals.  What the nine errors leave of X is
seen: the test of its amplitudes has the non-centrality a' M a.  The smallest hazard that is seen has the one that
reaches the alarm; what it, or the largest possible one where that is smaller, does to the vector is the protection
level: internal and external reliability after Baarda 1968, as RAIM uses them.  Pure: arrays in, levels out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.residuals import log_tail
from magcal_service.trust.hazards import Hazard

MISSED_SIGMA: Final = 3.0
"""Sigmas of the test between the alarm and the smallest hazard that counts as seen: it is missed once in 740."""

_SHARES: Final = np.array([0.02, 0.2, 0.5, 0.8, 0.98])
"""Weights of what is seen beside what is possible; the tightest of the ellipsoids that hold both limits is used."""


@dataclass(frozen=True, slots=True)
class Level:
    """A protection level.

    Parameters
    ----------
    nt: how far a vector may be off [nT].
    by: what sets it.
    """

    nt: float
    by: Hazard


@cache
def alarm_gain(nats: float, columns: int) -> float:
    """Gain of log likelihood by so many columns whose probability by chance is e^-nats [nats]."""
    low, high = 0.0, 4.0 * nats + 10.0 * columns
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if -log_tail(2.0 * middle, columns) > nats else (middle, high)
    return high


def smallest_seen(nats: float, columns: int, samples: int) -> float:
    """Non-centrality of the smallest hazard that reaches the alarm, missed once in 740.

    Parameters
    ----------
    nats: significance of the alarm.
    columns: amplitudes that are fitted for it.
    samples: behind the test; few of them say less of the noise.
    """
    gain = alarm_gain(nats, columns)
    reached = samples * math.expm1(min(2.0 * gain / samples, 50.0))
    return (math.sqrt(reached) + MISSED_SIGMA) ** 2


def worst(seen: Array, noncentrality: float, largest: Array, effect: Array) -> Array:
    """How far a vector may be off by hazards that are too small to be seen, in any of the directions given (h,) [nT].

    Parameters
    ----------
    seen: non-centrality matrices M of unit amplitudes (h, k, k).
    noncentrality: the smallest that is seen.
    largest: longest vector of amplitudes that is possible (h,).
    effect: what unit amplitudes do to vectors of m directions (h, m, 3, k) [nT].

    Both limits are quadratic; the level is that of the tightest ellipsoid among weighted sums of them, which holds all
    amplitudes that meet both: never too small, and at most a factor sqrt(2) too large.
    """
    count = seen.shape[-1]
    limits = (
        _SHARES[:, None, None, None] * (seen / noncentrality)
        + (1.0 - _SHARES)[:, None, None, None] * np.eye(count) / (largest**2)[:, None, None]
    )
    root = np.linalg.inv(np.linalg.cholesky(limits))
    squares = np.einsum("hmip,hmiq->hmpq", effect, effect)
    mean = root @ squares.mean(axis=1) @ root.swapaxes(-1, -2)
    best = np.argmin(np.linalg.eigvalsh(mean)[..., -1], axis=0)
    root = root[best, np.arange(len(seen))][:, None]
    longest = np.linalg.eigvalsh(root @ squares @ root.swapaxes(-1, -2))[..., -1].max(axis=-1)
    level: Array = np.sqrt(np.maximum(longest, 0.0))
    return level
