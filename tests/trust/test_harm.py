"""The comparison of a craft with compensation and without: what harms is said, what helps or does nothing is not."""

from __future__ import annotations

import numpy as np
import pytest

from magcal_service.model import Array, measure
from magcal_service.trust.harm import BLOCK_S, KEPT, HarmWatch

X = np.array([4000.0, -2000.0, 1000.0, 0.02, -0.03, 0.05, 0.01, 0.0, -0.02])
NOISE_NT = 100.0
SECONDS = 5500


def flight(seed: int) -> tuple[Array, Array, Array]:
    """Measured vectors (n, 3), magnitudes (n,) [nT] of a turning craft, and a field (n, 3) that follows an orbit."""
    t = np.arange(SECONDS)
    size = 35_000.0 + 10_000.0 * np.sin(t / 900.0)
    angle, tilt = 2.0 * np.pi * t / 8.0, 0.9 * np.sin(t / 700.0) + 0.4
    unit = np.stack([np.cos(angle) * np.cos(tilt), np.sin(angle) * np.cos(tilt), np.sin(tilt)], axis=1)
    truth = unit * size[:, None]
    noise = NOISE_NT * np.random.default_rng(seed).standard_normal((SECONDS, 3))
    slow = np.array([1.0, -0.6, 0.8]) * np.sin(t / 800.0)[:, None]
    return measure(X, truth + noise), size, slow


def said(watch: HarmWatch, ours: Array, theirs: Array, magnitude: Array, seconds: range) -> int | None:
    """Second at which harm is said first, None where it never is."""
    for t in seconds:
        watch.compensated(float(t), ours[t], float(magnitude[t]))
        watch.plain(float(t), theirs[t], float(magnitude[t]))
        if watch.harm():
            return t
    return None


@pytest.mark.parametrize("seed", range(4))
def test_what_harms_is_said_within_an_orbit_and_what_helps_never(seed: int) -> None:
    """A field of 2 sigma that is not there, taken off; the same one that is there, taken off; by its mirror image."""
    field, magnitude, slow = flight(seed)
    disturbed = field + 2.0 * NOISE_NT * slow
    harmed = said(HarmWatch(X), disturbed, field, magnitude, range(SECONDS))
    assert harmed is not None
    assert harmed > 11 * BLOCK_S
    assert said(HarmWatch(X), field, disturbed, magnitude, range(SECONDS)) is None


@pytest.mark.parametrize("every_s", [4, 8])
def test_a_sensor_that_samples_seldom_is_compared_in_longer_blocks(every_s: int) -> None:
    """A field of 2 sigma that is not there, taken off, at 4 and 8 s."""
    field, magnitude, slow = flight(5)
    disturbed = field + 2.0 * NOISE_NT * slow
    wrong, right, size = (
        np.concatenate([part] * 8) for part in (disturbed, field, magnitude)
    )  # an orbit again and again
    seconds = range(0, len(size), every_s)
    assert said(HarmWatch(X), wrong, right, size, seconds) is not None
    assert said(HarmWatch(X), right, wrong, size, seconds) is None


@pytest.mark.parametrize("seed", range(4))
def test_what_makes_no_difference_is_not_called_harm(seed: int) -> None:
    """A field of 3 % of the noise more on either side, and exactly the same."""
    field, magnitude, slow = flight(seed)
    assert said(HarmWatch(X), field + 0.03 * NOISE_NT * slow, field, magnitude, range(SECONDS)) is None
    assert said(HarmWatch(X), field, field, magnitude, range(SECONDS)) is None


def test_each_side_has_nine_errors_of_its_own() -> None:
    """A compensation that is constant only moves the bias: nothing is worse for it, however large."""
    field, magnitude, _ = flight(1)
    moved = field + np.array([900.0, -500.0, 700.0])
    assert said(HarmWatch(X), moved, field, magnitude, range(SECONDS)) is None


def test_outliers_of_the_sensor_are_no_evidence() -> None:
    """Spikes that hit both alike, which compensation turns by a little."""
    field, magnitude, slow = flight(2)
    spikes = np.random.default_rng(5).random(SECONDS) < 0.05
    field[spikes] += 20_000.0
    assert said(HarmWatch(X), field + 0.03 * NOISE_NT * slow, field, magnitude, range(SECONDS)) is None
    assert said(HarmWatch(X), field + 2.0 * NOISE_NT * slow, field, magnitude, range(SECONDS)) is not None


def test_ticks_that_one_side_did_not_have_are_not_compared() -> None:
    """Where a driver is missing the compensated side gives none; the other's do not pile up."""
    field, magnitude, slow = flight(3)
    watch = HarmWatch(X)
    for t in range(SECONDS):
        if t % 1000 < 300:
            watch.compensated(float(t), field[t], float(magnitude[t]))
        watch.plain(float(t), field[t] + 20.0 * slow[t], float(magnitude[t]))
        assert watch.harm() == ""
    assert 200 < len(watch._rows) < 0.35 * SECONDS / 4
    assert len(watch._without) < 200


def test_an_orbit_is_kept_and_what_was_right_before_does_not_excuse() -> None:
    """A model that fitted for an hour and then does not is stopped within the next."""
    field, magnitude, slow = flight(4)
    disturbed = field + 3.0 * NOISE_NT * slow
    watch = HarmWatch(X)
    assert said(watch, field, disturbed, magnitude, range(SECONDS)) is None
    for t in range(SECONDS):  # the same flight again, the other way round
        watch.compensated(float(t + SECONDS), disturbed[t], float(magnitude[t]))
        watch.plain(float(t + SECONDS), field[t], float(magnitude[t]))
        assert len(watch._rows) <= KEPT
        if watch.harm():
            break
    assert t < 5500


def test_a_restored_comparison_goes_on_as_it_was() -> None:
    field, magnitude, slow = flight(5)
    disturbed = field + 2.0 * NOISE_NT * slow
    whole, one, two = HarmWatch(X), HarmWatch(X), HarmWatch(np.zeros(9))
    at = said(whole, disturbed, field, magnitude, range(SECONDS))
    assert said(one, disturbed, field, magnitude, range(1500)) is None
    two.restore_state(one.export_state())
    assert said(two, disturbed, field, magnitude, range(1500, SECONDS)) == at
