"""A temperature without its sensor's noise: nearer the truth by what the length of its course allows, never farther."""

from __future__ import annotations

import numpy as np
import pytest

from magcal_service.model import Array
from magcal_service.physics.scene.smooth import expected_course, noise_of, smooth_course

COUNT = 6000


def heated() -> Array:
    """A board that follows light and shadow with 15 minutes, from 20 K below to 20 K above its mean."""
    lit = (np.arange(COUNT) % 5600) < 3500
    course, now = np.empty(COUNT), 0.0
    for k in range(COUNT):
        now += ((20.0 if lit[k] else -20.0) - now) / 900.0
        course[k] = now
    return course


@pytest.mark.parametrize(("noise_k", "left"), [(0.05, 0.35), (0.3, 0.2), (1.0, 0.15)])
def test_noise_is_taken_off_a_temperature(noise_k: float, left: float) -> None:
    """Of white noise a fifth and less is left, for a course that bends within minutes."""
    course = heated()
    noisy = course + noise_k * np.random.default_rng(3).standard_normal(COUNT)
    error = smooth_course(noisy) - course
    assert float(np.sqrt(np.mean(error**2))) < left * noise_k


def test_what_has_no_noise_stays_to_the_last_bit() -> None:
    """A noise-free course, a constant and a handful of values are as they were."""
    for values in (heated(), np.full(COUNT, 21.5), np.array([1.0, 5.0, 2.0])):
        assert np.array_equal(smooth_course(values), values)


def test_a_straight_line_under_noise_comes_back_straight() -> None:
    """The smoother does not bend a ramp at its ends by more than the noise of a few samples' mean."""
    ramp = np.linspace(-10.0, 30.0, COUNT)
    found = smooth_course(ramp + 0.3 * np.random.default_rng(5).standard_normal(COUNT))
    assert float(np.abs(found - ramp).max()) < 0.3


def test_white_noise_alone_is_all_but_gone() -> None:
    """A sensor that reads nothing but noise drives nothing."""
    noise = np.random.default_rng(7).standard_normal(COUNT)
    assert float(np.std(smooth_course(noise))) < 0.15


def test_a_course_with_jumps_stays_as_it_is() -> None:
    """Sessions at other temperatures, a little noise within each: no smooth course follows, and none is made up."""
    sessions = np.repeat(np.random.default_rng(9).uniform(-20.0, 40.0, COUNT // 60), 60)
    values = sessions + 0.02 * np.random.default_rng(10).standard_normal(COUNT)
    assert float(np.abs(smooth_course(values) - values).max()) < 0.1


def flowing(kind: str) -> Array:
    """A load that switches at random, every 40 samples on the average, or a battery's current that swings."""
    rng = np.random.default_rng(8912)
    if kind == "switching":
        return (np.cumsum(rng.random(COUNT) < 1.0 / 40.0) % 2).astype(np.float64)
    return 0.5 + 0.35 * np.sin(np.arange(COUNT) / 31.0) + 0.35 * np.sin(np.arange(COUNT) / 87.0 + 1.0)


@pytest.mark.parametrize("kind", ["switching", "swinging"])
@pytest.mark.parametrize("noise_a", [0.15, 0.3, 0.6])
def test_a_regression_on_what_a_noisy_record_lets_expect_has_no_bias(kind: str, noise_a: float) -> None:
    """On the record itself it is short by the noise's share of the variance: 8 to 60 %."""
    true = flowing(kind)
    record = true + noise_a * np.random.default_rng(8913).standard_normal(COUNT)
    assert noise_of(record) == pytest.approx(noise_a, rel=0.08)
    found = expected_course(record)
    for course, low, high in ((found, 0.97, 1.03), (record, 0.2, 1.0 - 0.5 * noise_a**2 / (np.var(true) + noise_a**2))):
        about = course - course.mean()
        assert low < float(about @ true) / float(about @ about) < high
    assert np.mean((found - true) ** 2) < 0.6 * noise_a**2


@pytest.mark.parametrize("values", [flowing("switching"), flowing("swinging"), np.ones(COUNT), np.arange(20.0)])
def test_a_record_without_noise_has_none(values: Array) -> None:
    assert noise_of(values) == 0.0


def test_noise_alone_is_no_record() -> None:
    assert noise_of(np.random.default_rng(8914).standard_normal(COUNT)) == 0.0
