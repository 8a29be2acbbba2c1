"""A safe start: a batch solution that cannot fall into the mirror, handed over with an inflated covariance.

The scalar cost has false minima (half-collapsed I + D, the mirror 1 + D33 < 0), so a filter with a wide prior must not
begin on it.  In theta = (E, c, s) with E = 2D + D^2, c = (I + D) b, s = |b|^2 equation (4) is linear, with one minimum:

    |B|^2 - |H|^2 - 3 s^2 = -B'E B + 2 B'c - s

Solved with the prior as a weak tie, turned into (b, D) by the positive square root of I + E, refined by Gauss-Newton on
noise-projected vectors together with the spin windows, and accepted only when it passes the gates.

Source: Alonso & Shuster 2002 (TWO-STEP: E and c, Gauss-Newton); the gates and the projection are this project's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.config import CraftConfig, FilterConfig
from magcal_service.estimators.spin_window import Window
from magcal_service.model import (
    BIAS,
    D_ALL,
    STATE_SIZE,
    Array,
    calibrate,
    d_matrix,
    field_jacobian,
    scalar_residual,
    state_of,
    without_radial_noise,
)
from magcal_service.residuals import white_floor
from magcal_service.ticks import Tick

SMALLEST_EIGENVALUE: Final = 0.4
LARGEST_EIGENVALUE: Final = 2.5
"""Accepted eigenvalues of I + D.  The half-collapsed minimum has one near 0.25; real sensors stay within 0.7 to 1.4."""

HANDOVER_SHARE: Final = (0.005, 0.03)
"""The filter may take over when a calibrated vector is known to this share of |H| (1 sigma), by the residual's level.

What the filter leaves out is of second order, |H| share^2.  It has to be small against the residual: half a percent of
its sigma, within these bounds.  At a share of 0.03 it is 30 nT, more than the noise of a spin window's mean, and the
filter was sure of the wrong place (5 to 17 sigma off in 3 of 60 random flights; none of them at 0.005).
"""

BAD_FIT: Final = 1.5
"""Residual rms over the given noise beyond which a solution is not believed; 120 samples give 1 +- 0.065."""

_AMBIGUOUS: Final = 25.0
"""Difference in cost below which two distinct minima can't be told apart (odds of e^12)."""

_OUTLIER: Final = 6.0
_OUTLIER_PASSES: Final = 4
_FEWEST_KEPT: Final = 0.6
"""Sigmas beyond which a sample is left out of the start, passes of it, and the least share that has to be left."""

_ITERATIONS: Final = 40
_NOISE_PASSES: Final = 4
_LARGEST_D: Final = 2.0

_MAX_SAMPLES: Final = 4096
"""Samples kept for the start; beyond that every second one is dropped, again and again."""

_RETRY: Final = 1.15
"""Each attempt waits until there is this much more sample time than at the one before."""


class StartGate(StrEnum):
    """Why a batch solution was not accepted."""

    NOT_POSITIVE = "not_positive"
    COLLAPSED = "collapsed"
    POOR_COVERAGE = "poor_coverage"
    NO_CONVERGENCE = "no_convergence"
    BAD_FIT = "bad_fit"


@dataclass(frozen=True, slots=True)
class BatchSolution:
    """A batch estimate: state (9,), covariance (9, 9) for residuals of ``sigma_nt``, of which ``noise_nt`` is white."""

    x: Array
    covariance: Array
    sigma_nt: float
    noise_nt: float
    residual_rms_nt: float


def prior_sigma(config: FilterConfig) -> Array:
    """1 sigma of the nine states before any sample (9,) [nT, -]."""
    sigma = np.empty(STATE_SIZE)
    sigma[BIAS], sigma[D_ALL] = config.prior_bias_nt, config.prior_D
    return sigma


def _scalar_rows(x: Array, problem: BatchProblem) -> tuple[Array, Array]:
    """Gauss-Newton rows (n, 9) and residuals (n,) of e = |w| - |H| less its mean s^2 / |H|."""
    share = (problem.noise_nt / problem.sigma_nt) ** 2
    w_hat, b_hat = without_radial_noise(x, problem.field_nt, problem.magnitude_nt, share)
    unit = w_hat / np.linalg.norm(w_hat, axis=1)[:, None]
    rows: Array = np.einsum("ni,nij->nj", unit, field_jacobian(b_hat))
    residual = scalar_residual(x, problem.field_nt, problem.magnitude_nt)
    return rows, residual - problem.noise_nt**2 / problem.magnitude_nt


@dataclass(frozen=True, slots=True)
class WindowMeans:
    """Spin windows as a batch sees them: w is affine in B and the weights sum to 1, so a window is its weighted mean.

    Parameters
    ----------
    field_nt: weighted mean of B over each window (m, 3) [nT].
    across: two unit body vectors across the spin axis, per window (m, 2, 3).
    weight, leak_nt: factor on the noise variance, and what is left of A H [nT], per window (m,).
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
        return WindowMeans(self.field_nt[keep], self.across[keep], self.weight[keep], self.leak_nt[keep])

    def rows(self, x: Array, noise_nt: float) -> tuple[Array, Array]:
        """Whitened Gauss-Newton rows (2 m, 9) and residuals (2 m,)."""
        scaled = self.across * ((noise_nt**2 * self.weight + self.leak_nt**2) ** -0.5)[:, None, None]
        residual = scaled @ calibrate(x, self.field_nt)[:, :, None]
        return (scaled @ field_jacobian(self.field_nt)).reshape(-1, STATE_SIZE), residual.reshape(-1)


@dataclass(frozen=True, slots=True)
class BatchProblem:
    """What a batch solution is fitted to.

    Parameters
    ----------
    field_nt, magnitude_nt: measured vectors B (n, 3) and |H| (n,) [nT].
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

    def normal_equations(self, x: Array) -> tuple[Array, Array, float]:
        """Normal matrix (9, 9), gradient (9,) and cost at x: prior, scalar residuals and windows."""
        rows, residual = _scalar_rows(x, self)
        weight, tie = self.sigma_nt**-2, self.prior**-2.0
        normal = weight * rows.T @ rows + np.diag(tie)
        gradient = weight * rows.T @ residual + tie * x
        cost = weight * float(residual @ residual) + float(tie @ x**2)
        window_rows, window_residual = self.windows.rows(x, self.sigma_nt)
        normal += window_rows.T @ window_rows
        gradient += window_rows.T @ window_residual
        cost += float(window_residual @ window_residual)
        return normal, gradient, cost


def linear_start(problem: BatchProblem) -> Array | StartGate:
    """The state (9,) from linear least squares in (E, c, s), with the prior as a weak tie."""
    field_nt, magnitude_nt, prior = problem.field_nt, problem.magnitude_nt, problem.prior
    scale = float(magnitude_nt.mean())
    b = field_nt / scale
    i, j = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
    products = b[:, i] * b[:, j] * np.where(i == j, 1.0, 2.0)
    design = np.hstack([-products, 2.0 * b, -np.ones((len(b), 1))])
    target = ((field_nt**2).sum(axis=1) - magnitude_nt**2 - 3.0 * problem.noise_nt**2) / scale**2
    row_sigma = 2.0 * problem.sigma_nt * magnitude_nt / scale**2
    tie = np.concatenate([2.0 * prior[D_ALL], prior[BIAS] / scale, [np.sum(prior[BIAS] ** 2) / scale**2]])
    rows = np.vstack([design / row_sigma[:, None], np.diag(1.0 / tie)])
    theta = np.linalg.lstsq(rows, np.concatenate([target / row_sigma, np.zeros(10)]), rcond=None)[0]
    square = np.eye(3)
    square[i, j] += theta[:6]
    square[j, i] = square[i, j]
    values, vectors = np.linalg.eigh(square)
    if values[0] <= 0.0:
        return StartGate.NOT_POSITIVE
    root = vectors @ np.diag(np.sqrt(values)) @ vectors.T
    return state_of(np.linalg.solve(root, theta[6:9] * scale), root - np.eye(3))


def gauss_newton(problem: BatchProblem, start: Array) -> tuple[Array, Array] | None:
    """Maximum a posteriori state (9,) and covariance (9, 9), by damped steps from ``start``; None if it runs away.

    Source: Gauss-Newton as in Alonso & Shuster 2002, damped after Marquardt 1963.
    """
    x, damping = start.copy(), 0.0
    normal, gradient, cost = problem.normal_equations(x)
    for _ in range(_ITERATIONS):
        step = np.linalg.solve(normal + damping * np.diag(np.diagonal(normal)), gradient)
        if float(step @ normal @ step) < 1e-6:
            return x, np.linalg.inv(normal)
        trial = x - step
        if np.abs(trial[D_ALL]).max() > _LARGEST_D:
            damping = max(10.0 * damping, 1e-3)
            continue
        trial_normal, trial_gradient, trial_cost = problem.normal_equations(trial)
        if trial_cost > cost * (1.0 + 1e-9):
            damping = max(10.0 * damping, 1e-3)
            continue
        x, normal, gradient, cost = trial, trial_normal, trial_gradient, trial_cost
        damping = 0.1 * damping if damping > 1e-6 else 0.0
    return None


def batch_start(
    field_nt: Array,
    magnitude_nt: Array,
    windows: Sequence[Window],
    noise_nt: float | None,
    config: FilterConfig,
    thinned: int = 1,
) -> BatchSolution | StartGate:
    """A batch solution that passed every gate, or the gate that stopped it.

    A solution that is not sure enough is not given out at all: along a badly observed direction the cost is a curved
    valley, and its covariance there is too small by orders of magnitude.  Samples that arithmetic cannot be done with
    (zeros, one direction only) don't converge.

    Parameters
    ----------
    field_nt: measured vectors B (n, 3) [nT].
    magnitude_nt: |H| (n,) [nT].
    windows: finished spin windows, possibly none.
    noise_nt: 1 sigma per axis [nT]; None: taken from the residual, in two passes.
    config: prior and limits.
    thinned: each sample stands for this many, of which the others were dropped.
    """
    means = WindowMeans.of(windows)
    problem = BatchProblem(field_nt, magnitude_nt, means, prior_sigma(config), noise_nt or 0.0, noise_nt or 0.0)
    try:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            solution = _solve_without_outliers(problem, noise_nt is None)
    except np.linalg.LinAlgError:
        return StartGate.NO_CONVERGENCE
    if isinstance(solution, StartGate):
        return solution
    if not (np.isfinite(solution.x).all() and np.isfinite(solution.covariance).all()):
        return StartGate.NO_CONVERGENCE
    solution = replace(solution, covariance=solution.covariance / thinned)
    eigenvalues = np.linalg.eigvalsh(np.eye(3) + d_matrix(solution.x))
    if eigenvalues[0] < SMALLEST_EIGENVALUE or eigenvalues[-1] > LARGEST_EIGENVALUE:
        return StartGate.COLLAPSED
    if noise_nt is not None and solution.residual_rms_nt > BAD_FIT * noise_nt:
        return StartGate.BAD_FIT
    scale = float(magnitude_nt.mean())
    share = float(np.clip((0.005 * solution.sigma_nt / scale) ** 0.5, *HANDOVER_SHARE))
    if vector_sigma(solution.covariance, field_nt) > share * scale:
        return StartGate.POOR_COVERAGE
    return solution


def _solve_without_outliers(problem: BatchProblem, noise_unknown: bool) -> BatchSolution | StartGate:
    """The solution, less the samples and windows that it finds far outside its own scatter, in passes.

    The scatter is taken from the median, so that spikes don't hide behind themselves.  Samples whose |B| alone stands
    far outside are left out from the beginning: a few of them would spoil the linear start.  Windows are of use when
    most of them agree; otherwise the running filter will find out why they don't.
    """
    length = np.linalg.norm(problem.field_nt, axis=1)
    keep = _within(length - np.median(length))
    windows = np.full(len(problem.windows.weight), bool(keep.all()))
    solution: BatchSolution | StartGate = StartGate.BAD_FIT
    for _ in range(_OUTLIER_PASSES):
        if np.count_nonzero(keep) < _FEWEST_KEPT * len(keep):
            return StartGate.BAD_FIT
        part = problem.only(keep, windows)
        solution = _solve_with_unknown_noise(part) if noise_unknown else _solve(part)
        if isinstance(solution, StartGate):
            return solution
        sound = _within(scalar_residual(solution.x, problem.field_nt, problem.magnitude_nt))
        residual = problem.windows.rows(solution.x, solution.sigma_nt)[1].reshape(-1, 2)
        passed = (residual**2).sum(axis=1) < _OUTLIER**2
        if (sound == keep).all() and ((passed == windows).all() or not windows.any()):
            break
        keep = sound
        windows = passed if np.count_nonzero(passed) >= _FEWEST_KEPT * len(passed) else np.zeros_like(passed)
    return solution


def _within(values: Array) -> NDArray[np.bool_]:
    """Which values (n,) lie within 6 sigma of zero, sigma taken from their median."""
    inside: NDArray[np.bool_] = np.abs(values) <= _OUTLIER * 1.4826 * np.median(np.abs(values))
    return inside


def _solve(problem: BatchProblem) -> BatchSolution | StartGate:
    """The lower of the minima reached from the linear start and from zero; ambiguous ones are poor coverage."""
    linear = linear_start(problem)
    starts = [np.zeros(STATE_SIZE)] if isinstance(linear, StartGate) else [linear, np.zeros(STATE_SIZE)]
    found = [result for start in starts if (result := gauss_newton(problem, start)) is not None]
    if not found:
        return linear if isinstance(linear, StartGate) else StartGate.NO_CONVERGENCE
    costs = [problem.normal_equations(x)[2] for x, _ in found]
    x, covariance = found[int(np.argmin(costs))]
    apart = max(float((x - other) @ np.linalg.solve(covariance, x - other)) for other, _ in found)
    if apart > _AMBIGUOUS and max(costs) - min(costs) < _AMBIGUOUS:
        return StartGate.POOR_COVERAGE
    residual = scalar_residual(x, problem.field_nt, problem.magnitude_nt)
    rms = float(np.sqrt(np.mean(residual**2)))
    return BatchSolution(x, covariance, problem.sigma_nt, min(problem.noise_nt, problem.sigma_nt), rms)


def _solve_with_unknown_noise(problem: BatchProblem) -> BatchSolution | StartGate:
    """Weight by the residual that is left, in passes; only its white part counts as sensor noise."""
    scale = float(problem.magnitude_nt.mean())
    problem = replace(problem, sigma_nt=0.03 * scale)
    for _ in range(_NOISE_PASSES):
        solution = _solve(problem)
        if isinstance(solution, StartGate):
            return solution
        residual = scalar_residual(solution.x, problem.field_nt, problem.magnitude_nt)
        sigma_nt = max(solution.residual_rms_nt, 1e-4 * scale)
        if abs(sigma_nt / problem.sigma_nt - 1.0) < 0.05:
            break
        problem = replace(problem, sigma_nt=sigma_nt, noise_nt=min(sigma_nt, white_floor(residual)))
    return solution


def vector_sigma(covariance: Array, field_nt: Array) -> float:
    """Largest 1 sigma of the calibrated vector over the measured ones [nT], from the state's covariance alone."""
    sample = field_nt[:: max(1, len(field_nt) // 50)]
    jacobian = field_jacobian(sample)
    variance = np.einsum("nij,jk,nik->n", jacobian, covariance, jacobian)
    return float(np.sqrt(variance.max()))


class StartCollector:
    """Collects ticks until a batch solution passes every gate.

    Parameters
    ----------
    config: the craft's configuration.  ``filter.start_s`` is when a start is first tried; when the residual still
        contradicts ``sensor.noise_nt`` after ``filter.start_max_s``, the noise is taken from the residual instead.

    Attributes
    ----------
    gate: what stopped the last attempt.
    spin_contradicted: the solution is one without the spin windows, because with them nothing fitted.
    noise_contradicted: the solution is one that takes the noise from the residual.
    """

    def __init__(self, config: CraftConfig) -> None:
        self.config = config
        self.gate: StartGate | None = None
        self.spin_contradicted = False
        self.noise_contradicted = False
        self._ticks: list[Tick] = []
        self._windows: list[Window] = []
        self._stride = 1
        self._seen = 0
        self.samples = 0
        self._seconds = 0.0
        self._last_s: float | None = None
        self._attempt_at_s = self.config.filter.start_s

    def push(self, tick: Tick, window: Window | None) -> BatchSolution | None:
        """Add a tick and the window that ended in it; a solution once there is one to hand over."""
        self._seen += 1
        now_s = float(tick.times_s[-1])
        if self._last_s is not None and not tick.after_gap:
            self._seconds += now_s - self._last_s
        self._last_s = now_s
        if self._seen % self._stride == 0:
            self._ticks.append(tick)
            self.samples += len(tick.times_s)
        if window is not None:
            self._windows.append(window)
        self._thin()
        if self._seconds < self._attempt_at_s or self.samples <= 2 * STATE_SIZE:
            return None
        self._attempt_at_s = max(self._seconds * _RETRY, self._seconds + 10.0)
        result = self._attempt()
        if isinstance(result, BatchSolution):
            return result
        self.gate = result
        return None

    def _attempt(self) -> BatchSolution | StartGate:
        """All there is; without the windows where they spoil it; without the given noise where that lasts too long."""
        noise_nt = self.config.sensor.noise_nt
        result = self._solve(self._windows, noise_nt)
        if result is StartGate.BAD_FIT and self._windows:
            alone = self._solve((), noise_nt)
            self.spin_contradicted = isinstance(alone, BatchSolution)
            result = alone
        if result is StartGate.BAD_FIT and self._seconds > self.config.filter.start_max_s:
            result = self._solve((), None)
            self.noise_contradicted = isinstance(result, BatchSolution)
        return result

    def _solve(self, windows: Sequence[Window], noise_nt: float | None) -> BatchSolution | StartGate:
        field = np.concatenate([tick.field_body_nt for tick in self._ticks])
        magnitude = np.concatenate([tick.reference_magnitude_nt for tick in self._ticks])
        return batch_start(field, magnitude, windows, noise_nt, self.config.filter, self._stride)

    def _thin(self) -> None:
        if self.samples > _MAX_SAMPLES:
            self._ticks = self._ticks[::2]
            self._stride *= 2
            self.samples = sum(len(tick.times_s) for tick in self._ticks)
