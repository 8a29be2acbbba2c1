"""``ukf`` for many runs at once: the same filter, with an axis of runs, for Monte-Carlo studies.

All runs share the sample times and the reference and differ in what was measured.  The formulas are those of
``ukf``, ``start`` and ``unscented``; results agree with them to rounding (a test holds that).

Not covered, and rejected: unknown noise, equation (8) and ``filter.adaptive``.  A run with a rejected sample, one whose
start is not plain (``batched_start``), or one that comes near a loss of consistency, after which ``ukf`` restarts or
gives its spin windows up, is marked ``left``: it goes no further and has to be repeated alone.  The limits are tighter
than those at which ``ukf`` acts, so a run that stays is the same.

Inside, the runs are the last axis (``unscented``), but for equation (6): it is worked out once a window, by the same
``spin_innovation`` as in ``ukf``, with the runs first.  Those that have started and not left fill the first columns of
every array, so that an update works on one slice without copying.

Source: as ``ukf``.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.config.settings import CraftConfig, SpinWindow
from magcal_service.estimators.parts.sample_gate import SampleGate
from magcal_service.estimators.parts.spin_innovation import spin_innovation
from magcal_service.estimators.parts.spin_window import SpinWindows, Window
from magcal_service.estimators.parts.start import prior_sigma
from magcal_service.estimators.parts.unscented import UnscentedWeights
from magcal_service.estimators.ukf import INNOVATION_MEMORY, SPIN_WINDOWS
from magcal_service.model import STATE_SIZE, Array
from magcal_service.studies.batched.start import BatchedStart
from magcal_service.studies.batched.unscented import roots, scalar_innovations
from magcal_service.ticks.assembler import Tick

Flags = NDArray[np.bool_]

_INNOVATION_MEAN: Final = 2.0  # below the 2.5 of ``ukf``: a run leaves before its single filter would act
_SPIN_MEAN: Final = 2.0 * 2.5
"""Running means of squared innovations, and of those of spin windows, at which a run leaves the batch.

``ukf`` acts at 2.5 and at 2 x 3.  Good runs have 1 +- 0.1 and 2 +- 0.5: none leaves by chance.
"""


class BatchedUkf:
    """The filters of many runs.

    Parameters
    ----------
    config: the craft's configuration, the same for every run.
    runs: how many.

    Attributes
    ----------
    running, left: runs that have started, and runs that have to be repeated alone (runs,).

    Raises ValueError where the configuration needs the filter alone (see ``supports``).
    """

    def __init__(self, config: CraftConfig, runs: int) -> None:
        if not self.supports(config):
            raise ValueError("sensor.noise_nt = None, spin.fourth or filter.adaptive: not in a batch, run it alone")
        settings, spin = config.filter, config.spin
        self._weights = UnscentedWeights.scaled(settings.alpha, settings.beta, settings.kappa)
        walk = np.array(settings.process_noise_bias_nt + settings.process_noise_D)
        self._walk = walk**2 if walk.any() else None
        self._gate = SampleGate.of(settings)
        self._inflation = settings.start_inflation**2
        self._variance = (config.sensor.noise_nt or 0.0) ** 2
        self.running: Flags = np.zeros(runs, dtype=bool)
        self.left: Flags = np.zeros(runs, dtype=bool)
        self._start = BatchedStart(config)
        usable = spin is not None and spin.window is not SpinWindow.OFF
        self._windows = (
            SpinWindows(spin, math.inf) if usable and spin is not None else None
        )  # vectors are the runs' own
        self._recent: deque[Array] = deque(maxlen=_longest_window(config))
        # by column: run number, and what ``ukf`` keeps of each run
        self._run = np.arange(runs)
        self._active = 0
        self._x: Array = np.zeros((STATE_SIZE, runs))
        self._covariance: Array = np.tile(np.diag(prior_sigma(settings) ** 2)[:, :, None], runs)
        self._innovation, self._innovations = np.ones(runs), np.zeros(runs, dtype=int)
        self._spin_norm, self._spin_count = np.full(runs, 2.0), np.zeros(runs, dtype=int)
        self._root, self._scratch = np.zeros_like(self._covariance), np.empty_like(self._covariance)
        self._time_s = 0.0

    @property
    def x(self) -> Array:
        """The states (runs, 9) [nT, -]."""
        return self._x.T[self._column()]

    @property
    def covariance(self) -> Array:
        """Their covariances (runs, 9, 9)."""
        covariance: Array = np.moveaxis(self._covariance, 2, 0)[self._column()]
        return covariance

    def _column(self) -> NDArray[np.intp]:
        """The column of each run (runs,)."""
        return np.argsort(self._run)

    @staticmethod
    def supports(config: CraftConfig) -> bool:
        """Whether a configuration can be run in a batch."""
        fourth = config.spin is not None and config.spin.fourth
        return config.sensor.noise_nt is not None and not (fourth or config.filter.adaptive)

    def handle(self, tick: Tick, field_body_nt: Array) -> None:
        """Take one tick of every run.

        Parameters
        ----------
        tick: one sample's time and reference; its measured vector is not used.
        field_body_nt: measured vectors B (runs, 3) [nT]; fastest where the runs are next to each other in memory.
        """
        self._recent.append(field_body_nt)
        window = self._windows.push(tick) if self._windows is not None else None
        now_s = float(tick.times_s[-1])
        if self._active:  # a run that starts in this tick is updated from the next on
            if self._walk is not None:
                for i, variance in enumerate(self._walk.tolist()):
                    self._covariance[i, i, : self._active] += variance * (now_s - self._time_s)
            self._scalar_update(field_body_nt, float(tick.reference_magnitude_nt[-1]))
            if window is not None:
                self._spin_update(window)
        self._collect(tick, field_body_nt, window)
        self._leave()
        self._time_s = now_s

    def _window_fields(self, window: Window, runs: NDArray[np.intp]) -> Array:
        """The measured vectors of a window that ends in this tick (runs, k, 3) [nT]."""
        newest = [self._recent[i][runs] for i in range(-len(window.weights), 0)]
        return np.stack(newest, axis=1)

    def _collect(self, tick: Tick, field_nt: Array, window: Window | None) -> None:
        """Starts; a run that starts moves to the first column that is free."""
        waiting = np.flatnonzero(~(self.running | self.left))
        if not len(waiting):
            return
        fields = self._window_fields(window, np.arange(len(field_nt))) if window is not None else None
        self._start.push(tick, field_nt, window, fields)
        starts = self._start.attempt(waiting)
        self.left[starts.irregular] = True
        for run, solution in starts.solutions.items():
            column = int(np.flatnonzero(self._run == run)[0])
            self._swap(column, self._active)
            self._x[:, self._active] = solution.x
            self._covariance[:, :, self._active] = self._inflation * solution.covariance
            self.running[run] = True
            self._active += 1

    def _swap(self, one: int, other: int) -> None:
        """Exchange two columns."""
        pair, crossed = [one, other], [other, one]
        for rows in (self._run, self._x, self._covariance, self._innovation, self._innovations):
            rows[..., pair] = rows[..., crossed]
        for rows in (self._spin_norm, self._spin_count):
            rows[..., pair] = rows[..., crossed]

    def _scalar_update(self, field_nt: Array, magnitude_nt: float) -> None:
        """Equation (3) for every run in progress."""
        count = self._active
        x, covariance, root = self._x[:, :count], self._covariance[:, :, :count], self._root[:, :, :count]
        field = field_nt.T[:, self._run[:count]]
        found = scalar_innovations(x, roots(covariance, root), self._weights, field, magnitude_nt, self._variance)
        norm = found.value * found.value / found.variance
        used = norm <= self._gate.limits(found.variance, found.noise_variance)
        weight = used / found.variance
        scaled = found.cross * weight
        x += scaled * found.value
        covariance -= np.multiply(scaled[:, None], found.cross, out=self._scratch[:, :, :count])
        self._innovations[:count] = np.minimum(self._innovations[:count] + used, INNOVATION_MEMORY)
        excess = used * (norm - self._innovation[:count])
        self._innovation[:count] += excess / np.maximum(self._innovations[:count], 1)
        self.left[self._run[:count][~used]] = True

    def _spin_update(self, window: Window) -> None:
        """Equations (6) for every run in progress."""
        count = self._active
        x, covariance, root = self._x[:, :count], self._covariance[:, :, :count], self._root[:, :, :count]
        field = self._window_fields(window, self._run[:count])
        states = np.ascontiguousarray(x.T), np.ascontiguousarray(np.moveaxis(roots(covariance, root), 2, 0))
        found = spin_innovation(*states, self._weights, window, field, self._variance)
        squared = (found.value * np.linalg.solve(found.covariance, found.value[..., None])[..., 0]).sum(axis=1)
        gain = np.moveaxis(found.gain(), 0, 2) * (squared <= self._gate.squared + 2.0)  # (9, 2, r)
        x += (gain * found.value.T).sum(axis=1)
        cross = np.moveaxis(found.cross, 0, 2)
        for i in range(2):
            covariance -= np.multiply(gain[:, None, i], cross[:, i], out=self._scratch[:, :, :count])
        self._spin_count[:count] = np.minimum(self._spin_count[:count] + 1, SPIN_WINDOWS)
        excess = np.minimum(squared, 1e3) - self._spin_norm[:count]
        self._spin_norm[:count] += excess / self._spin_count[:count]

    def _leave(self) -> None:
        """Runs near a loss of consistency leave; all that have left make room."""
        count = self._active
        changed = (self._innovations[:count] == INNOVATION_MEMORY) & (self._innovation[:count] > _INNOVATION_MEAN)
        changed |= (self._spin_count[:count] == SPIN_WINDOWS) & (self._spin_norm[:count] > _SPIN_MEAN)
        self.left[self._run[:count][changed]] = True
        for column in np.flatnonzero(self.left[self._run[:count]])[::-1].tolist():
            self._active -= 1
            self._swap(column, self._active)


class BatchedScalarUkf(BatchedUkf):
    """``scalar-ukf`` for many runs: whatever spin the configuration states is left aside."""

    def __init__(self, config: CraftConfig, runs: int) -> None:
        super().__init__(replace(config, spin=None), runs)

    @staticmethod
    def supports(config: CraftConfig) -> bool:
        """Whether a configuration can be run in a batch."""
        return BatchedUkf.supports(replace(config, spin=None))


def _longest_window(config: CraftConfig) -> int:
    """Samples to keep for spin windows at one sample a second."""
    if config.spin is None:
        return 1
    return max(int(config.spin.window_s) + 2, config.spin.window_samples or 0)
