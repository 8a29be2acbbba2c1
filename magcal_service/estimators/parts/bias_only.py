"""What the methods that estimate the bias alone have in common: they take D as zero and known.

Their x has D = 0 and their covariance keeps the prior's variance for D, because they learn nothing of it; the bias and
its covariance hold for D = 0 only.  A true D moves their bias by about D times the field's mean in the body.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.config.settings import CraftConfig
from magcal_service.estimators.interface import Phase, StateEstimate
from magcal_service.estimators.parts.noise_level import NoiseLevel
from magcal_service.estimators.parts.start import prior_sigma
from magcal_service.model import BIAS, STATE_SIZE, Array


@dataclass(init=False, repr=False, eq=False)
class BiasStateMemory:
    """What of ``BiasState`` outlives a restart, saved and restored whole."""

    bias_nt: Array
    covariance: Array
    noise: NoiseLevel
    phase: Phase
    samples: int
    rejected: int


class BiasState(Stateful, BiasStateMemory):
    """A bias with its covariance, and the account that every estimator keeps.

    Parameters
    ----------
    config: the craft's configuration (sensor, filter's prior and process noise of the bias).
    """

    def __init__(self, config: CraftConfig) -> None:
        self._prior = prior_sigma(config.filter)
        self._walk = np.diag(np.array(config.filter.process_noise_bias_nt) ** 2)
        self.bias_nt = np.zeros(3)
        self.covariance = np.diag(self._prior[BIAS] ** 2)
        self.noise = NoiseLevel(config.sensor.noise_nt)
        self.phase = Phase.STARTING
        self.samples = self.rejected = 0

    @property
    def x(self) -> Array:
        """The nine states with D = 0 (9,)."""
        x = np.zeros(STATE_SIZE)
        x[BIAS] = self.bias_nt
        return x

    def add_process_noise(self, seconds: float) -> None:
        """Random walk of the bias over a time [s]."""
        self.covariance = self.covariance + self._walk * seconds

    def estimate(self) -> StateEstimate:
        """The estimate as it stands."""
        covariance = np.diag(self._prior**2)
        covariance[BIAS, BIAS] = self.covariance
        return StateEstimate(
            x=self.x,
            covariance=covariance,
            phase=self.phase,
            noise_nt=self.noise.total_nt,
            samples=self.samples,
            rejected=self.rejected,
            restarts=0,
            waiting_for=None,
            spin_given_up=False,
        )
