"""Levels of a residual against analytic values of series whose spectrum is known; tails that chi-squared has."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2

from magcal_service.residuals import log_tail, median_and_sigma, rms, white_floor, white_noise_level

SECOND_NS = 1_000_000_000


def lines(count: int, amplitudes: np.ndarray, mean: float = 0.0) -> np.ndarray:
    """A series (count,) whose periodogram has a^2 n / 4 in each bin from 1 on and nothing else."""
    spectrum = np.zeros(count // 2 + 1, dtype=complex)
    spectrum[1 : len(amplitudes) + 1] = amplitudes * count / 2.0
    return np.fft.irfft(spectrum, count) + mean


def test_the_floor_is_the_median_of_the_periodogram_over_ln_2() -> None:
    """n = 65, amplitudes 1 to 32 in its 32 bins: powers a^2 n / 4, whose median is the mean of 16^2 and 17^2."""
    series = lines(65, np.arange(1.0, 33.0), mean=500.0)
    median = (16.0**2 + 17.0**2) / 2.0 * 65.0 / 4.0
    assert white_floor(series) == pytest.approx(math.sqrt(median / math.log(2.0)), rel=1e-9)


def test_a_mean_is_no_noise_and_a_line_touches_one_bin() -> None:
    flat = np.ones(32)
    line = flat.copy()
    line[4] = 1000.0
    expected = math.sqrt(65.0 / 4.0 / math.log(2.0))
    assert white_floor(lines(65, flat, mean=-7e4)) == pytest.approx(expected, rel=1e-9)
    assert white_floor(lines(65, line)) == pytest.approx(expected, rel=1e-9)


def test_the_floor_of_white_noise_is_its_sigma() -> None:
    floors = [white_floor(np.random.default_rng(seed).normal(size=4096) * 250.0) for seed in range(8)]
    assert np.mean(floors) == pytest.approx(250.0, rel=0.01)


def test_the_root_mean_square_of_values() -> None:
    assert rms(np.array([3.0, -4.0, 5.0, -6.0])) == pytest.approx(math.sqrt(86.0 / 4.0), rel=1e-15)


def stretches(*counts: int, step_s: float = 1.0, pause_s: float = 100.0) -> np.ndarray:
    """Times [ns] of evenly sampled stretches with pauses between them."""
    times = [0.0]
    for number, count in enumerate(counts):
        times += (times[-1] + (pause_s if number else 0.0) + step_s * np.arange(not number, count)).tolist()
    return np.rint(np.array(times) * SECOND_NS).astype(np.int64)


def test_the_floor_over_stretches_weighs_each_by_its_length() -> None:
    """100 samples at sigma 1, then 300 at 4: the weighted mean of the two variances."""
    rng = np.random.default_rng(3)
    quiet, loud = rng.normal(size=100), 4.0 * rng.normal(size=300)
    expected = math.sqrt((100 * white_floor(quiet) ** 2 + 300 * white_floor(loud) ** 2) / 400)
    assert white_noise_level(stretches(100, 300), np.r_[quiet, loud]) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("pause_s", "parted"), [(1.5, False), (1.6, True)])
def test_a_step_of_more_than_one_and_a_half_is_a_pause(pause_s: float, parted: bool) -> None:
    residual = np.random.default_rng(4).normal(size=200)
    whole = white_floor(residual)
    halves = math.sqrt((white_floor(residual[:100]) ** 2 + white_floor(residual[100:]) ** 2) / 2.0)
    times = stretches(100, 100, pause_s=pause_s)
    assert white_noise_level(times, residual) == pytest.approx(halves if parted else whole, rel=1e-12)
    assert halves != pytest.approx(whole, rel=1e-3)


@pytest.mark.parametrize(("count", "looked_at"), [(64, True), (63, False)])
def test_stretches_of_64_samples_have_a_spectrum_and_shorter_ones_an_rms(count: int, looked_at: bool) -> None:
    residual = np.random.default_rng(5).normal(size=2 * count) + 3.0
    floor = math.sqrt((white_floor(residual[:count]) ** 2 + white_floor(residual[count:]) ** 2) / 2.0)
    expected = floor if looked_at else rms(residual)
    assert white_noise_level(stretches(count, count), residual) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("degrees", [1, 2, 3, 6, 9, 29, 45])
def test_tails_against_scipy(degrees: int) -> None:
    """ln P to 1e-9 of itself, from the middle of the distribution to where P is 1e-400."""
    for x in (0.0, 0.3, 1.0, 5.0, 20.0, 60.0, 400.0, 900.0):
        assert log_tail(x, degrees) == pytest.approx(chi2.logsf(x, degrees), rel=1e-6, abs=1e-9)
    assert -log_tail(5000.0, degrees) == pytest.approx(2500.0, rel=0.1)
    assert log_tail(-3.0, degrees) == pytest.approx(0.0, abs=1e-12)


def test_a_median_scatters_by_the_sigma_that_is_given_with_it() -> None:
    """Of 2000 medians of 101 normal numbers about 3, with a sigma of 2: by sqrt(pi / 2) of a mean, 0.249."""
    draws = np.random.default_rng(90).normal(3.0, 2.0, (2000, 101))
    found = np.array([median_and_sigma(row) for row in draws])
    assert np.std(found[:, 0]) == pytest.approx(np.sqrt(np.pi / 2.0) * 2.0 / np.sqrt(101.0), rel=0.05)
    assert np.mean(found[:, 1]) == pytest.approx(np.std(found[:, 0]), rel=0.05)
