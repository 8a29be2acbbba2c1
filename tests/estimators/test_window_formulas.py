"""Spin windows against least squares, and their lengths, leaks and exclusions from both sides."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.config.settings import SpinConfig, SpinWindow
from magcal_service.estimators.parts.spin_window import (
    SpinWindows,
    across_axis,
    harmonic_leak_nt,
    harmonic_weights,
    sound_samples,
)
from magcal_service.ticks.assembler import Tick

RATE = 7.5 * 2.0 * math.pi / 60.0
H_NT = 40_000.0


def tick(index: int, count: int = 1, reference: np.ndarray | None = None, *, after_gap: bool = False) -> Tick:
    """Vectors that turn about z at 7.5 rpm."""
    times = index + np.arange(count) / count
    field = H_NT * np.stack([np.cos(RATE * times), np.sin(RATE * times), np.ones(count)], axis=1)
    vectors = None if reference is None else np.tile(reference, (count, 1))
    return Tick(index, times, field, np.full(count, H_NT), vectors, after_gap=after_gap)


def test_harmonic_weights_are_those_of_the_constant_in_least_squares() -> None:
    times = np.array([0.0, 1.0, 1.5, 3.0, 4.2, 5.0, 6.0, 7.7, 8.0, 9.1, 11.0, 12.0, 13.0, 15.0])
    t = times - times.mean()
    columns = np.stack(
        [np.ones(14), np.cos(RATE * t), np.sin(RATE * t), t * np.cos(RATE * t), t * np.sin(RATE * t)], axis=1
    )
    weights = harmonic_weights(times, RATE)
    assert weights is not None
    expected = np.linalg.pinv(columns)[0]
    np.testing.assert_allclose(weights, expected / expected.sum(), rtol=1e-9)
    assert expected.sum() == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize(("turns", "defined"), [(0.55, True), (0.3, False)])
def test_a_short_arc_has_no_constant(turns: float, defined: bool) -> None:
    """The smallest eigenvalue of the scaled normal matrix decides: 1e-4."""
    times = np.linspace(0.0, turns * 8.0, 40)
    t = times - times.mean()
    columns = np.stack(
        [np.ones(40), np.cos(RATE * t), np.sin(RATE * t), t * np.cos(RATE * t), t * np.sin(RATE * t)], axis=1
    )
    columns /= np.linalg.norm(columns, axis=0)
    least = float(np.linalg.eigvalsh(columns.T @ columns)[0])
    assert (least > 1e-4) is (harmonic_weights(times, RATE) is not None)
    assert defined or least < 1e-4


def test_the_leak_is_of_second_order() -> None:
    assert harmonic_leak_nt(np.array([30_000.0, 50_000.0]), 0.01) == pytest.approx(3.0 * 40_000.0 * 1e-4, rel=1e-12)


@pytest.mark.parametrize(
    ("axis", "first"),
    [((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)), ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)), ((0.0, 1.0, 0.0), (0.0, 0.0, -1.0))],
)
def test_the_first_vector_across_is_the_axis_times_the_least_aligned_unit_vector(
    axis: tuple[float, float, float], first: tuple[float, float, float]
) -> None:
    across = across_axis(np.array(axis))
    np.testing.assert_allclose(across[0], first, atol=1e-15)
    np.testing.assert_allclose(across @ across.T, np.eye(2), atol=1e-15)


@pytest.mark.parametrize(("turns", "samples"), [(1.0, 8), (2.0, 16), (3.5, 28)])
@pytest.mark.parametrize("per_tick", [1, 4])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_window_ends_with_the_last_sample_before_its_turns_are_full(
    turns: float, samples: int, per_tick: int, sense: float
) -> None:
    """At 8 s a turn the next sample would be the first of the next window, whatever the rate of sampling."""
    windows = SpinWindows(SpinConfig(rate_rpm=sense * 7.5, window_turns=turns))
    found = [windows.push(tick(index, per_tick)) for index in range(3 * samples)]
    ends = [index for index, window in enumerate(found) if window is not None]
    assert ends == [samples - 1, 2 * samples - 1, 3 * samples - 1]
    window = found[ends[1]]
    assert window is not None
    assert (len(window.weights), window.share) == (samples * per_tick, 1.0)
    np.testing.assert_allclose(window.field_body_nt[0], tick(samples, per_tick).field_body_nt[0])
    assert windows._samples == 0


@pytest.mark.parametrize(("samples", "there"), [(5, False), (6, True)])
def test_a_window_has_six_samples_at_least(samples: int, there: bool) -> None:
    windows = SpinWindows(SpinConfig(rate_rpm=60.0 / samples, window_turns=1.0))
    found = [windows.push(tick(index)) for index in range(samples)]
    assert (found[-1] is not None) is there


def turned(degrees: float) -> np.ndarray:
    return H_NT * np.array([[math.cos(math.radians(degrees)), math.sin(math.radians(degrees)), 0.0]])


@pytest.mark.parametrize(("first", "last"), [(turned(0.0), turned(6.0)), (None, turned(6.0)), (turned(0.0), None)])
def test_the_leak_is_by_how_far_the_reference_turned_or_by_a_low_orbit(
    first: np.ndarray | None, last: np.ndarray | None
) -> None:
    """6 degrees within 15 s; where no vector tells, 2.3 mrad/s."""
    windows = SpinWindows(SpinConfig(window_turns=2.0))
    for index in range(15):
        windows.push(tick(index, reference=first))
    window = windows.push(tick(15, reference=last))
    assert window is not None
    rate = math.radians(6.0) / 15.0 if first is not None and last is not None else 2.3e-3
    assert window.leak_nt == pytest.approx(3.0 * H_NT * (rate / RATE) ** 2, rel=1e-9)


@pytest.mark.parametrize(("samples", "turns"), [(8, 1.0), (10, 1.25)])
def test_a_plain_window_weighs_all_alike_and_says_how_often_a_sample_is_used(samples: int, turns: float) -> None:
    """Successive windows differ by a tick: a sample is in as many as the window has ticks, which ``share`` tells."""
    windows = SpinWindows(SpinConfig(window=SpinWindow.MEAN, window_samples=samples))
    found = [windows.push(tick(index)) for index in range(30)]
    assert [window is not None for window in found] == [False] * (samples - 1) + [True] * (31 - samples)
    window = found[20]
    assert window is not None
    np.testing.assert_allclose(window.weights, 1.0 / samples)
    np.testing.assert_allclose(window.field_body_nt[-1], tick(20).field_body_nt[0])
    assert window.share == samples
    tone = abs(np.exp(1j * RATE * np.arange(samples)).mean())
    leak = H_NT * math.hypot(tone, 2.3e-3 / RATE / turns) / math.sqrt(2.0)
    assert window.leak_nt == pytest.approx(leak, rel=1e-9)


def test_a_plain_window_of_ticks_with_several_samples_moves_on_by_a_tick() -> None:
    windows = SpinWindows(SpinConfig(window=SpinWindow.MEAN, window_turns=1.0))
    found = [windows.push(tick(index, 4)) for index in range(12)]
    assert [window is not None for window in found] == [False] * 7 + [True] * 5
    window = found[-1]
    assert window is not None
    assert (len(window.weights), window.share) == (32, 8.0)
    np.testing.assert_allclose(window.field_body_nt[0], tick(4, 4).field_body_nt[0])


@pytest.mark.parametrize(("samples", "ratio"), [(4, 1.0), (5, 2.3e-3 / RATE)])
def test_half_a_turn_tells_nothing_of_the_mean(samples: int, ratio: float) -> None:
    windows = SpinWindows(SpinConfig(window=SpinWindow.MEAN, window_samples=samples))
    window = [windows.push(tick(index)) for index in range(samples)][-1]
    assert window is not None
    tone = abs(np.exp(1j * RATE * np.arange(samples)).mean())
    assert window.leak_nt == pytest.approx(H_NT * math.hypot(tone, ratio) / math.sqrt(2.0), rel=1e-9)


def test_a_gap_clears_a_plain_window_too() -> None:
    windows = SpinWindows(SpinConfig(window=SpinWindow.MEAN, window_samples=8))
    found = [windows.push(tick(index, after_gap=index == 10)) for index in range(20)]
    assert [index for index, window in enumerate(found) if window is None] == [*range(7), *range(10, 17)]


# Vectors left out


def smooth(count: int, noise_nt: float = 0.0, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Times and vectors of a spinning craft in a field that changes linearly."""
    times = np.arange(count, dtype=float)
    slow = 1.0 + 0.002 * times
    field = H_NT * np.stack([slow * np.cos(RATE * times), slow * np.sin(RATE * times), slow], axis=1)
    return times, field + noise_nt * np.random.default_rng(seed).normal(size=(count, 3))


def studentised(times: np.ndarray, field: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Residuals of all vectors to the least-squares fit of those kept, over the root of 1 -+ their leverage."""
    t = times - times.mean()
    unit = t / np.abs(t).max()
    slow = [np.ones_like(t), unit] if len(t) <= 40 else [np.ones_like(t), unit, unit**2]
    columns = np.stack([term * turn for turn in (1.0, np.cos(RATE * t), np.sin(RATE * t)) for term in slow], axis=1)
    fit = np.linalg.pinv(columns[kept])
    residual = field - columns @ (fit @ field[kept])
    leverage = np.einsum("ki,ij,kj->k", columns, np.linalg.inv(columns[kept].T @ columns[kept]), columns)
    free = np.where(kept, np.maximum(1.0 - leverage, 0.1), 1.0 + leverage)
    return np.sqrt((residual**2).sum(axis=1) / free)


@pytest.mark.parametrize(("count", "at"), [(16, 0), (16, 7), (41, 20), (40, 3)])
@pytest.mark.parametrize(("factor", "sound"), [(0.97, True), (1.03, False)])
def test_a_vector_is_unsound_beyond_6_5_sigmas_of_its_own_scatter(
    count: int, at: int, factor: float, sound: bool
) -> None:
    """Without noise: the residual of the others grows with it, and the fit without it decides."""
    times, field = smooth(count)
    kept = np.arange(count) != at
    spoilt = field.copy()
    spoilt[at, 2] += 1.0
    all_kept = np.ones(count, dtype=bool)
    per_nt = max(studentised(times, spoilt, all_kept)[at] - studentised(times, field, all_kept)[at], 1e-9)
    assert per_nt == pytest.approx(studentised(times, spoilt, all_kept)[at], rel=1e-6)
    assert studentised(times, spoilt, kept)[at] == pytest.approx(per_nt, rel=1e-6)  # of the fit without it
    size_nt = factor * 6.5 * 100.0 / per_nt
    spoilt = field.copy()
    spoilt[at, 2] += size_nt
    found = sound_samples(times, spoilt, RATE, 100.0)
    assert found[kept].all()
    assert bool(found[at]) is sound


@pytest.mark.parametrize(("bad", "left_out"), [(4, True), (5, False)])
def test_a_quarter_of_a_window_may_be_left_out(bad: int, left_out: bool) -> None:
    times, field = smooth(16, 10.0)
    at = [1, 4, 8, 11, 14][:bad]
    field[at, 2] += np.array([5000.0, -7000.0, 6000.0, -4000.0, 9000.0])[:bad]
    found = sound_samples(times, field, RATE, 10.0)
    assert np.flatnonzero(~found).tolist() == (at if left_out else [])


@pytest.mark.parametrize(("count", "judged"), [(7, False), (8, True)])
def test_seven_vectors_are_all_taken(count: int, judged: bool) -> None:
    times, field = smooth(count)
    field[3] += [0.0, 0.0, 20_000.0]
    assert (not sound_samples(times, field, RATE, 1.0).all()) is judged


def test_with_an_unknown_noise_a_vector_is_unsound_beyond_8_medians() -> None:
    """Noise of 100 nT: the median of a vector's length is 154 nT, and 8 of them are 12 sigmas."""
    times, field = smooth(60, 100.0)
    limits = []
    for size_nt in (900.0, 1600.0):
        spoilt = field.copy()
        spoilt[30, 2] += size_nt
        limits.append(bool(sound_samples(times, spoilt, RATE, None)[30]))
    assert limits == [True, False]
    assert sound_samples(times, field, RATE, None).all()


def test_unsound_vectors_are_left_out_of_the_window() -> None:
    windows = SpinWindows(SpinConfig(window_turns=2.0), 50.0)
    window = None
    for index in range(16):
        one = tick(index)
        window = windows.push(replace(one, field_body_nt=-one.field_body_nt) if index == 5 else one)
    assert window is not None
    assert len(window.weights) == len(window.field_body_nt) == len(window.reference_magnitude_nt) == 15
    assert float(window.weights @ window.field_body_nt[:, 0]) == pytest.approx(0.0, abs=1e-6)
