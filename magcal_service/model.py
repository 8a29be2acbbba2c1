"""The measurement model: equations (1)-(5) of the method, their derivatives, and the state as named slices.

Letters of the paper: B measured vector (sensor frame), H reference field, A attitude (inertial -> body), b bias, D the
symmetric matrix of scale (diagonal) and non-orthogonality (off-diagonal), x = [b, D11 D22 D33, D12 D13 D23].

The calibrated vector is w = (I + D) B - b, equation (5).  It is affine in x: w = B + J(B) x, with J from
``field_jacobian``; everything here and in the filters rests on that.  Leading axes (``...``) are runs or samples.

Source: Cetin, Soken, Tekinalp, UHUK-2020-086, equations (1)-(5); Alonso & Shuster 2002 for (E, c).
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]
Number = Any
"""A float, or an array of runs or samples: the same arithmetic, element by element."""

STATE_SIZE: Final = 9  # three of the bias and six of the symmetric D
BIAS: Final = slice(0, 3)  # bx, by, bz [nT]
D_SCALE: Final = slice(3, 6)  # D11, D22, D33 [-]
D_ALL: Final = slice(3, 9)  # D_SCALE and D12, D13, D23 [-]
STATE_NAMES: Final = ("bx", "by", "bz", "D11", "D22", "D33", "D12", "D13", "D23")

# w_i gains B_j * D_ij: for each row i, the state's column of D_i1, D_i2, D_i3
_D_COLUMNS: Final = np.array([[3, 6, 7], [6, 4, 8], [7, 8, 5]])


def d_matrix(x: Array) -> Array:
    """D as symmetric matrices (..., 3, 3) from states (..., 9)."""
    return x[..., _D_COLUMNS]


def state_of(bias_nt: Array, d: Array) -> Array:
    """The state (..., 9) from b (..., 3) [nT] and symmetric D (..., 3, 3)."""
    diagonal = np.stack([d[..., 0, 0], d[..., 1, 1], d[..., 2, 2]], axis=-1)
    shear = np.stack([d[..., 0, 1], d[..., 0, 2], d[..., 1, 2]], axis=-1)
    return np.concatenate([np.broadcast_to(bias_nt, diagonal.shape), diagonal, shear], axis=-1)


def field_jacobian(field_nt: Array) -> Array:
    """J(B) = dw/dx, shape (..., 3, 9), at measured vectors B (..., 3) [nT]."""
    jacobian = np.zeros((*field_nt.shape, STATE_SIZE))
    rows = np.arange(3)
    jacobian[..., rows, rows] = -1.0
    jacobian[..., rows[:, None], _D_COLUMNS] = field_nt[..., None, :]
    return jacobian


def magnitude_jacobian(field_nt: Array, unit: Array) -> Array:
    """d|w|/dx (n, 9), each column in one piece, at measured vectors B (n, 3) [nT], w along ``unit`` (n, 3)."""
    (b1, b2, b3), (u1, u2, u3) = np.ascontiguousarray(field_nt.T), np.ascontiguousarray(unit.T)
    shear = b2 * u1 + b1 * u2, b3 * u1 + b1 * u3, b3 * u2 + b2 * u3
    return np.stack([-u1, -u2, -u3, b1 * u1, b2 * u2, b3 * u3, *shear]).T


def vector_jacobian(b1: float, b2: float, b3: float) -> Array:
    """J(B) = dw/dx, shape (3, 9), at one measured vector [nT]; ``field_jacobian`` for the hot path."""
    return np.array(
        (
            (-1.0, 0.0, 0.0, b1, 0.0, 0.0, b2, b3, 0.0),
            (0.0, -1.0, 0.0, 0.0, b2, 0.0, b1, 0.0, b3),
            (0.0, 0.0, -1.0, 0.0, 0.0, b3, 0.0, b1, b2),
        )
    )


def calibrate(x: Array, field_nt: Array) -> Array:
    """w = (I + D) B - b, equation (5) without noise; x (9,), B (..., 3) [nT] -> (..., 3) [nT]."""
    return field_nt + field_nt @ d_matrix(x) - x[BIAS]


def calibrated_components(x: Any, field_nt: Any) -> tuple[tuple[Number, ...], tuple[Number, Number, Number]]:
    """I + D and w = (I + D) B - b, equation (5), component by component: what every filter's hot path calls.

    Parameters
    ----------
    x: the nine numbers or arrays of a state, first axis first.
    field_nt: the three of B [nT], each a number or an array that broadcasts with those of ``x``.

    Returns
    -------
    (m11, m22, m33, m12, m13, m23) of I + D, and (w1, w2, w3) [nT].
    """
    b1, b2, b3, d11, d22, d33, m12, m13, m23 = x
    B1, B2, B3 = field_nt
    m11, m22, m33 = 1.0 + d11, 1.0 + d22, 1.0 + d33
    w1 = m11 * B1 + m12 * B2 + m13 * B3 - b1
    w2 = m12 * B1 + m22 * B2 + m23 * B3 - b2
    w3 = m13 * B1 + m23 * B2 + m33 * B3 - b3
    return (m11, m22, m33, m12, m13, m23), (w1, w2, w3)


def adjugate_product(matrix: tuple[Number, ...], w: Any) -> tuple[tuple[Number, Number, Number], Number]:
    """adj(I + D) w and det(I + D), whose quotient is (I + D)^-1 w; as ``calibrated_components`` has them."""
    m11, m22, m33, m12, m13, m23 = matrix
    c11, c12, c13 = m22 * m33 - m23 * m23, m13 * m23 - m12 * m33, m12 * m23 - m13 * m22
    c22, c23, c33 = m11 * m33 - m13 * m13, m12 * m13 - m11 * m23, m11 * m22 - m12 * m12
    w1, w2, w3 = w
    product = (c11 * w1 + c12 * w2 + c13 * w3, c12 * w1 + c22 * w2 + c23 * w3, c13 * w1 + c23 * w2 + c33 * w3)
    return product, m11 * c11 + m12 * c12 + m13 * c13


def measure(x: Array, field_body_nt: Array) -> Array:
    """B = (I + D)^-1 (A H + b + eps), equation (1); ``field_body_nt`` (..., 3) is A H + eps [nT]."""
    solution: Array = np.linalg.solve(np.eye(3) + d_matrix(x), (field_body_nt + x[BIAS]).reshape(-1, 3).T)
    return solution.T.reshape(field_body_nt.shape)


def scalar_residual(x: Array, field_nt: Array, reference_magnitude_nt: Array) -> Array:
    """e = |(I + D) B - b| - |H| [nT]; x (9,), B (..., 3), |H| (...)."""
    residual: Array = np.linalg.norm(calibrate(x, field_nt), axis=-1) - reference_magnitude_nt
    return residual


def scalar_innovation_value(
    residual_nt: Number, length_nt: Number, magnitude_nt: Number, noise_variance: Number
) -> Number:
    """Innovation h(x) + mean(v) - z of equations (2)-(4) [nT^2], as mean(v) - (|w| - |H|)(|w| + |H|).

    ``residual_nt`` is |w| - |H|; the difference of squares is taken as a product, which keeps its digits.
    """
    return mean_of_v(noise_variance) - residual_nt * (length_nt + magnitude_nt)


def mean_of_v(noise_variance: Number) -> Number:
    """Mean of v in z = h(x) + v, equation (3), for isotropic noise Sigma = s^2 I: tr(Sigma) = 3 s^2 [nT^2].

    From |(I + D) B - b|^2 = |H|^2 + 2 (AH)'eps + |eps|^2.  ``noise_variance`` is s^2 [nT^2], a number or any shape.
    """
    return 3.0 * noise_variance


def variance_of_v(reference_magnitude_nt: Number, noise_variance: Number) -> Number:
    """Variance of v as in ``mean_of_v``: 4 H'Sigma H + 2 tr(Sigma^2) = 4 |H|^2 s^2 + 6 s^4 [nT^4].

    |H| [nT] and s^2 [nT^2] are numbers or arrays that broadcast.
    """
    linear = 4.0 * noise_variance * reference_magnitude_nt * reference_magnitude_nt
    return linear + 6.0 * noise_variance * noise_variance


def largest_variance(covariance: Array, field_nt: Array) -> float:
    """Of a calibrated vector in any direction, by the nine errors' covariance (9, 9) alone [nT^2]; B (3,) [nT]."""
    jacobian = field_jacobian(field_nt)
    return float(np.linalg.eigvalsh(jacobian @ covariance @ jacobian.T)[-1])


def without_radial_noise(
    x: Array, field_nt: Array, reference_magnitude_nt: Array, noise_share: float = 1.0
) -> tuple[Array, Array]:
    """Project calibrated vectors onto the known magnitude; this removes the radial noise.

    Returns the projected vectors and what would have been measured, (w_hat, B_hat), each (..., 3) [nT].

    The scalar residual is the radial noise; a sensitivity evaluated at the noisy B contains that same noise, and their
    product does not average out (errors in variables: about 1e-4 in D at 300 nT).  On the projected vector only
    tangential noise is left, which the residual does not contain to first order.  ``B_hat`` is the measured vector
    that would have given ``w_hat``.

    ``noise_share`` is the share of the residual's variance that is noise (the rest is physics that was left out): its
    expected radial noise is that share of the residual, so only that much is removed.
    """
    w = calibrate(x, field_nt)
    length = np.linalg.norm(w, axis=-1)
    w_hat = w * (1.0 - noise_share * (1.0 - reference_magnitude_nt / length))[..., None]
    correction = np.linalg.solve(np.eye(3) + d_matrix(x), (w_hat - w).reshape(-1, 3).T)
    return w_hat, field_nt + correction.T.reshape(w.shape)
