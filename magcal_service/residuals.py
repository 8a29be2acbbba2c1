"""Levels of a residual: all of it, the part that is white noise, and what noise alone reaches."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array

MEDIAN_TO_SIGMA: Final = 1.4826
"""Sigma of a normal distribution over the median of its absolute values, 1 / quantile(3/4)."""

_FLOOR_SAMPLES: Final = 64
"""Shortest evenly sampled stretch whose spectrum is looked at."""

_OF_A_MEDIAN: Final = 1.2533  # sigma of a median over that of a mean: sqrt(pi / 2)


def median_and_sigma(values: Array) -> tuple[float, float]:
    """The median of values (n,), and its own sigma as of normal numbers, by the median of their distances from it."""
    middle = float(np.median(values))
    spread = MEDIAN_TO_SIGMA * float(np.median(np.abs(values - middle)))
    return middle, _OF_A_MEDIAN * spread / math.sqrt(len(values))


def white_floor(residual_nt: Array) -> float:
    """White-noise level of an evenly spaced residual (n,) [nT], n >= 16: lines and slow drifts don't count.

    The median of the periodogram is ln 2 times the mean for white noise, and lines or a low-frequency hump touch only
    few of its bins.  Relative error about 0.6 / sqrt(n / 2); it overestimates when more than half of the band is hit.
    """
    power = np.abs(np.fft.rfft(residual_nt - residual_nt.mean())[1:]) ** 2 / len(residual_nt)
    return math.sqrt(float(np.median(power)) / math.log(2.0))


def rms(values: Array) -> float:
    """Root mean square of the values (n,)."""
    return float(np.sqrt(np.mean(values**2)))


def white_noise_level(time_ns: NDArray[np.int64], residual_nt: Array) -> float:
    """White-noise level [nT] of a residual, over its evenly sampled stretches; the plain rms where all are short.

    Parameters
    ----------
    time_ns: times of the samples (n,) [ns], rising.
    residual_nt: residuals (n,) [nT].
    """
    steps = np.diff(time_ns)
    pauses = np.flatnonzero(steps > 1.5 * np.median(steps)) + 1
    floors = [(len(part), white_floor(part)) for part in np.split(residual_nt, pauses) if len(part) >= _FLOOR_SAMPLES]
    if not floors:
        return rms(residual_nt)
    total = sum(count for count, _ in floors)
    return float(np.sqrt(sum(count * floor**2 for count, floor in floors) / total))


def log_tail(x: float, degrees: int) -> float:
    """ln P(chi-squared with ``degrees`` > x), exact up to rounding.

    Source: Abramowitz & Stegun 26.4.4 and 26.4.5 (finite sums for odd and even degrees).
    """
    half = 0.5 * max(x, 0.0)
    if degrees % 2:
        root = math.sqrt(half)
        total = math.erfc(root) * math.exp(half) if half < 500.0 else 1.0 / (root * math.sqrt(math.pi))
        term, first = math.sqrt(half) / math.gamma(1.5), 1.5
    else:
        total, term, first = 0.0, 1.0, 1.0
    for step in range(degrees // 2):
        total += term
        term *= half / (first + step)
    return math.log(total) - half
