"""Tones that wander: a body-fixed oscillation whose frequency moves, as of a wheel that changes its speed.

A tone of one frequency holds next to nothing of it, and neither does any slow course.  The recording is cut into
windows; in each the wave is a chirp of some frequency and slope, and both go on from one window to the next.  The track
that holds most is found by dynamic programming (Viterbi 1967, IEEE Transactions on Information Theory 13, 260-269).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.lines import ORBIT_SIDE_HZ, folded
from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene

_WINDOWS: Final = (24, 48)
"""Windows that a recording is cut into; choice: the fewer, the fainter a wave may be, and the more, the quicker it may
change its pitch.  What hardly moves in a twelfth of the recording is a line that comes and goes (``shapes``)."""

_FEWEST: Final = 64
"""Samples in a window on the average, from which on a wave and its slope are known there."""

_FULL: Final = 0.5
"""Share of a recording that its samples have to fill: windows of passes days apart would be all pause."""

_SLOPES: Final = 16
"""Slopes to either side of none, in steps of ``2 / width^2``: half a step turns the ends of a window by an eighth of a
turn, and the steepest crosses 32 of its bins."""

_STEP: Final = 4
"""Half bins of frequency that one step of slope leads to in a window: ``2 / width^2`` times its width, over half of
``1 / width``."""

_TURNS: Final = np.arange(-1, 2)
"""Steps of slope, and half bins of frequency, by which a window may differ from what the one before leads to."""

_WANDERED: Final = 3.0  # half bins of a window that its frequency has moved by at the least: less may be a steady one
_SLOWEST_HZ: Final = 1.0 / 120.0  # what is slower may be the field model's crust, as for a tone (``grids``)
_FEWEST_CYCLES: Final = 8.0  # of the slowest wave in a window, so that it is no course of its own
_AGAIN: Final = 2  # tracks that are sought with the wave's shape of the one before; a third changes nothing
_OF_A_SHAPE: Final = 4.0  # numbers of a wave's shape in the body beside its amplitude and phase

Powers = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """A wandering tone.

    Parameters
    ----------
    rows: (n, 2 windows) along the field, cosine and sine of its phase in each window by itself.
    cost: of choosing it among all tracks [nats].
    from_hz, to_hz: its least and its greatest frequency.
    """

    rows: Array
    cost: float
    from_hz: float
    to_hz: float


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """Samples by window: number of each (n,), time from its window's middle [s], and the grids of a window's chirps."""

    number: NDArray[np.intp]
    into_s: Array
    slope: Array
    frequency: Array
    usable: NDArray[np.bool_]

    @classmethod
    def of(cls, scene: Scene, count: int, spin_hz: float | None) -> _Windows:
        elapsed = scene.time_s - scene.time_s[0]
        width_s = (float(elapsed[-1]) + scene.period_s) / count
        number = np.minimum((elapsed / width_s).astype(np.intp), count - 1)
        count_in = math.ceil(width_s / scene.period_s)
        whole_s = count_in * scene.period_s
        frequency = np.arange(count_in) / (2.0 * whole_s)  # half bins: as of a window and as much again of zeros
        usable = frequency >= max(_SLOWEST_HZ, _FEWEST_CYCLES / width_s)
        usable &= frequency <= 0.5 / scene.period_s - 1.0 / width_s
        for harmonic in () if spin_hz is None else (spin_hz, 2.0 * spin_hz):
            line = folded(harmonic, 1.0 / scene.period_s)
            usable &= np.abs(frequency - line) > max(2.0 / width_s, ORBIT_SIDE_HZ)
        slope = 2.0 / whole_s**2 * np.arange(-_SLOPES, _SLOPES + 1)
        return cls(number, elapsed - (number + 0.5) * width_s, slope, frequency, usable)

    def waves(self, weighted: Array, period_s: float) -> NDArray[np.complex64]:
        """(windows, slopes, frequencies, 3) sums of rows (n, 3) times each chirp, conjugated."""
        size, count = 2 * len(self.frequency), int(self.number[-1]) + 1
        slot = np.rint(self.into_s / period_s).astype(np.intp) % size
        waves = np.zeros((count, len(self.slope), size // 2, 3), dtype=np.complex64)
        for window in range(count):
            rows = np.flatnonzero(self.number == window)
            chirp = np.exp(-1j * np.pi * np.outer(self.slope, self.into_s[rows] ** 2))
            grid = np.zeros((len(self.slope), 3, size), dtype=np.complex128)
            grid[:, :, slot[rows]] = chirp[:, None, :] * weighted[rows].T
            waves[window] = np.fft.fft(grid)[:, :, : size // 2].swapaxes(1, 2)
        return waves

    def turning(self, path: NDArray[np.intp]) -> NDArray[np.complex128]:
        """(n,) exp(i phase) along a path."""
        hz, slope = self.frequency[path[:, 1]][self.number], self.slope[path[:, 0]][self.number]
        return np.asarray(np.exp(2j * np.pi * (hz + 0.5 * slope * self.into_s) * self.into_s))


def tracks(scene: Scene, residual: Array, unit: Array, spin_hz: float | None) -> list[Track]:
    """The best track for each number of windows; none of a recording that is mostly pause.

    Parameters
    ----------
    scene: whose times count.
    residual: (n,) [nT], none of them far out: one such sample would lie on every track.
    unit: (n, 3) directions of the field in the body.
    spin_hz: near which, and near whose double, no wave is looked for.
    """
    span_s = float(scene.time_s[-1] - scene.time_s[0])
    if len(scene) * scene.period_s < _FULL * span_s:
        return []
    counts = (count for count in _WINDOWS if len(scene) >= _FEWEST * count)
    found = (_track(scene, residual, unit, _Windows.of(scene, count, spin_hz)) for count in counts)
    return [one for one in found if one is not None]


def _track(scene: Scene, residual: Array, unit: Array, windows: _Windows) -> Track | None:
    """The best track, its wave of one shape in the body: ``Re(c_w exp(i phase))`` times a complex vector."""
    if windows.usable.sum() < 2:
        return None
    waves = windows.waves(residual[:, None] * unit, scene.period_s)
    normal = unit.T @ unit
    root = np.linalg.cholesky(np.linalg.inv(normal + 1e-3 * float(np.trace(normal)) * np.eye(3)))
    power = np.sum(np.abs(waves @ root.astype(np.complex64)) ** 2, axis=-1)
    count = len(waves)
    for _ in range(_AGAIN):
        path = _best_path(np.where(windows.usable, power, np.float32(0.0)))
        along = waves[np.arange(count), path[:, 0], path[:, 1]] @ root
        shape = root @ np.linalg.svd(along, full_matrices=False)[2][0]
        power = np.abs(waves @ shape.conj().astype(np.complex64)) ** 2
    seen = windows.usable[path[:, 1]] & np.isin(np.arange(count), windows.number)
    hz = windows.frequency[path[seen, 1]]
    if not seen.any() or hz.max() - hz.min() < _WANDERED * windows.frequency[1]:
        return None
    turning = windows.turning(path) * (unit @ shape) * seen[windows.number]
    rows = np.zeros((len(scene), 2 * count))
    each = np.arange(len(scene))
    rows[each, 2 * windows.number], rows[each, 2 * windows.number + 1] = turning.real, turning.imag
    states = int(windows.usable.sum()) * len(windows.slope) * len(_WINDOWS)
    cost = math.log(states) + 2.0 * (count - 1) * math.log(len(_TURNS)) + 0.5 * _OF_A_SHAPE * math.log(len(scene))
    return Track(rows, cost, float(hz.min()), float(hz.max()))


def _best_path(power: Powers) -> NDArray[np.intp]:
    """(windows, 2) indices of slope and frequency in each window, along which most power (windows, s, f) lies."""
    totals = [power[0]]
    for each in power[1:]:
        totals.append(each + _reached(totals[-1]))
    count, levels, width = power.shape
    path = np.empty((count, 2), dtype=np.intp)
    path[-1] = divmod(int(np.argmax(totals[-1])), width)
    for window in range(count - 1, 0, -1):
        level, place = path[window]
        came = [
            (float(totals[window - 1][before, source]), before, source)
            for before in level + _TURNS
            for source in place - _moved(level, before, levels) - _TURNS
            if 0 <= before < levels and 0 <= source < width
        ]
        path[window - 1] = max(came)[1:]
    return path


def _reached(total: Powers) -> Powers:
    """(s, f) the most that a track can have had in the window before."""
    levels, width = total.shape
    edge = np.full((levels, 2), -np.inf, dtype=np.float32)
    wide = np.concatenate([edge, total, edge], axis=1)
    near = np.maximum(np.maximum(wide[:, :-2], wide[:, 1:-1]), wide[:, 2:])  # its first is one bin below all
    best = np.full_like(total, -np.inf)
    for level in range(levels):
        for before in range(max(level - 1, 0), min(level + 2, levels)):
            first = 1 - _moved(level, before, levels)
            low, high = max(-first, 0), min(width + 2 - first, width)
            if low < high:
                np.maximum(best[level, low:high], near[before, low + first : high + first], out=best[level, low:high])
    return best


def _moved(level: int, before: int, levels: int) -> int:
    """Half bins of frequency from one window to the next, by the slopes of both."""
    return _STEP * (level + before - (levels - 1)) // 2
