"""Finding the spin from calibrated vectors: axis, rate and attitude without a first guess of any of them.

Two steps, each the starting point of the next, and of the fit of all fifteen states (``spin_fit``):

1. Axis.  While the craft turns about a body axis n that points along s in space, n'w = s'H at every sample.  Linear in
   both: project the columns of H out of the vectors w, and n is the direction in which least is left.
2. Rate and attitude.  Turned back by a trial rate, the vectors are those of a craft at rest, w -> R H with one R: the
   problem of Wahba, whose gain is the sum of the singular values of one 3x3 matrix.  The rate is searched on a grid,
   with R proper.  When an improper R (a reflection) fits much better, the calibration is mirrored.

Source: Wahba 1965 and Markley 1988 for step 2; the rest is original to this project.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.estimators.parts.spin_window import across_axis
from magcal_service.estimators.steady_spin.fit import Samples
from magcal_service.estimators.steady_spin.state import cross_matrix
from magcal_service.model import Array, calibrate

_SEARCH_SAMPLES: Final = 512
"""Samples used by the search for the rate; more only cost time."""

_AXIS_CONTRAST: Final = 2.0
"""Residual across the axis over that along it; a craft that does not turn about an axis has about 1."""

_FOLLOWED: Final = 3
"""Samples that nine numbers from H to B follow exactly whatever the axis is: of so few, none stands out."""

_MIRROR_MARGIN: Final = 0.5
"""A reflection that leaves less than this share of what a rotation leaves means a mirrored calibration."""

_FINE_RATES: Final = 21
"""Rates of the second grid, one step of the first to either side: a tenth of a radian over the span apart.

The fit that follows starts within 0.05 rad of the best of them, a sixth of the turn it may make in a step.
"""


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
    """Rate and attitude from scratch: the best guess and its twin; none where the vectors are few or show no axis.

    The twin: over a short stretch H moves on an arc in one plane.  Reflect the spin axis s in that plane, and H has the
    same component along it but moves about it the other way; a rate that differs by twice that motion makes up for it.
    Only a longer stretch distinguishes the two.

    Parameters
    ----------
    samples: a turn or more, most of it within a small part of the orbit.
    x: a calibration that is right to some percent (9,).
    lowest_rad_s, highest_rad_s: where the rate is searched, both without sign; both senses of turn are tried.
    """
    if len(samples.times_s) <= _FOLLOWED:
        return []
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
