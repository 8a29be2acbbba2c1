"""Spin pseudo-measurements: what one stretch of spin says about the bias and axes across the spin axis.

Across the spin axis the true field A H turns, so over a stretch of spin its mean is zero and equation (6) measures the
bias.  Two things spoil the plain mean: samples that don't divide the turn evenly, and H turning meanwhile (393 nT rms
at 60 s spin).  ``harmonic`` therefore takes the constant of a least-squares fit of {1, cos wt, sin wt, t cos wt,
t sin wt}: any sampling, gaps included, and the leak is left in second order only.  ``mean`` is the paper's plain mean.

Source: Cetin, Soken, Tekinalp 2020, equations (5) and (6); the harmonic weights are original to this project.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.base.snapshot import Stateful
from magcal_service.config.settings import SpinConfig, SpinWindow
from magcal_service.model import Array
from magcal_service.ticks.assembler import Tick

LEO_FIELD_RATE_RAD_S: Final = 2.3e-3
"""Fastest turn of H in a low orbit, twice the orbital rate at 350 km; used where no reference vector gives it."""

_SECOND_ORDER_LEAK: Final = 3.0
"""rms of the harmonic constant for a field turning at W under a spin w is below this times |H| (W/w)^2."""

_UNSOUND: Final = 6.5
"""Residual of a vector to the fit, in noise sigmas, that noise does not have: 4 of 10^9 exceed it."""

_UNSOUND_BY_MEDIAN: Final = 8.0
"""The same in medians of the residuals, where the noise is not given: 12 sigmas, since the median is 1.54 of them.

Choice: the median of the dozen vectors of a short window is itself uncertain by a sixth; at 6.5 sigmas, four medians,
it would cost sound ones.
"""

_MOST_UNSOUND: Final = 0.25
"""Share of a window that may be left out: where more would have to go, the model is wrong and not the vectors."""

_FEWEST_JUDGED: Final = 8
"""Vectors from which on a fit with six columns leaves two to judge them by; below, all are taken."""

_FEWEST_FOR_SQUARE: Final = 40
"""Vectors beyond which the fit has nine columns; choice: more than four for each column that they determine."""


@dataclass(frozen=True, slots=True)
class Window:
    """One stretch of spin, ready as a measurement.

    Parameters
    ----------
    weights: of the samples in the mean, sum 1, shape (k,).
    field_body_nt: measured vectors B (k, 3) [nT].
    reference_magnitude_nt: |H| (k,) [nT].
    across: two unit body vectors across the spin axis (2, 3).
    leak_nt: 1 sigma of the residual of A H in the mean, per component [nT].
    share: factor on the noise variance because windows overlap (1 where they don't) [-].
    """

    weights: Array
    field_body_nt: Array
    reference_magnitude_nt: Array
    across: Array
    leak_nt: float
    share: float


def across_axis(axis: Array) -> Array:
    """Two unit vectors (2, 3) that complete a unit body vector (3,) to a right-handed triad."""
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first)])


def _design(times_s: Array, rate_rad_s: float) -> Array:
    """Columns {1, cos, sin, t cos, t sin} (k, 5), each of length 1."""
    t = times_s - times_s.mean()
    phase = rate_rad_s * t
    cos, sin = np.cos(phase), np.sin(phase)
    return _normalised([np.ones_like(t), cos, sin, t * cos, t * sin])


def _normalised(columns: list[Array]) -> Array:
    """Columns (k,) as one matrix (k, n), each of length 1."""
    design: Array = np.array(columns).T.copy()  # row by row in memory: sums over rows depend on it in the last bit
    design /= np.sqrt(np.add.reduce(design * design))
    return design


def harmonic_leak_nt(magnitude_nt: Array, turn_ratio: float) -> float:
    """1 sigma [nT] of the residual of A H in a window's harmonic mean, per component.

    Parameters
    ----------
    magnitude_nt: |H| of the window's samples (k,) [nT].
    turn_ratio: rate at which H turns over the spin rate [-].
    """
    return _SECOND_ORDER_LEAK * float(magnitude_nt.mean()) * turn_ratio**2


def harmonic_weights(times_s: Array, rate_rad_s: float) -> Array | None:
    """Weights (k,) of the constant in a fit of {1, cos, sin, t cos, t sin} at the spin rate; None where undefined."""
    design = _design(times_s, rate_rad_s)
    normal = design.T @ design
    if np.linalg.eigvalsh(normal)[0] < 1e-4:  # the constant can't be separated from the spin: aliased or too short
        return None
    weights: Array = np.linalg.solve(normal, design.T)[0].copy()  # in one piece, as a restored one is: sums are alike
    weights /= weights.sum()
    return weights


def _smooth_design(times_s: Array, rate_rad_s: float) -> Array:
    """Columns for all three components of a field that turns meanwhile: {1, t}, and the same times cos and sin.

    With t^2, too, where there are samples for it: (k, 6) or (k, 9), each column of length 1.
    """
    t = times_s - times_s.mean()
    phase, t = rate_rad_s * t, t / max(float(np.abs(t).max()), 1e-9)
    slow = [np.ones_like(t), t, t * t - 1.0 / 3.0] if len(t) > _FEWEST_FOR_SQUARE else [np.ones_like(t), t]
    return _normalised([term * turn for turn in (1.0, np.cos(phase), np.sin(phase)) for term in slow])


def sound_samples(times_s: Array, field_nt: Array, rate_rad_s: float, noise_nt: float | None) -> NDArray[np.bool_]:
    """Which vectors (k, 3) [nT] of a window agree with its harmonic fit (k,); all, where too many would have to go.

    A corrupted vector may keep its length, so that no scalar measurement shows it, and would spoil the whole window.
    The worst are removed one by one until the fit of the rest holds without them, and each is tested against that fit.
    Their residuals are compared with ``noise_nt`` [nT] where that is given, and else with the median; physics that no
    harmonic fits spoils more than a quarter, and nothing is left out.

    The fit has terms in t of every component: along the spin axis the field goes by 80 nT/s in a low orbit, more than
    the noise of a good sensor within a window.
    """
    if len(times_s) < _FEWEST_JUDGED:
        return np.ones(len(times_s), dtype=bool)
    design, keep = _smooth_design(times_s, rate_rad_s), np.ones(len(times_s), dtype=bool)
    everything = keep.copy()
    for _ in range(int(_MOST_UNSOUND * len(keep))):
        scaled, limit_nt = _against_fit(design, field_nt, keep, noise_nt)
        worst = int(np.argmax(np.where(keep, scaled, 0.0)))
        if scaled[worst] <= (limit_nt if noise_nt else 0.5 * limit_nt):
            break
        keep[worst] = False
    if keep.all():
        return everything
    scaled, limit_nt = _against_fit(design, field_nt, keep, noise_nt)
    sound: NDArray[np.bool_] = scaled <= limit_nt
    return sound if sound[keep].all() else everything


def _against_fit(
    design: Array, field_nt: Array, keep: NDArray[np.bool_], noise_nt: float | None
) -> tuple[Array, float]:
    """Residuals (k,) of all vectors to the fit of those kept, scaled to the noise's length, and their limit [nT]."""
    q, triangle = np.linalg.qr(design[keep])
    residual = field_nt - design @ np.linalg.solve(triangle, q.T @ field_nt[keep])
    leverage = (np.linalg.solve(triangle.T, design.T) ** 2).sum(axis=0)
    free = np.where(keep, np.maximum(1.0 - leverage, 0.1), 1.0 + leverage)
    scaled = np.sqrt((residual * residual).sum(axis=1) / free)
    return scaled, _UNSOUND * noise_nt if noise_nt else _UNSOUND_BY_MEDIAN * float(np.median(scaled[keep]))


@dataclass(init=False, repr=False, eq=False)
class SpinWindowsMemory:
    """What of ``SpinWindows`` outlives a restart, saved and restored whole."""

    _ticks: deque[Tick]
    _first_s: float
    _samples: int


class SpinWindows(Stateful, SpinWindowsMemory):
    """Collects ticks into windows of spin.

    Parameters
    ----------
    spin: the configured spin.
    noise_nt: the sensor's noise, 1 sigma per axis [nT]; None: not known.
    """

    def __init__(self, spin: SpinConfig, noise_nt: float | None = None) -> None:
        self.spin = spin
        self._noise_nt = noise_nt
        self._across = across_axis(np.array(spin.axis))
        self._rate_rad_s = abs(spin.rate_rpm) * 2.0 * math.pi / 60.0
        self._span_s = spin.window_s
        self._ticks = deque()
        self._first_s = 0.0
        self._samples = 0

    def clear(self) -> None:
        """Forget the ticks of an unfinished window."""
        self._ticks.clear()
        self._samples = 0

    def push(self, tick: Tick) -> Window | None:
        """Add one tick; a finished window, or None."""
        if tick.after_gap:
            self.clear()
        if not self._ticks:
            self._first_s = float(tick.times_s[0])
        self._ticks.append(tick)
        self._samples += len(tick.times_s)
        if self.spin.window is SpinWindow.MEAN:
            return self._mean()
        if float(tick.times_s[-1]) - self._first_s < self._span_s * (1.0 - 1.0 / max(self._samples, 2)) - 1e-6:
            return None
        window = self._harmonic()
        self.clear()
        return window

    def _joined(self) -> tuple[Array, Array, Array]:
        times = np.concatenate([tick.times_s for tick in self._ticks])
        fields = np.concatenate([tick.field_body_nt for tick in self._ticks])
        magnitudes = np.concatenate([tick.reference_magnitude_nt for tick in self._ticks])
        return times, fields, magnitudes

    def _field_rate_rad_s(self) -> float:
        first, last = self._ticks[0], self._ticks[-1]
        span_s = float(last.times_s[-1] - first.times_s[0])
        if first.reference_eci_nt is None or last.reference_eci_nt is None or span_s <= 0.0:
            return LEO_FIELD_RATE_RAD_S
        a, b = first.reference_eci_nt[0], last.reference_eci_nt[-1]
        (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
        across = np.array((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx))
        return math.atan2(math.sqrt(float(across @ across)), float(a @ b)) / span_s

    def _harmonic(self) -> Window | None:
        times, fields, magnitudes = self._joined()
        if len(times) < 6:
            return None
        sound = sound_samples(times, fields, self._rate_rad_s, self._noise_nt)
        if not sound.all():
            times, fields, magnitudes = times[sound], fields[sound], magnitudes[sound]
        weights = harmonic_weights(times, self._rate_rad_s)
        if weights is None:
            return None
        leak_nt = harmonic_leak_nt(magnitudes, self._field_rate_rad_s() / self._rate_rad_s)
        return Window(weights, fields, magnitudes, self._across, leak_nt, 1.0)

    def _mean(self) -> Window | None:
        """The paper's window of N samples that moves on by one tick, so that a sample is seen N times."""
        period_s = 60.0 / abs(self.spin.rate_rpm)
        per_tick = len(self._ticks[-1].times_s)
        count = self.spin.window_samples or max(2, round(self.spin.window_turns * period_s * per_tick))
        while self._samples - len(self._ticks[0].times_s) >= count:
            self._samples -= len(self._ticks.popleft().times_s)
        if self._samples < count:
            return None
        times, fields, magnitudes = (part[-count:] for part in self._joined())
        turns = (times[-1] - times[0]) * count / (count - 1) / period_s
        weights = np.full(count, 1.0 / count)
        tone = abs(complex(np.exp(1j * self._rate_rad_s * (times - times[0])).mean()))  # an uneven turn leaves a tone
        ratio = self._field_rate_rad_s() / self._rate_rad_s
        leak_nt = float(magnitudes.mean()) * math.hypot(tone, ratio / max(turns, 1.0) if turns > 0.5 else 1.0)
        return Window(weights, fields, magnitudes, self._across, leak_nt / math.sqrt(2.0), count / per_tick)
