"""A learnt noise level against its recursion written out, normalised squares against brute force, sound states."""

from __future__ import annotations

import math

import numpy as np
import pytest

from magcal_service.estimators.parts.noise_level import NoiseLevel, is_sound, squared_innovations
from magcal_service.model import calibrate, field_jacobian


def recursion(residuals: list[float]) -> list[tuple[float, float]]:
    """Total and white level after each residual: means of the first 600, then a memory of 600."""
    total = white = 0.0
    levels = []
    for number, value in enumerate(residuals, start=1):
        weight = 1.0 / min(number, 600)
        total += weight * (value**2 - total)
        if number < 3:
            levels.append((math.sqrt(total), 0.0))
            continue
        second_difference = residuals[number - 1] - 2.0 * residuals[number - 2] + residuals[number - 3]
        rough = min(second_difference**2 / 6.0, 9.0 * total)
        white = rough if number == 3 else white + weight * (rough - white)
        white = min(white, total)
        levels.append((math.sqrt(total), math.sqrt(white)))
    return levels


@pytest.mark.parametrize("drift_nt", [0.0, 400.0])
def test_a_learnt_level_is_a_running_mean_square_and_its_white_part_that_of_second_differences(drift_nt: float) -> None:
    """1300 residuals of 100 nT, twice the memory and more, with and without a slow sine."""
    rng = np.random.default_rng(1)
    residuals = (100.0 * rng.normal(size=1300) + drift_nt * np.sin(np.arange(1300) / 40.0)).tolist()
    noise = NoiseLevel(None)
    found = []
    for value in residuals:
        noise.observe(np.array([value]))
        found.append((noise.total_nt, noise.white_nt))
    np.testing.assert_allclose(found, recursion(residuals), rtol=1e-9, atol=1e-9)
    assert noise.white_nt == pytest.approx(100.0, rel=0.1)
    assert noise.total_nt == pytest.approx(math.hypot(100.0, drift_nt / math.sqrt(2.0)), rel=0.1)


def test_residuals_of_one_tick_are_taken_in_order() -> None:
    residuals = (100.0 * np.random.default_rng(2).normal(size=60)).tolist()
    one, many = NoiseLevel(None), NoiseLevel(None)
    many.observe(np.array(residuals))
    for value in residuals:
        one.observe(np.array([value]))
    assert many.export_state() == one.export_state()


def test_over_a_gap_no_second_difference_is_taken() -> None:
    """A jump of 5000 nT between two stretches without noise: the white part does not see it."""
    noise = NoiseLevel(None)
    noise.observe(np.full(10, 10.0))
    noise.observe(np.full(10, 5010.0), after_gap=True)
    assert noise.white_nt == pytest.approx(1e-3, rel=1e-9)
    jumped = NoiseLevel(None)
    jumped.observe(np.full(10, 10.0))
    jumped.observe(np.full(10, 5010.0))
    assert jumped.white_nt > 100.0


def test_levels_have_a_floor_of_a_picotesla() -> None:
    noise = NoiseLevel(None)
    noise.observe(np.zeros(5))
    assert (noise.total_nt, noise.white_nt) == (pytest.approx(1e-3, rel=1e-12), pytest.approx(1e-3, rel=1e-12))


def test_a_given_level_never_changes() -> None:
    noise = NoiseLevel(250.0)
    noise.observe(np.full(50, 9000.0))
    noise.set(17.0)
    assert (noise.total_nt, noise.white_nt) == (250.0, 250.0)
    assert (NoiseLevel(None).total_nt, NoiseLevel(None).white_nt) == (0.0, 0.0)


@pytest.mark.parametrize(("count", "believed"), [(29, False), (30, True)])
def test_a_level_of_a_batch_is_the_white_part_until_30_residuals_have_been_seen(count: int, believed: bool) -> None:
    noise = NoiseLevel(None)
    noise.observe(100.0 * np.random.default_rng(3).normal(size=count))
    white_nt = noise.white_nt
    noise.set(5000.0)
    assert noise.total_nt == 5000.0
    assert noise.white_nt == (white_nt if believed else 5000.0)
    noise.set(20.0)
    assert (noise.total_nt, noise.white_nt) == (20.0, 20.0)
    noise.set(0.0)
    assert noise.total_nt == 1e-3


def test_normalised_squares_by_brute_force() -> None:
    """(e - mean)^2 over s^2 + u'J P J'u, sample by sample, and 1 on the mean where the covariance is right."""
    rng = np.random.default_rng(4)
    x = np.array([900.0, -400.0, 700.0, 0.05, -0.1, 0.02, 0.03, -0.04, 0.01])
    mixed = rng.normal(size=(9, 12)) * np.array([30.0] * 3 + [1e-3] * 6)[:, None]
    covariance = mixed @ mixed.T
    field = rng.normal(size=(20, 3)) * 25_000.0
    residual = rng.normal(size=20) * 300.0
    expected = []
    for b, e in zip(field, residual, strict=True):
        w = calibrate(x, b)
        row = w @ field_jacobian(b) / np.linalg.norm(w)
        expected.append((e - 150.0**2 / np.linalg.norm(w)) ** 2 / (200.0**2 + row @ covariance @ row))
    found = squared_innovations(x, covariance, field, residual, 200.0, 150.0)
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def placed(index: int, value: float) -> np.ndarray:
    x = np.zeros(9)
    x[index] = value
    return x


@pytest.mark.parametrize(
    ("x", "sound"),
    [
        (placed(0, 0.0), True),
        (placed(3, -0.599), True), (placed(3, -0.601), False),
        (placed(5, 1.499), True), (placed(5, 1.501), False),
        (placed(6, 0.599), True), (placed(6, 0.601), False), (placed(8, -0.601), False),
        (placed(1, 1e7), True), (placed(1, -1.01e7), False), (placed(2, 1.01e7), False),
        (placed(0, math.nan), False), (placed(4, math.inf), False),
    ],
)  # fmt: skip
def test_a_sound_state_is_finite_with_eigenvalues_within_the_limits(x: np.ndarray, sound: bool) -> None:
    """I + D has the eigenvalues 1 +- D12 where only D12 is not zero."""
    assert is_sound(x, (0.4, 2.5)) is sound


@pytest.mark.parametrize(("D", "sound"), [(9.9, True), (10.1, False)])
def test_a_state_far_from_any_sensor_is_not_even_looked_at(D: float, sound: bool) -> None:
    assert is_sound(placed(3, D), (0.0, 100.0)) is sound
