"""``ukf`` for many runs at once: the same filter, with an axis of runs, for Monte-Carlo studies.

All runs share the sample times and the reference and differ in what was measured.  The formulas are those of
``ukf`` and ``unscented``; results agree with them to rounding (a test holds that).  What stays one by one is the start:
each run has its own ``StartCollector`` until its batch solution is accepted, exactly as alone.

Not covered, and refused: unknown noise, equation (8) and ``filter.adaptive``.  A run with a rejected sample, or one
that comes near a loss of consistency, after which ``ukf`` starts anew or gives its spin windows up, is marked ``left``:
it goes no further and has to be repeated alone.  The limits are tighter than those at which ``ukf`` acts, so a run that
stays is the same.

Inside, the runs are the last axis: the scalar update is then plain arithmetic on long rows, several times faster than
thousands of small matrices.

Source: as ``ukf``.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.config import CraftConfig, SpinWindow
from magcal_service.estimators.spin_window import SpinWindows, Window
from magcal_service.estimators.start import StartCollector, prior_sigma
from magcal_service.estimators.unscented import UnscentedWeights, cholesky
from magcal_service.model import BIAS, STATE_SIZE, Array, d_matrix, field_jacobian
from magcal_service.ticks import Tick

Flags = NDArray[np.bool_]
Rows = NDArray[np.intp]

_INNOVATION_MEMORY: Final = 100
_INNOVATION_MEAN: Final = 2.0
_SPIN_MEMORY: Final = 16
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

    Raises ValueError where the configuration needs the filter alone (see ``supports``).
    """

    def __init__(self, config: CraftConfig, runs: int) -> None:
        if not self.supports(config):
            raise ValueError("sensor.noise_nt = None, spin.fourth or filter.adaptive: not in a batch, run it alone")
        settings, spin = config.filter, config.spin
        self._weights = UnscentedWeights.scaled(settings.alpha, settings.beta, settings.kappa)
        walk = np.array(settings.process_noise_bias_nt + settings.process_noise_D)
        self._walk = np.diag(walk**2)[:, :, None] if walk.any() else None
        self._gate = settings.gate_sigma**2
        self._inflation = settings.start_inflation**2
        self._variance = (config.sensor.noise_nt or 0.0) ** 2
        self._x: Array = np.zeros((STATE_SIZE, runs))
        self._covariance: Array = np.tile(np.diag(prior_sigma(settings) ** 2)[:, :, None], runs)
        self.running: Flags = np.zeros(runs, dtype=bool)
        self.left: Flags = np.zeros(runs, dtype=bool)
        self._starts = [StartCollector(config) for _ in range(runs)]
        self._windows = SpinWindows(spin) if spin is not None and spin.window is not SpinWindow.OFF else None
        self._recent: deque[Array] = deque(maxlen=_longest_window(config))
        self._innovation, self._innovations = np.ones(runs), np.zeros(runs, dtype=int)
        self._spin_norm, self._spin_count = np.full(runs, 2.0), np.zeros(runs, dtype=int)
        self._time_s = 0.0

    @property
    def x(self) -> Array:
        """The states (runs, 9) [nT, -]."""
        return self._x.T.copy()

    @property
    def covariance(self) -> Array:
        """Their covariances (runs, 9, 9)."""
        return _runs_first(self._covariance)

    @staticmethod
    def supports(config: CraftConfig) -> bool:
        """Whether a configuration can be run in a batch."""
        fourth = config.spin is not None and config.spin.fourth
        return config.sensor.noise_nt is not None and not (fourth or config.filter.adaptive)

    def handle(self, tick: Tick, field_body_nt: Array) -> None:
        """Take one tick of every run.

        Parameters
        ----------
        tick: one sample's time and reference; its own measured vector is not used.
        field_body_nt: measured vectors B (runs, 3) [nT].
        """
        self._recent.append(field_body_nt)
        window = self._windows.push(tick) if self._windows is not None else None
        fields = self._window_fields(window) if window is not None else None
        active = np.flatnonzero(self.running & ~self.left)  # a run that starts in this tick is updated from the next on
        self._collect(tick, field_body_nt, window, fields)
        if len(active):
            if self._walk is not None:
                self._covariance[:, :, active] += self._walk * (float(tick.times_s[-1]) - self._time_s)
            everyone = len(active) == len(self.left)
            self._scalar_update(slice(None) if everyone else active, field_body_nt, tick)
            if window is not None and fields is not None:
                self._spin_update(active, window, fields[active])
            self._guard_consistency()
        self._time_s = float(tick.times_s[-1])

    def _window_fields(self, window: Window) -> Array:
        """The measured vectors of a window that ends in this tick (runs, k, 3) [nT]."""
        newest = [self._recent[i] for i in range(-len(window.weights), 0)]
        return np.stack(newest, axis=1)

    def _collect(self, tick: Tick, field_nt: Array, window: Window | None, fields: Array | None) -> None:
        for run in np.flatnonzero(~self.running).tolist():
            own = replace(window, field_body_nt=fields[run]) if window is not None and fields is not None else None
            solution = self._starts[run].push(replace(tick, field_body_nt=field_nt[run][None]), own)
            if solution is not None:
                self._x[:, run], self._covariance[:, :, run] = solution.x, self._inflation * solution.covariance
                self.running[run] = True
                self.left[run] = self._starts[run].spin_contradicted or self._starts[run].noise_contradicted

    def _scalar_update(self, active: Rows | slice, field_nt: Array, tick: Tick) -> None:
        """``unscented.scalar_innovation`` and its application; rows in place of its numbers."""
        magnitude, variance, weights = float(tick.reference_magnitude_nt[-1]), self._variance, self._weights
        x, covariance = self._x[:, active], self._covariance[:, :, active]
        b1, b2, b3, d11, d22, d33, m12, m13, m23 = x
        B1, B2, B3 = field_nt[active].T
        m11, m22, m33 = 1.0 + d11, 1.0 + d22, 1.0 + d33
        w1 = m11 * B1 + m12 * B2 + m13 * B3 - b1
        w2 = m12 * B1 + m22 * B2 + m23 * B3 - b2
        w3 = m13 * B1 + m23 * B2 + m33 * B3 - b3
        length = np.sqrt(w1 * w1 + w2 * w2 + w3 * w3)
        residual = length - magnitude
        share = residual / length
        r1, r2, r3 = share * w1, share * w2, share * w3
        c11, c12, c13 = m22 * m33 - m23 * m23, m13 * m23 - m12 * m33, m12 * m23 - m13 * m22
        c22, c23, c33 = m11 * m33 - m13 * m13, m12 * m13 - m11 * m23, m11 * m22 - m12 * m12
        determinant = m11 * c11 + m12 * c12 + m13 * c13
        B1 = B1 - (c11 * r1 + c12 * r2 + c13 * r3) / determinant
        B2 = B2 - (c12 * r1 + c22 * r2 + c23 * r3) / determinant
        B3 = B3 - (c13 * r1 + c23 * r2 + c33 * r3) / determinant
        root = _roots(covariance)
        u1 = (B1 * root[3] + B2 * root[6] + B3 * root[7] - root[0]) * weights.spread
        u2 = (B2 * root[4] + B1 * root[6] + B3 * root[8] - root[1]) * weights.spread
        u3 = (B3 * root[5] + B1 * root[7] + B2 * root[8] - root[2]) * weights.spread
        linear = 2.0 * ((w1 - r1) * u1 + (w2 - r2) * u2 + (w3 - r3) * u3)
        quadratic = u1 * u1 + u2 * u2 + u3 * u3
        shift = 2.0 * weights.pair * quadratic.sum(axis=0)
        quadratic -= shift
        square = (linear * linear).sum(axis=0) + (quadratic * quadratic).sum(axis=0)
        noise = 4.0 * variance * magnitude * magnitude + 6.0 * variance * variance
        total = 2.0 * weights.pair * square + weights.covariance_0 * shift * shift + noise
        value = 3.0 * variance - residual * (length + magnitude) - shift
        cross = (root * linear).sum(axis=1) * (2.0 * weights.pair * weights.spread)
        norm = value * value / total
        used = norm <= self._gate
        weight = used / total
        self._x[:, active] = x + cross * (value * weight)
        self._covariance[:, :, active] = covariance - (cross * weight)[:, None] * cross
        self._innovations[active] = np.minimum(self._innovations[active] + used, _INNOVATION_MEMORY)
        step = used * (norm - self._innovation[active]) / np.maximum(self._innovations[active], 1)
        self._innovation[active] += step
        self.left[active] |= ~used

    def _spin_update(self, active: Rows, window: Window, field_nt: Array) -> None:
        """``Ukf._spin_innovation`` and its application, for (r, k, 3) measured vectors."""
        x, covariance = self._x[:, active].T, _runs_first(self._covariance[:, :, active])
        value, total, cross = self._spin_innovation(x, covariance, window, field_nt)
        squared = (value * np.linalg.solve(total, value[:, :, None])[:, :, 0]).sum(axis=1)
        gain = np.linalg.solve(total, cross.transpose(0, 2, 1)).transpose(0, 2, 1)
        gain *= (squared <= self._gate + 2.0)[:, None, None]
        updated = covariance - gain @ cross.transpose(0, 2, 1)
        self._x[:, active] = (x + (gain @ value[:, :, None])[:, :, 0]).T
        self._covariance[:, :, active] = np.moveaxis(0.5 * (updated + updated.transpose(0, 2, 1)), 0, 2)
        self._spin_count[active] = np.minimum(self._spin_count[active] + 1, _SPIN_MEMORY)
        excess = np.minimum(squared, 1e3) - self._spin_norm[active]
        self._spin_norm[active] += excess / self._spin_count[active]

    def _spin_innovation(
        self, x: Array, covariance: Array, window: Window, field_nt: Array
    ) -> tuple[Array, Array, Array]:
        """Innovation (r, 2), its covariance (r, 2, 2) and the state's covariance with it (r, 9, 2)."""
        weights, magnitude, across = window.weights, window.reference_magnitude_nt, window.across
        matrix, bias = np.eye(3) + d_matrix(x), x[:, None, BIAS]
        w = field_nt @ matrix - bias
        projected = w * (magnitude / np.sqrt((w * w).sum(axis=2)))[:, :, None]
        mean = (weights @ projected) @ across.T
        clean = projected - (mean @ across)[:, None, :]
        field_clean = (clean + bias) @ np.linalg.inv(matrix)
        root = _runs_first(_roots(np.moveaxis(covariance, 0, 2)))
        offsets = self._weights.spread * root
        points = np.concatenate([x[:, :, None], x[:, :, None] + offsets, x[:, :, None] - offsets], axis=2)
        runs, samples = field_clean.shape[:2]
        moved = field_jacobian(field_clean).reshape(runs, 3 * samples, STATE_SIZE) @ points
        moved = moved.reshape(runs, samples, 3, -1) + field_clean[..., None]  # (r, k, 3, 19)
        length = np.sqrt((moved * moved).sum(axis=2))
        moved *= ((weights * magnitude)[:, None] / length)[:, :, None]
        outputs = across @ moved.sum(axis=1)  # (r, 2, 19)
        unit = (projected / magnitude[:, None]) @ across.T
        tangential = np.eye(2) * (weights**2).sum() - (unit * weights[:, None] ** 2).transpose(0, 2, 1) @ unit
        noise = self._variance * window.share * tangential + window.leak_nt**2 * np.eye(2)
        return _transformed(root, self._weights, outputs, outputs[:, :, 0] - mean, noise)

    def _guard_consistency(self) -> None:
        changed = (self._innovations == _INNOVATION_MEMORY) & (self._innovation > _INNOVATION_MEAN)
        spin = (self._spin_count == _SPIN_MEMORY) & (self._spin_norm > _SPIN_MEAN)
        self.left |= changed | spin


def _longest_window(config: CraftConfig) -> int:
    """Samples to keep for spin windows at one sample a second."""
    if config.spin is None:
        return 1
    turns_s = config.spin.window_turns * 60.0 / abs(config.spin.rate_rpm)
    return max(int(turns_s) + 2, config.spin.window_samples or 0)


def _runs_first(matrices: Array) -> Array:
    """Matrices (m, n, r) as (r, m, n), in memory too."""
    return np.ascontiguousarray(np.moveaxis(matrices, 2, 0))


def _roots(covariance: Array) -> Array:
    """Lower Cholesky factors of (9, 9, r), column by column; by ``unscented.cholesky`` where one fails."""
    root = np.zeros_like(covariance)
    for j in range(STATE_SIZE):
        column = covariance[j:, j] - (root[j:, :j] * root[j, :j]).sum(axis=1)
        if not (column[0] > 0.0).all():
            return np.stack([cholesky(matrix) for matrix in _runs_first(covariance)], axis=2)
        root[j:, j] = column / np.sqrt(column[0])
    return root


def _transformed(
    root: Array, weights: UnscentedWeights, outputs: Array, measured: Array, noise: Array
) -> tuple[Array, Array, Array]:
    """``unscented.transformed_innovation`` for outputs (r, m, 19): value, covariance, cross."""
    mean = weights.mean_0 * outputs[:, :, 0] + weights.pair * outputs[:, :, 1:].sum(axis=2)
    d_0, d = outputs[:, :, 0] - mean, outputs[:, :, 1:] - mean[:, :, None]
    centre = weights.covariance_0 * d_0[:, :, None] * d_0[:, None, :]
    covariance = centre + weights.pair * d @ d.transpose(0, 2, 1) + noise
    odd = d[:, :, :STATE_SIZE] - d[:, :, STATE_SIZE:]
    cross = (weights.pair * weights.spread) * root @ odd.transpose(0, 2, 1)
    return measured - mean, covariance, cross
