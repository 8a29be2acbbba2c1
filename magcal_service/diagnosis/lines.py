"""Lines of a residual: frequencies at which a body-fixed oscillation would explain most of it."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene

_SLOWEST_PERIODS: Final = 8.0
"""Periods that a tone has to have in the recording; choice: fewer cannot be distinguished from a drift or a step."""

_SLOWEST_S: Final = 900.0
"""Longest period of a tone [s]: a sixth of a low orbit; what is slower belongs to orbit, light and warmth."""

_APART_BINS: Final = 4
"""Bins to either side that belong to a line: its main lobe, two to four of them at a padding of two to four times."""

_PEAK: Final = 2.0
"""How far a peak has to stand above the mean of what lies below it to be an oscillation; choice: a factor of two."""

_WAVES: Final = 6
"""Of a course that repeats, the waves that are summed up: choice, of five uneven levels they hold nearly all."""

_WAVE_NATS: Final = 9.0
"""Of a wave, what noise seldom holds [nats]: in 6 of 1000 places, for the square of six amplitudes."""

_FINER: Final = 2 * _WAVES  # steps in one of the spectrum's: then the sixth wave is met within half of one
_FEWEST_CYCLES: Final = 4.0  # what came back less often is no cycle yet
_FEWEST_SAMPLES: Final = 4.0  # in a cycle: fewer are a tone's, or an alias

_SLOWEST_CYCLE_S: Final = 1800.0
"""Longest period of what repeats [s]: a third of a low orbit; what is slower belongs to orbit, light and warmth."""

_MOST_SLOTS: Final = 1 << 18
"""Places of an even grid beyond which pauses are cut: three days at 1 Hz, a transform of 2^19 points."""

ORBIT_SIDE_HZ: Final = 1.2e-3  # half a dozen turns of the orbit: what is fixed in space has side lines there


Spectrum = tuple[Array, Array]
"""Frequencies [Hz] (f,) and the drop in squares (f,) [nT^2] that a body-fixed oscillation at each would bring."""


def strongest(
    scene: Scene, spectrum: Spectrum, count: int, spin_hz: float | None = None, all_lines: bool = False
) -> Array:
    """Up to ``count`` frequencies [Hz], strongest first.

    The six columns u_i cos, u_i sin at each frequency of a zero-padded transform; their normal matrix follows from the
    transform of u_i u_j at zero and at twice the frequency.  Gaps count as no data.  Lines slower than eight periods a
    recording or 900 s, and those at the spin's rate and its double, are no tones (``all_lines`` keeps the latter).
    """
    frequency, power = spectrum[0], _without_spin(scene, spectrum, None if all_lines else spin_hz)
    power[frequency < max(_SLOWEST_PERIODS / _span_s(scene), 1.0 / _SLOWEST_S)] = 0.0
    found: list[float] = []
    for _ in range(count):
        best = int(np.argmax(power))
        if power[best] <= 0.0:
            break
        found.append(float(frequency[best]))
        power[max(0, best - _APART_BINS) : best + _APART_BINS + 1] = 0.0
    return np.array(found)


def repeating(scene: Scene, spectrum: Spectrum, count: int, sigma_nt: float, spin_hz: float | None = None) -> Array:
    """Up to ``count`` frequencies [Hz], best first, whose first waves together stand out of the noise the most.

    What repeats need not have a line of its own at its period: of uneven levels the second or third wave is as large.
    Those of which the spin or its double is a wave are the attitude's.
    """
    frequency, span = spectrum[0], _span_s(scene)
    power = _without_spin(scene, spectrum, spin_hz)
    beyond = np.maximum(power / (2.0 * sigma_nt**2) - _WAVE_NATS, 0.0)
    step = float(frequency[1]) / _FINER
    first = math.ceil(max(_FEWEST_CYCLES / span, 1.0 / _SLOWEST_CYCLE_S) / step)
    places = np.arange(first, int(1.0 / (_FEWEST_SAMPLES * scene.period_s) / step))
    held = np.zeros(len(places))
    for wave in range(1, _WAVES + 1):
        place = (wave * places + _FINER // 2) // _FINER
        held += np.where(place < len(beyond), beyond[np.minimum(place, len(beyond) - 1)], 0.0)
    for turn_hz in _of_spin(spin_hz):
        waves = np.clip(np.rint(turn_hz / (places * step)), 1, _WAVES)
        held[np.abs(waves * places * step - turn_hz) < 1.0 / span] = 0.0
    found: list[float] = []
    while len(found) < count and len(held) and held.max() > 0.0:
        best = int(np.argmax(held))
        found.append(float(places[best] * step))
        aside = math.ceil(0.5 / span / step)
        held[max(0, best - aside) : best + aside + 1] = 0.0
    return np.array(found)


def _span_s(scene: Scene) -> float:
    return max(float(scene.time_s[-1] - scene.time_s[0]), 1.0)


def _of_spin(spin_hz: float | None) -> tuple[float, ...]:
    """The spin's rate and its double [Hz]: a field fixed in space, and what errors of scale make of it."""
    return () if spin_hz is None else (spin_hz, 2.0 * spin_hz)


def _without_spin(scene: Scene, spectrum: Spectrum, spin_hz: float | None) -> Array:
    """A spectrum's drops (f,) without the spin, its double, and the end near half of the sampling rate."""
    frequency, power = spectrum[0], spectrum[1].copy()
    span = _span_s(scene)
    power[frequency > 0.5 / scene.period_s - 3.0 / span] = 0.0
    for turn_hz in _of_spin(spin_hz):
        line = folded(turn_hz, 1.0 / scene.period_s)
        power[np.abs(frequency - line) < max(6.0 / span, ORBIT_SIDE_HZ)] = 0.0
    return power


def body_spectrum(scene: Scene, residual: Array, unit: Array) -> Spectrum:
    """A residual's spectrum in the body.

    White noise gives six times its variance everywhere.  ``residual`` is of the magnitude (n,), or of the components,
    three a sample (3 n,), which need no direction.
    """
    slot = slots(scene)
    size = 1 << int(np.ceil(np.log2(2 * (int(slot[-1]) + 1))))
    if len(residual) == 3 * len(scene):
        turns = _transform(slot, residual.reshape(-1, 3), size)[: size // 2]
        return np.arange(size // 2) / (size * scene.period_s), 2.0 * (np.abs(turns) ** 2).sum(axis=1) / len(scene)
    products = np.stack([unit[:, i] * unit[:, j] for i in range(3) for j in range(3)], axis=1)
    right = _transform(slot, residual[:, None] * unit, size)
    pairs = _transform(slot, products, size)
    half = size // 2
    frequency = np.arange(half) / (size * scene.period_s)
    double = pairs[(2 * np.arange(half)) % size].reshape(half, 3, 3)
    still = pairs[0].real.reshape(1, 3, 3)
    normal = np.empty((half, 6, 6))
    normal[:, :3, :3] = 0.5 * (still + double.real)
    normal[:, 3:, 3:] = 0.5 * (still - double.real)
    normal[:, :3, 3:] = -0.5 * double.imag
    normal[:, 3:, :3] = -0.5 * double.imag
    vector = np.concatenate([right[:half].real, -right[:half].imag], axis=1)
    trace = np.trace(still[0]) / 3.0
    normal += 1e-6 * trace * np.eye(6)
    power = np.einsum("fi,fi->f", vector, np.linalg.solve(normal, vector[:, :, None])[:, :, 0])
    return frequency, power


def slots(scene: Scene) -> NDArray[np.intp]:
    """Place (n,) of each sample on an even grid.

    Where pauses make up most of a long recording, each is cut to as many samples as there are in all stretches divided
    by their number: phases are then those of each stretch alone, and the grid stays small however long the pauses are.
    """
    slot: NDArray[np.intp] = np.rint((scene.time_s - scene.time_s[0]) / scene.period_s).astype(np.intp)
    if int(slot[-1]) < _MOST_SLOTS:
        return slot
    steps = np.diff(slot, prepend=slot[0])
    after = scene.pauses[1:]
    steps[after] = np.minimum(steps[after], max(len(slot) // max(len(scene.pauses), 1), 1))
    places: NDArray[np.intp] = np.cumsum(steps, dtype=np.intp)
    return places


def is_red(scene: Scene, residual: Array, unit: Array) -> bool:
    """Whether a residual's spectrum in the body falls from the lowest frequencies on, as noise with a memory has it.

    A peak in the middle (twice what lies below it) is an oscillation.
    """
    _, power = body_spectrum(scene, residual, unit)
    width = max(len(power) // 60, 8)
    smooth = np.convolve(power, np.ones(width) / width, mode="valid")
    best = int(np.argmax(smooth))
    below = smooth[: max(best // 2, 1)]
    return best < 2 * width or float(smooth[best]) < _PEAK * float(np.mean(below))


def folded(line_hz: float, rate_hz: float) -> float:
    """Where a line appears when sampled at a rate."""
    folded = abs(line_hz) % rate_hz
    return min(folded, rate_hz - folded)


def _transform(slot: NDArray[np.intp], values: Array, size: int) -> NDArray[np.complex128]:
    """Sum of values exp(-i w t) on an even grid: (size, k) from values (n, k)."""
    grid = np.zeros((size, values.shape[1]))
    np.add.at(grid, slot, values)
    return np.asarray(np.fft.fft(grid, axis=0), dtype=np.complex128)
