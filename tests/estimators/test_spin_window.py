"""Spin windows: what they leave of the turning field, and how many samples they take."""

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.config.settings import SpinConfig, SpinWindow
from magcal_service.estimators.parts.spin_window import (
    SpinWindows,
    Window,
    across_axis,
    harmonic_weights,
    sound_samples,
)
from magcal_service.model import calibrate
from tests.estimators.estimator_ticks import Craft, tilted_dipole_eci

CLEAN = np.zeros(9)


def windows(craft: Craft, seconds: int, **settings: object) -> list[Window]:
    collector = SpinWindows(SpinConfig(rate_rpm=craft.rate_rpm, **settings))
    return [window for tick in craft.ticks(seconds) if (window := collector.push(tick)) is not None]


def leak(window: Window) -> np.ndarray:
    """What is left of A H across the axis, for a craft without errors and noise [nT]."""
    return window.across @ (window.weights @ calibrate(CLEAN, window.field_body_nt))


@pytest.mark.parametrize("rate_rpm", [1.0, 7.5, 7.7, 23.0])
def test_a_harmonic_window_leaves_less_than_the_leak_it_states(rate_rpm: float) -> None:
    craft = Craft(seed=1, x=CLEAN, noise_nt=0.0, rate_rpm=rate_rpm)
    found = windows(craft, 3000)
    left = np.array([leak(window) for window in found])
    stated = np.array([window.leak_nt for window in found])
    assert len(found) > 20
    assert np.sqrt((left**2).mean()) < np.sqrt((stated**2).mean())


def test_the_plain_mean_leaves_hundreds_of_nanotesla_at_one_turn_a_minute() -> None:
    craft = Craft(seed=2, x=CLEAN, noise_nt=0.0, rate_rpm=1.0)
    plain = windows(craft, 5800, window=SpinWindow.MEAN, window_turns=1)
    harmonic = windows(craft, 5800, window_turns=2)
    rms_plain = np.sqrt(np.mean([leak(window) ** 2 for window in plain]))
    rms_harmonic = np.sqrt(np.mean([leak(window) ** 2 for window in harmonic]))
    assert 150.0 < rms_plain < 800.0
    assert rms_harmonic < 0.1 * rms_plain


def test_the_stated_leak_of_the_plain_mean_covers_what_is_left() -> None:
    found = windows(Craft(seed=3, x=CLEAN, noise_nt=0.0), 3000, window=SpinWindow.MEAN, window_samples=8)
    left = np.sqrt(np.mean([leak(window) ** 2 for window in found]))
    stated = np.sqrt(np.mean([window.leak_nt**2 for window in found]))
    assert left < stated < 5.0 * left


def test_a_plain_window_moves_on_sample_by_sample() -> None:
    assert len(windows(Craft(seed=4), 100, window=SpinWindow.MEAN, window_samples=8)) == 100 - 8 + 1


def test_harmonic_windows_share_no_samples() -> None:
    found = windows(Craft(seed=5), 400)
    assert len(found) == 25
    assert all(len(window.weights) == 16 for window in found)


def test_harmonic_windows_are_not_thrown_off_by_missing_samples() -> None:
    times = np.delete(np.arange(16.0), [3, 4, 11])
    rate = 7.5 * 2.0 * math.pi / 60.0
    weights = harmonic_weights(times, rate)
    assert weights is not None
    for signal in (np.cos(rate * times), np.sin(rate * times), times * np.cos(rate * times)):
        assert abs(weights @ signal) < 1e-9
    assert weights.sum() == pytest.approx(1.0)


def test_samples_a_whole_turn_apart_give_no_window() -> None:
    assert harmonic_weights(np.arange(12) * 8.0, 7.5 * 2.0 * math.pi / 60.0) is None


def test_a_gap_starts_the_window_anew() -> None:
    collector = SpinWindows(SpinConfig())
    ticks = list(Craft(seed=6).ticks(40))
    found = [collector.push(replace(tick, after_gap=tick.index == 10)) for tick in ticks]
    assert [index for index, window in enumerate(found) if window is not None] == [25]


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, 0.8)])
def test_across_vectors_complete_a_right_handed_triad(axis: tuple[float, float, float]) -> None:
    first, second = across_axis(np.array(axis))
    assert np.allclose(np.cross(first, second), axis)


def test_the_test_field_turns_as_in_a_low_orbit() -> None:
    field = tilted_dipole_eci(np.arange(6000.0))
    rate = np.linalg.norm(np.diff(field, axis=0), axis=1)
    magnitude = np.linalg.norm(field, axis=1)
    assert 20_000.0 < magnitude.min() < 27_000.0
    assert 40_000.0 < magnitude.max() < 50_000.0
    assert 40.0 < rate.mean() < 100.0


def window_of_vectors(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
    """Times, vectors of 40 uT that turn about z in 8 s, with 300 nT of noise, and the rate."""
    times, rate = np.arange(count, dtype=float), 2.0 * np.pi / 8.0
    field = 40_000.0 * np.stack([np.cos(rate * times), np.sin(rate * times), np.ones(count)], axis=1)
    return times, field + rng.normal(0.0, 300.0, (count, 3)), rate


@pytest.mark.parametrize("noise_nt", [300.0, None])
@pytest.mark.parametrize("seed", range(8))
def test_corrupted_vectors_in_a_window_are_left_out_whatever_their_length(noise_nt: float | None, seed: int) -> None:
    """Two of 16, turned into another direction: exactly these two."""
    rng = np.random.default_rng([31, seed])
    times, field, rate = window_of_vectors(16, rng)
    hit = rng.choice(16, 2, replace=False)
    field[hit] = field[hit][:, [1, 2, 0]] * [-1.0, 1.0, 1.0]
    np.testing.assert_array_equal(np.flatnonzero(~sound_samples(times, field, rate, noise_nt)), np.sort(hit))


@pytest.mark.parametrize("noise_nt", [300.0, None])
def test_sound_windows_are_left_as_they_are(noise_nt: float | None) -> None:
    rng = np.random.default_rng(32)
    assert all(sound_samples(*window_of_vectors(16, rng), noise_nt).all() for _ in range(300))


@pytest.mark.parametrize("rate_rpm", [0.5, 1.0, 7.5, 20.0])
def test_the_field_s_own_motion_spoils_no_window_of_a_quiet_sensor(rate_rpm: float) -> None:
    times, field, _ = Craft(1, noise_nt=20.0, rate_rpm=rate_rpm).arrays(3000)
    count, rate = max(6, round(120.0 / rate_rpm)), rate_rpm * 2.0 * np.pi / 60.0
    parts = [slice(first, first + count) for first in range(0, 3000 - count, count)]
    assert all(sound_samples(times[part], field[part], rate, 20.0).all() for part in parts)


def test_a_window_that_is_spoilt_throughout_is_left_to_the_filter() -> None:
    rng = np.random.default_rng(33)
    times, field, rate = window_of_vectors(16, rng)
    assert sound_samples(times, field + rng.normal(0.0, 9000.0, (16, 3)), rate, 300.0).all()
