"""The paper's filter: a nine-state UKF with the scalar measurement and two spin pseudo-measurements.

State x = [b, D], random walk.  Each tick: predict, scalar update with equation (3), and at the end of each spin window
the two pseudo-measurements (6).  Added to the paper, because measured to matter: the mean of v, the noise inside B
(``model.without_radial_noise``), windows that don't share data, their leak, a batch start, and an innovation gate.

The pseudo-measurements are taken on vectors projected to the known magnitude.  A plain window mean contains the radial
noise that the scalar updates have already used, and counting it twice makes the filter overconfident by up to a third
in variance; the projected one contains tangential noise only.

Source: Cetin, Soken, Tekinalp 2020, equations (2)-(8); Crassidis, Lai & Harman 2003.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.base.snapshot import Stateful
from magcal_service.config.settings import CraftConfig, SpinConfig, SpinWindow
from magcal_service.estimators.interface import InformationSet, Method, Phase, StateEstimate, TickOutcome
from magcal_service.estimators.parts.adaptive import ChangeDetector
from magcal_service.estimators.parts.sample_gate import SampleGate
from magcal_service.estimators.parts.spin_innovation import spin_innovation
from magcal_service.estimators.parts.spin_window import SpinWindows, Window
from magcal_service.estimators.parts.start import StartCollector, prior_sigma
from magcal_service.estimators.parts.unscented import (
    Innovation,
    UnscentedWeights,
    cholesky,
    scalar_innovation,
)
from magcal_service.model import BIAS, STATE_SIZE, Array, d_matrix, field_jacobian
from magcal_service.ticks.assembler import Tick

REJECTED_MEMORY: Final = 60
"""Samples over which the rejected share is averaged.

Choice: 42 rejected in a row reach the limit. Fewer would restart for one burst of spikes, more would leave the
filter wrong for longer after a step.
"""

REJECTED_LIMIT: Final = 0.5
"""Rejected share at which the filter is wrong and not the samples: most of them contradict it."""

INNOVATION_MEMORY: Final = 100
"""Accepted samples over which their squared innovation is averaged: its expectation is 1, with a scatter of 0.14."""

INNOVATION_LIMIT: Final = 2.5
"""Mean that says that the errors changed: ten of its scatter; outliers don't raise it, the gate stops them."""

_NOISE_MEMORY: Final = 600
"""Samples over which an unknown noise level is averaged."""

SMALLEST_VARIANCE_NT2: Final = 1e-4
"""Least noise variance that is learnt: 0.01 nT is better than any sensor in orbit, and keeps the arithmetic sound."""

RUNAWAY_SHARE: Final = 0.3
"""A learnt noise level of this share of |H| is no noise: the filter has lost its way."""

SPIN_WINDOWS: Final = 16
"""Spin windows over which their squared innovation is averaged.

Choice: four minutes of the paper's flight; fewer would need a higher limit, more would keep a wrong axis or rate in use
for longer.
"""

SPIN_LIMIT: Final = 3.0
"""The multiple of its expectation that is too much: the mean of 16 windows exceeds it 3 times in 10^8 by chance."""


_SCALAR_FITS: Final = 0.1
"""Share of rejected samples below which contradicting windows are the spin's fault; above, the errors have changed."""

_SPIN_MOST: Final = SPIN_WINDOWS * 2.0 * SPIN_LIMIT / 4.0
"""A single window counts no more than this, so that it takes four bad ones of sixteen to give the spin up."""


def _only(tick: Tick, used: NDArray[np.bool_]) -> Tick:
    """The tick with some of its samples (n,)."""
    vectors = tick.reference_eci_nt
    return replace(
        tick,
        times_s=tick.times_s[used],
        field_body_nt=tick.field_body_nt[used],
        reference_magnitude_nt=tick.reference_magnitude_nt[used],
        reference_eci_nt=None if vectors is None else vectors[used],
    )


@dataclass(init=False, repr=False, eq=False)
class UkfMemory:
    """What of ``Ukf`` outlives a restart, saved and restored whole."""

    _x: Array
    _covariance: Array
    _samples: int
    _rejected: int
    _restarts: int
    _spin_given_up: bool
    changes: int
    _windows: SpinWindows | None
    _start: StartCollector
    _phase: Phase
    _noise_variance: float
    _white_variance: float
    _noise_samples: int
    _residuals_before: tuple[float, float]
    _rejected_share: float
    _innovation_mean: float
    _innovation_count: int
    _learning: bool
    _time_s: float | None
    _last_field: Array | None
    _spin_norm: float
    _spin_count: int
    _detector: ChangeDetector | None


class Ukf(Stateful, UkfMemory):
    """One craft's filter.

    Parameters
    ----------
    config: the craft's configuration (sensor, spin, filter).

    Attributes
    ----------
    changes: jumps of the errors that ``filter.adaptive`` has found and followed.
    """

    name = "ukf"

    def __init__(self, config: CraftConfig) -> None:
        self.config = config
        settings = config.filter
        self._weights = UnscentedWeights.scaled(settings.alpha, settings.beta, settings.kappa)
        walk = np.array(settings.process_noise_bias_nt + settings.process_noise_D)
        self._walk = np.diag(walk**2) if walk.any() else None
        self._gate = SampleGate.of(settings)
        self._prior = prior_sigma(settings)
        self._detector = ChangeDetector(self._walk) if settings.adaptive else None
        self.reset()

    def reset(self) -> None:
        """Back to the prior, before any sample."""
        self._x = np.zeros(STATE_SIZE)
        self._covariance = np.diag(self._prior**2)
        self._samples = self._rejected = self._restarts = 0
        self._spin_given_up = False
        self.changes = 0
        self._begin()

    def begin_with(self, x: Array, covariance: Array, noise_nt: float) -> None:
        """Run from now on without a start, from nine errors that are known.

        Parameters
        ----------
        x, covariance: state (9,) and covariance (9, 9) [nT, -].
        noise_nt: of the sensor, 1 sigma per axis [nT]; learnt on from there where the configuration states none.
        """
        self.reset()
        self._x, self._covariance = x.copy(), covariance.copy()
        self._noise_variance = self._white_variance = max(noise_nt**2, SMALLEST_VARIANCE_NT2)
        self._noise_samples = _NOISE_MEMORY
        self._phase = Phase.RUNNING

    def _begin(self) -> None:
        """Start collecting; the estimate stays what it was until the new start is accepted."""
        spin = self.config.spin
        usable = spin is not None and spin.window is not SpinWindow.OFF and not self._spin_given_up
        self._windows = SpinWindows(spin, self.config.sensor.noise_nt) if usable and spin is not None else None
        self._start = StartCollector(self.config)
        self._phase = Phase.STARTING
        self._noise_variance = self._white_variance = (self.config.sensor.noise_nt or 0.0) ** 2
        self._noise_samples = 0
        self._residuals_before = (0.0, 0.0)
        self._rejected_share, self._innovation_mean, self._innovation_count = 0.0, 1.0, 0
        self._learning = self.config.sensor.noise_nt is None
        self._time_s = None
        self._last_field = None
        self._spin_norm, self._spin_count = 2.0, 0
        if self._detector is not None:
            self._detector.clear()

    def estimate(self) -> StateEstimate:
        """The estimate after the last tick."""
        return StateEstimate(
            x=self._x,
            covariance=self._covariance,
            phase=self._phase,
            noise_nt=math.sqrt(self._noise_variance),
            samples=self._samples,
            rejected=self._rejected,
            restarts=self._restarts,
            waiting_for=self._start.gate if self._phase is Phase.STARTING else None,
            spin_given_up=self._spin_given_up,
            departure="" if self._walk is None and self._detector is None else self._departure(),
            followed=self.changes,
        )

    def _departure(self) -> str:
        return "process noise" if self._walk is not None else "adaptive"

    def handle(self, tick: Tick) -> TickOutcome:
        """Take one tick: collect it towards the start, or update with its samples and the window it ends."""
        if self._phase is Phase.STARTING:
            return self._collect(tick, self._windows.push(tick) if self._windows is not None else None)
        try:
            return self._update(tick)
        except np.linalg.LinAlgError:  # a covariance beyond repair: samples that no sensor near its reference sends
            self._restarts += 1
            self._x, self._covariance = np.zeros(STATE_SIZE), np.diag(self._prior**2)
            self._begin()
            return TickOutcome(self._phase, self._residual(tick), 0, len(tick.times_s))

    def _update(self, tick: Tick) -> TickOutcome:
        self._predict(tick)
        outcome, used = self._scalar_update(tick)
        if self.config.spin is not None and self.config.spin.fourth:
            self._fourth_update(tick, self.config.spin)
        window = self._window(tick, used)
        if window is not None:
            outcome = self._spin_update(window, outcome)
        self._time_s = float(tick.times_s[-1])
        if self._detector is not None:
            self._follow_change(self._detector, self._time_s)
        self._guard_consistency(float(tick.reference_magnitude_nt[-1]))
        return outcome

    def _collect(self, tick: Tick, window: Window | None) -> TickOutcome:
        self._samples += len(tick.times_s)
        solution = self._start.push(tick, window)
        if solution is not None:
            self._x, self._covariance = solution.x, self.config.filter.start_inflation**2 * solution.covariance
            self._noise_variance, self._white_variance = solution.sigma_nt**2, solution.noise_nt**2
            self._noise_samples = self._start.samples
            self._learning |= self._start.noise_contradicted
            if self._start.spin_contradicted:
                self._spin_given_up, self._windows = True, None
            self._phase = Phase.RUNNING
            self._start = StartCollector(self.config)  # what was collected has served
            self._time_s = float(tick.times_s[-1])
        return TickOutcome(self._phase, self._residual(tick), used=len(tick.times_s))

    def _residual(self, tick: Tick) -> Array:
        w = tick.field_body_nt + tick.field_body_nt @ d_matrix(self._x) - self._x[BIAS]
        residual: Array = np.sqrt((w * w).sum(axis=1)) - tick.reference_magnitude_nt
        return residual

    def _predict(self, tick: Tick) -> None:
        """Random walk: the state stays, its covariance grows with the time since the last tick."""
        if self._walk is not None and self._time_s is not None:
            self._covariance = self._covariance + self._walk * (float(tick.times_s[-1]) - self._time_s)

    def _window(self, tick: Tick, used: list[bool]) -> Window | None:
        """The window that ends in this tick; a sample that the gate has stopped would spoil a whole one."""
        if self._windows is None:
            return None
        if all(used):
            return self._windows.push(tick)
        if not any(used):
            if tick.after_gap:
                self._windows.clear()
            return None
        return self._windows.push(_only(tick, np.array(used)))

    def _scalar_update(self, tick: Tick) -> tuple[TickOutcome, list[bool]]:
        """Equation (3), sample by sample; a sample beyond the gate is counted and left out: which were used (n,)."""
        residuals: list[float] = []
        used: list[bool] = []
        squared = 0.0
        for field, magnitude in zip(tick.field_body_nt, tick.reference_magnitude_nt.tolist(), strict=True):
            root = cholesky(self._covariance)
            innovation = scalar_innovation(
                self._x, root, self._weights, field, magnitude, self._noise_variance, self._white_variance
            )
            residuals.append(innovation.residual_nt)
            norm = innovation.squared_norm()
            rejected = norm > self._gate.limit(innovation.variance, innovation.noise_variance)
            used.append(not rejected)
            self._rejected_share += (float(rejected) - self._rejected_share) / REJECTED_MEMORY
            if rejected:
                continue
            self._innovation_count = min(self._innovation_count + 1, INNOVATION_MEMORY)
            self._innovation_mean += (norm - self._innovation_mean) / self._innovation_count
            self._x, self._covariance = innovation.apply(self._x, self._covariance)
            squared += norm
            if self._learning:
                self._learn_noise(innovation.residual_nt)
        count = sum(used)
        left_out = len(used) - count
        self._samples += count
        self._rejected += left_out
        return TickOutcome(self._phase, np.array(residuals), count, left_out, squared, count), used

    def _learn_noise(self, residual_nt: float) -> None:
        """Follow an unknown noise level by the running mean square of the residual and of its second difference.

        The second difference (variance 6 s^2 for white noise s^2) leaves out what is slow: only white noise has the
        mean 3 s^2 in equation (3), physics that was left out has not.
        """
        self._noise_samples = min(self._noise_samples + 1, _NOISE_MEMORY)
        variance_before = self._noise_variance
        self._noise_variance += (residual_nt**2 - variance_before) / self._noise_samples
        self._noise_variance = max(self._noise_variance, SMALLEST_VARIANCE_NT2)
        self._covariance = self._covariance * (self._noise_variance / variance_before)  # all samples weigh the same
        before, last = self._residuals_before
        rough = (residual_nt - 2.0 * last + before) ** 2 / 6.0
        self._residuals_before = (last, residual_nt)
        self._white_variance += (min(rough, 9.0 * self._noise_variance) - self._white_variance) / self._noise_samples
        self._white_variance = min(self._white_variance, self._noise_variance)

    def _spin_update(self, window: Window, outcome: TickOutcome) -> TickOutcome:
        """Equations (6) on the projected vectors of one window."""
        root, noise_variance = cholesky(self._covariance), self._noise_variance
        innovation = spin_innovation(self._x, root, self._weights, window, window.field_body_nt, noise_variance)
        squared = innovation.squared_norm()
        accepted = squared <= self.config.filter.gate_sigma**2 + 2.0
        if accepted:
            self._x, self._covariance = innovation.apply(self._x, self._covariance)
        self._spin_count = min(self._spin_count + 1, SPIN_WINDOWS)
        self._spin_norm += (min(squared, _SPIN_MOST) - self._spin_norm) / self._spin_count
        return outcome.with_spin(squared, rejected=not accepted)

    def _fourth_update(self, tick: Tick, spin: SpinConfig) -> None:
        """Equation (8), which the paper rejects: the field along the axis does not change from sample to sample."""
        field = tick.field_body_nt if self._last_field is None else np.vstack([self._last_field, tick.field_body_nt])
        self._last_field = tick.field_body_nt[-1]
        if tick.after_gap or len(field) < 2:
            return
        step = np.diff(field, axis=0)
        jacobian = np.array(spin.axis) @ (field_jacobian(step) * np.repeat([0.0, 1.0], [3, 6]))
        value = -(step @ np.array(spin.axis) + jacobian @ self._x)
        cross = self._covariance @ jacobian.T
        covariance = jacobian @ cross + 2.0 * self._noise_variance * np.eye(len(step))
        self._x, self._covariance = Innovation(value, covariance, cross).apply(self._x, self._covariance)

    def _follow_change(self, detector: ChangeDetector, now_s: float) -> None:
        """Where the errors have jumped, give their covariance what the jump needs, and judge consistency afresh."""
        change = detector.push(now_s, self._x, self._covariance, self._noise_variance)
        if change is None:
            return
        self.changes += 1
        self._x, self._covariance = change.x, change.covariance
        self._innovation_mean, self._innovation_count = 1.0, 0
        self._spin_norm, self._spin_count = 2.0, 0

    def _guard_consistency(self, magnitude_nt: float) -> None:
        """Restart where the samples, or the spin windows, keep contradicting the estimate."""
        spin_lost = self._spin_count == SPIN_WINDOWS and self._spin_norm > 2.0 * SPIN_LIMIT
        settled = self._innovation_count == INNOVATION_MEMORY
        changed = settled and self._innovation_mean > INNOVATION_LIMIT and not self._learning
        changed |= self._learning and self._noise_variance > (RUNAWAY_SHARE * magnitude_nt) ** 2
        if self._rejected_share > REJECTED_LIMIT or changed or spin_lost:
            self._spin_given_up |= spin_lost and self._rejected_share < _SCALAR_FITS
            self._restarts += 1
            self._begin()


METHOD = Method(
    "ukf",
    "nine-state UKF: scalar measurement and two spin pseudo-measurements, in real time",
    Ukf,
    takes_prior=True,
    bound=InformationSet.SCALAR_SPIN,
)
