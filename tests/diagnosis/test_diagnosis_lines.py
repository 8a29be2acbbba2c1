"""Lines of a residual that are fixed in the body, seen through a field that turns."""

from __future__ import annotations

import math

import numpy as np
import pytest

from magcal_service.diagnosis.lines import body_spectrum, is_red, strongest
from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene
from tests.physics.scenes import RATE_RAD_S, scene

SPIN_HZ = RATE_RAD_S / (2.0 * math.pi)
SPAN_S = float(np.ptp(scene().time_s))


def noise(seed: int) -> Array:
    """White noise of unit sigma, one number a sample."""
    return np.random.default_rng(seed).normal(size=len(scene()))


def line(frequency_hz: float, size: float) -> Array:
    """A body-fixed oscillation along one direction, as the residual shows it."""
    swing = size * np.cos(2.0 * math.pi * frequency_hz * scene().time_s + 0.4)
    return swing * (scene().unit @ np.array([0.5, -0.7, 0.5]))


@pytest.mark.parametrize("frequency_hz", [0.0071, 0.0213, 0.0587, 0.1119])
def test_the_strongest_line_is_the_one_that_is_there(frequency_hz: float) -> None:
    """A line of half the noise is found to a quarter of a turn over the recording."""
    residual = noise(1) + line(frequency_hz, 0.7)
    found = strongest(scene(), residual, scene().unit, 3, SPIN_HZ)
    assert float(found[0]) == pytest.approx(frequency_hz, abs=0.25 / SPAN_S)


@pytest.mark.parametrize(("weak_hz", "strong_hz"), [(0.0213, 0.0871), (0.0871, 0.0213)])
def test_the_stronger_of_two_lines_comes_first(weak_hz: float, strong_hz: float) -> None:
    """Twice as strong is enough, whichever of the two it is."""
    found = strongest(scene(), noise(2) + line(weak_hz, 1.0) + line(strong_hz, 2.0), scene().unit, 2, SPIN_HZ)
    assert float(found[0]) == pytest.approx(strong_hz, abs=0.25 / SPAN_S)


def test_a_line_is_found_across_a_gap() -> None:
    """Ten minutes without samples count as no data."""
    keep = (scene().time_s < 3000.0) | (scene().time_s > 3600.0)
    part = Scene(
        *(scene().time_s[keep], scene().origin_ns, True, scene().field_nt[keep], scene().calibrated_nt[keep]),
        clean_field_nt=scene().clean_field_nt[keep],
        magnitude_nt=scene().magnitude_nt[keep],
    )
    residual = (noise(3) + line(0.0587, 0.8))[keep]
    assert float(strongest(part, residual, part.unit, 1)[0]) == pytest.approx(0.0587, abs=0.25 / SPAN_S)


def test_the_spins_own_lines_are_left_out_unless_asked_for() -> None:
    """At the spin and its double sit the nine errors; ``all_lines`` shows them."""
    residual = 0.1 * noise(4) + 5.0 * np.cos(RATE_RAD_S * scene().time_s)[:] * scene().unit[:, 0]
    quiet = strongest(scene(), residual, scene().unit, 4, SPIN_HZ)
    loud = strongest(scene(), residual, scene().unit, 4, SPIN_HZ, all_lines=True)
    assert np.abs(quiet[:, None] - np.array([SPIN_HZ, 2.0 * SPIN_HZ])).min() > 1e-3
    assert abs(float(loud[0]) - SPIN_HZ) < 1.2e-3


def test_drop_in_squares_is_that_of_a_fit() -> None:
    """At a frequency of the transform the drop equals that of six columns fitted by least squares."""
    residual = noise(5) + line(0.0213, 1.5)
    frequency, power = body_spectrum(scene(), residual, scene().unit)
    index = int(np.argmin(np.abs(frequency - 0.0213)))
    angle = 2.0 * math.pi * float(frequency[index]) * scene().time_s
    columns = np.concatenate([scene().unit * np.cos(angle)[:, None], scene().unit * np.sin(angle)[:, None]], axis=1)
    left = residual - columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]
    assert float(power[index]) == pytest.approx(float(residual @ residual - left @ left), rel=1e-4)


def test_white_noise_gives_six_variances_everywhere() -> None:
    """The mean drop of white noise is that of six amplitudes, low and high."""
    _, power = body_spectrum(scene(), noise(6), scene().unit)
    parts = [float(part.mean()) for part in np.array_split(power[10:-10], 4)]
    assert parts == pytest.approx([6.0] * 4, rel=0.2)


def walk(seed: int) -> Array:
    """Noise with a memory of a hundred samples, fixed in the body, as the residual shows it."""
    white = np.random.default_rng(seed).normal(size=(len(scene()), 3))
    found = np.zeros_like(white)
    for row in range(1, len(white)):
        found[row] = 0.99 * found[row - 1] + 0.1 * white[row]
    return np.asarray(np.einsum("ni,ni->n", found, scene().unit))


def test_noise_with_a_memory_is_red() -> None:
    """A spectrum that falls from the lowest frequencies on is red, whatever the seed."""
    assert all(is_red(scene(), walk(seed) + 0.3 * noise(seed), scene().unit) for seed in range(8))


def test_an_oscillation_is_not_red() -> None:
    """A swing that comes and goes in the middle of the spectrum is none."""
    coming = np.exp(-(((scene().time_s - 3000.0) / 1500.0) ** 2))
    swings = [noise(seed) + coming * line(0.045, 6.0) for seed in range(8)]
    assert not any(is_red(scene(), swing, scene().unit) for swing in swings)
