"""Finding the spin from calibrated vectors: axis, rate and attitude without a first guess of any of them.

Three steps, each the starting point of the next:

1. Axis.  While the craft turns about a body axis n that points along s in space, n'w = s'H at every sample.  Linear in
   both: project the columns of H out of the vectors w, and n is the direction in which least is left.
2. Rate and attitude.  Turned back by a trial rate, the vectors are those of a craft at rest, w -> R H with one R: the
   problem of Wahba, whose gain is the sum of the singular values of one 3x3 matrix.  The rate is searched on a grid,
   with R proper.  When an improper R (a reflection) fits much better, the calibration is mirrored.
3. All fifteen states by Gauss-Newton on the measured vectors, on the newest stretch and then on twice as much each
   time, so that the phase is never more than a fraction of a turn off.

Source: Wahba 1965 and Markley 1988 for step 2; the rest is this project's own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.estimators.spin_state import (
    ATTITUDE,
    ERRORS,
    RATE,
    SPIN_STATE_SIZE,
    SpinState,
    cross_matrix,
    turned,
)
from magcal_service.estimators.spin_window import across_axis
from magcal_service.model import BIAS, D_ALL, Array, calibrate, d_matrix, field_jacobian

_SEARCH_SAMPLES: Final = 512
"""Samples used by the search for the rate; more only cost time."""

_AXIS_CONTRAST: Final = 2.0
"""What is left across the axis over what is left along it; a craft that does not turn about an axis has about 1."""

_MIRROR_MARGIN: Final = 0.5
"""A reflection that leaves less than this share of what a rotation leaves means a mirrored calibration."""

_FINE_RATES: Final = 21

_ITERATIONS: Final = 25
_LARGEST_TURN_RAD: Final = 0.3
_LARGEST_D: Final = 2.0
_CONVERGED: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Samples:
    """Samples before a moment: times before it (n,), at most 0 [s], B (n, 3) and H (n, 3) in ECI [nT]."""

    times_s: Array
    field_nt: Array
    reference_eci_nt: Array

    def newest(self, span_s: float) -> Samples:
        """Those of the last ``span_s`` seconds."""
        first = int(np.searchsorted(self.times_s, -span_s))
        return Samples(self.times_s[first:], self.field_nt[first:], self.reference_eci_nt[first:])

    def thinned(self, most: int) -> Samples:
        """Every so many-th, so that at most ``most`` are left."""
        step = -(-len(self.times_s) // most)
        return Samples(self.times_s[::step], self.field_nt[::step], self.reference_eci_nt[::step])

    def where(self, chosen: NDArray[np.bool_]) -> Samples:
        """Those chosen (n,)."""
        return Samples(self.times_s[chosen], self.field_nt[chosen], self.reference_eci_nt[chosen])

    @property
    def span_s(self) -> float:
        """Time from first to last [s]."""
        return float(self.times_s[-1] - self.times_s[0]) if len(self.times_s) else 0.0


@dataclass(frozen=True, slots=True)
class SpinGuess:
    """Attitude R (3, 3) at the moment the samples' times refer to, and body rate (3,) [rad/s]."""

    body_from_eci: Array
    rate_rad_s: Array
    mirrored: bool


def find_axis(w: Array, reference_eci_nt: Array) -> Array | None:
    """Unit spin axis (3,) in the body, its sign arbitrary; None where no direction stands out.

    Parameters
    ----------
    w: calibrated vectors (n, 3) [nT], one turn or more.
    reference_eci_nt: H (n, 3) [nT].
    """
    fitted = reference_eci_nt @ np.linalg.lstsq(reference_eci_nt, w, rcond=None)[0]
    rest = w - fitted
    values, vectors = np.linalg.eigh(rest.T @ rest)
    if values[0] * _AXIS_CONTRAST**2 > values[1]:
        return None
    axis: Array = vectors[:, 0]
    return axis


def rate_grid(lowest_rad_s: float, highest_rad_s: float, span_s: float) -> Array:
    """Trial rates [rad/s] dense enough that one is within a tenth of a turn over the span."""
    count = max(3, math.ceil((highest_rad_s - lowest_rad_s) * span_s) + 1)
    return np.linspace(lowest_rad_s, highest_rad_s, count)


def wahba_gains(samples: Samples, w: Array, axis: Array, rates_rad_s: Array) -> tuple[Array, Array]:
    """Gain (m, 2) of the best rotation and the best reflection, and the matrices (m, 3, 3), for each trial rate.

    The matrix is sum exp([n x] w t) w_k H_k', written as a constant, a cosine and a sine part so that all trial rates
    take two matrix products.
    """
    k = cross_matrix(axis)
    products = np.einsum("ni,nj->nij", w, samples.reference_eci_nt)
    along = np.outer(axis, axis) @ products.sum(axis=0)
    phase = rates_rad_s[:, None] * samples.times_s
    flat = products.reshape(len(w), 9)
    cos = (np.cos(phase) @ flat).reshape(-1, 3, 3)
    sin = (np.sin(phase) @ flat).reshape(-1, 3, 3)
    matrices = along - k @ k @ cos + k @ sin
    singular = np.linalg.svd(matrices, compute_uv=False)
    handed = np.where(np.linalg.det(matrices) < 0.0, -1.0, 1.0)
    both = singular[:, 0] + singular[:, 1]
    last = singular[:, 2] * handed
    return np.stack([both + last, both - last], axis=1), matrices


def best_rotation(matrix: Array) -> Array:
    """The proper rotation R (3, 3) with the largest trace(R' M)."""
    u, _, v = np.linalg.svd(matrix)
    rotation: Array = u @ np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(v)]) @ v
    return rotation


def find_spin(samples: Samples, x: Array, lowest_rad_s: float, highest_rad_s: float) -> list[SpinGuess]:
    """Rate and attitude from scratch: the best guess and its twin; none where the vectors show no axis.

    The twin: over a short stretch H moves on an arc in one plane.  Reflect the spin axis s in that plane, and H has the
    same component along it but moves about it the other way; a rate that differs by twice that motion makes up for it.
    Only a longer stretch tells the two apart.

    Parameters
    ----------
    samples: a turn or more, most of it within a small part of the orbit.
    x: a calibration that is right to some percent (9,).
    lowest_rad_s, highest_rad_s: where the rate is searched, both without sign; both senses of turn are tried.
    """
    samples = samples.thinned(_SEARCH_SAMPLES)
    w = calibrate(x, samples.field_nt)
    axis = find_axis(w, samples.reference_eci_nt)
    if axis is None:
        return []
    rates = rate_grid(lowest_rad_s, highest_rad_s, samples.span_s)
    best = _best_guess(samples, w, axis, np.concatenate([rates, -rates]))
    rate = float(axis @ best.rate_rad_s)
    close = rate + np.linspace(-1.0, 1.0, _FINE_RATES) / samples.span_s
    best = _best_guess(samples, w, axis, close)
    rate = float(axis @ best.rate_rad_s)
    motion = _motion_about(best.body_from_eci.T @ axis, samples)
    twin = _best_guess(samples, w, axis, np.array([rate - 2.0 * motion]))
    return [best, twin]


def _best_guess(samples: Samples, w: Array, axis: Array, rates_rad_s: Array) -> SpinGuess:
    gains, matrices = wahba_gains(samples, w, axis, rates_rad_s)
    best = int(np.argmax(gains[:, 0]))
    total = 0.5 * float((w**2).sum() + (samples.reference_eci_nt**2).sum())
    left_proper, left_mirrored = total - gains[:, 0].max(), total - gains[:, 1].max()
    mirrored = bool(left_mirrored < _MIRROR_MARGIN * left_proper)
    return SpinGuess(best_rotation(matrices[best]), axis * rates_rad_s[best], mirrored)


def _motion_about(axis_eci: Array, samples: Samples) -> float:
    """Mean rate at which H moves about an inertial axis [rad/s]."""
    first, second = across_axis(axis_eci)
    h = samples.reference_eci_nt
    azimuth = np.unwrap(np.arctan2(h @ second, h @ first))
    return float(np.polyfit(samples.times_s, azimuth, 1)[0])


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of the nine errors from elsewhere: x (9,) and covariance (9, 9)."""

    x: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class SpinFit:
    """A batch solution.

    Parameters
    ----------
    state: at the moment the samples' times refer to.
    residual_nt: y = (I + D) B - b - R H of every sample (n, 3) [nT].
    field_body_nt, attitudes: R H (n, 3) [nT] and R (n, 3, 3) of every sample.
    """

    state: SpinState
    residual_nt: Array
    field_body_nt: Array
    attitudes: Array


@dataclass(frozen=True, slots=True)
class AxisTie:
    """A body axis that the craft is known to turn about.

    Parameters
    ----------
    across: two unit vectors across it (2, 3).
    sigma_rad: how well it is known [rad], above 0.
    """

    across: Array
    sigma_rad: float

    def information(self, rate_rad_s: Array) -> Array:
        """Of the rate (3, 3) [(s/rad)^2]: its components across the axis are zero to within sigma times the rate."""
        weight = 1.0 / (self.sigma_rad**2 * float(rate_rad_s @ rate_rad_s))
        return weight * self.across.T @ self.across


def fit_spin(
    samples: Samples, start: SpinState, prior: Prior, noise_nt: float, tie: AxisTie | None = None
) -> SpinFit | None:
    """All fifteen states by Gauss-Newton from ``start``; None where it runs away or does not settle.

    Attitude and rate have no prior but the tie of the axis, where there is one.  The covariance is that of the samples
    and the prior with noise of ``noise_nt``.
    """
    state = SpinState(start.x, start.body_from_eci, start.rate_rad_s, start.covariance)
    information = np.zeros((SPIN_STATE_SIZE, SPIN_STATE_SIZE))
    information[ERRORS, ERRORS] = np.linalg.inv(prior.covariance)
    if tie is not None:
        information[RATE, RATE] = tie.information(start.rate_rad_s)
    for _ in range(_ITERATIONS):
        rows, fit = _linearise(samples, state)
        flat = rows.reshape(-1, SPIN_STATE_SIZE)
        normal = flat.T @ flat / noise_nt**2 + information
        gradient = flat.T @ fit.residual_nt.ravel() / noise_nt**2
        gradient[ERRORS] += information[ERRORS, ERRORS] @ (prior.x - state.x)
        gradient[RATE] -= information[RATE, RATE] @ state.rate_rad_s
        scale = np.sqrt(np.diagonal(normal))
        scaled = normal / np.outer(scale, scale)
        if float(np.linalg.eigvalsh(scaled)[0]) < 1e-13:
            return None
        step = np.linalg.solve(scaled, gradient / scale) / scale
        if float(step @ gradient) < _CONVERGED:
            state.covariance = np.linalg.inv(scaled) / np.outer(scale, scale)
            return fit
        step *= min(1.0, _LARGEST_TURN_RAD / max(_turn_of(step, state.rate_rad_s, samples.span_s), 1e-12))
        if np.abs(state.x + step[ERRORS])[D_ALL].max() > _LARGEST_D:
            return None
        state.correct(step)
    return None


def _turn_of(step: Array, rate_rad_s: Array, span_s: float) -> float:
    """How far a step turns the attitude of any sample [rad]: a rate across the axis tilts it, one along it adds up."""
    speed = max(float(np.linalg.norm(rate_rad_s)), 1e-12)
    along = abs(float(step[RATE] @ rate_rad_s)) / speed
    across = math.sqrt(max(float(step[RATE] @ step[RATE]) - along**2, 0.0))
    return max(float(np.abs(step[ATTITUDE]).max()), along * span_s, min(2.0 / speed, span_s) * across)


def _linearise(samples: Samples, state: SpinState) -> tuple[Array, SpinFit]:
    """Rows (n, 3, 15) of dB_pred / dstate times (I + D), and the residuals of a state."""
    rotations, integrals = turned(state.rate_rad_s, samples.times_s)
    attitudes = rotations @ state.body_from_eci
    h = np.einsum("nij,nj->ni", attitudes, samples.reference_eci_nt)
    predicted = np.linalg.solve(np.eye(3) + d_matrix(state.x), (h + state.x[BIAS]).T).T
    rows = np.empty((len(h), 3, SPIN_STATE_SIZE))
    rows[:, :, ERRORS] = -field_jacobian(predicted)
    turn = cross_matrix(h)
    rows[:, :, ATTITUDE] = turn @ rotations
    rows[:, :, RATE] = turn @ integrals
    return rows, SpinFit(state, calibrate(state.x, samples.field_nt) - h, h, attitudes)


def contradiction(state: SpinState, tie: AxisTie) -> float:
    """Squared norm of how far a free fit's rate points off a known axis; its expectation is 2 where it doesn't."""
    rate = state.rate_rad_s
    off = tie.across @ rate
    allowed = np.eye(2) * tie.sigma_rad**2 * float(rate @ rate)
    covariance = tie.across @ state.covariance[RATE, RATE] @ tie.across.T + allowed
    return float(off @ np.linalg.solve(covariance, off))
