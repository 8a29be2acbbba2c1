"""The gates of the batch start from both sides, what is left out of it, and when an attempt is due."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig
from magcal_service.estimators.interface import StartGate
from magcal_service.estimators.parts import start as module
from magcal_service.estimators.parts.spin_window import Window, across_axis
from magcal_service.estimators.parts.start import (
    BatchSolution,
    StartBuffer,
    StartCollector,
    batch_start,
    fits_all,
    gated,
    lowest,
    prior_sigma,
    vector_sigma,
    without_outliers,
)
from magcal_service.estimators.parts.start_problem import BatchProblem, WindowMeans
from magcal_service.model import field_jacobian, measure
from magcal_service.ticks.assembler import Tick

CONFIG = FilterConfig()
X = np.array([900.0, -1400.0, 2100.0, 0.05, -0.08, 0.11, 0.03, -0.04, 0.06])
MAGNITUDE_NT = 40_000.0


def sphere(count: int, noise_nt: float = 0.0, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """B (n, 3) of a craft with the errors ``X`` in all directions, and |H| (n,) that changes by a third."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    magnitude = MAGNITUDE_NT * rng.uniform(0.8, 1.2, count)
    return measure(X, direction * magnitude[:, None] + noise_nt * rng.normal(size=(count, 3))), magnitude


def solution(sigma_of_w_nt: float = 1.0, **changes: object) -> BatchSolution:
    """A sound one, in which every calibrated vector is known to ``sigma_of_w_nt``, its three components together."""
    covariance = np.diag([sigma_of_w_nt**2 / 3.0] * 3 + [0.0] * 6)
    return replace(BatchSolution(np.zeros(9), covariance, 300.0, 300.0, 300.0), **changes)  # type: ignore[arg-type]


def gate_of(found: BatchSolution, noise_nt: float | None = None, thinned: int = 1) -> StartGate | None:
    field = np.tile([[MAGNITUDE_NT, 0.0, 0.0]], (20, 1))
    result = gated(found, field, np.full(20, MAGNITUDE_NT), noise_nt, thinned)
    return result if isinstance(result, StartGate) else None


def placed(index: int, value: float) -> np.ndarray:
    x = np.zeros(9)
    x[index] = value
    return x


@pytest.mark.parametrize(
    ("x", "gate"),
    [
        (placed(3, -0.599), None), (placed(4, -0.601), StartGate.COLLAPSED),
        (placed(5, 1.499), None), (placed(3, 1.501), StartGate.COLLAPSED),
        (placed(7, 0.599), None), (placed(7, 0.601), StartGate.COLLAPSED),
        (placed(0, math.nan), StartGate.NO_CONVERGENCE), (placed(3, math.inf), StartGate.NO_CONVERGENCE),
    ],
)  # fmt: skip
def test_eigenvalues_from_0_4_to_2_5_are_no_collapse(x: np.ndarray, gate: StartGate | None) -> None:
    assert gate_of(solution(x=x)) is gate


def test_a_covariance_that_is_not_finite_is_no_convergence() -> None:
    assert gate_of(solution(covariance=np.full((9, 9), np.nan))) is StartGate.NO_CONVERGENCE


@pytest.mark.parametrize(
    ("rms_nt", "noise_nt", "gate"),
    [(449.0, 300.0, None), (451.0, 300.0, StartGate.BAD_FIT), (9000.0, None, None)],
)
def test_a_residual_of_more_than_1_5_times_the_noise_is_a_bad_fit(
    rms_nt: float, noise_nt: float | None, gate: StartGate | None
) -> None:
    assert gate_of(solution(residual_rms_nt=rms_nt), noise_nt) is gate


@pytest.mark.parametrize(
    ("sigma_nt", "share"),
    [(300.0, math.sqrt(0.005 * 300.0 / MAGNITUDE_NT)), (10.0, 0.005), (20_000.0, 0.03)],
)
def test_the_filter_takes_over_when_second_order_is_small_against_the_residual(sigma_nt: float, share: float) -> None:
    """|H| share^2 is half a percent of sigma, within half a percent and three percent of |H|."""
    limit_nt = share * MAGNITUDE_NT
    assert gate_of(solution(0.999 * limit_nt, sigma_nt=sigma_nt)) is None
    assert gate_of(solution(1.001 * limit_nt, sigma_nt=sigma_nt)) is StartGate.POOR_COVERAGE


def test_samples_that_stand_for_others_weigh_as_many() -> None:
    limit_nt = math.sqrt(0.005 * 300.0 / MAGNITUDE_NT) * MAGNITUDE_NT
    assert gate_of(solution(1.99 * limit_nt), thinned=4) is None
    assert gate_of(solution(2.01 * limit_nt), thinned=4) is StartGate.POOR_COVERAGE


def test_the_sigma_of_a_vector_is_the_largest_over_the_samples_of_its_three_components_together() -> None:
    rng = np.random.default_rng(2)
    field = rng.normal(size=(40, 3)) * 30_000.0
    mixed = rng.normal(size=(9, 12)) * np.array([50.0] * 3 + [2e-3] * 6)[:, None]
    covariance = mixed @ mixed.T
    expected = max(float(np.trace(j @ covariance @ j.T)) for j in field_jacobian(field)) ** 0.5
    assert vector_sigma(covariance, field) == pytest.approx(expected, rel=1e-12)
    spread = np.repeat(field, 5, axis=0)  # every fourth is looked at: all forty are among them
    assert vector_sigma(covariance, spread) == pytest.approx(expected, rel=1e-12)


def test_the_prior_is_that_of_the_configuration() -> None:
    assert prior_sigma(FilterConfig(prior_bias_nt=123.0, prior_D=0.25)).tolist() == [123.0] * 3 + [0.25] * 6


# Outliers


def bare(
    field: np.ndarray, magnitude: np.ndarray, noise_nt: float = 300.0, windows: list[Window] | None = None
) -> BatchProblem:
    return BatchProblem(field, magnitude, WindowMeans.of(windows or []), prior_sigma(CONFIG), noise_nt, noise_nt)


def test_spikes_are_left_out_and_everything_else_is_used() -> None:
    """The solution is that of the samples without them."""
    field, magnitude = sphere(300, 300.0)
    sound = batch_start(field[20:], magnitude[20:], [], 300.0, CONFIG)
    field[:20] *= 1.5
    found = batch_start(field, magnitude, [], 300.0, CONFIG)
    assert isinstance(found, BatchSolution)
    assert isinstance(sound, BatchSolution)
    np.testing.assert_allclose(found.x, sound.x, rtol=1e-6, atol=1e-9)
    assert found.residual_rms_nt == pytest.approx(sound.residual_rms_nt, rel=1e-6)


@pytest.mark.parametrize(("share", "bad"), [(0.35, False), (0.45, True)])
def test_where_less_than_six_in_ten_would_be_left_the_fit_is_bad(share: float, bad: bool) -> None:
    field, magnitude = sphere(300, 30.0)
    field[: round(300 * share)] *= 10.0
    found = batch_start(field, magnitude, [], 30.0, CONFIG)
    assert (found is StartGate.BAD_FIT) is bad


@pytest.mark.parametrize(("sigmas", "inside"), [(5.9, True), (6.1, False)])
def test_six_sigmas_of_the_median_are_inside(sigmas: float, inside: bool) -> None:
    """Three in four |B| are 100 nT off the median of 40 000: so is the median deviation, and their sigma 148.26 nT."""
    field = np.tile([[MAGNITUDE_NT, 0.0, 0.0]], (41, 1))
    field[:15, 0] += 100.0
    field[15:31, 0] -= 100.0
    field[40, 0] += sigmas * 148.26
    one = bare(np.stack([field, field[:, [1, 0, 2]]]), np.full(41, MAGNITUDE_NT))
    assert without_outliers(one).tolist() == [inside, inside]


def window(off_nt: float, count: int = 16) -> Window:
    """A window across z whose mean is off by so much, with 300 nT of noise."""
    phase = 2.0 * math.pi * np.arange(count) / count
    field = 30_000.0 * np.stack([np.cos(phase), np.sin(phase), np.ones(count)], axis=1) + [off_nt, 0.0, 0.0]
    return Window(
        np.full(count, 1.0 / count), field, np.full(count, 42_426.0), across_axis(np.array([0.0, 0.0, 1.0])), 0.0, 1.0
    )


@pytest.mark.parametrize(("sigmas", "fits"), [(5.9, True), (6.1, False)])
def test_a_solution_fits_all_where_no_window_is_six_sigmas_off(sigmas: float, fits: bool) -> None:
    """A mean over 16 samples of 300 nT has 75 nT."""
    field, magnitude = sphere(60, 300.0)
    one = bare(field, magnitude, windows=[window(0.0), window(sigmas * 75.0)])
    one = replace(
        one,
        field_nt=measure(np.zeros(9), np.full((60, 3), 20_000.0)),
        magnitude_nt=np.full(60, 20_000.0 * math.sqrt(3.0)),
    )
    assert fits_all(one, np.zeros(9)) is fits


def test_two_minima_that_are_as_good_are_poor_coverage_and_a_better_one_wins() -> None:
    """Distinct: more than 25 in squared sigmas apart.  Advantages below 25 do not tell them apart."""
    field, magnitude = sphere(200, 300.0)
    one = bare(field, magnitude)
    truth = batch_start(field, magnitude, [], 300.0, CONFIG)
    assert isinstance(truth, BatchSolution)
    wrong = truth.x + np.array([3000.0, 0, 0, 0, 0, 0, 0, 0, 0])
    for order in ([truth.x, wrong], [wrong, truth.x]):
        found = lowest(one, [(x, truth.covariance) for x in order])
        assert isinstance(found, BatchSolution)
        np.testing.assert_array_equal(found.x, truth.x)
    few = replace(one, sigma_nt=1e5, noise_nt=1e5)
    assert lowest(few, [(truth.x, truth.covariance), (wrong, truth.covariance)]) is StartGate.POOR_COVERAGE


def test_of_two_roads_to_one_minimum_the_nearer_is_taken() -> None:
    field, magnitude = sphere(200, 300.0)
    one = bare(field, magnitude)
    truth = batch_start(field, magnitude, [], 300.0, CONFIG)
    assert isinstance(truth, BatchSolution)
    beside = truth.x + 0.1 * np.sqrt(np.diagonal(truth.covariance))
    for order in ([truth.x, beside], [beside, truth.x]):
        found = lowest(one, [(x, truth.covariance) for x in order])
        assert isinstance(found, BatchSolution)
        np.testing.assert_array_equal(found.x, truth.x)
        assert found.residual_rms_nt == pytest.approx(float(np.sqrt(np.mean(one.residuals(truth.x) ** 2))), rel=1e-12)
        assert (found.sigma_nt, found.noise_nt) == (300.0, 300.0)


@pytest.mark.parametrize("noise_nt", [30.0, 300.0])
def test_a_noise_that_is_not_given_is_taken_from_the_residual(noise_nt: float) -> None:
    field, magnitude = sphere(600, noise_nt)
    found = batch_start(field, magnitude, [], None, CONFIG)
    assert isinstance(found, BatchSolution)
    assert found.sigma_nt == pytest.approx(noise_nt, rel=0.1)
    assert found.noise_nt == pytest.approx(noise_nt, rel=0.15)
    given = batch_start(field, magnitude, [], found.sigma_nt, CONFIG)
    assert isinstance(given, BatchSolution)
    np.testing.assert_allclose(found.covariance, given.covariance, rtol=0.1, atol=1e-3 * given.covariance.max())


def test_samples_of_one_direction_do_not_converge() -> None:
    field = np.tile([[0.0, 0.0, 0.0]], (30, 1))
    assert batch_start(field, np.full(30, MAGNITUDE_NT), [], 300.0, CONFIG) is StartGate.NO_CONVERGENCE


# What is kept, and when


def tick(index: int, count: int = 1, period_s: float = 1.0, *, after_gap: bool = False) -> Tick:
    times = period_s * index + np.arange(count) / count
    return Tick(index, times, np.full((count, 3), float(index)), np.full(count, MAGNITUDE_NT), after_gap=after_gap)


@pytest.mark.parametrize(
    ("after_s", "attempts"), [(120.0, [120, 138, 159, 183, 211]), (20.0, [20, 30, 40, 50, 60, 70, 81])]
)
def test_attempts_are_put_off_by_15_percent_and_at_least_10_s(after_s: float, attempts: list[int]) -> None:
    buffer: StartBuffer[int] = StartBuffer(after_s)
    due = []
    for index in range(attempts[-1] + 1):
        buffer.add(tick(index), index)
        if buffer.due():
            due.append(index)
    assert due == attempts


def test_more_than_twice_as_many_samples_as_states_are_needed() -> None:
    buffer: StartBuffer[int] = StartBuffer(0.0)
    due = []
    for index in range(25):
        buffer.add(tick(index), index)
        due.append(buffer.due())
    assert due.index(True) == 18


def test_time_over_a_gap_does_not_count() -> None:
    buffer: StartBuffer[int] = StartBuffer(120.0)
    for index in (0, 1, 2):
        buffer.add(tick(index), index)
    buffer.add(tick(1000, after_gap=True), 3)
    buffer.add(tick(1001), 4)
    assert (buffer.seconds, buffer.samples, buffer.entries) == (3.0, 5, [0, 1, 2, 3, 4])


def test_beyond_4096_samples_every_second_entry_goes_again_and_again() -> None:
    buffer: StartBuffer[int] = StartBuffer(0.0)
    for index in range(4096):
        buffer.add(tick(index), index)
    assert (buffer.stride, buffer.samples, len(buffer.entries)) == (1, 4096, 4096)
    for index in range(4096, 9000):
        buffer.add(tick(index), index)
        assert buffer.samples <= 4096
        assert buffer.samples == len(buffer.entries)
    assert buffer.stride == 4
    steps = np.diff(buffer.entries)
    assert steps.max() <= 4
    assert 9000 // 4 - 2 <= len(buffer.entries) <= 9000 // 4 + 2


def test_entries_of_ticks_with_many_samples_count_all_of_them() -> None:
    buffer: StartBuffer[int] = StartBuffer(0.0)
    for index in range(410):
        buffer.add(tick(index, 10), index)
    assert (buffer.stride, buffer.samples, len(buffer.entries)) == (2, 2050, 205)


def collector(
    results: dict[tuple[bool, bool], object], monkeypatch: pytest.MonkeyPatch, max_s: float = 100.0
) -> tuple[StartCollector, list[tuple[int, float | None]]]:
    """A collector whose batch gives ``results`` by (with windows, with the noise given); and how it was asked."""
    asked: list[tuple[int, float | None]] = []

    def solve(field: object, magnitude: object, windows: list[Window], noise_nt: float | None, *_: object) -> object:
        asked.append((len(windows), noise_nt))
        return results[bool(windows), noise_nt is not None]

    monkeypatch.setattr(module, "batch_start", solve)
    config = CraftConfig("c", SensorConfig(300.0), filter=FilterConfig(start_s=20.0, start_max_s=max_s))
    return StartCollector(config), asked


def until_asked(
    target: StartCollector, asked: list[tuple[int, float | None]], with_window: bool, ticks: int = 21
) -> object:
    found = None
    for index in range(ticks):
        found = target.push(tick(index), window(0.0) if with_window and index == 5 else None)
        if found is not None:
            return found
    return found


GOOD, THIN = solution(), StartGate.POOR_COVERAGE


@pytest.mark.parametrize(
    ("results", "with_window", "expected", "calls", "flags"),
    [
        ({(True, True): GOOD}, True, GOOD, [(1, 300.0)], (False, False)),
        ({(False, True): GOOD}, False, GOOD, [(0, 300.0)], (False, False)),
        ({(True, True): StartGate.BAD_FIT, (False, True): GOOD}, True, GOOD, [(1, 300.0), (0, 300.0)], (True, False)),
        ({(True, True): StartGate.BAD_FIT, (False, True): THIN}, True, THIN, [(1, 300.0), (0, 300.0)], (False, False)),
        ({(True, True): THIN}, True, THIN, [(1, 300.0)], (False, False)),
        ({(False, True): StartGate.BAD_FIT}, False, StartGate.BAD_FIT, [(0, 300.0)], (False, False)),
    ],
)  # fmt: skip
def test_windows_that_spoil_a_fit_are_left_out(
    monkeypatch: pytest.MonkeyPatch, results: dict[tuple[bool, bool], object], with_window: bool, expected: object,
    calls: list[tuple[int, float | None]], flags: tuple[bool, bool],
) -> None:  # fmt: skip
    target, asked = collector(results, monkeypatch)
    found = until_asked(target, asked, with_window)
    assert asked == calls
    assert (found if found is not None else target.gate) is expected
    assert (target.spin_contradicted, target.noise_contradicted) == flags


@pytest.mark.parametrize(("max_s", "taken"), [(19.0, True), (20.0, False)])
def test_a_noise_that_contradicts_the_residual_for_too_long_is_not_believed(
    monkeypatch: pytest.MonkeyPatch, max_s: float, taken: bool
) -> None:
    target, asked = collector({(False, True): StartGate.BAD_FIT, (False, False): GOOD}, monkeypatch, max_s)
    found = until_asked(target, asked, with_window=False)
    assert asked == ([(0, 300.0), (0, None)] if taken else [(0, 300.0)])
    assert (found is GOOD, target.noise_contradicted) == (taken, taken)


def test_the_batch_is_given_all_samples_and_how_many_each_stands_for(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[tuple[object, ...]] = []
    monkeypatch.setattr(module, "batch_start", lambda *arguments: given.append(arguments) or StartGate.POOR_COVERAGE)
    target = StartCollector(CraftConfig("c", SensorConfig(300.0), filter=FilterConfig(start_s=20.0)))
    for index in range(21):
        target.push(tick(index, 2), None)
    field, magnitude, _, noise_nt, config, stride = given[0]
    np.testing.assert_array_equal(np.asarray(field)[:, 0], np.repeat(np.arange(21), 2)[: len(np.asarray(field))])
    assert (len(np.asarray(magnitude)), noise_nt, config, stride) == (
        len(np.asarray(field)),
        300.0,
        target.config.filter,
        1,
    )
    assert target.samples == 42
