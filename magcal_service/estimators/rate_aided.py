"""Bias from magnetometer and gyro: the true field turns with the craft, the bias does not.

In body axes dm/dt = -w x m for the true field m = A H, and with D = 0 the measured B = m + b, so that
dB/dt = -w x (B - b).  The state (m, b) of six is linear: m turns by the gyro's rotation from sample to sample, b stays,
and B measures their sum; a Kalman filter needs neither start nor reference.  H itself turns, which enters as process
noise from the reference's own change, and so does an assumed noise of the gyro.

About a constant axis the bias along it is not observable.  The gyro's noise makes it seem so (a noisy axis resembles
a changing one), and the filter would then attribute the field's mean to the bias.  Directions in which the gyro's noise
explains more than half of the apparent change of axis are therefore given back to the prior.

Needs ticks with ``rate_body_rad_s`` (n, 3) [rad/s]; those without are counted as not used.

Source: Troni & Whitcomb 2014, "Field sensor bias calibration with angular-rate sensors", the Kalman filter on
dB/dt = -w x (B - b); Sakai 2011 for spinning craft; Wu 2019.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.config.settings import CraftConfig
from magcal_service.estimators.interface import Method, Phase, StateEstimate, TickOutcome
from magcal_service.estimators.parts.bias_only import BiasState
from magcal_service.estimators.parts.spin_window import LEO_FIELD_RATE_RAD_S
from magcal_service.model import Array, scalar_residual
from magcal_service.ticks.assembler import Tick

GYRO_NOISE_RAD_S: Final = 1e-3
"""Assumed error of the gyro per sample [rad/s]: a MEMS gyro's, its quantisation included."""

_LARGEST_TURN_RAD: Final = 1.5
"""Between two samples; beyond it the mean of two rates is not the rotation."""

_LONGEST_STEP_S: Final = 60.0
"""Longest time between two samples over which the rate is integrated; choice: beyond it the field's state is reset.

At the fastest turn of H in a low orbit 60 s are 8 degrees, a seventh of |H| of process noise: m is as good as unknown.
"""

_MEMORY: Final = 300
"""Samples over which the innovations are averaged: a mean of three-component squares known to 5 %.

Choice: shorter, the covariance would breathe with chance; longer, it would follow a change later.
"""

_OBSERVED_SHARE: Final = 0.5
"""Share of the apparent change of axis that noise of the gyro may explain: half, the odds turn there."""

_SETTLED: Final = 60
"""Samples before the state is called running; choice: a minute at 1 Hz, several turns at the paper's 7.5 rpm."""


def rotation(rate_rad_s: Array, seconds: float) -> Array:
    """exp(-[w t]x) (3, 3): turns the body components of an inertial vector over a time; w (3,) [rad/s] (Rodrigues)."""
    x, y, z = (rate_rad_s * seconds).tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    first = math.sin(angle) / angle if angle > 1e-9 else 1.0
    second = (1.0 - math.cos(angle)) / angle**2 if angle > 1e-9 else 0.5
    turned: Array = np.eye(3) - first * cross + second * cross @ cross
    return turned


@dataclass(init=False, repr=False, eq=False)
class _RateNoiseMemory:
    """What of ``_RateNoise`` outlives a restart, saved and restored whole."""

    _last: list[Array]
    _count: int
    _noise: float
    _change: Array
    _expected: float


class _RateNoise(Stateful, _RateNoiseMemory):
    """Noise of the gyro by its second differences, and how far the axis of turning really changes."""

    def __init__(self) -> None:
        self._last = []
        self._count = 0
        self._noise = 0.0
        self._change = np.zeros((3, 3))  # sum of (I - R)'(I - R)
        self._expected = 0.0  # what the noise alone adds to each of its eigenvalues

    def clear(self) -> None:
        self._last.clear()

    def add(self, rate_rad_s: Array, turned: Array, seconds: float) -> None:
        """Take in a rate (3,) [rad/s] with the rotation (3, 3) it led to over a time [s]."""
        self._last.append(rate_rad_s)
        if len(self._last) == 3:
            first, second, third = self._last
            self._count += 1
            self._noise += (float(np.sum((third - 2.0 * second + first) ** 2)) / 18.0 - self._noise) / self._count
            del self._last[0]
        away = np.eye(3) - turned
        self._change += away.T @ away
        self._expected += self._noise * seconds**2  # two of three components, of a mean of two rates

    def observed(self) -> Array:
        """Projector (3, 3) on the directions of b that the turning shows."""
        values, vectors = np.linalg.eigh(self._change)
        kept = vectors[:, values * (1.0 - _OBSERVED_SHARE) > self._expected + 1e-12]
        projector: Array = kept @ kept.T
        return projector


@dataclass(init=False, repr=False, eq=False)
class RateAidedMemory:
    """What of ``RateAided`` outlives a restart, saved and restored whole."""

    _state: BiasState
    _joint: Array
    _joint_covariance: Array
    _rates: _RateNoise
    _last: tuple[float, Array, Array | None] | None
    _norm: float
    _updates: int


class RateAided(Stateful, RateAidedMemory):
    """One craft's filter.

    Parameters
    ----------
    config: the craft's configuration (sensor, filter's prior and process noise of the bias).
    """

    name = "rate-aided"

    def __init__(self, config: CraftConfig) -> None:
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Back to the prior, before any sample."""
        self._state = BiasState(self.config)
        self._joint = np.zeros(6)  # m, b
        self._joint_covariance = np.zeros((6, 6))
        self._joint_covariance[3:, 3:] = self._state.covariance
        self._rates = _RateNoise()
        self._last = None  # time, rate, H
        self._norm = 1.0
        self._updates = 0

    def estimate(self) -> StateEstimate:
        """The estimate after the last tick."""
        return self._state.estimate()

    def handle(self, tick: Tick) -> TickOutcome:
        """Take one tick, sample by sample; without rates nothing is learned from it."""
        state = self._state
        residual = scalar_residual(state.x, tick.field_body_nt, tick.reference_magnitude_nt)
        rates: Array | None = getattr(tick, "rate_body_rad_s", None)
        if rates is None:
            return TickOutcome(state.phase, residual, used=0)
        if tick.after_gap:
            self._last = None
        state.noise.observe(residual, after_gap=tick.after_gap)
        squared, used = 0.0, 0
        for i in range(len(residual)):
            vector = tick.reference_eci_nt[i] if tick.reference_eci_nt is not None else None
            self._predict(float(tick.times_s[i]), rates[i], vector, float(tick.reference_magnitude_nt[i]))
            square = self._update(tick.field_body_nt[i])
            used += square is not None
            squared += square or 0.0
        state.samples += used
        state.rejected += len(residual) - used
        self._publish()
        return TickOutcome(
            state.phase,
            residual,
            used,
            rejected=len(residual) - used,
            squared_innovation=squared / 3.0,
            degrees=used,
        )

    def _predict(self, time_s: float, rate_rad_s: Array, vector_nt: Array | None, magnitude_nt: float) -> None:
        """Turn m to the time of a sample; begin with an unknown m where the last sample is too far away."""
        last, self._last = self._last, (time_s, rate_rad_s, vector_nt)
        seconds = time_s - last[0] if last is not None else 0.0
        mean = 0.5 * (rate_rad_s + last[1]) if last is not None else rate_rad_s
        angle = float(np.linalg.norm(mean)) * seconds
        if last is None or seconds > _LONGEST_STEP_S or angle > _LARGEST_TURN_RAD:
            self._begin(magnitude_nt)
            return
        turned = rotation(mean, seconds)
        self._rates.add(rate_rad_s, turned, seconds)
        self._joint[:3] = turned @ self._joint[:3]
        covariance = self._joint_covariance
        covariance[:3] = turned @ covariance[:3]
        covariance[:, :3] = covariance[:, :3] @ turned.T
        if vector_nt is not None and last[2] is not None:
            drift_nt = float(np.linalg.norm(vector_nt - last[2]))
        else:
            drift_nt = LEO_FIELD_RATE_RAD_S * magnitude_nt * seconds
        gyro_nt = GYRO_NOISE_RAD_S * magnitude_nt * seconds
        covariance[[0, 1, 2], [0, 1, 2]] += drift_nt**2 + gyro_nt**2
        walk = np.array(self.config.filter.process_noise_bias_nt) ** 2
        covariance[[3, 4, 5], [3, 4, 5]] += walk * seconds

    def _begin(self, magnitude_nt: float) -> None:
        """Reset m; what is known of b stays."""
        self._rates.clear()
        self._joint[:3] = 0.0
        self._joint_covariance[:3] = 0.0
        self._joint_covariance[:, :3] = 0.0
        self._joint_covariance[[0, 1, 2], [0, 1, 2]] = magnitude_nt**2

    def _update(self, field_nt: Array) -> float | None:
        """B = m + b + noise; the normalised innovation squared (expectation 3), None where the gate stopped it."""
        covariance = self._joint_covariance
        noise_nt = max(self._state.noise.white_nt, 1.0)
        innovation = field_nt - self._joint[:3] - self._joint[3:]
        cross = covariance[:, :3] + covariance[:, 3:]
        spread = cross[:3] + cross[3:] + noise_nt**2 * np.eye(3)
        squared = float(innovation @ np.linalg.solve(spread, innovation))
        self._updates += 1
        self._norm += (min(squared / 3.0, 100.0) - self._norm) / min(self._updates, _MEMORY)
        if self._updates > _SETTLED and squared > self.config.filter.gate_sigma**2 * 3.0 * max(1.0, self._norm):
            return None
        gain = np.linalg.solve(spread, cross.T).T
        self._joint = self._joint + gain @ innovation
        updated = covariance - gain @ cross.T
        self._joint_covariance = 0.5 * (updated + updated.T)
        return squared

    def _publish(self) -> None:
        """What is observed of b, its variance grown with the innovations where those are too large; the prior else."""
        seen = self._rates.observed()
        unseen = np.eye(3) - seen
        prior = self.config.filter.prior_bias_nt**2
        self._state.bias_nt = seen @ self._joint[3:]
        covariance = max(1.0, self._norm) * seen @ self._joint_covariance[3:, 3:] @ seen + prior * unseen
        self._state.covariance = 0.5 * (covariance + covariance.T)
        if self._updates >= _SETTLED:
            self._state.phase = Phase.RUNNING


METHOD = Method(
    "rate-aided",
    "bias from magnetometer and gyro: dB/dt = -w x (B - b)",
    RateAided,
    needs="angular rate",
    estimates_matrix=False,
)
