"""Unscented measurement updates in the form this model allows: every sigma point moves w on a straight line.

Because w = B + J(B) x is affine in x, the 18 symmetric points of Julier & Uhlmann give w_0 +- U_i with one matrix
product, and the transform of |w|^2 needs no loop over points: with a_i = 2 w_0'U_i and q_i = |U_i|^2 the point pairs
are |w_0|^2 + q_i +- a_i.  The result is the unscented transform itself, not an approximation of it.

Source: Julier & Uhlmann 1997; Crassidis, Lai & Harman 2003 for its use on equation (3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.model import (
    STATE_SIZE,
    Array,
    adjugate_product,
    calibrated_components,
    scalar_innovation_value,
    variance_of_v,
    vector_jacobian,
)

_IDENTITY: Final = np.eye(STATE_SIZE)


@dataclass(frozen=True, slots=True)
class UnscentedWeights:
    """Spread and weights of the 2 n + 1 sigma points for n = 9.

    ``spread`` multiplies the columns of the Cholesky factor; ``mean_0`` and ``covariance_0`` weigh the centre point,
    ``pair`` each of the 18 others.
    """

    spread: float
    mean_0: float
    covariance_0: float
    pair: float

    @classmethod
    def scaled(cls, alpha: float, beta: float, kappa: float) -> UnscentedWeights:
        """The scaled transform: lambda = alpha^2 (n + kappa) - n."""
        scale = alpha**2 * (STATE_SIZE + kappa)
        mean_0 = 1.0 - STATE_SIZE / scale
        return cls(scale**0.5, mean_0, mean_0 + 1.0 - alpha**2 + beta, 0.5 / scale)


@dataclass(frozen=True, slots=True)
class Innovation:
    """A measurement update before it is applied: innovation (m,), its covariance S (m, m), cross covariance (9, m).

    Those of many runs have an axis of runs before these; ``squared_norm`` and ``apply`` are for one.
    """

    value: Array
    covariance: Array
    cross: Array

    def gain(self) -> Array:
        """Cross covariance times S^-1 (..., 9, m)."""
        gain: Array = np.linalg.solve(self.covariance, self.cross.swapaxes(-1, -2)).swapaxes(-1, -2)
        return gain

    def squared_norm(self) -> float:
        """Normalised innovation squared, v' S^-1 v; its expectation is m."""
        return float(self.value @ np.linalg.solve(self.covariance, self.value))

    def apply(self, x: Array, covariance: Array) -> tuple[Array, Array]:
        """The updated state (9,) and covariance (9, 9), symmetric to the last bit."""
        gain = self.gain()
        updated = covariance - gain @ self.cross.T
        return x + gain @ self.value, 0.5 * (updated + updated.T)


@dataclass(frozen=True, slots=True)
class ScalarInnovation:
    """One scalar update before it is applied.

    Parameters
    ----------
    residual_nt: e = |w| - |H| at the measured vector [nT].
    value, variance: innovation of equation (3) [nT^2] and its variance [nT^4].
    noise_variance: the part of the variance that is the sample's own noise [nT^4].
    cross: covariance of the state with it (9,).
    """

    residual_nt: float
    value: float
    variance: float
    noise_variance: float
    cross: Array

    def squared_norm(self) -> float:
        """Normalised innovation squared; its expectation is 1."""
        return self.value * self.value / self.variance

    def apply(self, x: Array, covariance: Array) -> tuple[Array, Array]:
        """The updated state (9,) and covariance (9, 9), symmetric to the last bit."""
        cross = self.cross
        return x + cross * (self.value / self.variance), covariance - cross[:, None] * cross / self.variance


def scalar_innovation(
    x: Array,
    root: Array,
    weights: UnscentedWeights,
    field_nt: Array,
    magnitude_nt: float,
    noise_variance: float,
    white_variance: float,
) -> ScalarInnovation:
    """Innovation of equation (3) for one sample, in plain floats where vectors have three elements: it is the hot path.

    The sensitivity is taken at the vector projected to the known magnitude (``model.without_radial_noise`` explains why
    and is the same arithmetic for arrays), the innovation at the measured one, and the mean of v is subtracted.

    Parameters
    ----------
    x, root: state (9,) and the lower Cholesky factor of its covariance (9, 9).
    field_nt: measured vector B (3,) [nT].
    magnitude_nt: |H| [nT].
    noise_variance: s^2 of the isotropic noise that the residual is weighted with [nT^2].
    white_variance: its part that is sensor noise; the same unless physics was left out [nT^2].
    """
    B1, B2, B3 = field_nt.tolist()
    matrix, (w1, w2, w3) = calibrated_components(x.tolist(), (B1, B2, B3))
    length = math.sqrt(w1 * w1 + w2 * w2 + w3 * w3)
    residual = length - magnitude_nt
    share = white_variance / noise_variance * residual / length if length > 0.0 else 0.0
    # the radial part, subtracted from w and, through (I + D)^-1, from B
    r1, r2, r3 = share * w1, share * w2, share * w3
    (p1, p2, p3), determinant = adjugate_product(matrix, (r1, r2, r3))
    B1, B2, B3 = B1 - p1 / determinant, B2 - p2 / determinant, B3 - p3 / determinant
    # ``dot`` costs half of ``@`` for so few numbers
    moved = vector_jacobian(B1, B2, B3).dot(root) * weights.spread  # U (3, 9)
    linear = np.array((2.0 * (w1 - r1), 2.0 * (w2 - r2), 2.0 * (w3 - r3))).dot(moved)  # a (9,)
    quadratic = np.add.reduce(moved * moved)  # q (9,); ``ndarray.sum`` costs as much again for so few numbers
    shift = (
        2.0 * weights.pair * float(np.add.reduce(quadratic))
    )  # mean of |w|^2 over the points, less its value at the centre
    quadratic -= shift
    spread = (
        2.0 * weights.pair * float(linear.dot(linear) + quadratic.dot(quadratic)) + weights.covariance_0 * shift * shift
    )
    value = scalar_innovation_value(residual, length, magnitude_nt, white_variance) - shift
    cross = root.dot(linear) * (2.0 * weights.pair * weights.spread)
    own = variance_of_v(magnitude_nt, noise_variance)
    return ScalarInnovation(residual, value, spread + own, own, cross)


def sigma_points(x: Array, root: Array, weights: UnscentedWeights) -> Array:
    """The 19 points (..., 19, 9): centre, then x + and x - the scaled columns of the Cholesky factor.

    Parameters
    ----------
    x, root: states (..., 9) and the lower Cholesky factors of their covariances (..., 9, 9).
    """
    offsets, centre = weights.spread * root.swapaxes(-1, -2), x[..., None, :]
    return np.concatenate([centre, centre + offsets, centre - offsets], axis=-2)


def transformed_innovation(
    root: Array, weights: UnscentedWeights, outputs: Array, measured: Array, noise_covariance: Array
) -> Innovation:
    """Innovation for any measurement from its values at the 19 sigma points; leading axes (...) are runs.

    Parameters
    ----------
    outputs: predicted measurements at ``sigma_points``, (..., 19, m).
    measured: what the prediction at the centre is compared with, (..., m).
    noise_covariance: (..., m, m).
    """
    centre, pairs = outputs[..., :1, :], outputs[..., 1:, :]
    mean = weights.mean_0 * centre + weights.pair * pairs.sum(axis=-2, keepdims=True)
    d_0, d = centre - mean, pairs - mean
    spread = weights.covariance_0 * (d_0.swapaxes(-1, -2) * d_0) + weights.pair * d.swapaxes(-1, -2) @ d
    half = STATE_SIZE
    cross = (weights.pair * weights.spread) * root @ (d[..., :half, :] - d[..., half:, :])
    return Innovation(measured - mean[..., 0, :], spread + noise_covariance, cross)


def cholesky(covariance: Array) -> Array:
    """Lower factor of a covariance (9, 9); where rounding has cost definiteness, the nearest floor is restored.

    The floor adds 1e-12 of each variance to the diagonal; it is raised up to a millionth before the factorisation
    fails.

    Raises
    ------
    numpy.linalg.LinAlgError: the matrix is not a covariance at all.
    """
    try:
        factor: Array = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        diagonal = np.abs(np.diagonal(covariance))
        for floor in (1e-12, 1e-10, 1e-8):
            try:
                factor = np.linalg.cholesky(covariance + _IDENTITY * (floor * diagonal))
            except np.linalg.LinAlgError:
                continue
            return factor
        factor = np.linalg.cholesky(covariance + _IDENTITY * (1e-6 * diagonal))
    return factor
