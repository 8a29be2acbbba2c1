"""The spectrum of a residual, and the lines in it that the craft's own turning explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.model import Array

_FEWEST: Final = 64  # rows below which a spectrum says nothing
_MOST_SHOWN: Final = 300  # points of the plot; between them the largest of each group is kept
_SLOWEST_TURN: Final = 4.0  # turns within the stretch, below which a line is not told from drift
_TURN_SHARE: Final = 0.2  # of the power of a component that its line must hold to be a turn


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Amplitudes of a residual.

    Parameters
    ----------
    frequency_hz, amplitude_nt: of a sine [Hz, nT].
    turn_hz: how fast the craft turns, as the raw vector shows it [Hz]; None where it shows no turn.
    lines: (frequency [Hz], name) of what the turn explains, folded to below half the sample rate.
    """

    frequency_hz: list[float]
    amplitude_nt: list[float]
    turn_hz: float | None
    lines: list[tuple[float, str]]


def spectrum(time_s: Sequence[float], residual_nt: Sequence[float], vectors_nt: Array) -> Spectrum | None:
    """Amplitude spectrum of the residual by a Hann window; None where there are too few rows.

    Parameters
    ----------
    time_s, residual_nt: of each row (n,) [s, nT], times increasing.
    vectors_nt: measured vectors (n, 3) [nT], for the turn.

    Rows are put on a grid of their median step, where a missing one is zero; a step that varies blurs lines.
    """
    times = np.asarray(time_s, dtype=float)
    if times.size < _FEWEST:
        return None
    step_s = float(np.median(np.diff(times)))
    if not step_s > 0.0:
        return None
    place = np.rint((times - times[0]) / step_s).astype(int)
    size = int(place[-1]) + 1
    if not _FEWEST <= size <= 8 * times.size:
        return None
    residual = np.zeros(size)
    values = np.asarray(residual_nt, dtype=float)
    residual[place] = values - values.mean()
    window = np.hanning(size)
    amplitude = np.abs(np.fft.rfft(residual * window)) * 2.0 / window.sum()
    frequency = np.fft.rfftfreq(size, step_s)
    turn_hz = _turn(place, vectors_nt, window, frequency)
    shown = _thinned(frequency[1:], amplitude[1:])
    return Spectrum(*shown, turn_hz, [] if turn_hz is None else _lines(turn_hz, 0.5 / step_s))


def _turn(place: Array, vectors_nt: Array, window: Array, frequency: Array) -> float | None:
    """The frequency at which the measured vector turns [Hz], None where no line stands out."""
    grid = np.zeros((window.size, 3))
    grid[place] = vectors_nt - vectors_nt.mean(axis=0)
    power = (np.abs(np.fft.rfft(grid * window[:, None], axis=0)) ** 2).sum(axis=1)
    power[: int(np.ceil(_SLOWEST_TURN))] = 0.0
    peak = int(power.argmax())
    near = power[max(peak - 2, 0) : peak + 3].sum()
    total = float(power.sum())
    return float(frequency[peak]) if total > 0.0 and near > _TURN_SHARE * total else None


def _lines(turn_hz: float, nyquist_hz: float) -> list[tuple[float, str]]:
    folded = (abs(times * turn_hz - 2.0 * nyquist_hz * round(times * turn_hz / (2.0 * nyquist_hz))) for times in (1, 2))
    return list(zip(folded, ("turn", "twice the turn"), strict=True))


def _thinned(frequency: Array, amplitude: Array) -> tuple[list[float], list[float]]:
    """At most so many points as are shown; of each group its largest amplitude at its own frequency."""
    group = -(-frequency.size // _MOST_SHOWN)
    starts = range(0, frequency.size, group)
    best = [start + int(amplitude[start : start + group].argmax()) for start in starts]
    return [float(f"{frequency[i]:.6g}") for i in best], [float(f"{amplitude[i]:.4g}") for i in best]
