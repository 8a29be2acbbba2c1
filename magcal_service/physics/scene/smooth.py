"""A slow channel without its own noise: what drives physics is the temperature, not the sensor that reports it.

A driver with noise is a worse regressor than the truth, and than any smooth course that happens to resemble it (errors
in variables).  The values are taken as a smooth course under white noise, y = x + e, with white second differences of
x; the ratio of the two variances is the likeliest (Whittle's likelihood on the cosine transform), and x its mean.

Source: Whittaker 1923 and Wahba 1978 for the smoother, whose gain at a frequency w is 1 / (1 + lambda (2 - 2 cos w)^2).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from magcal_service.model import Array

_RATIOS: Final = np.concatenate([[0.0], np.geomspace(1.0, 1e10, 41)])
"""Variances of noise over those of second differences: no noise at all, to a course that bends once in 300 samples."""

_MOST_TAKEN: Final = 1.3
"""Times the noise that changes from sample to sample, what may be smoothed away: more is a course with jumps or kinks,
as between sessions, that no smooth one follows.  White noise has 1 to a few per cent."""

_LEAST_NOISE, _MOST_NOISE = 0.02, 0.9
"""Shares of a record's variance that its own noise has: less costs an amplitude 2 %, beyond it nothing is recorded."""

_FEWEST: Final = 32
"""Samples below which nothing is told of a channel's noise."""

_QUINTIC: Final = 6  # numbers of a polynomial of degree five


def smooth_course(values: Array) -> Array:
    """The likeliest smooth course (n,) under values (n,) at even times; as they are where they have no noise."""
    if len(values) < _FEWEST or not np.isfinite(values).all() or float(np.ptp(values)) == 0.0:
        return values
    _, gain = _likeliest_gain(values, 2)
    if gain.all() and float(np.ptp(gain)) == 0.0:
        return values
    course = _through(values, gain)
    white = float(np.median(np.abs(np.diff(values, 2)))) / (0.6745 * np.sqrt(6.0))  # of a normal law, whatever jumps
    return course if float(np.std(values - course)) < _MOST_TAKEN * white else values


def noise_of(values: Array) -> float:
    """Noise of its own that a record (n,) at even times has, 1 sigma; 0 where it has hardly any.

    It is what the variance has beyond the covariances with the neighbours, in which noise has no part.

    Source: the nugget of a variogram, Matheron 1963, Economic Geology 58, 1246-1266.
    """
    if len(values) < _FEWEST or not np.isfinite(values).all():
        return 0.0
    about = values - values.mean()
    whole, next_to, after = (float(about[: len(about) - by] @ about[by:]) / len(about) for by in (0, 1, 2))
    noise = whole - (2.0 * next_to - after)  # a straight line back from the neighbours
    return math.sqrt(noise) if _LEAST_NOISE * whole < noise < _MOST_NOISE * whole else 0.0


def expected_course(values: Array) -> Array:
    """What flowed (n,), as a record (n,) at even times with noise of its own lets expect.

    A load jumps, so either first or second differences of the course are white, whichever is likelier.  What such a
    course lacks of the truth is not correlated with it, so that a regression on it has no bias.

    Source: Berkson 1950, Journal of the American Statistical Association 45, 164-180.
    """
    _, gain = max((_likeliest_gain(values, order) for order in (1, 2)), key=lambda found: found[0])
    return _through(values, gain)


def quintic_slope(values: Array, half: int) -> Array:
    """Slope per row (n, k) of values (n, k) by the quintic through so many rows to either side of each, least squares.

    At the ends it is that of the last whole one; of fewer rows one of lower degree, of a single one 0.

    Source: Savitzky & Golay 1964.
    """
    count = len(values)
    half = min(half, (count - 1) // 2)
    if half < 1:
        return np.gradient(values, axis=0) if count > 1 else np.zeros_like(values)
    rows = np.arange(-half, half + 1) / half
    fitted = np.linalg.pinv(np.vander(rows, min(_QUINTIC, len(rows)), increasing=True))
    inside = np.stack([np.convolve(column, fitted[1, ::-1], mode="valid") for column in values.T], axis=1)
    powers = np.arange(1, len(fitted))
    sides = []
    for window, part in ((values[: 2 * half + 1], rows[:half]), (values[-2 * half - 1 :], rows[half + 1 :])):
        sides.append((powers * part[:, None] ** (powers - 1)) @ (fitted[1:] @ window))
    found: Array = np.concatenate([sides[0], inside, sides[1]]) / half
    return found


def _likeliest_gain(values: Array, order: int) -> tuple[float, Array]:
    """Log-likelihood, and what a smoother keeps of each wave (n,), at the likeliest ratio of the variances.

    Parameters
    ----------
    order: of the differences of the course that are white.
    """
    power = _cosine(values - _line(values))[1:] ** 2
    rough = (2.0 - 2.0 * np.cos(np.pi * np.arange(1, len(values)) / len(values))) ** order
    each = [(_likelihood(power, rough, ratio), ratio) for ratio in _RATIOS.tolist()]
    likelihood, best = max(each, key=lambda one: one[0])
    return likelihood, np.concatenate([[1.0], 1.0 / (1.0 + best * rough)])


def _through(values: Array, gain: Array) -> Array:
    """Values (n,) with so much of each wave (n,)."""
    line = _line(values)
    return np.asarray(_inverse_cosine(_cosine(values - line) * gain) + line)


def _line(values: Array) -> Array:
    """The straight line (n,) from the first of values to the last: what the transform would wrap around."""
    return np.linspace(values[0], values[-1], len(values))


def _likelihood(power: Array, rough: Array, ratio: float) -> float:
    """Whittle's log-likelihood of squares (k,) at squared roughness (k,), the level at its best."""
    shape = 1.0 / rough if ratio == 0.0 else 1.0 + 1.0 / (ratio * rough)
    level = float(np.mean(power / shape))
    return float(-0.5 * np.log(shape).sum() - 0.5 * len(power) * np.log(max(level, 1e-300)))


def _cosine(values: Array) -> Array:
    """Type II cosine transform (n,), unscaled, by a transform of the mirrored values."""
    count = len(values)
    spectrum = np.fft.rfft(np.concatenate([values, values[::-1]]))[:count]
    return np.asarray((spectrum * np.exp(-0.5j * np.pi * np.arange(count) / count)).real)


def _inverse_cosine(transform: Array) -> Array:
    """Inverse of ``_cosine``."""
    count = len(transform)
    spectrum = np.zeros(count + 1, dtype=complex)
    spectrum[:count] = transform * np.exp(0.5j * np.pi * np.arange(count) / count)
    return np.asarray(np.fft.irfft(spectrum, 2 * count)[:count])


def mean_over(time_s: Array, values: Array, begin_s: Array, over_s: float) -> Array:
    """Means (m, k) over so many seconds from each of (m,) instants on, of values (n, k) at rising times (n,), straight
    between them and constant beyond; over no time the values then.
    """
    if over_s <= 0.0:
        return np.stack([np.interp(begin_s, time_s, one) for one in values.T], axis=1)
    steps = np.diff(time_s)[:, None]
    areas = np.concatenate([np.zeros_like(values[:1]), np.cumsum(0.5 * steps * (values[1:] + values[:-1]), axis=0)])
    slopes = np.concatenate([np.diff(values, axis=0) / steps, np.zeros_like(values[:1])])

    def area(at_s: Array) -> Array:
        row = np.clip(np.searchsorted(time_s, at_s, side="right") - 1, 0, len(time_s) - 1)
        after = (at_s - time_s[row])[:, None]
        bent = np.maximum(after, 0.0)  # before the first it is constant
        return np.asarray(areas[row] + after * values[row] + 0.5 * bent**2 * slopes[row])

    return np.asarray((area(begin_s + over_s) - area(begin_s)) / over_s)
