"""Running sums of what hazards would do to the residual and to the estimate; protection levels follow from them.

One sample of each tick since the filter's start, its start included, gives the residual e = |(I + D) B - b| - |H|, its
nine sensitivities J, and a column for each amplitude of a hazard.  Two things follow:

- what is seen: sums of products of all columns, from which the nine errors are fitted anew at each look;
- what the filter makes of it.  With A the inverse of its covariance, the response R (9, k) to unit amplitudes goes as

      A_new R_new = A_old R_old + sum(J' X) / s^2 + (what else was learned, such as spin windows) f,

  where f are the amplitudes where they are errors of the sensor that change with time, 0 where the reference is wrong.

Units: D is scaled by 5e4 nT, so that every sensitivity has a size near one.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from magcal_service.model import BIAS, STATE_SIZE, Array, calibrate, field_jacobian, without_radial_noise

FAR_NT: Final = 5e4
"""A strong field [nT]: the unit of D's sensitivities."""

UNIT: Final = np.r_[np.ones(3), np.full(6, 1.0 / FAR_NT)]
"""The nine errors [nT, -] of one unit each."""

ORBIT_S: Final = 5700.0
"""Period of what goes with the orbit [s]: 95 min; a low orbit has 90 to 100."""

DRIFT_S: Final = 1e4
"""Unit of time of a drift [s]."""

LATE: Final = 9  # column of a reference that is late by a second: its slope [nT/s]
SCALED: Final = 10  # of a reference that is wrong by its own size [nT]
DRIFT: Final = (11, 12, 13)  # of each bias that grows with time
ORBIT_BIAS: Final = (14, 15, 16, 20, 21, 22)  # of each bias that follows the orbit, by cos and sin
ORBIT_GAIN: Final = (17, 18, 19, 23, 24, 25)  # of each axis' gain that does
PANEL: Final = (26, 27, 28, 29, 30, 31)  # of each bias that follows the spin
RESIDUAL: Final = 32  # the last column
COLUMNS: Final = 33  # nine sensitivities, 23 of hazards, the residual

STEADY: Final = 6
"""Of the errors that may step: the biases and the scale factors."""


def leave_out(columns: Array, gate_nt: float) -> int:
    """Empty the rows of columns (n, 33) that the filter's gate [nT] stops, in place; how many are left."""
    far = np.abs(columns[:, RESIDUAL]) > gate_nt
    columns[far] = 0.0
    return len(columns) - int(np.count_nonzero(far))


def courses(times_s: Array, spin_rad_s: float) -> Array:
    """How amplitudes of the hazards with a course go with time: drift, cos and sin of orbit, of spin (n, 5)."""
    orbit, spin = (2.0 * math.pi / ORBIT_S) * times_s, spin_rad_s * times_s
    course = np.stack([times_s / DRIFT_S, np.cos(orbit), np.sin(orbit), np.cos(spin), np.sin(spin)], axis=-1)
    return course if spin_rad_s else course * np.array([1.0, 1.0, 1.0, 0.0, 0.0])


def errors_of(course: Array) -> Array:
    """The errors (..., 9, 23) of unit amplitudes of the columns 9 to 31 at times whose courses are (..., 5)."""
    errors = np.zeros((*course.shape[:-1], STATE_SIZE, RESIDUAL - STATE_SIZE))
    for first, part, size in ((11, 0, 3), (14, 1, STEADY), (20, 2, STEADY), (26, 3, 3), (29, 4, 3)):
        rows = np.arange(size)
        errors[..., rows, first - STATE_SIZE + rows] = course[..., part, None]
    return errors


def columns_of(rows: Array, x: Array, noise_nt: float, spin_rad_s: float) -> Array:
    """Columns (n, 33) of samples: sensitivities, those of the hazards, the residual.

    Parameters
    ----------
    rows: time [s], B and |H| [nT] of each sample (n, 5).
    x: the nine errors at which it is linear.
    noise_nt: of the sensor, per axis: noise across the field makes vectors longer by s^2 / |H|.
    spin_rad_s: the spin's rate; 0: none.
    """
    times_s, field, magnitude = rows[:, 0], rows[:, 1:4], rows[:, 4]
    w_hat, b_hat = without_radial_noise(x, field, magnitude)
    unit = w_hat / np.maximum(magnitude, 1.0)[:, None]
    sensitivity = np.einsum("ni,nij->nj", unit, field_jacobian(b_hat)) * UNIT
    length = np.sqrt((calibrate(x, field) ** 2).sum(axis=1))
    residual = length - magnitude - noise_nt**2 / np.maximum(magnitude, 1.0)
    slope = np.gradient(magnitude, np.maximum.accumulate(times_s + 1e-6 * np.arange(len(rows))))
    drift, orbit_cos, orbit_sin, spin_cos, spin_sin = courses(times_s, spin_rad_s).T[:, :, None]
    bias, steady = sensitivity[:, BIAS], sensitivity[:, :STEADY]
    driven = [bias * drift, steady * orbit_cos, steady * orbit_sin, bias * spin_cos, bias * spin_sin]
    return np.column_stack([sensitivity, slope, magnitude, *driven, residual])


def steps_seen(blocks: Array) -> tuple[Array, Array]:
    """What is left of steps at the beginning of each block but the first once the nine errors are fitted.

    Parameters
    ----------
    blocks: sums of products of sensitivities and residual (m, 10, 10).

    Returns
    -------
    Squares and products of the six errors that may step (m - 1, 6, 6), and theirs with the residual (m - 1, 6).
    """
    since = np.cumsum(blocks[::-1], axis=0)[::-1]
    total, later = since[0], since[1:]
    fitted = np.linalg.solve(total[:STATE_SIZE, :STATE_SIZE], later[:, :STATE_SIZE, :STEADY])
    residual = np.linalg.solve(total[:STATE_SIZE, :STATE_SIZE], total[:STATE_SIZE, STATE_SIZE])
    squares = later[:, :STEADY, :STEADY] - later[:, :STEADY, :STATE_SIZE] @ fitted
    return squares, later[:, :STEADY, STATE_SIZE] - later[:, :STEADY, :STATE_SIZE] @ residual


def gains(squares: Array, products: Array, residual_square: float, samples: int) -> Array:
    """Gain of log likelihood by each group of columns (h, k, k), whose products with the residual are (h, k) [nats]."""
    safe = (
        squares
        + 1e-9 * np.trace(squares, axis1=-2, axis2=-1)[:, None, None] * np.eye(squares.shape[-1])
        + 1e-30 * (np.eye(squares.shape[-1]))
    )
    explained = np.einsum("hk,hk->h", products, np.linalg.solve(safe, products[..., None])[..., 0])
    share = np.clip(explained / max(residual_square, 1e-300), 0.0, 1.0 - 1e-12)
    gain: Array = -0.5 * samples * np.log1p(-share)
    return gain
