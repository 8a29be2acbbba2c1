"""The EKF as published: right from a narrow prior, and the convergence trouble from a wide one."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig
from magcal_service.estimators.ekf import Ekf
from magcal_service.estimators.interface import Estimator, StateEstimate
from magcal_service.estimators.scalar_ukf import ScalarUkf
from magcal_service.model import Array
from tests.equations import predicted_scalar, scalar_jacobian, scalar_measurement
from tests.estimators.method_data import PAPER_NOISE_NT, paper_field, play

RUNS = 8


def craft(bias_nt: float, d: float) -> CraftConfig:
    filters = FilterConfig(prior_bias_nt=bias_nt, prior_D=d)
    return CraftConfig("craft", sensor=SensorConfig(noise_nt=PAPER_NOISE_NT), filter=filters)


@cache
def runs(method: type[Estimator], bias_nt: float, d: float) -> list[tuple[Array, StateEstimate]]:
    """Truth and final estimate of runs whose errors are of the size that the prior says."""
    field, results = paper_field().until(3600.0), []
    for seed in np.random.SeedSequence(50).spawn(RUNS):
        rng = np.random.default_rng(seed)
        direction = rng.standard_normal(3)
        x = np.concatenate([bias_nt * direction / np.linalg.norm(direction), rng.uniform(-d, d, 6)])
        estimator = method(craft(bias_nt, d))
        play(estimator, field.ticks(field.measured(rng, x), per_tick=4))
        results.append((x, estimator.estimate()))
    return results


def failures(results: list[tuple[Array, StateEstimate]]) -> int:
    """Runs whose bias is off by more than five of its own sigma and 50 nT."""
    limits = [np.maximum(5.0 * np.sqrt(np.diagonal(e.covariance)[:3]), 50.0) for _, e in results]
    return sum(bool(np.any(np.abs(e.x[:3] - x[:3]) > limit)) for (x, e), limit in zip(results, limits, strict=True))


def test_it_converges_from_a_narrow_prior() -> None:
    assert failures(runs(Ekf, 3000.0, 0.03)) == 0


def test_from_a_wide_prior_most_runs_do_not_converge() -> None:
    """30 uT and 0.2: the trouble that the paper reports."""
    assert failures(runs(Ekf, 30_000.0, 0.2)) >= RUNS // 2


def test_the_ukf_with_its_batch_start_converges_in_the_same_runs() -> None:
    assert failures(runs(ScalarUkf, 30_000.0, 0.2)) == 0


def test_a_run_that_failed_is_sure_of_itself() -> None:
    """Which is why it is dangerous: its sigma says under 200 nT, its error is ten times that."""
    results = runs(Ekf, 30_000.0, 0.2)
    errors = np.array([np.abs(e.x[:3] - x[:3]).max() for x, e in results])
    sigmas = np.array([np.sqrt(np.diagonal(e.covariance)[:3]).max() for _, e in results])
    assert np.any((errors > 2000.0) & (sigmas < 200.0))


def test_one_update_is_the_extended_kalman_filters_of_equations_3_and_4() -> None:
    field = paper_field().until(600.0)
    tick = next(field.ticks(field.measured(np.random.default_rng(51))))
    estimator = Ekf(craft(3000.0, 0.03))
    P = np.diag(np.array([3000.0] * 3 + [0.03] * 6) ** 2)
    B, magnitude = tick.field_body_nt, tick.reference_magnitude_nt
    zero = np.zeros(9)
    H = scalar_jacobian(zero, B)
    R = 4.0 * float(B[0] @ B[0]) * PAPER_NOISE_NT**2 + 6.0 * PAPER_NOISE_NT**4
    S = (H @ P @ H.T)[0, 0] + R
    innovation = scalar_measurement(B, magnitude) - predicted_scalar(zero, B) - 3.0 * PAPER_NOISE_NT**2
    outcome = estimator.handle(tick)
    np.testing.assert_allclose(estimator.estimate().x, (P @ H.T)[:, 0] / S * innovation, rtol=1e-9)
    np.testing.assert_allclose(estimator.estimate().covariance, P - P @ H.T @ H @ P / S, rtol=1e-9, atol=1e-12)
    assert outcome.squared_innovation == pytest.approx(float(innovation[0]) ** 2 / S)


def test_process_noise_grows_with_the_time_between_ticks() -> None:
    walk = FilterConfig(prior_bias_nt=100.0, prior_D=0.01, process_noise_bias_nt=(5.0, 5.0, 5.0))
    estimator = Ekf(CraftConfig("craft", sensor=SensorConfig(noise_nt=1e5), filter=walk))
    field = paper_field().until(600.0)
    measured = field.measured(np.random.default_rng(52))
    for first in (0, 400):  # noise of 1e5 nT: the samples themselves say nothing
        estimator.handle(field.tick(measured, first, slice(first, first + 1)))
    assert estimator.estimate().covariance[0, 0] == pytest.approx(100.0**2 + 400.0 * 5.0**2, rel=1e-2)
