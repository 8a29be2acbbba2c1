"""The scalar update of ``ukf`` for many runs at once, with the runs as the last axis of every array.

The arithmetic is that of ``unscented``, number by number; a number there is a row of runs here.  So each line costs one
pass over rows that stay in the cache, instead of thousands of small matrices.

Source: as ``unscented``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
    """``unscented.ScalarInnovation`` of many runs: innovation, variance (r,), its part, cross covariance (9, r)."""

    value: Array
    variance: Array
    noise_variance: float
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
    return ScalarInnovations(value, variance, noise, cross)
