"""What every method of the registry must do, whoever wrote it: found by its presence, judged by its behaviour."""

from __future__ import annotations

import importlib
import re
from dataclasses import replace
from functools import cache
from typing import Any

import msgpack
import numpy as np
import pytest

from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig, SpinConfig
from magcal_service.estimators import find_method, methods
from magcal_service.estimators.interface import Estimator, Phase, StateEstimate
from magcal_service.model import BIAS, STATE_NAMES, Array
from tests.estimators.method_data import PAPER_X, RateTick, paper_field, play

NAMES = [method.name for method in methods()]
NOISE_NT = 30.0
SECONDS, GAP_AT = 700, 420

every_method = pytest.mark.parametrize("name", NAMES)


def craft(name: str, **walk: Any) -> CraftConfig:
    """A craft with everything a method may want, its errors within a prior that the method takes."""
    bias_nt, d = (8000.0, 0.1) if find_method(name).takes_wide_prior else (300.0, 0.01)
    settings = FilterConfig(name, bias_nt, d, **walk)
    return CraftConfig("craft", sensor=SensorConfig(noise_nt=NOISE_NT), spin=SpinConfig(), filter=settings)


def truth(name: str) -> Array:
    """Table 1, at half of its size; without D for the methods that take it as zero."""
    x = (0.5 if find_method(name).takes_wide_prior else 0.05) * PAPER_X
    if not find_method(name).estimates_matrix:
        x[3:] = 0.0
    return x


@cache
def measured(name: str) -> Array:
    field = paper_field().until(SECONDS)
    return field.measured(np.random.default_rng(100), truth(name), NOISE_NT)


def ticks(name: str) -> list[RateTick]:
    return list(paper_field().until(SECONDS).ticks(measured(name), per_tick=3))


def build(name: str) -> Estimator:
    return find_method(name).build(craft(name))


@cache
def final(name: str) -> StateEstimate:
    """The estimate after the whole clean case."""
    estimator = build(name)
    play(estimator, ticks(name))
    return estimator.estimate()


def assert_within(state: StateEstimate, name: str, sigmas: float, part: slice = slice(None)) -> None:
    """Each error of the estimate is below its 1 sigma times a factor; a failure names both, state by state."""
    errors, sigma = np.abs(state.x - truth(name)), np.sqrt(np.diagonal(state.covariance))
    message = f"{name}: error of {', '.join(STATE_NAMES[part])} [nT, -] against {sigmas} sigma"
    np.testing.assert_array_less(errors[part], sigmas * sigma[part], err_msg=message)


def same(one: StateEstimate, other: StateEstimate) -> bool:
    arrays = np.array_equal(one.x, other.x) and np.array_equal(one.covariance, other.covariance)
    plain = replace(one, x=other.x, covariance=other.covariance) == other
    return arrays and plain


def test_the_methods_of_the_papers_comparison_are_all_there() -> None:
    expected = {"ukf", "two-step", "scalar-ukf", "ekf", "plkf", "rate-aided", "sliding-batch"}
    assert expected <= set(NAMES)


@every_method
def test_it_reports_under_its_own_name(name: str) -> None:
    assert build(name).name == name


@every_method
def test_its_file_names_its_source(name: str) -> None:
    module = importlib.import_module(find_method(name).build.__module__)
    found = re.search(r"^Source: \S.*\b(19|20)\d\d\b", module.__doc__ or "", re.MULTILINE)
    assert found, f"the docstring of {module.__name__} needs a line that begins with 'Source: ' and holds a year"


@every_method
def test_its_summary_is_one_line(name: str) -> None:
    summary = find_method(name).summary
    assert 10 < len(summary) < 120, "one line of 11 to 119 characters, for `magcal calibrate --help`"
    assert "\n" not in summary


@every_method
def test_it_uses_process_noise_or_says_that_it_does_not(name: str) -> None:
    """``has_process_noise`` decides whether the daemon's command is taken, and whether vectors age."""
    walked = find_method(name).build(craft(name, process_noise_bias_nt=(1.0,) * 3, process_noise_D=(1e-5,) * 6))
    play(walked, ticks(name))
    assert same(walked.estimate(), final(name)) != find_method(name).has_process_noise


@every_method
def test_it_estimates_d_or_says_that_it_does_not(name: str) -> None:
    """``estimates_matrix`` decides what a table shows: without it x has no D, and its sigma stays the prior's."""
    state, prior = final(name), craft(name).filter.prior_D
    sigma = np.sqrt(np.diagonal(state.covariance))[BIAS.stop :]
    if find_method(name).estimates_matrix:
        np.testing.assert_array_less(sigma, prior, err_msg=f"{name}: sigma of D against the prior's")
    else:
        np.testing.assert_allclose(sigma, prior, rtol=1e-12)
        np.testing.assert_array_equal(state.x[BIAS.stop :], 0.0)


@every_method
def test_before_any_sample_it_has_the_prior(name: str) -> None:
    state = build(name).estimate()
    assert state.phase is Phase.STARTING
    np.testing.assert_array_equal(state.x, np.zeros(9))
    sigma = np.sqrt(np.diagonal(state.covariance))
    settings = craft(name).filter
    np.testing.assert_allclose(sigma, [settings.prior_bias_nt] * 3 + [settings.prior_D] * 6, rtol=1e-12)


@every_method
def test_same_input_same_answer(name: str) -> None:
    estimator = build(name)
    play(estimator, ticks(name))
    assert same(estimator.estimate(), final(name))


@every_method
def test_a_reset_gives_the_same_result_again(name: str) -> None:
    estimator = build(name)
    fresh = estimator.estimate()
    play(estimator, ticks(name)[:200])
    estimator.reset()
    assert same(estimator.estimate(), fresh)
    play(estimator, ticks(name))
    assert same(estimator.estimate(), final(name))


@every_method
@pytest.mark.parametrize("count", [0, 3, 39, 121, 400])
def test_a_saved_state_goes_on_as_if_nothing_had_happened(name: str, count: int) -> None:
    """To the last bit, through msgpack, from the prior, from the midst of the start and from a running filter."""
    first, second = build(name), build(name)
    play(first, ticks(name)[:count])
    second.restore_state(msgpack.unpackb(msgpack.packb(first.export_state())))
    assert same(first.estimate(), second.estimate())
    play(second, ticks(name)[count:])
    assert same(second.estimate(), final(name))


@every_method
def test_saving_changes_nothing(name: str) -> None:
    estimator = build(name)
    for tick in ticks(name):
        estimator.handle(tick)
        if tick.index % 50 == 0:
            estimator.export_state()
    assert same(estimator.estimate(), final(name))


@every_method
def test_asking_for_the_estimate_changes_nothing(name: str) -> None:
    estimator = build(name)
    for tick in ticks(name):
        estimator.handle(tick)
        estimator.estimate()
    assert same(estimator.estimate(), final(name))


@every_method
def test_an_estimate_that_was_given_out_does_not_change_afterwards(name: str) -> None:
    estimator = build(name)
    play(estimator, ticks(name)[:400])
    state = estimator.estimate()
    x, covariance = state.x.copy(), state.covariance.copy()
    play(estimator, ticks(name)[400:])
    np.testing.assert_array_equal(state.x, x)
    np.testing.assert_array_equal(state.covariance, covariance)


@every_method
def test_its_inputs_are_unchanged(name: str) -> None:
    given, copies = ticks(name)[:200], ticks(name)[:200]
    for tick in given:
        for array in (tick.times_s, tick.field_body_nt, tick.reference_magnitude_nt, tick.reference_eci_nt):
            assert array is not None
            array.flags.writeable = False
    play(build(name), given)
    for one, other in zip(given, copies, strict=True):
        np.testing.assert_array_equal(one.field_body_nt, other.field_body_nt)


@every_method
def test_its_covariance_is_symmetric_and_positive_at_any_time(name: str) -> None:
    estimator = build(name)
    for count, tick in enumerate(ticks(name)):
        estimator.handle(tick)
        if count not in (0, 60, 250, SECONDS // 3 - 1):
            continue
        covariance = estimator.estimate().covariance
        sigma = np.sqrt(np.diagonal(covariance))
        correlation = covariance / np.outer(sigma, sigma)
        np.testing.assert_allclose(correlation, correlation.T, rtol=0.0, atol=1e-9)
        assert np.linalg.eigvalsh(correlation)[0] > 0.0, f"{name}: not positive after {count + 1} ticks"


@every_method
def test_the_bias_of_a_clean_case_is_found_to_its_stated_sigma(name: str) -> None:
    """Four sigma, and at least the two components across the spin axis to better than 30 nT."""
    state = final(name)
    sigma = np.sqrt(np.diagonal(state.covariance))
    assert state.phase is Phase.RUNNING
    assert_within(state, name, 4.0, BIAS)
    np.testing.assert_array_less(sigma[:2], 30.0, err_msg=f"{name}: 1 sigma of bx, by [nT]")


@every_method
def test_no_state_of_a_clean_case_is_off_by_more_than_its_sigma_allows(name: str) -> None:
    assert_within(final(name), name, 4.5)


@every_method
def test_ticks_of_one_to_five_samples_are_taken(name: str) -> None:
    field, rng = paper_field().until(SECONDS), np.random.default_rng(101)
    estimator, first, index, used = build(name), 0, 0, 0
    while first < SECONDS:
        size = int(rng.integers(1, 6))
        tick = field.tick(measured(name), index, slice(first, first + size))
        outcome = estimator.handle(tick)
        assert outcome.residual_nt.shape == tick.times_s.shape
        assert outcome.used + outcome.rejected == len(tick.times_s), "each sample is used or rejected, in its own tick"
        first, index, used = first + size, index + 1, used + outcome.used
    state = estimator.estimate()
    assert (state.samples, state.phase) == (used, Phase.RUNNING)
    assert_within(state, name, 4.5)


@every_method
def test_a_gap_of_ten_minutes_does_no_harm(name: str) -> None:
    """The estimate afterwards is as consistent as without it."""
    field = paper_field().until(SECONDS + 600)
    values = field.measured(np.random.default_rng(102), truth(name), NOISE_NT)
    whole = [*range(GAP_AT), *range(GAP_AT + 600, SECONDS + 600)]
    estimator = build(name)
    for index, row in enumerate(whole):
        estimator.handle(field.tick(values, index, slice(row, row + 1), after_gap=row == GAP_AT + 600))
    state = estimator.estimate()
    assert state.phase is Phase.RUNNING
    assert_within(state, name, 4.5)


@every_method
def test_a_reference_without_direction_is_enough(name: str) -> None:
    """Every method can be run where only |H| is known."""
    estimator = build(name)
    play(estimator, [replace(tick, reference_eci_nt=None) for tick in ticks(name)])
    assert_within(estimator.estimate(), name, 4.5)
