"""The batch start: right where it hands over, silent where it can't know, never in a mirror."""

import numpy as np
import pytest

from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig
from magcal_service.estimators.interface import StartGate
from magcal_service.estimators.parts.start import BatchSolution, StartCollector, batch_start, prior_sigma
from magcal_service.estimators.parts.start_problem import BatchProblem, WindowMeans, gauss_newton, linear_states
from magcal_service.model import d_matrix
from tests.estimators.estimator_ticks import TABLE_1, Craft

SECONDS = 6000


def batch(craft: Craft, noise_nt: float | None, seconds: int = SECONDS) -> BatchSolution | StartGate:
    _, measured, reference = craft.arrays(seconds)
    return batch_start(measured, np.linalg.norm(reference, axis=1), (), noise_nt, FilterConfig())


def random_errors(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    bias = rng.normal(size=3)
    return np.concatenate([30_000.0 * bias / np.linalg.norm(bias), rng.uniform(-0.15, 0.15, 6)])


@pytest.mark.parametrize("seed", range(6))
def test_solution_lies_within_its_own_covariance(seed: int) -> None:
    craft = Craft(seed=seed, x=random_errors(seed))
    solution = batch(craft, 300.0)
    assert isinstance(solution, BatchSolution)
    error = solution.x - craft.x
    assert error @ np.linalg.solve(solution.covariance, error) < 27.9  # chi-square of 9, one in a thousand


def test_unknown_noise_is_found() -> None:
    solution = batch(Craft(seed=7), None)
    assert isinstance(solution, BatchSolution)
    assert solution.sigma_nt == pytest.approx(300.0, rel=0.05)
    assert solution.noise_nt == pytest.approx(300.0, rel=0.05)


def test_linear_start_alone_is_near_the_truth() -> None:
    craft = Craft(seed=8, noise_nt=50.0)
    _, measured, reference = craft.arrays(SECONDS)
    problem = BatchProblem(
        measured, np.linalg.norm(reference, axis=1), WindowMeans.of(()), prior_sigma(FilterConfig()), 50.0, 50.0
    )
    x, positive = linear_states(problem)
    assert positive
    assert np.abs(x - TABLE_1)[:3].max() < 100.0


def test_scattered_gauss_newton_starts_meet_half_collapsed_minima_and_the_linear_start_does_not() -> None:
    craft = Craft(seed=9, noise_nt=50.0)
    _, measured, reference = craft.arrays(SECONDS)
    problem = BatchProblem(
        measured[::10],
        np.linalg.norm(reference[::10], axis=1),
        WindowMeans.of(()),
        10.0 * prior_sigma(FilterConfig()),
        50.0,
        50.0,
    )
    rng = np.random.default_rng(10)
    wrong = 0
    for _ in range(12):
        scattered = np.concatenate([rng.uniform(-60_000.0, 60_000.0, 3), rng.uniform(-1.6, -0.4, 3), np.zeros(3)])
        found = gauss_newton(problem, scattered)
        wrong += found is None or np.linalg.eigvalsh(np.eye(3) + d_matrix(found[0]))[0] < 0.4
    assert wrong >= 6
    first, positive = linear_states(problem)
    assert positive
    found = gauss_newton(problem, first)
    assert found is not None
    assert np.abs(found[0] - TABLE_1)[:3].max() < 30.0


def test_a_short_arc_is_not_handed_over() -> None:
    assert isinstance(batch(Craft(seed=11), 300.0, seconds=120), StartGate)


def test_samples_that_contradict_the_stated_noise_are_not_handed_over() -> None:
    assert batch(Craft(seed=12, noise_nt=1500.0), 300.0) is StartGate.BAD_FIT


def test_a_reference_in_other_units_is_seen_as_collapse() -> None:
    _, measured, reference = Craft(seed=13).arrays(SECONDS)
    found = batch_start(measured, 0.1 * np.linalg.norm(reference, axis=1), (), None, FilterConfig())
    assert isinstance(found, StartGate)


def test_collector_hands_over_when_the_field_has_turned_enough() -> None:
    collector = StartCollector(CraftConfig("x", sensor=SensorConfig(noise_nt=300.0)))
    for tick in Craft(seed=14).ticks(4000):
        solution = collector.push(tick, None)
        if solution is not None:
            break
    assert solution is not None
    assert 120.0 <= tick.times_s[-1] < 3000.0
    error = solution.x - TABLE_1
    assert error @ np.linalg.solve(solution.covariance, error) < 27.9


def test_collector_thins_fast_samples_without_losing_their_weight() -> None:
    fast = StartCollector(CraftConfig("x", sensor=SensorConfig(noise_nt=300.0)))
    for tick in Craft(seed=15, rate_hz=10).ticks(3000):
        solution = fast.push(tick, None)
        if solution is not None:
            break
    assert solution is not None
    assert fast.samples <= 4096
    error = solution.x - TABLE_1
    assert error @ np.linalg.solve(solution.covariance, error) < 9.0 * 27.9
