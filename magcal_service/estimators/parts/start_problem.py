"""What a batch start is fitted to: its normal equations, a linear first solution, and damped Gauss-Newton.

Everything but ``gauss_newton`` takes one problem or a stack of them: leading axes (``...``) are runs, and the samples
are the last axis of every working array, so that a hundred runs cost little more than one (``batched_start``).

Source: Alonso & Shuster 2002 (TWO-STEP: E and c, Gauss-Newton); damping after Marquardt 1963.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.estimators.parts.spin_window import Window
from magcal_service.model import (
    BIAS,
    D_ALL,
    Array,
    adjugate_product,
    calibrated_components,
    d_matrix,
    mean_of_v,
    state_of,
)

SETTLED: Final = 1e-6
"""Squared length of a step, in sigmas, below which the iteration ends."""

WORSE: Final = 1.0 + 1e-9
"""A cost that grows by more than this is worse; less is rounding."""

ITERATIONS: Final = 40
"""Most steps; None after that.

Choice: the starts in the tests settle after 5 (the rule) to 37; one that has not by then fails, and the next
attempt has more samples.
"""

LARGEST_D: Final = 2.0
"""Largest element of D that a step may lead to: a gain of three, far beyond what the gates accept.

Choice: the way to a minimum may pass outside the gates; a wider limit lets runaway steps go on until ``ITERATIONS``.
"""

FIRST_DAMPING: Final = 1e-3
"""Marquardt's damping after the first step that made it worse, as a share of the diagonal; a choice of scale.

It grows tenfold while steps make it worse: a larger first one shortens good steps, a smaller one costs rounds.
"""

LEAST_DAMPING: Final = 1e-6
"""Below this the damping is dropped, and steps are those of Gauss-Newton: it would change them by a millionth."""

_LEAST_SLOPE: Final = 0.25
"""Of a residual against another's, for its logarithm: what is flatter or falls has collapsed or is mirrored."""

_I: Final = np.array([0, 1, 2, 0, 0, 1])
_J: Final = np.array([0, 1, 2, 1, 2, 2])


@dataclass(frozen=True, slots=True)
class WindowMeans:
    """Spin windows as a batch sees them: w is affine in B and the weights sum to 1, so a window is its weighted mean.

    Parameters
    ----------
    field_nt: weighted mean of B over each window (..., m, 3) [nT].
    across: two unit body vectors across the spin axis, per window (m, 2, 3).
    weight, leak_nt: factor on the noise variance, and the residual of A H [nT], per window (m,).
    """

    field_nt: Array
    across: Array
    weight: Array
    leak_nt: Array

    @classmethod
    def of(cls, windows: Sequence[Window]) -> WindowMeans:
        """The means of finished windows."""
        return cls(
            field_nt=np.array([window.weights @ window.field_body_nt for window in windows]).reshape(-1, 3),
            across=np.array([window.across for window in windows]).reshape(-1, 2, 3),
            weight=np.array([float(window.weights @ window.weights) * window.share for window in windows]),
            leak_nt=np.array([window.leak_nt for window in windows]),
        )

    def only(self, keep: NDArray[np.bool_]) -> WindowMeans:
        """Some of the windows, chosen by a mask (m,)."""
        return WindowMeans(self.field_nt[..., keep, :], self.across[keep], self.weight[keep], self.leak_nt[keep])

    def rows(self, noise_nt: float) -> tuple[Array, Array]:
        """Whitened rows (..., 9, 2 m), and residuals at x = 0 (..., 2 m): the residual is affine in x."""
        scaled = self.across * ((noise_nt**2 * self.weight + self.leak_nt**2) ** -0.5)[:, None, None]
        s1, s2, s3 = np.moveaxis(scaled, 2, 0)
        b1, b2, b3 = np.moveaxis(self.field_nt[..., None, :], -1, 0)  # (..., m, 1)
        zero = s1 * b1 + s2 * b2 + s3 * b3
        parts = (-s1, -s2, -s3, s1 * b1, s2 * b2, s3 * b3, s1 * b2 + s2 * b1, s1 * b3 + s3 * b1, s2 * b3 + s3 * b2)
        rows = np.stack(np.broadcast_arrays(*parts), axis=-3)
        return rows.reshape(*rows.shape[:-2], -1), zero.reshape(*zero.shape[:-2], -1)

    def residuals(self, x: Array, noise_nt: float) -> Array:
        """Whitened residuals (..., m, 2) at states x (..., 9)."""
        rows, zero = self.rows(noise_nt)
        residual: Array = zero + (x[..., None, :] @ rows)[..., 0, :]
        return residual.reshape(*residual.shape[:-1], -1, 2)


@dataclass(frozen=True)
class BatchProblem:
    """What a batch solution is fitted to.

    Parameters
    ----------
    field_nt, magnitude_nt: measured vectors B (..., n, 3) and |H| (n,) [nT].
    windows: means of the finished spin windows, possibly none.
    prior: 1 sigma of the nine states (9,).
    sigma_nt: weight of a scalar residual, 1 sigma [nT].
    noise_nt: white sensor noise for the mean of v [nT]; smaller than ``sigma_nt`` where the residual is not all noise.
    """

    field_nt: Array
    magnitude_nt: Array
    windows: WindowMeans
    prior: Array
    sigma_nt: float
    noise_nt: float

    def only(self, keep: NDArray[np.bool_], windows: NDArray[np.bool_]) -> BatchProblem:
        """The problem with some of its samples (n,) and windows (m,)."""
        return replace(
            self,
            field_nt=self.field_nt[keep],
            magnitude_nt=self.magnitude_nt[keep],
            windows=self.windows.only(windows),
        )

    def runs(self, chosen: NDArray[np.bool_]) -> BatchProblem:
        """Some of the problems of a stack, chosen by a mask over the leading axis."""
        windows = replace(self.windows, field_nt=self.windows.field_nt[chosen])
        return replace(self, field_nt=self.field_nt[chosen], windows=windows)

    def run(self, number: int) -> BatchProblem:
        """One problem of a stack."""
        windows = replace(self.windows, field_nt=self.windows.field_nt[number])
        return replace(self, field_nt=self.field_nt[number], windows=windows)

    @cached_property
    def _windows(self) -> tuple[Array, Array, Array]:
        """Rows (..., 9, 2 m), residuals at zero (..., 2 m) and normal matrix (..., 9, 9) of windows and prior."""
        rows, zero = self.windows.rows(self.sigma_nt)
        return rows, zero, rows @ np.swapaxes(rows, -1, -2) + np.diag(self.prior**-2.0)

    def residuals(self, x: Array) -> Array:
        """e = |w| - |H| (..., n) [nT] at states x (..., 9), its mean not subtracted."""
        _, (w1, w2, w3) = _calibrated(x, self.field_nt)
        residual: Array = np.sqrt(w1 * w1 + w2 * w2 + w3 * w3) - self.magnitude_nt
        return residual

    def normal_equations(self, x: Array) -> tuple[Array, Array, Array]:
        """Normal matrix (..., 9, 9), gradient (..., 9) and cost (...) at x (..., 9): prior, scalars and windows."""
        rows, residual = self._scalar_rows(x)
        weight = self.sigma_nt**-2
        window_rows, zero, fixed = self._windows
        window_residual = zero + (x[..., None, :] @ window_rows)[..., 0, :]
        tie = self.prior**-2.0
        normal = weight * (rows @ np.swapaxes(rows, -1, -2)) + fixed
        gradient = weight * (rows @ residual[..., None])[..., 0]
        gradient += tie * x + (window_rows @ window_residual[..., None])[..., 0]
        cost = weight * (residual * residual).sum(axis=-1) + (window_residual * window_residual).sum(axis=-1)
        return normal, gradient, cost + (tie * x * x).sum(axis=-1)

    def advantage(self, x: Array, other: Array) -> float:
        """By how much a state (9,) explains the samples better than another, at least: -2 log of a likelihood ratio.

        Costs alone cannot be compared.  The noise in B goes through I + D: a solution that is smaller by a tenth makes
        the sum of squares smaller by a fifth, and so better than the truth by a hundred within minutes.  A density of B
        on a line has the slope of the residual along it beside its square.  The line taken is the one across the
        other's surface |w| = |H|, on which ``x`` fits worst.
        """
        step = np.linalg.solve(np.eye(3) + d_matrix(other), self._directions(other))  # 1 nT in the other's residual
        slope = (self._directions(x) * ((np.eye(3) + d_matrix(x)) @ step)).sum(axis=0)
        thinner = float(np.log(np.maximum(slope, _LEAST_SLOPE)).sum())
        costs = float(self.normal_equations(other)[2] - self.normal_equations(x)[2])
        return costs + 2.0 * (self.noise_nt / self.sigma_nt) ** 2 * thinner

    def _directions(self, x: Array) -> Array:
        """Unit vectors of w (3, n) at a state (9,)."""
        w = np.stack(_calibrated(x, self.field_nt)[1])
        directions: Array = w / np.linalg.norm(w, axis=0)
        return directions

    def _scalar_rows(self, x: Array) -> tuple[Array, Array]:
        """Gauss-Newton rows (..., 9, n) and residuals (..., n) of e = |w| - |H| less its mean s^2 / |H|.

        The rows are u'J(B_hat) with ``model.without_radial_noise``, of which this is the arithmetic.
        """
        matrix, (w1, w2, w3) = _calibrated(x, self.field_nt)
        length = np.sqrt(w1 * w1 + w2 * w2 + w3 * w3)
        residual = length - self.magnitude_nt
        u1, u2, u3 = w1 / length, w2 / length, w3 / length
        (p1, p2, p3), determinant = adjugate_product(matrix, (u1, u2, u3))
        radial = residual * ((self.noise_nt / self.sigma_nt) ** 2 / determinant)
        b1, b2, b3 = np.moveaxis(self.field_nt, -1, 0)
        b1, b2, b3 = b1 - radial * p1, b2 - radial * p2, b3 - radial * p3
        rows = np.empty((*x.shape, residual.shape[-1]))
        rows[..., 0, :], rows[..., 1, :], rows[..., 2, :] = -u1, -u2, -u3
        rows[..., 3, :], rows[..., 4, :], rows[..., 5, :] = u1 * b1, u2 * b2, u3 * b3
        rows[..., 6, :] = u1 * b2 + u2 * b1
        rows[..., 7, :] = u1 * b3 + u3 * b1
        rows[..., 8, :] = u2 * b3 + u3 * b2
        return rows, residual - self.noise_nt**2 / self.magnitude_nt


def _calibrated(x: Array, field_nt: Array) -> tuple[tuple[Array, ...], tuple[Array, Array, Array]]:
    """I + D by components (..., 1), and w by components (..., n) [nT]; states x (..., 9), B (..., n, 3)."""
    return calibrated_components(np.moveaxis(x, -1, 0)[..., None], np.moveaxis(field_nt, -1, 0))


def linear_states(problem: BatchProblem) -> tuple[Array, NDArray[np.bool_]]:
    """States (..., 9) from linear least squares in (E, c, s), with the prior as a weak tie; and whether I + E is
    positive (...), without which there is no such state.
    """
    field_nt, magnitude_nt, prior = problem.field_nt, problem.magnitude_nt, problem.prior
    scale = float(magnitude_nt.mean())
    b = field_nt / scale
    count = len(magnitude_nt)
    per_row = scale**2 / (2.0 * problem.sigma_nt * magnitude_nt)
    rows = np.zeros((*field_nt.shape[:-2], count + 10, 11))
    rows[..., :count, :6] = b[..., _I] * b[..., _J] * -np.where(_I == _J, 1.0, 2.0)
    rows[..., :count, 6:9] = 2.0 * b
    rows[..., :count, 9] = -1.0
    square = (field_nt * field_nt).sum(axis=-1)
    rows[..., :count, 10] = (square - magnitude_nt**2 - mean_of_v(problem.noise_nt**2)) / scale**2
    rows[..., :count, :] *= per_row[:, None]
    tie = np.concatenate([2.0 * prior[D_ALL], prior[BIAS] / scale, [np.sum(prior[BIAS] ** 2) / scale**2]])
    rows[..., count:, :10] = np.diag(1.0 / tie)
    triangle = np.asarray(np.linalg.qr(rows, mode="r"))
    theta = np.linalg.solve(triangle[..., :10, :10], triangle[..., :10, 10:])[..., 0]
    square = np.broadcast_to(np.eye(3), (*theta.shape[:-1], 3, 3)).copy()
    square[..., _I, _J] += theta[..., :6]
    square[..., _J, _I] = square[..., _I, _J]
    values, vectors = np.linalg.eigh(square)
    positive = values[..., 0] > 0.0
    values = np.where(positive[..., None], values, 1.0)
    root = (vectors * np.sqrt(values)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    bias = np.linalg.solve(root, theta[..., 6:9, None] * scale)[..., 0]
    return state_of(bias, root - np.eye(3)), positive


def gauss_newton(problem: BatchProblem, start: Array) -> tuple[Array, Array] | None:
    """Maximum a posteriori state (9,) and covariance (9, 9), by damped steps from ``start``; None if it runs away.

    Source: Gauss-Newton as in Alonso & Shuster 2002, damped after Marquardt 1963.
    """
    x, damping = start.copy(), 0.0
    normal, gradient, cost = problem.normal_equations(x)
    for _ in range(ITERATIONS):
        step = np.linalg.solve(normal + damping * np.diag(np.diagonal(normal)), gradient)
        if float(step @ normal @ step) < SETTLED:
            return x, np.linalg.inv(normal)
        trial = x - step
        if np.abs(trial[D_ALL]).max() > LARGEST_D:
            damping = max(10.0 * damping, FIRST_DAMPING)
            continue
        trial_normal, trial_gradient, trial_cost = problem.normal_equations(trial)
        if trial_cost > cost * WORSE:
            damping = max(10.0 * damping, FIRST_DAMPING)
            continue
        x, normal, gradient, cost = trial, trial_normal, trial_gradient, trial_cost
        damping = 0.1 * damping if damping > LEAST_DAMPING else 0.0
    return None
