"""The sliding batch: a plain TWO-STEP while nothing is old, and one that follows when errors change."""

from __future__ import annotations

import math

import numpy as np
import pytest

from magcal_service.config.settings import CraftConfig, SensorConfig
from magcal_service.estimators.interface import Estimator
from magcal_service.estimators.sliding_batch import SlidingBatch
from magcal_service.estimators.two_step import TwoStep
from tests.estimators.method_data import PAPER_NOISE_NT, PAPER_X, Field, nees, paper_field, play

CRAFT = CraftConfig("craft", sensor=SensorConfig(noise_nt=PAPER_NOISE_NT))


def run(estimator: Estimator, field: Field, measured: np.ndarray, per_tick: int = 20) -> Estimator:
    play(estimator, field.ticks(measured, per_tick=per_tick))
    return estimator


def test_with_a_window_that_holds_everything_it_is_two_step() -> None:
    field = paper_field().until(4000.0)
    measured = field.measured(np.random.default_rng(90))
    sliding = run(SlidingBatch(CRAFT, window_s=1e6, decay_s=math.inf), field, measured).estimate()
    batch = run(TwoStep(CRAFT), field, measured).estimate()
    np.testing.assert_allclose(sliding.x, batch.x, rtol=1e-6)
    sigma = np.sqrt(np.diagonal(batch.covariance))
    np.testing.assert_allclose((sliding.covariance - batch.covariance) / np.outer(sigma, sigma), 0.0, atol=5e-3)


def test_a_step_of_200_nt_is_followed_where_the_plain_batch_lags() -> None:
    field = paper_field()
    measured = field.measured(np.random.default_rng(91))
    after = field.times_s >= 6000.0
    measured[after] += np.linalg.solve(
        np.eye(3) + np.array([[0.05, 0.05, 0.05], [0.05, 0.1, 0.05], [0.05, 0.05, 0.05]]), [200.0, 0.0, 0.0]
    )
    truth = PAPER_X + np.array([200.0, *[0.0] * 8])
    errors, sigmas = [], []
    for estimator in (SlidingBatch(CRAFT), TwoStep(CRAFT)):
        state = run(estimator, field, measured).estimate()
        errors.append(abs(state.x[0] - truth[0]))
        sigmas.append(math.sqrt(state.covariance[0, 0]))
    assert errors[0] < 4.0 * sigmas[0]
    assert errors[1] > 10.0 * sigmas[1]


def test_samples_older_than_the_window_have_no_influence() -> None:
    """Two recordings that differ in their first hour only end in the same estimate."""
    field = paper_field().until(12_000.0)
    measured = field.measured(np.random.default_rng(92))
    other = measured.copy()
    other[:3600] = field.measured(np.random.default_rng(93), PAPER_X * 1.02)[:3600]
    one, two = (run(SlidingBatch(CRAFT), field, values).estimate() for values in (measured, other))
    np.testing.assert_allclose(one.x, two.x, rtol=1e-9, atol=1e-9)


def test_the_covariance_of_the_weighted_batch_is_its_scatter() -> None:
    """Mean NEES of 16 runs has the standard deviation 1.06 about 9."""
    field = paper_field().until(6000.0)
    values = []
    for seed in np.random.SeedSequence(94).spawn(16):
        measured = field.measured(np.random.default_rng(seed))
        state = run(SlidingBatch(CRAFT), field, measured, per_tick=100).estimate()
        values.append(nees(state.x - PAPER_X, state.covariance))
    assert np.mean(values) == pytest.approx(9.0, abs=2.5)


def test_forgetting_costs_accuracy_while_nothing_changes() -> None:
    field = paper_field().until(6000.0)
    measured = field.measured(np.random.default_rng(95))
    decaying, plain = (
        run(SlidingBatch(CRAFT, decay_s=decay_s), field, measured).estimate() for decay_s in (1800.0, math.inf)
    )
    assert np.all(np.diagonal(decaying.covariance) > 1.1 * np.diagonal(plain.covariance))
