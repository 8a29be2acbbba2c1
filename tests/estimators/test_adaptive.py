"""Jumps of the errors: what the closed form equals, that the quiet costs nothing, and that jumps are followed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magcal_service.config.reader import load_config
from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig, SpinConfig
from magcal_service.estimators.parts.adaptive import EVERY_TICKS, JUMP_D, JUMP_NT, Change, ChangeDetector
from magcal_service.estimators.ukf import Ukf
from magcal_service.model import Array, d_matrix
from magcal_service.ticks.assembler import Tick
from tests.estimators.estimator_ticks import TABLE_1, Craft

NOISE_NT = 300.0
ADAPTIVE = CraftConfig(
    "craft", sensor=SensorConfig(noise_nt=NOISE_NT), spin=SpinConfig(), filter=FilterConfig(adaptive=True)
)
FIXED = replace(ADAPTIVE, filter=FilterConfig())
PRIOR = np.array([200.0] * 3 + [0.01] * 6)


class LinearFilter:
    """A Kalman filter of nine constant states that are seen through random rows [nT, -]."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.truth = PRIOR * self.rng.standard_normal(9)
        self.x, self.covariance = np.zeros(9), np.diag(PRIOR**2)

    def measure(self) -> tuple[Array, float]:
        """A row (9,) and its noisy value [nT]."""
        row = np.array([1.0] * 3 + [30_000.0] * 6) * self.rng.standard_normal(9)
        return row, float(row @ self.truth) + NOISE_NT * float(self.rng.standard_normal())

    def update(self, row: Array, value: float) -> None:
        cross = self.covariance @ row
        variance = float(row @ cross) + NOISE_NT**2
        self.x = self.x + cross * ((value - float(row @ self.x)) / variance)
        updated = self.covariance - np.outer(cross, cross) / variance
        self.covariance = 0.5 * (updated + updated.T)

    def watched(self, detector: ChangeDetector, ticks: int) -> list[tuple[int, Change]]:
        """So many ticks with a detector that follows; what it found, and when."""
        found = []
        for tick in range(ticks):
            self.update(*self.measure())
            change = detector.push(float(tick), self.x, self.covariance, NOISE_NT**2)
            if change is not None:
                self.x, self.covariance = change.x, change.covariance
                found.append((tick, change))
        return found


def test_the_estimate_that_follows_is_that_of_a_filter_with_process_noise_at_the_jump() -> None:
    first, knowing, detector = LinearFilter(1), LinearFilter(1), ChangeDetector()
    ticks, rows = 50 * EVERY_TICKS, []
    first.watched(detector, ticks)
    first.truth[:3] += [400.0, -300.0, 500.0]
    change = None
    while change is None:
        rows.append(first.measure())
        first.update(*rows[-1])
        change = detector.push(0.0, first.x, first.covariance, NOISE_NT**2)
    jump_at = ticks + len(rows) - change.ticks_ago
    earlier = [knowing.measure() for _ in range(ticks)]
    for tick, row in enumerate(earlier + rows):
        if tick == jump_at:
            free = change.jump != 0.0
            knowing.covariance += np.diag(np.array([JUMP_NT] * 3 + [JUMP_D] * 6) ** 2 * free)
        knowing.update(*row)
    sigma = np.sqrt(np.diagonal(knowing.covariance))
    np.testing.assert_allclose(
        change.covariance / np.outer(sigma, sigma), knowing.covariance / np.outer(sigma, sigma), atol=1e-7
    )
    np.testing.assert_allclose((change.x - knowing.x) / sigma, 0.0, atol=1e-6)


def test_a_linear_filter_is_left_alone_in_the_quiet() -> None:
    assert [LinearFilter(seed).watched(ChangeDetector(), 5000) for seed in range(4)] == [[]] * 4


@pytest.mark.parametrize("state", [0, 2, 3, 7])
def test_a_jump_of_any_state_is_found_timed_and_followed(state: int) -> None:
    craft, detector = LinearFilter(2), ChangeDetector()
    assert craft.watched(detector, 2000) == []
    craft.truth[state] += 0.5 * PRIOR[state]
    [(tick, change), *_] = craft.watched(detector, 2000)
    assert tick <= 1500
    assert abs(change.ticks_ago - tick) <= max(2 * EVERY_TICKS, tick / 4)
    error = craft.x - craft.truth
    assert float(error @ np.linalg.solve(craft.covariance, error)) < 27.9  # chi-square of 9, exceeded once in 1000


def taken_for_a_bias() -> tuple[LinearFilter, ChangeDetector]:
    """A gain has jumped, and for 400 ticks a bias would have shown alike: which of them it was is open."""
    craft, detector = LinearFilter(5), ChangeDetector()
    assert craft.watched(detector, 1500) == []
    craft.truth[3] += 200.0 / 30_000.0
    for tick in range(400):  # the sum of bx and 30 uT times D11 alone is seen
        row = np.eye(9)[0] + 30_000.0 * np.eye(9)[3]
        craft.update(row, float(row @ craft.truth) + 30.0 * float(craft.rng.standard_normal()))
        change = detector.push(float(tick), craft.x, craft.covariance, NOISE_NT**2)
        if change is not None:
            craft.x, craft.covariance = change.x, change.covariance
    assert craft.x[0] - craft.truth[0] > 100.0
    return craft, detector


def test_a_gain_that_looked_like_a_bias_is_put_right_once_they_are_told_apart() -> None:
    craft, detector = taken_for_a_bias()
    changes = craft.watched(detector, 1500)
    error = craft.x - craft.truth
    assert len(changes) == 1
    assert float(error @ np.linalg.solve(craft.covariance, error)) < 27.9


def test_what_is_open_outlives_a_restart() -> None:
    """A checkpoint is written while it is not known yet what has jumped."""
    (craft, detector), (other, _), restored = taken_for_a_bias(), taken_for_a_bias(), ChangeDetector()
    restored.restore_state(detector.export_state())
    found, again = craft.watched(detector, 1500), other.watched(restored, 1500)
    assert len(found) == 1
    assert [(tick, change.ticks_ago, change.x.tolist()) for tick, change in again] == [
        (tick, change.ticks_ago, change.x.tolist()) for tick, change in found
    ]


def test_a_random_walk_that_the_filter_knows_of_is_no_jump() -> None:
    walk = np.diag((PRIOR / 300.0) ** 2)
    craft, detector = LinearFilter(3), ChangeDetector(walk)
    for tick in range(4000):
        craft.truth = craft.truth + np.sqrt(np.diagonal(walk)) * craft.rng.standard_normal(9)
        craft.covariance = craft.covariance + walk
        craft.update(*craft.measure())
        assert detector.push(float(tick), craft.x, craft.covariance, NOISE_NT**2) is None


def test_a_change_of_the_assumed_noise_is_no_jump() -> None:
    craft, detector = LinearFilter(4), ChangeDetector()
    for tick in range(3000):
        craft.update(*craft.measure())
        level = 1.0 + tick / 1000.0  # the same estimate, with a noise level that is being learnt
        assert detector.push(float(tick), craft.x, level * craft.covariance, level * NOISE_NT**2) is None


def play(config: CraftConfig, ticks: list[Tick]) -> Ukf:
    estimator = Ukf(config)
    for tick in ticks:
        estimator.handle(tick)
    return estimator


def stepped(ticks: list[Tick], at: int, step_nt: Array) -> list[Tick]:
    """The same ticks with the bias ``step_nt`` (3,) [nT] higher from one of them on."""
    moved = np.linalg.solve(np.eye(3) + d_matrix(TABLE_1), step_nt)
    return ticks[:at] + [replace(tick, field_body_nt=tick.field_body_nt + moved) for tick in ticks[at:]]


@pytest.fixture(scope="module")
def flight() -> list[Tick]:
    return list(Craft(seed=11).ticks(5400))


def test_in_the_quiet_the_filter_is_the_same_to_the_last_bit(flight: list[Tick]) -> None:
    with_it, without = (play(config, flight[:3000]).estimate() for config in (ADAPTIVE, FIXED))
    assert np.array_equal(with_it.x, without.x)
    assert np.array_equal(with_it.covariance, without.covariance)


@pytest.mark.parametrize(("axis", "within_s"), [(0, 300), (1, 300), (2, 300)])
def test_200_nt_in_one_axis_are_followed_without_a_restart(flight: list[Tick], axis: int, within_s: int) -> None:
    step = 200.0 * np.eye(3)[axis]
    estimator = play(ADAPTIVE, stepped(flight, 4000, step)[: 4000 + within_s])
    state = estimator.estimate()
    error = (state.x[:3] - TABLE_1[:3] - step) / np.sqrt(np.diagonal(state.covariance)[:3])
    assert estimator.changes >= 1
    assert state.restarts == 0
    assert np.abs(error).max() < 3.5
    assert state.covariance[axis, axis] ** 0.5 < 60.0


def test_without_it_the_same_step_is_not_followed_in_that_time(flight: list[Tick]) -> None:
    state = play(FIXED, stepped(flight, 4000, np.array([0.0, 0.0, 200.0]))).estimate()
    assert abs(state.x[2] - TABLE_1[2] - 200.0) > 10.0 * state.covariance[2, 2] ** 0.5


def test_a_spin_that_is_not_as_configured_is_still_given_up(flight: list[Tick]) -> None:
    other = Craft(seed=12, rate_rpm=9.5).ticks(2500)
    ticks = flight[:1500] + list(other)[1500:]
    assert play(ADAPTIVE, ticks).estimate().spin_given_up


def test_reset_forgets_the_jumps(flight: list[Tick]) -> None:
    estimator = play(ADAPTIVE, stepped(flight, 3000, np.array([400.0, 0.0, 0.0]))[:3300])
    assert estimator.changes >= 1
    estimator.reset()
    assert estimator.changes == 0


@pytest.mark.parametrize("value", [True, False])
def test_the_setting_is_read(tmp_path: Path, value: bool) -> None:
    path = tmp_path / "magcal.toml"
    text = f'version = 1\n[[craft]]\nname = "a"\n[craft.filter]\nadaptive = {str(value).lower()}\n'
    path.write_text(text, encoding="utf-8")
    assert load_config(path).crafts[0].filter.adaptive is value
