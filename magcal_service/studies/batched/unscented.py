"""The updates of ``ukf`` for many runs at once, with the runs as the last axis of every array.

The arithmetic is that of ``unscented`` and ``Ukf._spin_innovation``, number by number; a number there is a row of runs
here.  So each line costs one pass over rows that stay in the cache, instead of thousands of small matrices.

Source: as ``unscented`` and ``ukf``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_service.estimators.parts.spin_window import Window
from magcal_service.estimators.parts.unscented import UnscentedWeights, cholesky
from magcal_service.model import (
    STATE_SIZE,
    Array,
    adjugate_product,
    calibrated_components,
    scalar_innovation_value,
    variance_of_v,
)


def roots(covariance: Array, out: Array) -> Array:
    """Lower Cholesky factors (9, 9, r) of covariances (9, 9, r); by ``unscented.cholesky`` where one fails.

    Parameters
    ----------
    out: where to, (9, 9, r), zero above the diagonal.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        for j in range(STATE_SIZE):
            column = out[j:, j]
            if j:
                np.einsum("ikr,kr->ir", out[j:, :j], out[j, :j], out=column)
                np.subtract(covariance[j:, j], column, out=column)
            else:
                column[:] = covariance[:, 0]
            column /= np.sqrt(column[0])
    failed = np.flatnonzero(~(out[-1, -1] > 0.0))  # a pivot that is not positive has spoilt all that follow
    for run in failed.tolist():
        out[:, :, run] = cholesky(covariance[:, :, run])
    return out


@dataclass(frozen=True, slots=True)
class Vectors:
    """Calibrated vectors of many runs: rows of I + D, and w, |w|, each a row of runs or (k, r)."""

    matrix: tuple[Array, ...]
    w: tuple[Array, Array, Array]
    length: Array

    @classmethod
    def of(cls, x: Array, field_nt: Array) -> Vectors:
        """w of states (9, r) and measured vectors (3, ..., r) [nT]."""
        matrix, w = calibrated_components(x, field_nt)
        w1, w2, w3 = w
        return cls(matrix, w, np.sqrt(w1 * w1 + w2 * w2 + w3 * w3))

    def measured(self, w: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        """(I + D)^-1 w."""
        (p1, p2, p3), determinant = adjugate_product(self.matrix, w)
        inverse = 1.0 / determinant
        return p1 * inverse, p2 * inverse, p3 * inverse


def moved(field: tuple[Array, ...], root: Array, spread: float) -> tuple[Array, Array, Array]:
    """J(B) times the scaled columns of a factor (9, 9, r): for each component (..., 9, r)."""
    B1, B2, B3 = field
    first = B1 * root[3] + B2 * root[6] + B3 * root[7] - root[0]
    second = B2 * root[4] + B1 * root[6] + B3 * root[8] - root[1]
    third = B3 * root[5] + B1 * root[7] + B2 * root[8] - root[2]
    for part in (first, second, third):
        part *= spread
    return first, second, third


@dataclass(frozen=True, slots=True)
class ScalarInnovations:
    """``unscented.ScalarInnovation`` of many runs: innovation and variance (r,), cross covariance (9, r)."""

    value: Array
    variance: Array
    cross: Array


def scalar_innovations(
    x: Array, root: Array, weights: UnscentedWeights, field_nt: Array, magnitude_nt: float, noise_variance: float
) -> ScalarInnovations:
    """``unscented.scalar_innovation`` for states (9, r), factors (9, 9, r) and measured vectors (3, r)."""
    vectors = Vectors.of(x, field_nt)
    residual = vectors.length - magnitude_nt
    share = residual / vectors.length
    w1, w2, w3 = vectors.w
    r1, r2, r3 = share * w1, share * w2, share * w3
    c1, c2, c3 = vectors.measured((r1, r2, r3))
    B1, B2, B3 = field_nt
    u1, u2, u3 = moved((B1 - c1, B2 - c2, B3 - c3), root, weights.spread)
    linear = (2.0 * (w1 - r1)) * u1
    linear += (2.0 * (w2 - r2)) * u2
    linear += (2.0 * (w3 - r3)) * u3
    quadratic = u1 * u1
    quadratic += u2 * u2
    quadratic += u3 * u3
    shift = 2.0 * weights.pair * quadratic.sum(axis=0)
    quadratic -= shift
    square = (linear * linear).sum(axis=0) + (quadratic * quadratic).sum(axis=0)
    noise = variance_of_v(magnitude_nt, noise_variance)
    variance = 2.0 * weights.pair * square + weights.covariance_0 * shift * shift + noise
    value = scalar_innovation_value(residual, vectors.length, magnitude_nt, noise_variance) - shift
    cross = np.einsum("ijr,jr->ir", root, linear) * (2.0 * weights.pair * weights.spread)
    return ScalarInnovations(value, variance, cross)


@dataclass(frozen=True, slots=True)
class SpinInnovations:
    """The two pseudo-measurements (6) of many runs.

    Parameters
    ----------
    value: innovation (2, r) [nT].
    cross, gain: the state's covariance with it, and the same times S^-1 (9, 2, r).
    squared: normalised innovation squared (r,).
    """

    value: Array
    cross: Array
    gain: Array
    squared: Array


def spin_innovations(
    x: Array, root: Array, weights: UnscentedWeights, window: Window, field_nt: Array, noise_variance: float
) -> SpinInnovations:
    """``Ukf._spin_innovation`` for states (9, r), factors (9, 9, r) and measured vectors (3, k, r) of a window."""
    share, magnitude, across = window.weights[:, None], window.reference_magnitude_nt[:, None], window.across
    vectors = Vectors.of(x, field_nt)
    unit = np.stack([part / vectors.length for part in vectors.w])  # (3, k, r)
    projected = unit * magnitude
    mean = across @ (share * projected).sum(axis=1)  # (2, r)
    clean = projected - (across.T @ mean)[:, None]
    c1, c2, c3 = clean + x[:3, None]
    field_clean = vectors.measured((c1, c2, c3))
    offsets = np.stack(moved(tuple(part[:, None] for part in field_clean), root, weights.spread))  # (3, k, 9, r)
    scale = share * magnitude
    centre = across @ _directions(clean, scale)
    middle, scale = clean[:, :, None], scale[:, None]
    plus = np.einsum("ci,ipr->cpr", across, _directions(middle + offsets, scale))
    minus = np.einsum("ci,ipr->cpr", across, _directions(middle - offsets, scale))
    first, second = np.einsum("ci,ikr->ckr", across, unit)
    tangential, square = float(window.weights @ window.weights), share * share
    isotropic, level = window.leak_nt**2, noise_variance * window.share
    noise = (
        level * (tangential - (square * first * first).sum(axis=0)) + isotropic,
        -level * (square * first * second).sum(axis=0),
        level * (tangential - (square * second * second).sum(axis=0)) + isotropic,
    )
    return _transformed(root, weights, (centre, plus, minus), centre - mean, noise)


def _directions(vectors: Array, scale: Array) -> Array:
    """Sum over k of scale times the unit vectors of (3, k, ..., r): (3, ..., r)."""
    length = vectors[0] * vectors[0]
    length += vectors[1] * vectors[1]
    length += vectors[2] * vectors[2]
    total: Array = (vectors * (scale / np.sqrt(length))).sum(axis=1)
    return total


def _transformed(
    root: Array,
    weights: UnscentedWeights,
    outputs: tuple[Array, Array, Array],
    measured: Array,
    noise: tuple[Array, Array, Array],
) -> SpinInnovations:
    """``unscented.transformed_innovation`` for outputs at the centre (2, r), above and below (2, 9, r)."""
    centre, plus, minus = outputs
    mean = weights.mean_0 * centre + weights.pair * (plus + minus).sum(axis=1)
    d_0, above, below = centre - mean, plus - mean[:, None], minus - mean[:, None]

    def covariance(i: int, j: int) -> Array:
        pairs = (above[i] * above[j] + below[i] * below[j]).sum(axis=0)
        total: Array = weights.covariance_0 * d_0[i] * d_0[j] + weights.pair * pairs
        return total

    s11, s12, s22 = covariance(0, 0) + noise[0], covariance(0, 1) + noise[1], covariance(1, 1) + noise[2]
    determinant = s11 * s22 - s12 * s12
    cross = np.einsum("ijr,cjr->icr", root, above - below) * (weights.pair * weights.spread)
    gain = np.stack([cross[:, 0] * s22 - cross[:, 1] * s12, cross[:, 1] * s11 - cross[:, 0] * s12], axis=1)
    value = measured - mean
    v1, v2 = value
    squared = (s22 * v1 * v1 - 2.0 * s12 * v1 * v2 + s11 * v2 * v2) / determinant
    return SpinInnovations(value, cross, gain / determinant, squared)
