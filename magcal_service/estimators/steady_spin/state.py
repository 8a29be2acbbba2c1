"""The state of the ``spin`` estimator: nine sensor errors, attitude and body rate of a craft that turns steadily.

The attitude R (inertial -> body) turns at a body rate w that is constant while no torque acts: R(t + s) = exp(-[w s x])
R(t), so the spin axis may point anywhere in the body.  The fifteen error states are

    [b, D] (9),  theta (3): R_true = (I - [theta x]) R,  dw (3): w_true = w + dw

The measured vector is predicted from the noise-free reference, B = (I + D)^-1 (R H + b), equation (1), and the
innovation is taken times (I + D), which makes its noise isotropic:

    y = (I + D) (B - B_pred) = (I + D) B - b - R H,    G = dB_pred/dstate = [-J(B_pred), [R H x], 0]

J is evaluated at the *predicted* vector.  At the measured one it would hold the noise that y holds too, and their
product would bias D (errors in variables).

Source: Cetin, Soken, Tekinalp 2020, equation (1); Lefferts, Markley & Shuster 1982 for the attitude error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.model import BIAS, STATE_SIZE, Array, d_matrix

SPIN_STATE_SIZE: Final = 15
"""The nine errors, three of the attitude, three of the rate: the slices below."""

ERRORS: Final = slice(0, STATE_SIZE)  # b [nT], D [-]
ATTITUDE: Final = slice(9, 12)  # theta [rad]
RATE: Final = slice(12, 15)  # dw [rad/s]
SPIN: Final = slice(9, 15)

_IDENTITY: Final = np.eye(3)
_IDENTITY_15: Final = np.eye(SPIN_STATE_SIZE)
_DIAGONAL_15: Final = np.diag_indices(SPIN_STATE_SIZE)


def cross_matrix(vectors: Array) -> Array:
    """[v x] (..., 3, 3) of vectors (..., 3): [v x] u = v x u."""
    matrix = np.zeros((*vectors.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -vectors[..., 2], vectors[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 2] = vectors[..., 2], -vectors[..., 0]
    matrix[..., 2, 0], matrix[..., 2, 1] = -vectors[..., 1], vectors[..., 0]
    return matrix


def turned(rate_rad_s: Array, seconds: Array | float) -> tuple[Array, Array]:
    """exp(-[w t x]) [-] and its integral from 0 to t [s], each (..., 3, 3), for a rate w (3,) [rad/s] and t (...) [s].

    The first carries vectors into axes that have turned by w t meanwhile, the second an error of the rate into one of
    the attitude: theta(t) = exp(-[w t x]) theta(0) + integral dw.
    """
    t = np.asarray(seconds, dtype=np.float64)
    speed = max(math.sqrt(float(rate_rad_s @ rate_rad_s)), 1e-12)
    k = cross_matrix(rate_rad_s / speed)
    square = k @ k
    phase = (speed * t)[..., None, None]
    sin, versine = np.sin(phase), 2.0 * np.sin(0.5 * phase) ** 2
    rotation = _IDENTITY - sin * k + versine * square
    lag = np.where(np.abs(phase) < 1e-4, phase**3 / 6.0, phase - sin)  # without cancellation
    integral = t[..., None, None] * _IDENTITY - (versine * k - lag * square) / speed
    return rotation, integral


def turned_once(rate_rad_s: Array, seconds: float) -> tuple[Array, Array]:
    """``turned`` for one time, in plain floats: it is the hot path."""
    r1, r2, r3 = rate_rad_s.tolist()
    speed = max(math.sqrt(r1 * r1 + r2 * r2 + r3 * r3), 1e-12)
    k1, k2, k3 = r1 / speed, r2 / speed, r3 / speed
    phase = speed * seconds
    sin, versine = math.sin(phase), 2.0 * math.sin(0.5 * phase) ** 2
    lag = phase**3 / 6.0 if abs(phase) < 1e-4 else phase - sin
    return _about(k1, k2, k3, 1.0, sin, versine), _about(k1, k2, k3, seconds, versine / speed, lag / speed)


def _about(k1: float, k2: float, k3: float, one: float, odd: float, even: float) -> Array:
    """one I - odd [k x] + even [k x]^2 for a unit vector k, as rows."""
    c = one - even
    o1, o2, o3 = odd * k1, odd * k2, odd * k3
    e12, e13, e23 = even * k1 * k2, even * k1 * k3, even * k2 * k3
    return np.array(
        (
            (c + even * k1 * k1, e12 + o3, e13 - o2),
            (e12 - o3, c + even * k2 * k2, e23 + o1),
            (e13 + o2, e23 - o1, c + even * k3 * k3),
        )
    )


@dataclass(slots=True)
class Innovation:
    """A vector update before it is applied.

    Parameters
    ----------
    value: y = (I + D) B - b - R H (3,) [nT].
    field_body_nt: R H (3,) [nT].
    covariance: S of y (3, 3) [nT^2].
    cross: covariance of the state with it (15, 3).
    weighted: S^-1 y (3,).
    """

    value: Array
    field_body_nt: Array
    covariance: Array
    cross: Array
    weighted: Array

    def squared_norm(self) -> float:
        """Normalised innovation squared, y' S^-1 y; its expectation is 3."""
        return float(self.value @ self.weighted)


@dataclass(init=False, repr=False, eq=False)
class SpinStateMemory:
    """What of ``SpinState`` outlives a restart, saved and restored whole."""

    x: Array
    body_from_eci: Array
    rate_rad_s: Array
    covariance: Array


class SpinState(Stateful, SpinStateMemory):
    """The fifteen-state extended filter itself: predict, innovation, apply.

    Parameters
    ----------
    x: nine errors (9,) [nT, -].
    body_from_eci: attitude R (3, 3).
    rate_rad_s: body rate (3,) [rad/s].
    covariance: of the fifteen error states (15, 15).
    """

    def __init__(self, x: Array, body_from_eci: Array, rate_rad_s: Array, covariance: Array) -> None:
        self.x = x
        self.body_from_eci = body_from_eci
        self.rate_rad_s = rate_rad_s
        self.covariance = covariance

    def predict(self, seconds: float, error_walk: Array | None, rate_walk: float) -> None:
        """Turn on for a time [s]; a negative time turns back, without process noise.

        Parameters
        ----------
        error_walk: variance that the nine errors gain per second (9,), or None for constant errors.
        rate_walk: random walk of each component of the body rate [rad/s/sqrt(s)].
        """
        rotation, integral = turned_once(self.rate_rad_s, seconds)
        attitude = rotation @ self.body_from_eci
        self.body_from_eci = 1.5 * attitude - 0.5 * attitude @ attitude.T @ attitude  # rounding must not build up
        transition = _IDENTITY_15.copy()
        transition[ATTITUDE, ATTITUDE], transition[ATTITUDE, RATE] = rotation, integral
        covariance = transition @ self.covariance @ transition.T
        if seconds > 0.0 and (error_walk is not None or rate_walk):
            covariance[_DIAGONAL_15] += walk_variance(seconds, error_walk, rate_walk)
        self.covariance = covariance

    def innovation(self, field_nt: Array, reference_eci_nt: Array, noise_variance: float) -> Innovation:
        """What a sample says that the state did not know.

        Parameters
        ----------
        field_nt: measured vector B (3,) [nT].
        reference_eci_nt: H (3,) [nT].
        noise_variance: s^2 per axis [nT^2].
        """
        jacobian, value, field_body_nt = self._linearised(field_nt, reference_eci_nt)
        cross = self.covariance @ jacobian.T
        covariance = jacobian @ cross
        covariance[(0, 1, 2), (0, 1, 2)] += noise_variance
        return Innovation(value, field_body_nt, covariance, cross, np.linalg.solve(covariance, value))

    def jacobian(self, reference_eci_nt: Array) -> Array:
        """G (3, 15): (I + D) dB_pred / dstate at a reference H (3,) [nT]."""
        return self._linearised(np.zeros(3), reference_eci_nt)[0]

    def _linearised(self, field_nt: Array, reference_eci_nt: Array) -> tuple[Array, Array, Array]:
        """G (3, 15), y (3,) and R H (3,); in plain floats where vectors have three elements: it is the hot path."""
        x = self.x
        h = self.body_from_eci @ reference_eci_nt
        matrix = _IDENTITY + d_matrix(x)
        h1, h2, h3 = h.tolist()
        p1, p2, p3 = np.linalg.solve(matrix, h + x[BIAS]).tolist()
        jacobian = np.array(
            (
                (1.0, 0.0, 0.0, -p1, 0.0, 0.0, -p2, -p3, 0.0, 0.0, -h3, h2, 0.0, 0.0, 0.0),
                (0.0, 1.0, 0.0, 0.0, -p2, 0.0, -p1, 0.0, -p3, h3, 0.0, -h1, 0.0, 0.0, 0.0),
                (0.0, 0.0, 1.0, 0.0, 0.0, -p3, 0.0, -p1, -p2, -h2, h1, 0.0, 0.0, 0.0, 0.0),
            )
        )
        return jacobian, matrix @ field_nt - x[BIAS] - h, h

    def apply(self, innovation: Innovation) -> None:
        """Take an innovation in; the covariance stays symmetric to the last bit."""
        self.correct(innovation.cross @ innovation.weighted)
        cross = innovation.cross
        covariance = self.covariance - cross @ np.linalg.solve(innovation.covariance, cross.T)
        self.covariance = 0.5 * (covariance + covariance.T)

    def correct(self, step: Array) -> None:
        """Move the state by error states (15,)."""
        self.x = self.x + step[ERRORS]
        self.body_from_eci = turned_once(step[ATTITUDE], 1.0)[0] @ self.body_from_eci
        self.rate_rad_s = self.rate_rad_s + step[RATE]

    def attitude_sigma_rad(self) -> float:
        """Largest 1 sigma of the attitude about any axis [rad]."""
        return math.sqrt(max(float(np.linalg.eigvalsh(self.covariance[ATTITUDE, ATTITUDE])[-1]), 0.0))


def walk_variance(seconds: float, error_walk: Array | None, rate_walk: float) -> Array:
    """Variance (15,) that the error states gain in a time [s] by random walk of errors (9,) [per s] and rate."""
    gained = np.zeros(SPIN_STATE_SIZE)
    if error_walk is not None:
        gained[ERRORS] = error_walk * seconds
    gained[ATTITUDE] = rate_walk**2 * seconds**3 / 3.0
    gained[RATE] = rate_walk**2 * seconds
    return gained


@dataclass(frozen=True, slots=True)
class SpinEstimate:
    """The spin, a by-product of the calibration.

    Parameters
    ----------
    time_s: sample time it holds for, since the first sample [s].
    rate_rad_s, rate_sigma_rad_s: rate about the axis, never negative, and its 1 sigma [rad/s].
    axis_body, axis_eci: unit vectors (3,) about which the craft turns right-handed, in the body and in space.
    axis_body_sigma_rad, axis_eci_sigma_rad: 1 sigma of their direction, in the worst direction across [rad].
    body_from_eci: attitude (3, 3) at ``time_s``.
    attitude_sigma_rad: its 1 sigma about the worst axis [rad].
    consistent: the vectors agreed with a steady spin to within noise; False: the figures describe a craft that does
        not turn steadily, or a field that holds more than the model, and the sigmas only scale with the residual.
    """

    time_s: float
    rate_rad_s: float
    rate_sigma_rad_s: float
    axis_body: Array
    axis_body_sigma_rad: float
    axis_eci: Array
    axis_eci_sigma_rad: float
    body_from_eci: Array
    attitude_sigma_rad: float
    consistent: bool


def spin_estimate(state: SpinState, time_s: float, *, consistent: bool) -> SpinEstimate:
    """The spin of a state, with what its covariance says about it."""
    rate = max(math.sqrt(float(state.rate_rad_s @ state.rate_rad_s)), 1e-12)
    axis = state.rate_rad_s / rate
    across = _IDENTITY - np.outer(axis, axis)
    body = np.zeros((3, SPIN_STATE_SIZE))
    body[:, RATE] = across / rate
    # in space the axis is R'w / |w|: its error in body components is that of w, and theta x w beside
    space = body.copy()
    space[:, ATTITUDE] = -cross_matrix(axis)
    along = np.zeros(SPIN_STATE_SIZE)
    along[RATE] = axis
    return SpinEstimate(
        time_s=time_s,
        rate_rad_s=rate,
        rate_sigma_rad_s=math.sqrt(max(float(along @ state.covariance @ along), 0.0)),
        axis_body=axis,
        axis_body_sigma_rad=_worst_sigma(body, state.covariance),
        axis_eci=state.body_from_eci.T @ axis,
        axis_eci_sigma_rad=_worst_sigma(space, state.covariance),
        body_from_eci=state.body_from_eci,
        attitude_sigma_rad=state.attitude_sigma_rad(),
        consistent=consistent,
    )


def _worst_sigma(rows: Array, covariance: Array) -> float:
    return math.sqrt(max(float(np.linalg.eigvalsh(rows @ covariance @ rows.T)[-1]), 0.0))
