"""``SpinState`` of many runs at once, with the runs as the last axis of every array.

The arithmetic is that of ``spin_state``, number by number; a number there is a row of runs here.

Source: as ``spin_state``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_service.estimators.steady_spin.state import ATTITUDE, ERRORS, RATE, SPIN, SPIN_STATE_SIZE, SpinState
from magcal_service.model import STATE_SIZE, Array
from magcal_service.studies.batched.unscented import Vectors


@dataclass(frozen=True, slots=True)
class SpinInnovations:
    """``spin_state.Innovation`` of many runs.

    Parameters
    ----------
    value: y = (I + D) B - b - R H (3, r) [nT].
    field_body_nt: R H (3, r) [nT].
    covariance, inverse: S of y, and its inverse (3, 3, r).
    cross: covariance of the state with it (15, 3, r).
    weighted: S^-1 y (3, r).
    """

    value: Array
    field_body_nt: Array
    covariance: Array
    inverse: Array
    cross: Array
    weighted: Array

    def squared_norm(self) -> Array:
        """Normalised innovation squared (r,); its expectation is 3."""
        norm: Array = (self.value * self.weighted).sum(axis=0)
        return norm


class SpinStates:
    """The filters of many runs; those in progress fill the first columns.

    Parameters
    ----------
    runs: how many there may be.

    Attributes
    ----------
    x: nine errors (9, runs).
    body_from_eci: R (3, 3, runs).
    rate_rad_s: (3, runs).
    covariance: (15, 15, runs).
    """

    def __init__(self, runs: int) -> None:
        self.x = np.zeros((STATE_SIZE, runs))
        self.body_from_eci = np.zeros((3, 3, runs))
        self.rate_rad_s = np.zeros((3, runs))
        self.covariance = np.zeros((SPIN_STATE_SIZE, SPIN_STATE_SIZE, runs))
        self._scratch = np.empty_like(self.covariance)

    def put(self, column: int, state: SpinState) -> None:
        """Set one run's state."""
        self.x[:, column], self.rate_rad_s[:, column] = state.x, state.rate_rad_s
        self.body_from_eci[:, :, column], self.covariance[:, :, column] = state.body_from_eci, state.covariance

    def get(self, column: int) -> SpinState:
        """One run's state."""
        return SpinState(
            self.x[:, column].copy(),
            self.body_from_eci[:, :, column].copy(),
            self.rate_rad_s[:, column].copy(),
            self.covariance[:, :, column].copy(),
        )

    def predict(self, count: int, seconds: float) -> None:
        """``SpinState.predict`` without process noise for the first ``count`` columns."""
        both = _turned(self.rate_rad_s[:, :count], seconds)  # (3, 6, r)
        attitude = np.einsum("abr,bcr->acr", both[:, :3], self.body_from_eci[:, :, :count])
        square = np.einsum("abr,cbr->acr", attitude, attitude)
        self.body_from_eci[:, :, :count] = 1.5 * attitude - 0.5 * np.einsum("abr,bcr->acr", square, attitude)
        covariance = self.covariance[:, :, :count]
        rows = np.einsum("abr,bjr->ajr", both, covariance[SPIN])  # of the attitude, in the turned axes (3, 15, r)
        covariance[ATTITUDE, ATTITUDE] = np.einsum("aer,ber->abr", rows[:, SPIN], both)
        for others in (ERRORS, RATE):
            covariance[ATTITUDE, others] = rows[:, others]
            covariance[others, ATTITUDE] = rows[:, others].transpose(1, 0, 2)

    def innovations(
        self, count: int, field_nt: Array, reference_eci_nt: Array, noise_variance: float
    ) -> SpinInnovations:
        """``SpinState.innovation`` for measured vectors (3, r) and one reference H (3,) [nT]."""
        x, covariance = self.x[:, :count], self.covariance[:, :, :count]
        field = np.einsum("abr,b->ar", self.body_from_eci[:, :, :count], reference_eci_nt)
        vectors = Vectors.of(x, field_nt)
        predicted = np.stack(vectors.measured(tuple(field + x[:3])))
        cross = np.stack(_projected(covariance, field, predicted), axis=1)  # P G' (15, 3, r)
        inner = np.stack(_projected(cross, field, predicted), axis=1)  # G P G' (3, 3, r)
        for i in range(3):
            inner[i, i] += noise_variance
        value = np.stack(vectors.w) - field
        inverse = _inverse(inner)
        return SpinInnovations(value, field, inner, inverse, cross, np.einsum("abr,br->ar", inverse, value))

    def apply(self, innovations: SpinInnovations, used: Array) -> None:
        """Take innovations in, of the first runs; ``used`` (r,) says which, by one and zero."""
        count = len(used)
        cross = innovations.cross
        step = np.einsum("iar,ar->ir", cross, innovations.weighted * used)
        self.x[:, :count] += step[ERRORS]
        turn = _turned(step[ATTITUDE], 1.0)[:, :3]
        self.body_from_eci[:, :, :count] = np.einsum("abr,bcr->acr", turn, self.body_from_eci[:, :, :count])
        self.rate_rad_s[:, :count] += step[RATE]
        gain = np.einsum("iar,abr->ibr", cross, innovations.inverse * used)
        covariance, scratch = self.covariance[:, :, :count], self._scratch[:, :, :count]
        for i in range(3):
            covariance -= np.multiply(gain[:, None, i], cross[None, :, i], out=scratch)


def _turned(rate: Array, seconds: float) -> Array:
    """``spin_state.turned_once`` for rates (3, r): turn and integral side by side (3, 6, r)."""
    speed = np.maximum(np.sqrt(rate[0] * rate[0] + rate[1] * rate[1] + rate[2] * rate[2]), 1e-12)
    k = rate / speed
    phase = speed * seconds
    sin, half = np.sin(phase), np.sin(0.5 * phase)
    versine = 2.0 * half * half
    lag = np.where(np.abs(phase) < 1e-4, phase * phase * phase / 6.0, phase - sin)
    both = np.empty((3, 6, len(speed)))
    for first, one, odd, even in ((0, 1.0, sin, versine), (3, seconds, versine / speed, lag / speed)):
        o1, o2, o3 = odd * k
        e1, e2, e3 = even * k
        e12, e13, e23 = e1 * k[1], e1 * k[2], e2 * k[2]
        c = one - even
        both[0, first], both[0, first + 1], both[0, first + 2] = c + e1 * k[0], e12 + o3, e13 - o2
        both[1, first], both[1, first + 1], both[1, first + 2] = e12 - o3, c + e2 * k[1], e23 + o1
        both[2, first], both[2, first + 1], both[2, first + 2] = e13 + o2, e23 - o1, c + e3 * k[2]
    return both


def _projected(rows: Array, field: Array, predicted: Array) -> tuple[Array, Array, Array]:
    """G times rows (15, ..., r), component by component, with G of ``SpinState.jacobian``.

    ``rows`` is symmetric, or holds the state along its first axis.
    """
    h1, h2, h3 = field
    p1, p2, p3 = predicted
    first = rows[0] - p1 * rows[3]
    first -= p2 * rows[6]
    first -= p3 * rows[7]
    first -= h3 * rows[10]
    first += h2 * rows[11]
    second = rows[1] - p2 * rows[4]
    second -= p1 * rows[6]
    second -= p3 * rows[8]
    second += h3 * rows[9]
    second -= h1 * rows[11]
    third = rows[2] - p3 * rows[5]
    third -= p1 * rows[7]
    third -= p2 * rows[8]
    third -= h2 * rows[9]
    third += h1 * rows[10]
    return first, second, third


def _inverse(matrices: Array) -> Array:
    """Inverses of symmetric matrices (3, 3, r)."""
    (a, b, c), (_, d, e), (_, _, f) = matrices
    c11, c12, c13 = d * f - e * e, c * e - b * f, b * e - c * d
    c22, c23, c33 = a * f - c * c, b * c - a * e, a * d - b * b
    inverse: Array = np.stack([c11, c12, c13, c12, c22, c23, c13, c23, c33]).reshape(3, 3, -1)
    inverse /= a * c11 + b * c12 + c * c13
    return inverse
