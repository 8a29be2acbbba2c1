"""TWO-STEP and the sliding batch against batches written out in a few lines of numpy, and their limits."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from magcal_service.config.settings import FilterConfig
from magcal_service.estimators import two_step as two_step_module
from magcal_service.estimators.interface import Phase, StartGate
from magcal_service.estimators.parts.magnitude_sums import MagnitudeSums, scaled
from magcal_service.estimators.parts.noise_level import NoiseLevel
from magcal_service.estimators.sliding_batch import SlidingBatch
from magcal_service.estimators.two_step import Solution, TwoStep, correlation_of, two_step
from magcal_service.model import calibrate, field_jacobian, scalar_residual
from tests.estimators.method_ticks import CONFIG, NOISE_NT, PRIOR, X, cloud, ticks

# TWO-STEP and the sliding batch


def sums_of(field: np.ndarray, magnitude: np.ndarray) -> MagnitudeSums:
    sums = MagnitudeSums()
    sums.add(field, magnitude)
    return sums


@pytest.mark.parametrize("corrected", [True, False])
def test_a_solution_is_where_the_gradient_of_the_batch_is_zero(corrected: bool) -> None:
    field, magnitude = cloud(2000)
    sums, noise = sums_of(field, magnitude), NoiseLevel(NOISE_NT)
    found = two_step(sums, noise, PRIOR, corrected=corrected)
    assert isinstance(found, Solution)
    y, s2 = scaled(found.x), (NOISE_NT / 30_000.0) ** 2
    tie = s2 * scaled(PRIOR) ** -2.0
    gradient = sums.gradient(y, NOISE_NT, corrected=corrected) + tie * y
    normal = sums.information(y, NOISE_NT, corrected=corrected) + np.diag(tie)
    assert float(gradient @ np.linalg.solve(normal, gradient)) / s2 < 1e-6
    unit = np.array([30_000.0] * 3 + [1.0] * 6)
    np.testing.assert_allclose(
        found.covariance / np.outer(unit, unit), s2 * np.linalg.inv(normal), rtol=1e-6, atol=1e-15
    )
    assert found.count == 2000.0
    assert found.residual_nt == pytest.approx(math.sqrt(sums.mean_square_nt(y)), rel=1e-9)
    assert float(np.abs((found.x - X) / np.sqrt(np.diagonal(found.covariance))).max()) < (4.5 if corrected else 20.0)
    warm = two_step(sums, noise, PRIOR, corrected=corrected, start=found.x + np.sqrt(np.diagonal(found.covariance)))
    assert isinstance(warm, Solution)
    np.testing.assert_allclose((warm.x - found.x) / np.sqrt(np.diagonal(found.covariance)), 0.0, atol=0.01)


def test_a_start_that_is_far_off_is_left_for_the_linear_one() -> None:
    field, magnitude = cloud(500)
    sums, noise = sums_of(field, magnitude), NoiseLevel(NOISE_NT)
    cold = two_step(sums, noise, PRIOR)
    far = two_step(sums, noise, PRIOR, start=X + 0.5 * PRIOR)
    assert isinstance(cold, Solution)
    assert isinstance(far, Solution)
    np.testing.assert_array_equal(far.x, cold.x)


def test_correlations_are_covariances_over_sigmas_and_need_positive_variances() -> None:
    mixed = np.random.default_rng(4).normal(size=(9, 12)) * PRIOR[:, None]
    covariance = mixed @ mixed.T
    sigma = np.sqrt(np.diagonal(covariance))
    np.testing.assert_allclose(correlation_of(covariance), covariance / np.outer(sigma, sigma), rtol=1e-12)
    for bad in (0.0, -1.0, math.nan):
        spoilt = covariance.copy()
        spoilt[4, 4] = bad
        with pytest.raises(np.linalg.LinAlgError):
            correlation_of(spoilt)


@pytest.mark.parametrize(
    ("residual_nt", "sigma_nt", "gate"),
    [(899.0, 1.0, None), (901.0, 1.0, StartGate.BAD_FIT), (100.0, 0.99, None), (100.0, 1.01, StartGate.POOR_COVERAGE)],
)
def test_gates_of_the_batch(residual_nt: float, sigma_nt: float, gate: StartGate | None) -> None:
    """Residual level within three times the noise; the worst component of w known to 3 % of |H|."""
    target = TwoStep(CONFIG)
    field = np.tile([[40_000.0, 0.0, 0.0]], (10, 1))
    target._all.add(field, np.full(10, 40_000.0))
    covariance = np.diag([(1200.0 * sigma_nt) ** 2] * 3 + [0.0] * 6)
    assert target._gate_of(Solution(X, covariance, residual_nt, 10.0)) is gate


def test_starts_are_tried_with_five_percent_more_and_runs_are_solved_with_half_a_percent_new(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[tuple[int, bool]] = []
    answers: list[Solution | StartGate] = []
    covariance = np.diag([1.0] * 3 + [1e-10] * 6)

    def solve(
        sums: MagnitudeSums, noise: object, prior: object, *, corrected: bool, start: np.ndarray | None = None
    ) -> object:
        asked.append((round(sums.count), start is not None))
        return answers[-1] if answers else Solution(X, covariance, 300.0, sums.count)

    monkeypatch.setattr(two_step_module, "two_step", solve)
    target = TwoStep(replace(CONFIG, filter=FilterConfig(start_s=100.0)))
    answers.append(StartGate.NOT_POSITIVE)
    stream = ticks(*cloud(2000))
    for tick in stream[:112]:
        target.handle(tick)
    assert [count for count, _ in asked] == [101, 106, 112]
    assert (target.estimate().waiting_for, target.estimate().phase) == (StartGate.NOT_POSITIVE, Phase.STARTING)
    answers.clear()
    for tick in stream[112:400]:
        target.handle(tick)
    assert asked[3:6] == [(118, False), (119, True), (120, True)]
    assert (target.estimate().phase, target.estimate().waiting_for) == (Phase.RUNNING, None)
    counts = [count for count, _ in asked]
    steps = {a: b - a for a, b in pairwise(counts)}
    assert {steps[count] for count in counts[4:-1] if count <= 200} == {1}  # half a percent of 200 is one sample
    assert {steps[count] for count in counts[4:-1] if count > 200} == {2}
    assert target.estimate().samples == 400
    answers.append(StartGate.COLLAPSED)
    for tick in stream[400:410]:
        target.handle(tick)
    state = target.estimate()
    assert (state.phase, state.restarts, state.waiting_for) == (Phase.STARTING, 1, StartGate.COLLAPSED)
    np.testing.assert_array_equal(state.x, X)


def test_a_batch_needs_more_than_twice_as_many_samples_as_states(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []

    def solve(sums: MagnitudeSums, *_: object, **__: object) -> StartGate:
        asked.append(sums.count)
        return StartGate.POOR_COVERAGE

    monkeypatch.setattr(two_step_module, "two_step", solve)
    target = TwoStep(replace(CONFIG, filter=FilterConfig(start_s=10.0)))
    for tick in ticks(*cloud(25)):
        target.handle(tick)
    assert asked[0] == 19.0


def test_a_running_batch_gives_the_normalised_squares_of_its_samples() -> None:
    target = TwoStep(replace(CONFIG, filter=FilterConfig(start_s=100.0)))
    field, magnitude = cloud(300)
    for tick in ticks(field, magnitude, 2):
        before = target.estimate()
        outcome = target.handle(tick)
        residual = scalar_residual(before.x, tick.field_body_nt, tick.reference_magnitude_nt)
        np.testing.assert_allclose(outcome.residual_nt, residual, rtol=1e-12)
        if before.phase is Phase.STARTING:
            assert (outcome.squared_innovation, outcome.degrees) == (0.0, 0)
            continue
        expected = 0.0
        for b, e in zip(tick.field_body_nt, residual, strict=True):
            w = calibrate(before.x, b)
            row = w @ field_jacobian(b) / np.linalg.norm(w)
            expected += (e - NOISE_NT**2 / np.linalg.norm(w)) ** 2 / (NOISE_NT**2 + row @ before.covariance @ row)
        assert (outcome.squared_innovation, outcome.degrees) == (pytest.approx(expected, rel=1e-6), 2)
    assert target.estimate().phase is Phase.RUNNING


def test_the_level_of_a_batch_counts_the_fitted_parameters() -> None:
    field, magnitude = cloud(40)
    sums = sums_of(field, magnitude)
    y = scaled(X)
    assert TwoStep._level(sums, y) == pytest.approx(math.sqrt(sums.mean_square_nt(y) * 40.0 / 31.0), rel=1e-12)
    few = sums_of(field[:5], magnitude[:5])
    assert TwoStep._level(few, y) == pytest.approx(math.sqrt(few.mean_square_nt(y) * 5.0), rel=1e-12)


def test_a_sliding_batch_weighs_blocks_of_a_minute_by_their_age_and_drops_those_beyond_its_window() -> None:
    """Window 600 s, decay 200 s: sums of each block times exp(-age of its first sample / decay)."""
    target = SlidingBatch(CONFIG, window_s=600.0, decay_s=200.0)
    field, magnitude = cloud(2000)
    stream = ticks(field, magnitude)
    for tick in stream[:1000]:
        target._take(tick)
    starts = [start for start, _ in target._blocks]
    assert starts == [float(second) for second in range(360, 1000, 60)]
    for power in (1.0, 2.0):
        weight = np.exp(-power * (999.0 - np.array(starts)) / 200.0)
        expected = MagnitudeSums()
        for start, each in zip(starts, weight.tolist(), strict=True):
            part = slice(int(start), min(int(start) + 60, 1000))
            expected = expected + sums_of(field[part], magnitude[part]).times(each)
        found = target._weighted(power)
        assert found.count == pytest.approx(expected.count, rel=1e-12)
        np.testing.assert_allclose(found.normal, expected.normal, rtol=1e-9)
    target._take(stream[1020])
    assert target._blocks[0][0] == 420.0


def test_the_covariance_of_a_weighted_batch_is_that_of_weighted_least_squares() -> None:
    """P (sum w^2 F) P with P = (sum w F + prior)^-1, F the information of a block."""
    target = SlidingBatch(CONFIG, window_s=600.0, decay_s=200.0)
    field, magnitude = cloud(600)
    for tick in ticks(field, magnitude):
        target._take(tick)
    solution = two_step(target._sums(), NoiseLevel(NOISE_NT), PRIOR)
    assert isinstance(solution, Solution)
    target._accept(solution)
    unit = np.array([30_000.0] * 3 + [1.0] * 6)
    y = scaled(solution.x)
    squared = target._weighted(2.0).information(y, NOISE_NT, corrected=False) / (NOISE_NT / 30_000.0) ** 2
    scatter = squared / np.outer(unit, unit) + np.diag(PRIOR**-2.0)
    expected = solution.covariance @ scatter @ solution.covariance
    scale = np.sqrt(np.diagonal(expected))
    np.testing.assert_allclose(
        target.estimate().covariance / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-9
    )
    assert (target._fresh, target._solved_count) == (0, solution.count)
