"""The nine-state EKF with the scalar measurement alone, as published: from the prior, without a batch start.

Each sample linearises h(x) of equation (4) at the estimate, H = dh/dx = -2 w'J(B), and takes v with its mean and with
the variance 4 w'Sigma w + 2 tr(Sigma^2) at the estimate.  It is here to be compared with: from a prior as wide as
real sensors need, the first updates go along a wrong tangent, the covariance shrinks as if they had been right, and
the filter stays at a wrong solution with small sigmas.  Nothing is added that would hide this: no gate, no start, no
correction for the noise inside B.  ``docs/methods.md`` has the share of runs that fail.

Source: Crassidis, Lai & Harman 2003, "Real-time attitude-independent three-axis magnetometer calibration", section on
the extended filter; Cetin, Soken & Tekinalp 2020, equations (2)-(4), who report the divergence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.config.settings import CraftConfig
from magcal_service.estimators.interface import Method, Phase, StateEstimate, TickOutcome
from magcal_service.estimators.parts.noise_level import NoiseLevel
from magcal_service.estimators.parts.start import prior_sigma
from magcal_service.model import (
    STATE_SIZE,
    Array,
    calibrate,
    field_jacobian,
    scalar_innovation_value,
    variance_of_v,
)
from magcal_service.ticks.assembler import Tick

_FIRST_NOISE = 0.01
"""Share of |H| that stands for an unknown noise level before it is learned."""


@dataclass(init=False, repr=False, eq=False)
class EkfMemory:
    """What of ``Ekf`` outlives a restart, saved and restored whole."""

    _x: Array
    _covariance: Array
    _noise: NoiseLevel
    _phase: Phase
    _samples: int
    _time_s: float | None


class Ekf(Stateful, EkfMemory):
    """One craft's filter.

    Parameters
    ----------
    config: the craft's configuration (sensor, filter's prior and process noise).
    """

    name = "ekf"

    def __init__(self, config: CraftConfig) -> None:
        self.config = config
        walk = np.array(config.filter.process_noise_bias_nt + config.filter.process_noise_D)
        self._walk = np.diag(walk**2)
        self.reset()

    def reset(self) -> None:
        """Back to the prior, before any sample."""
        self._x = np.zeros(STATE_SIZE)
        self._covariance = np.diag(prior_sigma(self.config.filter) ** 2)
        self._noise = NoiseLevel(self.config.sensor.noise_nt)
        self._phase = Phase.STARTING
        self._samples = 0
        self._time_s = None

    def estimate(self) -> StateEstimate:
        """The estimate after the last tick."""
        return StateEstimate(
            x=self._x,
            covariance=self._covariance,
            phase=self._phase,
            noise_nt=self._noise.total_nt,
            samples=self._samples,
            rejected=0,
            restarts=0,
            waiting_for=None,
            spin_given_up=False,
        )

    def handle(self, tick: Tick) -> TickOutcome:
        """Predict over the time since the last tick, then update with equation (3) sample by sample."""
        self._phase = Phase.RUNNING
        if self._noise.total_nt == 0.0:
            self._noise.set(_FIRST_NOISE * float(tick.reference_magnitude_nt[0]))
        now_s = float(tick.times_s[-1])
        if self._time_s is not None:
            self._covariance = self._covariance + self._walk * (now_s - self._time_s)
        self._time_s = now_s
        residuals, squared = np.empty(len(tick.times_s)), 0.0
        for i, magnitude_nt in enumerate(tick.reference_magnitude_nt.tolist()):
            residuals[i], square = self._update(tick.field_body_nt[i], magnitude_nt)
            squared += square
        self._samples += len(residuals)
        self._noise.observe(residuals, after_gap=tick.after_gap)
        return TickOutcome(self._phase, residuals, len(residuals), squared_innovation=squared, degrees=len(residuals))

    def _update(self, field_nt: Array, magnitude_nt: float) -> tuple[float, float]:
        """One sample; its scalar residual before the update [nT] and its normalised innovation squared."""
        w = calibrate(self._x, field_nt)
        length = float(np.linalg.norm(w))
        residual = length - magnitude_nt
        variance = self._noise.total_nt**2
        jacobian = -2.0 * w @ field_jacobian(field_nt)  # H
        cross = self._covariance @ jacobian  # P H'
        innovation = -scalar_innovation_value(residual, length, magnitude_nt, variance)  # z - h(x) - mean(v)
        spread = float(jacobian @ cross) + variance_of_v(length, variance)
        self._x = self._x + cross * (innovation / spread)
        self._covariance = self._covariance - np.outer(cross, cross) / spread
        return residual, innovation**2 / spread


METHOD = Method(
    "ekf",
    "nine-state EKF with the scalar measurement alone, from the prior, as published",
    Ekf,
    takes_wide_prior=False,
)
