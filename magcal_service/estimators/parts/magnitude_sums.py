"""The scalar measurement's whole cost in 66 running sums, for any state and any number of samples.

With w = (I + D) B - b the residual |w|^2 - |H|^2 of equation (3) is linear in the ten monomials of B,

    |w|^2 = q(x)'l(B),    l = (B1^2, B2^2, B3^2, B1 B2, B1 B3, B2 B3, B1, B2, B3, 1),

so the sums of l l', l |H|^2 and |H|^4, weighted by 1 / (4 |H|^2), hold all that a batch will ever need: memory and time
of a solution don't grow with the recording, and sums of stretches add.  This is the algebra of TWO-STEP: q is
(E, c, |b|^2) of Alonso & Shuster up to signs and factors.

Noise inside B (errors in variables).  With isotropic noise s in w, the gradient of the cost at the true state has the
mean 10 s^2 w'J(B) + 4 s^2 w'J((I + D)^-1 w) per sample; three tenths of the first term are the mean of v, which the
published method subtracts.  ``gradient`` subtracts all of it where asked to; terms in s^4 are left.  In the same way
the noise adds to the normal matrix what looks like information; it matters where a state is badly observable.

Source: Alonso & Shuster 2002 for the algebra and the mean of v; adjusted least squares after Kukush, Markovsky & Van
Huffel 2004 for the noise inside B, worked out here for this model.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from magcal_service.model import BIAS, STATE_SIZE, Array, d_matrix, field_jacobian, mean_of_v

SCALE_NT: Final = 30_000.0
"""Unit of every sum: numbers near 1 keep ten monomials of fourth order apart in double precision."""

_I: Final = np.array([0, 1, 2, 0, 0, 1])
_J: Final = np.array([0, 1, 2, 1, 2, 2])
_TWICE: Final = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
_DIRECTIONS: Final = np.zeros((6, 3, 3))  # dD / dx of D11 D22 D33 D12 D13 D23
_DIRECTIONS[np.arange(6), _I, _J] = _DIRECTIONS[np.arange(6), _J, _I] = 1.0
_UNIT: Final = np.array([SCALE_NT] * 3 + [1.0] * 6)

_AFFINE: Final = np.concatenate(  # J(B) = sum of B_j _AFFINE[j], with B_3 = 1: (4, 3, 9)
    [field_jacobian(np.eye(3)) - field_jacobian(np.zeros(3)), field_jacobian(np.zeros((1, 3)))]
)


def scaled(x: Array) -> Array:
    """A state (9,) with its bias in units of ``SCALE_NT``."""
    result: Array = x / _UNIT
    return result


def unscaled(x: Array) -> Array:
    """Inverse of ``scaled``."""
    result: Array = x * _UNIT
    return result


def unscaled_covariance(covariance: Array) -> Array:
    """Covariance (9, 9) [nT, -] of a scaled state's, symmetric to the last bit."""
    result = covariance * np.outer(_UNIT, _UNIT)
    return 0.5 * (result + result.T)


def unscaled_information(information: Array, noise_nt: float) -> Array:
    """Fisher information (9, 9) [1/nT, 1] from ``MagnitudeSums.information`` and the sigma of the residual."""
    result: Array = information / np.outer(_UNIT, _UNIT) * (SCALE_NT / noise_nt) ** 2
    return result


def coefficients(y: Array) -> Array:
    """q (10,) at a scaled state y (9,)."""
    a, b = np.eye(3) + d_matrix(y), y[BIAS]
    square = a @ a
    return np.concatenate([square[_I, _J] * _TWICE, -2.0 * (a @ b), [b @ b]])


def coefficient_jacobian(y: Array) -> Array:
    """dq/dy (10, 9) at a scaled state y (9,)."""
    a, b = np.eye(3) + d_matrix(y), y[BIAS]
    jacobian = np.zeros((10, STATE_SIZE))
    jacobian[6:9, BIAS], jacobian[9, BIAS] = -2.0 * a, 2.0 * b
    moved = _DIRECTIONS @ a
    square = moved + moved.transpose(0, 2, 1)
    jacobian[:6, 3:] = (square[:, _I, _J] * _TWICE).T
    jacobian[6:9, 3:] = -2.0 * (_DIRECTIONS @ b).T
    return jacobian


@dataclass
class MagnitudeSums:
    """Weighted sums over samples, in units of ``SCALE_NT``.

    Parameters
    ----------
    count: samples, or the sum of their weights.
    normal: sum of l l' / (4 |H|^2) (10, 10).
    target: sum of l |H|^2 / (4 |H|^2) (10,).
    square: sum of |H|^4 / (4 |H|^2).
    """

    count: float = 0.0
    normal: Array = field(default_factory=lambda: np.zeros((10, 10)))
    target: Array = field(default_factory=lambda: np.zeros(10))
    square: float = 0.0

    def add(self, field_nt: Array, magnitude_nt: Array) -> None:
        """Take in samples: B (n, 3) and |H| (n,) [nT]."""
        b, h = field_nt / SCALE_NT, magnitude_nt / SCALE_NT
        monomials = np.concatenate([b[:, _I] * b[:, _J], b, np.ones((len(b), 1))], axis=1)
        rows = monomials / (2.0 * h)[:, None]
        self.count += len(b)
        self.normal += rows.T @ rows
        self.target += 0.25 * monomials.sum(axis=0)
        self.square += 0.25 * float(h @ h)

    def __add__(self, other: MagnitudeSums) -> MagnitudeSums:
        return MagnitudeSums(
            self.count + other.count,
            self.normal + other.normal,
            self.target + other.target,
            self.square + other.square,
        )

    def times(self, weight: float) -> MagnitudeSums:
        """The sums of the same samples with a weight each."""
        return MagnitudeSums(weight * self.count, weight * self.normal, weight * self.target, weight * self.square)

    def mean_square_nt(self, y: Array) -> float:
        """Mean of ((|w|^2 - |H|^2) / (2 |H|))^2 at a scaled state, nearly the mean square of |w| - |H| [nT^2]."""
        q = coefficients(y)
        total = float(q @ self.normal @ q - 2.0 * (q @ self.target)) + self.square
        return max(total, 0.0) * SCALE_NT**2 / max(self.count, 1.0)

    def linear_solution(self, noise_nt: float, prior: Array) -> Array:
        """q (10,) by linear least squares with the constant free: TWO-STEP's centred estimate.

        Centring removes |b|^2 from the measurements; leaving the last coefficient free does the same.  ``prior``
        (9,), 1 sigma of a scaled state, ties q weakly to that of x = 0, so that there is a solution always.
        """
        variance = (noise_nt / SCALE_NT) ** 2
        bias = prior[BIAS]
        tie = np.concatenate([2.0 * _TWICE * prior[3:], 2.0 * bias, [bias @ bias]]) ** -2.0 * variance
        moments = self.target + mean_of_v(variance) * self.normal[9]
        solution: Array = np.linalg.solve(
            self.normal + np.diag(tie), moments + tie * coefficients(np.zeros(STATE_SIZE))
        )
        return solution

    def gradient(self, y: Array, noise_nt: float, *, corrected: bool) -> Array:
        """Half the derivative of the cost (9,) at a scaled state, per unit of noise variance of one.

        ``corrected``: with the mean of the noise inside B subtracted, too; else the mean of v alone.
        """
        variance = (noise_nt / SCALE_NT) ** 2
        q, jacobian = coefficients(y), coefficient_jacobian(y)
        noise = (mean_of_v(1.0) + (2.0 if corrected else 0.0)) * variance
        gradient: Array = jacobian.T @ (self.normal @ q - self.target - noise * self.normal[9])
        if corrected:
            gradient[3:] -= 4.0 * variance * self._turned(y)
        return gradient

    def _turned(self, y: Array) -> Array:
        """Sum of w'J((I + D)^-1 w) for the six elements of D (6,): w B0' + B0 w' with B0 = (I + D)^-1 w."""
        a = np.eye(3) + d_matrix(y)
        transform = np.hstack([a, -y[BIAS][:, None]])  # w = transform (B, 1)
        w_square = transform @ self.second_moments() @ transform.T
        both = w_square @ np.linalg.inv(a)
        turned: Array = (both + both.T)[_I, _J] * _TWICE / 2.0
        return turned

    def second_moments(self) -> Array:
        """Sum of (B, 1) (B, 1)' / (4 |H|^2) (4, 4)."""
        moments = np.empty((4, 4))
        constant = self.normal[9]
        moments[_I, _J] = moments[_J, _I] = constant[:6]
        moments[:3, 3] = moments[3, :3] = constant[6:9]
        moments[3, 3] = constant[9]
        return moments

    def information(self, y: Array, noise_nt: float, *, corrected: bool) -> Array:
        """Normal matrix (9, 9) at a scaled state, per unit of noise variance of one.

        ``corrected``: without what the noise inside B adds to it.
        """
        jacobian = coefficient_jacobian(y)
        information: Array = jacobian.T @ self.normal @ jacobian
        if corrected:
            information = information - self.noise_information(y, noise_nt)
        return information

    def noise_information(self, y: Array, noise_nt: float) -> Array:
        """Mean of what noise adds to ``information`` (9, 9): the rows 2 w'J(B) gain 4 s^2 times the sum of R_i'R_i.

        R_i = e_i'J(B) + w'J(A^-1 e_i).
        R_i is linear in (B, 1), so the sum follows from the second moments.
        """
        a, b = np.eye(3) + d_matrix(y), y[BIAS]
        turned = np.einsum("ki,kmn->imn", np.linalg.inv(a), _AFFINE[:3])
        rows = _AFFINE.transpose(1, 0, 2) + np.einsum("mj,imn->ijn", np.hstack([a, -b[:, None]]), turned)
        total: Array = np.einsum("ijn,jk,ikm->nm", rows, self.second_moments(), rows)
        return 4.0 * (noise_nt / SCALE_NT) ** 2 * total

    def vector_sigma_nt(self, covariance: Array) -> float:
        """rms over the samples of 1 sigma of w's worst component [nT], from the state's covariance (9, 9) [nT, -]."""
        moments = self.second_moments() / max(self.normal[9, 9], 1e-300)
        moments[:3] *= SCALE_NT
        moments[:, :3] *= SCALE_NT
        variance = np.einsum("kl,kis,st,ljt->ij", moments, _AFFINE, covariance, _AFFINE)
        return float(np.sqrt(np.linalg.eigvalsh(variance)[-1]))
