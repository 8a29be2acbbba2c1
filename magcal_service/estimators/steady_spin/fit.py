"""The batch fit of ``spin``: all fifteen states by Gauss-Newton on the measured vectors.

Everything that has as many elements as there are samples has them as its last axis, and is worked through in pieces
that stay in the cache: a fit over five hours takes some ten milliseconds.

Source: equation (1) of Cetin, Soken, Tekinalp 2020 and ``spin_state``; the rest is original to this project.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.estimators.steady_spin.state import ATTITUDE, ERRORS, RATE, SPIN_STATE_SIZE, SpinState, cross_matrix
from magcal_service.model import BIAS, D_ALL, Array, d_matrix

_ITERATIONS: Final = 25
"""Most steps; None after that.

Choice: of some 1170 fits in the tests of the spin nine in ten settle within 6 steps, 10 do not in 25 and are given up;
the next attempt has more samples.
"""

_LARGEST_TURN_RAD: Final = 0.3
"""How far a step may turn the attitude of any sample: what linearising leaves out, half its square, is 4.5 % of |H|.

Choice: longer steps can land on the neighbouring rate, a whole turn off over the span; shorter ones take more of them.
"""

_LARGEST_D: Final = 2.0
"""Largest element of D on the way: as ``LARGEST_D`` of the batch start, a gain of three."""

_CONVERGED: Final = 1e-6
"""Squared length of a step, in sigmas, below which the fit is accepted: a thousandth of a sigma."""

_PIECE: Final = 4096
"""Samples worked through at a time: some forty arrays of 32 kB."""

_COLUMNS: Final = tuple(
    np.array([i, *d_columns, *range(ATTITUDE.start, RATE.stop), SPIN_STATE_SIZE])
    for i, d_columns in enumerate(((3, 6, 7), (6, 4, 8), (7, 8, 5)))
)
"""States that component i of a sample depends on: its bias, its row of D, the spin; last, the residual itself."""


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

    def period_s(self) -> float:
        """Median time between two samples [s]."""
        return float(np.median(np.diff(self.times_s))) if len(self.times_s) > 1 else 1.0

    @property
    def span_s(self) -> float:
        """Time from first to last [s]."""
        return float(self.times_s[-1] - self.times_s[0]) if len(self.times_s) else 0.0


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
    residual_eci_nt: the same turned into inertial axes, R'y (n, 3) [nT].
    field_body_nt: R H of every sample (n, 3) [nT].
    """

    state: SpinState
    residual_nt: Array
    residual_eci_nt: Array
    field_body_nt: Array


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
    pieces = _pieces(samples)
    information = np.zeros((SPIN_STATE_SIZE, SPIN_STATE_SIZE))
    information[ERRORS, ERRORS] = np.linalg.inv(prior.covariance)
    if tie is not None:
        information[RATE, RATE] = tie.information(start.rate_rad_s)
    for _ in range(_ITERATIONS):
        sums = np.zeros((SPIN_STATE_SIZE + 1, SPIN_STATE_SIZE + 1))
        for piece in pieces:
            sums += _Turned.of(state, *piece).sums()
        sums /= noise_nt**2
        normal = sums[:SPIN_STATE_SIZE, :SPIN_STATE_SIZE] + information
        gradient = sums[:SPIN_STATE_SIZE, SPIN_STATE_SIZE]
        gradient[ERRORS] += information[ERRORS, ERRORS] @ (prior.x - state.x)
        gradient[RATE] -= information[RATE, RATE] @ state.rate_rad_s
        scale = np.sqrt(np.diagonal(normal))
        scaled = normal / np.outer(scale, scale)
        if float(np.linalg.eigvalsh(scaled)[0]) < 1e-13:
            return None
        step = np.linalg.solve(scaled, gradient / scale) / scale
        if float(step @ gradient) < _CONVERGED:
            state.covariance = np.linalg.inv(scaled) / np.outer(scale, scale)
            return _fit_of(state, pieces)
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


def _pieces(samples: Samples) -> list[tuple[Array, Array, Array]]:
    """Times (m,), B (3, m) and H (3, m), piece by piece."""
    field, reference = np.ascontiguousarray(samples.field_nt.T), np.ascontiguousarray(samples.reference_eci_nt.T)
    times = np.ascontiguousarray(samples.times_s)
    bounds = [slice(first, first + _PIECE) for first in range(0, len(times), _PIECE)]
    return [(times[part], field[:, part], reference[:, part]) for part in bounds]


def _fit_of(state: SpinState, pieces: list[tuple[Array, Array, Array]]) -> SpinFit:
    turned = [_Turned.of(state, *piece) for piece in pieces]
    return SpinFit(
        state=state,
        residual_nt=np.concatenate([each.residual_nt.T for each in turned]),
        residual_eci_nt=np.concatenate([each.residual_eci_nt(state.body_from_eci).T for each in turned]),
        field_body_nt=np.concatenate([each.field_nt.T for each in turned]),
    )


@dataclass(frozen=True, slots=True)
class _Turned:
    """Samples as a state predicts them.

    Parameters
    ----------
    turns: exp(-[w t x]) and its integral over t, by row and column (2, 3, 3, m); ``spin_state.turned``.
    field_nt: R H (3, m) [nT].
    predicted_nt: the measured vector (3, m) [nT].
    residual_nt: y (3, m) [nT].
    """

    turns: Array
    field_nt: Array
    predicted_nt: Array
    residual_nt: Array

    @classmethod
    def of(cls, state: SpinState, times_s: Array, measured_nt: Array, reference_eci_nt: Array) -> _Turned:
        """Of times before the state's (m,), B (3, m) and H (3, m)."""
        speed = max(math.sqrt(float(state.rate_rad_s @ state.rate_rad_s)), 1e-12)
        k = cross_matrix(state.rate_rad_s / speed)
        phase = speed * times_s
        sin, half = np.sin(phase), np.sin(0.5 * phase)
        versine = 2.0 * half * half
        lag = np.where(np.abs(phase) < 1e-4, phase * phase * phase / 6.0, phase - sin)  # without cancellation
        shapes = np.stack([np.eye(3).ravel(), -k.ravel(), (k @ k).ravel()], axis=1)  # (9, 3)
        parts = np.stack([[np.ones_like(phase), sin, versine], [times_s, versine / speed, lag / speed]])
        turns = (shapes @ parts).reshape(2, 3, 3, -1)
        at_rest = state.body_from_eci @ reference_eci_nt
        field = turns[0, :, 0] * at_rest[0] + turns[0, :, 1] * at_rest[1] + turns[0, :, 2] * at_rest[2]
        matrix, bias = np.eye(3) + d_matrix(state.x), state.x[BIAS, None]
        predicted = np.linalg.inv(matrix) @ (field + bias)
        return cls(turns, field, predicted, matrix @ measured_nt - bias - field)

    def sums(self) -> Array:
        """Sums (16, 16) of products of dy/dstate and, in the last row and column, of y."""
        h1, h2, h3 = self.field_nt
        first, second, third = self.turns[:, 0], self.turns[:, 1], self.turns[:, 2]  # rows (2, 3, m)
        rows = np.empty((3, 11, len(h1)))
        rows[:, 0], rows[:, 1:4], rows[:, 10] = 1.0, -self.predicted_nt, self.residual_nt
        spin = rows[:, 4:10].reshape(3, 2, 3, -1)  # [R H x] times both turns
        np.subtract(h2 * third, h3 * second, out=spin[0])
        np.subtract(h3 * first, h1 * third, out=spin[1])
        np.subtract(h1 * second, h2 * first, out=spin[2])
        total = np.zeros((SPIN_STATE_SIZE + 1, SPIN_STATE_SIZE + 1))
        for columns, part in zip(_COLUMNS, rows, strict=True):
            total[np.ix_(columns, columns)] += part @ part.T
        return total

    def residual_eci_nt(self, body_from_eci: Array) -> Array:
        """R'y (3, m) [nT]."""
        y = self.residual_nt
        at_rest = self.turns[0, 0] * y[0] + self.turns[0, 1] * y[1] + self.turns[0, 2] * y[2]
        inertial: Array = body_from_eci.T @ at_rest
        return inertial


def contradiction(state: SpinState, tie: AxisTie) -> float:
    """Squared norm of how far a free fit's rate points off a known axis; its expectation is 2 where it doesn't."""
    rate = state.rate_rad_s
    off = tie.across @ rate
    allowed = np.eye(2) * tie.sigma_rad**2 * float(rate @ rate)
    covariance = tie.across @ state.covariance[RATE, RATE] @ tie.across.T + allowed
    return float(off @ np.linalg.solve(covariance, off))
