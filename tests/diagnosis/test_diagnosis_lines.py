"""Lines of a residual that are fixed in the body, seen through a field that turns."""

from __future__ import annotations

import math

import numpy as np
import pytest

from magcal_service.diagnosis import lines as module
from magcal_service.diagnosis.lines import Spectrum, body_spectrum, is_red, strongest
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


def of(residual: Array) -> Spectrum:
    """A residual's spectrum in the body."""
    return body_spectrum(scene(), residual, scene().unit)


@pytest.mark.parametrize("frequency_hz", [0.0071, 0.0213, 0.0587, 0.1119])
def test_the_strongest_line_is_the_one_that_is_there(frequency_hz: float) -> None:
    """A line of half the noise is found to a quarter of a turn over the recording."""
    residual = noise(1) + line(frequency_hz, 0.7)
    found = strongest(scene(), of(residual), 3, SPIN_HZ)
    assert float(found[0]) == pytest.approx(frequency_hz, abs=0.25 / SPAN_S)


@pytest.mark.parametrize(("weak_hz", "strong_hz"), [(0.0213, 0.0871), (0.0871, 0.0213)])
def test_the_stronger_of_two_lines_comes_first(weak_hz: float, strong_hz: float) -> None:
    """Twice as strong is enough, whichever of the two it is."""
    found = strongest(scene(), of(noise(2) + line(weak_hz, 1.0) + line(strong_hz, 2.0)), 2, SPIN_HZ)
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
    assert float(strongest(part, body_spectrum(part, residual, part.unit), 1)[0]) == pytest.approx(
        0.0587, abs=0.25 / SPAN_S
    )


def test_the_spins_own_lines_are_left_out_unless_asked_for() -> None:
    """At the spin and its double sit the nine errors; ``all_lines`` shows them."""
    residual = 0.1 * noise(4) + 5.0 * np.cos(RATE_RAD_S * scene().time_s)[:] * scene().unit[:, 0]
    quiet = strongest(scene(), of(residual), 4, SPIN_HZ)
    loud = strongest(scene(), of(residual), 4, SPIN_HZ, all_lines=True)
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


# Limits, on a spectrum that is made here

STEP_HZ = 1e-4


def found_in(
    peaks: dict[int, float],
    span_s: float,
    count: int = 9,
    spin_hz: float | None = None,
) -> list[int]:
    """Bins of ``STEP_HZ`` that are found where the spectrum has these peaks; samples come every 2 s."""
    power = np.zeros(2600)
    for number, size in peaks.items():
        power[number] = size
    time_s = np.arange(0.0, span_s + 1.0, 2.0)
    field = np.ones((len(time_s), 3))
    made = Scene(time_s, 0, True, field, field, field, field[:, 0])
    return [
        round(line / STEP_HZ) for line in strongest(made, (STEP_HZ * np.arange(2600.0), power), count, spin_hz).tolist()
    ]


@pytest.mark.parametrize(("span_s", "slowest"), [(2000.0, 40.0), (1000.0, 80.0), (20_000.0, 1e4 / 900.0)])
def test_a_line_has_eight_periods_and_fifteen_minutes_at_most(
    monkeypatch: pytest.MonkeyPatch, span_s: float, slowest: float
) -> None:
    below, above = math.ceil(slowest) - 1, math.floor(slowest) + 1
    assert found_in({below: 5.0}, span_s) == []
    assert found_in({above: 5.0}, span_s) == [above]


@pytest.mark.parametrize(("number", "found"), [(2469, True), (2471, False)])
def test_a_line_keeps_three_bins_off_half_the_rate(monkeypatch: pytest.MonkeyPatch, number: int, found: bool) -> None:
    """Of 1000 s: 0.003 Hz below 0.25."""
    assert bool(found_in({number: 5.0}, 1000.0)) is found


def test_lines_come_by_their_size_and_not_within_four_bins_of_a_larger_one(monkeypatch: pytest.MonkeyPatch) -> None:
    peaks = {500: 9.0, 504: 8.0, 496: 8.0, 505: 7.0, 495: 6.0, 900: 8.5}
    assert found_in(peaks, 2000.0) == [500, 900, 505, 495]
    assert found_in(peaks, 2000.0, count=2) == [500, 900]


@pytest.mark.parametrize(("span_s", "width"), [(20_000.0, 12.0), (2000.0, 30.0)])
def test_lines_at_the_spin_and_its_double_are_left_out_with_the_orbits_side_lines(
    monkeypatch: pytest.MonkeyPatch, span_s: float, width: float
) -> None:
    """Twelve ten-thousandths of a hertz to either side, or six bins of a short recording; folded where need be."""
    near, far = int(width) - 1, int(width) + 1
    for spin, line in ((1000, 1000), (1000, 2000), (4200, 800), (4200, 1600)):
        for sign in (1, -1):
            assert found_in({line + sign * near: 5.0}, span_s, spin_hz=spin * STEP_HZ) == []
            beyond = line + sign * far
            assert found_in({beyond: 5.0}, span_s, spin_hz=spin * STEP_HZ) == [beyond]
    assert found_in({1000: 5.0}, span_s) == [1000]


def red_with(monkeypatch: pytest.MonkeyPatch, power: Array) -> bool:
    monkeypatch.setattr(module, "body_spectrum", lambda *_: (np.arange(float(len(power))), power))
    return is_red(scene(), noise(1), scene().unit)


@pytest.mark.parametrize(("height", "red"), [(1.9, True), (2.1, False)])
def test_a_hump_twice_what_lies_below_it_is_an_oscillation(
    monkeypatch: pytest.MonkeyPatch, height: float, red: bool
) -> None:
    """Means of a sixtieth of the spectrum; below is what lies under half of the hump's frequency."""
    power = np.where(np.arange(6000) < 1600, 1.0, 0.2)
    power[3000:3100] = height
    assert red_with(monkeypatch, power) is red


@pytest.mark.parametrize(("first", "red"), [(190, True), (320, False)])
def test_a_hump_within_two_widths_of_nought_is_red_whatever_lies_below(
    monkeypatch: pytest.MonkeyPatch, first: int, red: bool
) -> None:
    power = np.full(6000, 0.01)
    power[first : first + 100] = 5.0
    assert red_with(monkeypatch, power) is red


def test_a_short_spectrum_is_looked_at_in_means_of_eight(monkeypatch: pytest.MonkeyPatch) -> None:
    power = np.full(120, 1.0)
    power[60] = 8.0 * 1.5  # alone it is twelve times what lies below, among eight less than three
    assert not red_with(monkeypatch, power)
    power[60] = 8.0 * 0.5
    assert red_with(monkeypatch, power)
