"""Pseudo-linear Kalman filter for the bias of a spinning craft: each spin window is a linear measurement of it.

With D = 0 equation (6) reads: the mean of B over whole turns, across the spin axis, is the bias across the spin axis.
That is linear in b, so a Kalman filter needs no start and cannot diverge.  What it cannot do: the bias along the axis
(its sigma stays the prior's), scale and non-orthogonality (``bias_only`` says what they do to the bias), and anything
without a spin.  The windows are those of ``spin_window``: noise s^2 sum(weights^2) and the leak of the turning field.

The mean of consecutive windows carries the leak with a sign that changes slowly, so it does not average out like noise:
it enters with a variance that is held constant over an orbit's quarter instead of shrinking with every window.

Source: Soken & Sakai 2017/2018, magnetometer bias for spin-stabilised craft by a pseudo-linear Kalman filter; Cetin,
Soken & Tekinalp 2020, equation (6) with D = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_service.base.errors import MISSING, ConfigError, Fault, Lacking
from magcal_service.base.snapshot import Stateful
from magcal_service.config.settings import CraftConfig, SpinConfig, SpinWindow
from magcal_service.estimators.interface import Method, Phase, StateEstimate, TickOutcome
from magcal_service.estimators.parts.bias_only import BiasState
from magcal_service.estimators.parts.spin_window import SpinWindows, Window
from magcal_service.model import scalar_residual
from magcal_service.ticks.assembler import Tick

_LEAK_MEMORY_S = 1500.0
"""Time over which the leak keeps its sign: a quarter of a low orbit."""


@dataclass(init=False, repr=False, eq=False)
class PlkfMemory:
    """What of ``Plkf`` outlives a restart, saved and restored whole."""

    _state: BiasState
    _windows: SpinWindows
    _time_s: float | None


class Plkf(Stateful, PlkfMemory):
    """One craft's filter.

    Parameters
    ----------
    config: the craft's configuration (sensor, spin, filter's prior and process noise of the bias).

    Raises ConfigError where no spin is given.
    """

    name = "plkf"

    def __init__(self, config: CraftConfig) -> None:
        self._spin = _spin_of(config)
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Back to the prior, before any sample."""
        self._state = BiasState(self.config)
        self._windows = SpinWindows(self._spin, self.config.sensor.noise_nt)
        self._time_s = None

    def estimate(self) -> StateEstimate:
        """The estimate after the last tick."""
        return self._state.estimate()

    def handle(self, tick: Tick) -> TickOutcome:
        """Take one tick; where it ends a spin window, update with the window."""
        state = self._state
        residual = scalar_residual(state.x, tick.field_body_nt, tick.reference_magnitude_nt)
        now_s = float(tick.times_s[-1])
        if self._time_s is not None:
            state.add_process_noise(now_s - self._time_s)
        self._time_s = now_s
        state.noise.observe(residual, after_gap=tick.after_gap)
        state.samples += len(residual)
        window = self._windows.push(tick)
        if window is not None:
            squared, rejected = self._update(window)
            return TickOutcome(state.phase, residual, len(residual)).with_spin(squared, rejected=rejected)
        return TickOutcome(state.phase, residual, len(residual))

    def _update(self, window: Window) -> tuple[float, bool]:
        """One window: its normalised innovation squared (expectation 2), and whether the gate stopped it."""
        state = self._state
        across = window.across
        innovation = across @ (window.weights @ window.field_body_nt - state.bias_nt)
        cross = state.covariance @ across.T
        spread = across @ cross + self._variance(window) * np.eye(2)
        squared = float(innovation @ np.linalg.solve(spread, innovation))
        if state.phase is Phase.RUNNING and squared > self.config.filter.gate_sigma**2 + 2.0:
            state.rejected += len(window.weights)
            return squared, True
        gain = np.linalg.solve(spread, cross.T).T
        covariance = state.covariance - gain @ cross.T
        state.bias_nt, state.covariance = state.bias_nt + gain @ innovation, 0.5 * (covariance + covariance.T)
        state.phase = Phase.RUNNING
        return squared, False

    def _variance(self, window: Window) -> float:
        """Variance [nT^2] of one component of the window's mean, with the leak's lasting sign."""
        noise_nt = self._state.noise.white_nt or self._state.noise.total_nt
        windows = max(1.0, _LEAK_MEMORY_S / self._spin.window_s)
        noise = noise_nt**2 * float(window.weights @ window.weights) * window.share
        return noise + window.leak_nt**2 * windows


def _spin_of(config: CraftConfig) -> SpinConfig:
    if config.spin is None or config.spin.window is SpinWindow.OFF:
        accepted = "the method plkf needs [spin] with its axis and rate_rpm; add it"
        is_off = config.spin is not None
        raise ConfigError([Fault("spin", 'window = "off"', accepted) if is_off else Lacking("spin", MISSING, accepted)])
    return config.spin


METHOD = Method(
    "plkf",
    "pseudo-linear Kalman filter: bias across the spin axis, from spin windows",
    Plkf,
    estimates_matrix=False,
)
