"""Nine errors, and the amplitudes of known fields, by damped least squares on the magnitude of a few hundred samples.

    e = |(I + D)(B - sum_k y_k g_k) - b| - |H|

with g_k a field in the sensor's axes of which only the amplitude is unknown.  Outliers are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.model import STATE_SIZE, Array, calibrate, d_matrix, field_jacobian, scalar_residual

_STEPS: Final = 12
"""Of a fit, at most; from the fit of a moment before two or three are taken."""

_ARRIVED: Final = 0.01
"""Change of the residual's rms in a step that is no progress any more, in parts of its standard error."""

_FAR: Final = 6.0
"""Sigmas beyond which a sample is an outlier of the sensor."""

_UNIT: Final = np.array([30_000.0] * 3 + [1.0] * 6)
"""Of the nine errors in the fit: columns of one size."""


@dataclass(frozen=True, slots=True, eq=False)
class MagnitudeFit:
    """The result of ``magnitude_fit``.

    Parameters
    ----------
    x: nine errors (9,).
    amplitudes, covariance: y (k,) and its covariance (k, k), the nine errors unknown beside it.
    x_covariance: of the nine errors (9, 9), the amplitudes being what they were found to be.
    residual_nt: e (n,) of every sample [nT].
    sigma_nt: of most of them.
    """

    x: Array
    amplitudes: Array
    covariance: Array
    x_covariance: Array
    residual_nt: Array
    sigma_nt: float


def usual(residual_nt: Array) -> float:
    """1 sigma of most residuals (n,) [nT]."""
    return max(float(np.median(np.abs(residual_nt))) / 0.6745, 1e-6)


def are_near(residual_nt: Array) -> Array:
    """Which residuals (n,) are no outliers."""
    return np.asarray(np.abs(residual_nt) < _FAR * usual(residual_nt))


def magnitude_fit(
    x: Array,
    field_nt: Array,
    magnitude_nt: Array,
    fields_nt: Array | None = None,
    prior: float = 1.0,
    known: Array | None = None,
) -> MagnitudeFit:
    """Fit from x (9,) on.

    Parameters
    ----------
    field_nt, magnitude_nt: B (n, 3) and |H| (n,) [nT].
    fields_nt: g (n, k, 3) [nT per unit]; None: the nine errors alone.
    prior: 1 sigma of each amplitude about zero.
    known: 1 sigma of each of the nine errors about x (9,); None: nothing is known of them.
    """
    g = np.zeros((len(field_nt), 0, 3)) if fields_nt is None else fields_nt
    first = np.concatenate([x, np.zeros(g.shape[1])])
    state, unit = first, np.concatenate([_UNIT, np.ones(g.shape[1])])
    of_x = np.zeros(STATE_SIZE) if known is None else known**-2.0
    ties = np.concatenate([of_x, np.full(g.shape[1], prior**-2.0)])
    damping, residual = 1e-3, _residual(state, field_nt, magnitude_nt, g)
    near = are_near(residual)
    for _ in range(_STEPS):
        weighed = _remembered(residual) * ties  # samples that remember one another are worth so much less
        normal, right = _equations(state, first, field_nt[near], residual[near], g[near], unit, weighed)
        damped = normal + damping * np.trace(normal) / len(normal) * np.eye(len(normal))
        step = -np.linalg.solve(damped, right) * unit
        tried = _residual(state + step, field_nt, magnitude_nt, g)
        before, after = (
            _cost(at - first, one[near], weighed) for at, one in ((state, residual), (state + step, tried))
        )
        if not after < before:
            damping *= 10.0
            continue
        state, residual, damping = state + step, tried, 0.1 * damping
        near = are_near(residual)
        if before - after < _ARRIVED * before / math.sqrt(len(residual)):
            break
    weight = _remembered(residual)
    normal, _ = _equations(state, first, field_nt[near], residual[near], g[near], unit, weight * ties)
    sigma_nt = float(np.sqrt(np.mean(residual[near] ** 2)))
    variance = sigma_nt**2 * weight
    covariance = variance * np.linalg.pinv(normal)[STATE_SIZE:, STATE_SIZE:]
    of_errors = variance * np.outer(_UNIT, _UNIT) * np.linalg.pinv(normal[:STATE_SIZE, :STATE_SIZE])
    return MagnitudeFit(state[:STATE_SIZE], state[STATE_SIZE:], covariance, of_errors, residual, sigma_nt)


def _cost(moved: Array, residual_nt: Array, ties: Array) -> float:
    """Mean square, what ties the unknowns counted in units of it."""
    square = float(np.mean(residual_nt**2))
    return square * (1.0 + float(ties @ moved**2) / len(residual_nt))


def _remembered(residual_nt: Array) -> float:
    """By how much a residual (n,) with a memory raises variances: (1 + r) / (1 - r), r from sample to sample."""
    moved = residual_nt[np.abs(residual_nt) < _FAR * usual(residual_nt)]
    r = float(moved[1:] @ moved[:-1]) / max(float(moved @ moved), 1e-12)
    return (1.0 + min(max(r, 0.0), 0.95)) / (1.0 - min(max(r, 0.0), 0.95))


def _residual(state: Array, field_nt: Array, magnitude_nt: Array, g: Array) -> Array:
    left = field_nt - np.einsum("nki,k->ni", g, state[STATE_SIZE:])
    return scalar_residual(state[:STATE_SIZE], left, magnitude_nt)


def _equations(
    state: Array, first: Array, field_nt: Array, residual_nt: Array, g: Array, unit: Array, ties: Array
) -> tuple[Array, Array]:
    """Normal matrix and right side of a step in ``unit``, tied to the first state by inverse variances (9 + k,)."""
    x, y = state[:STATE_SIZE], state[STATE_SIZE:]
    left = field_nt - np.einsum("nki,k->ni", g, y)
    w = calibrate(x, left)
    along = w / np.linalg.norm(w, axis=1)[:, None]
    of_errors = np.einsum("ni,nij->nj", along, field_jacobian(left))
    of_fields = -np.einsum("ni,nki->nk", along + along @ d_matrix(x), g)
    columns = np.hstack([of_errors, of_fields]) * unit
    weights = float(np.mean(residual_nt**2)) * ties
    normal = columns.T @ columns + np.diag(weights * unit**2)
    right = columns.T @ residual_nt + weights * unit * (state - first)
    return normal, right
