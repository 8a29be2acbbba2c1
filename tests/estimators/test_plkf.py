"""The pseudo-linear filter: the bias across the spin axis, and a consistent covariance of the rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.base.errors import ConfigError
from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig, SpinConfig, SpinWindow
from magcal_service.estimators.interface import Phase
from magcal_service.estimators.plkf import Plkf
from magcal_service.model import Array
from tests.estimators.method_data import paper_field, play

BIAS_ONLY = np.array([5000.0, 3000.0, 4000.0, *[0.0] * 6])
SPINNING = CraftConfig("craft", sensor=SensorConfig(noise_nt=300.0), spin=SpinConfig())


def final(seed: int, config: CraftConfig = SPINNING, x: Array = BIAS_ONLY, seconds: float = 3600.0) -> Plkf:
    field = paper_field().until(seconds)
    estimator = Plkf(config)
    play(estimator, field.ticks(field.measured(np.random.default_rng(seed), x)))
    return estimator


def test_the_bias_across_the_axis_is_found_to_its_sigma_on_average() -> None:
    errors = []
    for seed in range(12):
        state = final(seed, seconds=1200.0).estimate()
        errors.append((state.x[:2] - BIAS_ONLY[:2]) / np.sqrt(np.diagonal(state.covariance)[:2]))
    assert np.mean(np.square(errors)) < 1.0 + 3.0 * np.sqrt(2.0 / 24.0)
    assert np.abs(errors).max() < 4.0


def test_its_sigma_across_the_axis_falls_below_20_nt_in_an_hour() -> None:
    sigma = np.sqrt(np.diagonal(final(70).estimate().covariance))
    assert np.all(sigma[:2] < 20.0)


def test_the_bias_along_the_axis_and_the_scale_stay_at_the_prior() -> None:
    state = final(71).estimate()
    sigma = np.sqrt(np.diagonal(state.covariance))
    assert sigma[2] == pytest.approx(SPINNING.filter.prior_bias_nt, rel=1e-6)
    np.testing.assert_array_equal(sigma[3:], SPINNING.filter.prior_D)
    np.testing.assert_array_equal(state.x[3:], np.zeros(6))


def test_a_scale_error_it_does_not_know_moves_the_bias_by_no_more_than_its_share() -> None:
    """D13 = 0.01 times the field along the axis, below 45 uT."""
    x = BIAS_ONLY + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.01, 0.0])
    moved = final(72, x=x).estimate().x[:2] - final(72).estimate().x[:2]
    assert 10.0 < abs(moved[0]) < 450.0
    assert abs(moved[1]) < 10.0


@pytest.mark.parametrize("spin", [None, SpinConfig(window=SpinWindow.OFF)])
def test_a_craft_without_spin_windows_is_refused(spin: SpinConfig | None) -> None:
    with pytest.raises(ConfigError, match="needs \\[spin\\]"):
        Plkf(replace(SPINNING, spin=spin))


def test_it_is_starting_until_the_first_window_ends() -> None:
    field = paper_field().until(60.0)
    estimator = Plkf(SPINNING)
    outcomes = play(estimator, field.ticks(field.measured(np.random.default_rng(73), BIAS_ONLY)))
    phases = [outcome.phase for outcome in outcomes]
    first = phases.index(Phase.RUNNING)
    assert outcomes[first].spin_squared_innovation is not None
    assert all(phase is Phase.STARTING for phase in phases[:first])


def test_a_spike_is_left_out_of_its_window() -> None:
    field = paper_field().until(1200.0)
    measured = field.measured(np.random.default_rng(74), BIAS_ONLY)
    spoiled = measured.copy()
    spoiled[900] += 50_000.0
    clean, hit = Plkf(SPINNING), Plkf(SPINNING)
    play(clean, field.ticks(measured))
    outcomes = play(hit, field.ticks(spoiled))
    assert not any(outcome.spin_rejected for outcome in outcomes)
    np.testing.assert_allclose(hit.estimate().x[:2], clean.estimate().x[:2], atol=5.0)


def test_a_window_that_is_spoilt_throughout_is_stopped_by_the_gate() -> None:
    """12 samples in a row, so that one window at least has more than a quarter of them."""
    field = paper_field().until(1200.0)
    measured = field.measured(np.random.default_rng(74), BIAS_ONLY)
    spoiled = measured.copy()
    spoiled[900:912] += 50_000.0 * np.random.default_rng(76).standard_normal((12, 3))
    clean, hit = Plkf(SPINNING), Plkf(SPINNING)
    play(clean, field.ticks(measured))
    outcomes = play(hit, field.ticks(spoiled))
    assert sum(outcome.spin_rejected for outcome in outcomes) >= 1
    assert hit.estimate().rejected > 0
    np.testing.assert_allclose(hit.estimate().x[:2], clean.estimate().x[:2], atol=20.0)


def test_process_noise_follows_a_bias_that_wanders() -> None:
    walk = FilterConfig(process_noise_bias_nt=(3.0, 3.0, 3.0))
    field = paper_field().until(3600.0)
    measured = field.measured(np.random.default_rng(75), BIAS_ONLY)
    measured[1800:] += [200.0, 0.0, 0.0]
    estimators = Plkf(SPINNING), Plkf(replace(SPINNING, filter=walk))
    for estimator in estimators:
        play(estimator, field.ticks(measured))
    still, walking = (abs(estimator.estimate().x[0] - 5200.0) for estimator in estimators)
    assert walking < 60.0 < still
