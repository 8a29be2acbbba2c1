"""TWO-STEP: its sums, its corrections, its gates, and that it attains the Cramer-Rao bound."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig
from magcal_service.estimators.interface import InformationSet, Phase, StartGate
from magcal_service.estimators.parts.magnitude_sums import (
    MagnitudeSums,
    coefficient_jacobian,
    coefficients,
    scaled,
    unscaled,
)
from magcal_service.estimators.parts.noise_level import NoiseLevel
from magcal_service.estimators.parts.start import prior_sigma
from magcal_service.estimators.sliding_batch import SlidingBatch
from magcal_service.estimators.two_step import Solution, TwoStep, published, two_step
from magcal_service.model import Array, measure
from magcal_service.studies.bounds import bound_sigma
from magcal_service.ticks.assembler import Tick
from tests.equations import predicted_scalar, scalar_measurement
from tests.estimators.method_data import NEAR_NORMAL, PAPER_NOISE_NT, PAPER_X, nees, paper_field, play, sigmas_off

PRIOR = prior_sigma(FilterConfig())
NOISY = CraftConfig("craft", sensor=SensorConfig(noise_nt=PAPER_NOISE_NT))
RUNS = 80
DIAGONAL = (1.0, 1.0, 1.0)


@cache
def runs(direction: tuple[float, float, float], corrected: bool) -> tuple[Array, Array, Array]:
    """Errors (k, 9), covariances (k, 9, 9) of ``RUNS`` batches with fresh noise, and the bound (9,)."""
    field = paper_field(direction)
    magnitude = np.linalg.norm(field.reference_eci_nt, axis=1)
    errors, covariances = [], []
    for seed in np.random.SeedSequence(20).spawn(RUNS):
        sums = MagnitudeSums()
        sums.add(field.measured(np.random.default_rng(seed)), magnitude)
        solution = two_step(sums, NoiseLevel(PAPER_NOISE_NT), PRIOR, corrected=corrected)
        assert isinstance(solution, Solution)
        errors.append(solution.x - PAPER_X)
        covariances.append(solution.covariance)
    return np.array(errors), np.array(covariances), bound_sigma(field.flight(), InformationSet.SCALAR)


@pytest.mark.parametrize("direction", [DIAGONAL, NEAR_NORMAL])
def test_the_scatter_is_the_cramer_rao_bound(direction: tuple[float, float, float]) -> None:
    """A standard deviation of 80 runs is known to 8 %; three and a half times that is allowed."""
    errors, _, bound = runs(direction, True)
    np.testing.assert_allclose(errors.std(axis=0) / bound, 1.0, rtol=0.0, atol=0.28)


@pytest.mark.parametrize("direction", [DIAGONAL, NEAR_NORMAL])
def test_the_estimate_is_unbiased(direction: tuple[float, float, float]) -> None:
    errors, _, bound = runs(direction, True)
    assert np.all(np.abs(errors.mean(axis=0)) < 3.5 * bound / np.sqrt(RUNS))


@pytest.mark.parametrize("direction", [DIAGONAL, NEAR_NORMAL])
def test_the_covariance_is_the_bound(direction: tuple[float, float, float]) -> None:
    _, covariances, bound = runs(direction, True)
    sigma = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    np.testing.assert_allclose(sigma / bound, np.ones_like(sigma), rtol=0.0, atol=0.02)


@pytest.mark.parametrize("direction", [DIAGONAL, NEAR_NORMAL])
def test_the_covariance_is_consistent(direction: tuple[float, float, float]) -> None:
    """Mean NEES of 80 runs has the standard deviation 0.47 about 9."""
    errors, covariances, _ = runs(direction, True)
    mean = np.mean([nees(error, covariance) for error, covariance in zip(errors, covariances, strict=True)])
    assert mean == pytest.approx(9.0, abs=1.6)


def test_the_published_form_is_biased_by_the_noise_inside_the_measured_vector() -> None:
    """By most of a sigma in the scale factors at 300 nT: the reason for the correction."""
    errors, covariances, bound = runs(DIAGONAL, False)
    mean = np.mean([nees(error, covariance) for error, covariance in zip(errors, covariances, strict=True)])
    assert np.all(errors[:, 3:6].mean(axis=0) < -0.5 * bound[3:6])
    assert mean > 12.0


def test_the_published_form_takes_the_mean_of_v_off() -> None:
    """Without it the bias along the worst observed axis would be ten sigma off."""
    errors, _, bound = runs(DIAGONAL, False)
    assert np.all(np.abs(errors.mean(axis=0)) < 2.0 * bound)


def test_the_sums_hold_the_cost_of_every_state() -> None:
    rng = np.random.default_rng(21)
    field, x = rng.normal(0.0, 30_000.0, (50, 3)), PAPER_X * rng.normal(1.0, 0.5, 9)
    magnitude = np.linalg.norm(field, axis=1) * rng.uniform(0.9, 1.1, 50)
    sums = MagnitudeSums()
    sums.add(field, magnitude)
    direct = (scalar_measurement(field, magnitude) - predicted_scalar(x, field)) / (2.0 * magnitude)
    assert sums.mean_square_nt(scaled(x)) == pytest.approx(np.mean(direct**2), rel=1e-9)


def test_sums_of_stretches_add() -> None:
    rng = np.random.default_rng(22)
    field, magnitude = rng.normal(0.0, 30_000.0, (40, 3)), rng.uniform(20_000.0, 50_000.0, 40)
    whole, first, second = MagnitudeSums(), MagnitudeSums(), MagnitudeSums()
    whole.add(field, magnitude)
    first.add(field[:13], magnitude[:13])
    second.add(field[13:], magnitude[13:])
    both = first + second
    np.testing.assert_allclose(both.normal, whole.normal, rtol=1e-12)
    np.testing.assert_allclose(both.target, whole.target, rtol=1e-12)
    assert (both.count, both.square) == (40.0, pytest.approx(whole.square, rel=1e-12))


def test_the_derivative_of_the_coefficients_is_the_numerical_one() -> None:
    y = scaled(PAPER_X * np.linspace(-1.0, 2.0, 9))
    numerical = [(coefficients(y + h) - coefficients(y - h)) / 2e-6 for h in 1e-6 * np.eye(9)]
    np.testing.assert_allclose(coefficient_jacobian(y), np.array(numerical).T, rtol=0.0, atol=1e-8)


def test_scaling_a_state_is_undone() -> None:
    np.testing.assert_allclose(unscaled(scaled(PAPER_X)), PAPER_X, rtol=1e-15)


def noisy_sums(noise_nt: float) -> tuple[MagnitudeSums, MagnitudeSums, Array]:
    """Sums of 200000 directions without and with noise, and the gradients' means with noise (9,) by its own sigma."""
    rng = np.random.default_rng(23)
    field = rng.normal(0.0, 1.0, (200_000, 3)) * [20_000.0, 25_000.0, 15_000.0] + [0.0, 10_000.0, 10_000.0]
    field = field[np.linalg.norm(field, axis=1) > 15_000.0]
    magnitude = np.linalg.norm(field, axis=1)
    gradients = []
    for _ in range(8):
        noisy, clean = MagnitudeSums(), MagnitudeSums()
        noisy.add(measure(PAPER_X, field + noise_nt * rng.standard_normal(field.shape)), magnitude)
        gradients.append([noisy.gradient(scaled(PAPER_X), noise_nt, corrected=c) for c in (False, True)])
    clean.add(measure(PAPER_X, field), magnitude)
    values = np.array(gradients)
    return clean, noisy, values.mean(axis=0) / (values.std(axis=0, ddof=1) / np.sqrt(8.0))


def test_the_corrections_take_off_what_the_noise_inside_the_vector_adds() -> None:
    """At 1500 nT the mean gradient at the truth is many sigmas off without the correction, and none with it."""
    clean, noisy, (without, with_correction) = noisy_sums(1500.0)
    y = scaled(PAPER_X)
    assert np.abs(without).max() > 20.0
    assert np.abs(with_correction).max() < 6.0  # Student's t with 7 degrees
    expected = np.diagonal(clean.information(y, 0.0, corrected=False))
    raw, corrected = (np.diagonal(noisy.information(y, 1500.0, corrected=c)) for c in (False, True))
    assert np.abs(corrected / expected - 1.0).max() < 0.5 * np.abs(raw / expected - 1.0).max()


@pytest.mark.parametrize("seed", range(6))
def test_large_errors_do_not_lead_into_a_false_minimum(seed: int) -> None:
    """A bias of 60 uT and |D| up to 0.25."""
    rng = np.random.default_rng([24, seed])
    direction = rng.standard_normal(3)
    x = np.concatenate([60_000.0 * direction / np.linalg.norm(direction), rng.uniform(-0.25, 0.25, 6)])
    field = paper_field().until(9000.0)
    sums = MagnitudeSums()
    sums.add(field.measured(rng, x), np.linalg.norm(field.reference_eci_nt, axis=1))
    solution = two_step(sums, NoiseLevel(PAPER_NOISE_NT), PRIOR)
    assert isinstance(solution, Solution)
    assert np.all(np.abs(solution.x - x) < 5.0 * np.sqrt(np.diagonal(solution.covariance)))


def test_an_unknown_noise_is_found() -> None:
    field = paper_field().until(6000.0)
    estimator = TwoStep(CraftConfig("craft"))
    play(estimator, field.ticks(field.measured(np.random.default_rng(25)), per_tick=10))
    assert estimator.estimate().noise_nt == pytest.approx(PAPER_NOISE_NT, rel=0.04)
    assert np.all(np.abs(sigmas_off(estimator, PAPER_X)) < 4.0)


def test_a_field_in_one_direction_gives_no_estimate() -> None:
    field = paper_field().until(600.0)
    still = np.tile(field.measured(np.random.default_rng(26))[:1], (600, 1))
    estimator = TwoStep(NOISY)
    play(estimator, field.ticks(still + np.random.default_rng(27).normal(0.0, 300.0, still.shape), per_tick=10))
    state = estimator.estimate()
    assert state.phase is Phase.STARTING
    assert state.waiting_for is not None
    np.testing.assert_array_equal(state.x, np.zeros(9))


def test_samples_that_contradict_the_noise_are_refused() -> None:
    field = paper_field().until(3000.0)
    estimator = TwoStep(CraftConfig("craft", sensor=SensorConfig(noise_nt=20.0)))
    play(estimator, field.ticks(field.measured(np.random.default_rng(28)), per_tick=10))
    assert estimator.estimate().waiting_for is StartGate.BAD_FIT


def test_the_estimator_ends_where_the_batch_of_all_samples_does() -> None:
    """To the half percent of samples that may not have entered yet: a tenth of a sigma."""
    field = paper_field().until(6000.0)
    measured = field.measured(np.random.default_rng(29))
    estimator = TwoStep(NOISY)
    play(estimator, field.ticks(measured, per_tick=5))
    sums = MagnitudeSums()
    sums.add(measured, np.linalg.norm(field.reference_eci_nt, axis=1))
    batch = two_step(sums, NoiseLevel(PAPER_NOISE_NT), PRIOR)
    assert isinstance(batch, Solution)
    np.testing.assert_allclose(sigmas_off(estimator, batch.x), np.zeros(9), atol=0.25)


def test_the_published_form_can_be_had_as_an_estimator() -> None:
    field = paper_field().until(3000.0)
    measured = field.measured(np.random.default_rng(30))
    ours, theirs = TwoStep(NOISY), published(NOISY)
    for estimator in (ours, theirs):
        play(estimator, field.ticks(measured, per_tick=10))
    apart = sigmas_off(theirs, ours.estimate().x)
    assert 0.1 < np.abs(apart).max() < 5.0


@pytest.mark.parametrize("method", [TwoStep, SlidingBatch])
@pytest.mark.parametrize("magnitude_nt", [1.0, 300.0, 2e5])
@pytest.mark.parametrize("shape", ["cloud", "plane", "line", "point"])
def test_samples_that_make_no_sense_are_stopped_by_a_gate(
    method: type[TwoStep], magnitude_nt: float, shape: str
) -> None:
    """Whatever a broken sensor or a wrong unit sends: a finite estimate and a reason, no exception."""
    rng = np.random.default_rng(31)
    spread = {"cloud": [1.0, 1.0, 1.0], "plane": [1.0, 1.0, 0.0], "line": [1.0, 0.0, 0.0], "point": [1e-7, 0.0, 0.0]}
    values = 900.0 * (rng.standard_normal((400, 3)) * spread[shape] + [0.0, 0.0, 1.0])
    estimator = method(CraftConfig("craft"))
    for index in range(0, 400, 4):
        part = slice(index, index + 4)
        magnitude = magnitude_nt * rng.uniform(0.8, 1.2, 4)
        estimator.handle(Tick(index, np.arange(400.0)[part], values[part], magnitude))
    state = estimator.estimate()
    assert np.isfinite(state.x).all()
    assert np.linalg.eigvalsh(state.covariance / np.sqrt(np.outer(*[np.diagonal(state.covariance)] * 2)))[0] > 0.0
    assert state.phase is Phase.RUNNING or state.waiting_for is not None
