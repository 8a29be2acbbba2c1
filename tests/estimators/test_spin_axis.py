"""The configured spin axis: what it is worth, when it is not believed, and consistency while it is held."""

import math

import numpy as np
import pytest
from test_spin_start import PRIOR, near_truth, samples_of

from magcal_service.config.settings import CraftConfig, SensorConfig, SpinConfig
from magcal_service.estimators.parts.spin_window import across_axis
from magcal_service.estimators.spin import SpinFilter
from magcal_service.estimators.steady_spin.fit import AxisTie, contradiction, fit_spin
from tests.estimators.estimator_ticks import TABLE_1, Craft

Z = np.array([0.0, 0.0, 1.0])
NORMAL = Craft(seed=28, spin_eci=(0.0, -0.96, 0.28))


def tie(axis: np.ndarray, sigma_rad: float = 1e-6) -> AxisTie:
    return AxisTie(across_axis(axis / np.linalg.norm(axis)), sigma_rad)


def test_a_tied_fit_turns_about_the_axis() -> None:
    craft = Craft(seed=1)
    fit = fit_spin(samples_of(craft, 1200), near_truth(craft, 1200), PRIOR, 300.0, tie(Z))
    assert fit is not None
    rate = fit.state.rate_rad_s
    assert math.hypot(rate[0], rate[1]) < 1e-5 * abs(rate[2])


def test_a_loose_tie_changes_nothing() -> None:
    craft = Craft(seed=2)
    free = fit_spin(samples_of(craft, 1200), near_truth(craft, 1200), PRIOR, 300.0)
    loose = fit_spin(samples_of(craft, 1200), near_truth(craft, 1200), PRIOR, 300.0, tie(Z, 10.0))
    assert free is not None
    assert loose is not None
    sigma = np.sqrt(np.diagonal(free.state.covariance))[:9]
    assert np.abs((free.state.x - loose.state.x) / sigma).max() < 1e-2


def test_near_the_orbit_normal_the_tie_is_worth_most_across_the_axis() -> None:
    samples, start = samples_of(NORMAL, 4000), near_truth(NORMAL, 4000)
    free, tied = (fit_spin(samples, start, PRIOR, 300.0, known) for known in (None, tie(Z)))
    assert free is not None
    assert tied is not None
    ratio = np.sqrt(np.diagonal(tied.state.covariance) / np.diagonal(free.state.covariance))
    assert ratio[:2].max() < 0.8
    assert ratio[2] > 0.8


def test_the_true_axis_is_not_contradicted_and_one_two_degrees_off_is() -> None:
    craft = Craft(seed=3)
    fit = fit_spin(samples_of(craft, 1200), near_truth(craft, 1200), PRIOR, 300.0)
    assert fit is not None
    assert contradiction(fit.state, tie(Z)) < 11.8
    assert contradiction(fit.state, tie(np.array([math.tan(math.radians(2.0)), 0.0, 1.0]))) > 100.0


def test_the_filter_stays_consistent_between_its_fits_near_the_orbit_normal() -> None:
    """Without the tie in the filter it was 60 nT off at a sigma of 10 nT between two fits."""
    estimator = SpinFilter(CraftConfig("x", sensor=SensorConfig(noise_nt=300.0), spin=SpinConfig()))
    worst = 0.0
    for tick in NORMAL.ticks(12_000):
        estimator.handle(tick)
        if estimator.fallback is None and tick.index % 100 == 0:
            estimate = estimator.estimate()
            error = estimate.x - TABLE_1
            worst = max(worst, float(error @ np.linalg.solve(estimate.covariance, error)))
    assert estimator.fallback is None
    assert 0.0 < worst < 27.9


@pytest.mark.parametrize("tilt_deg", [5.0, 20.0])
def test_a_wrong_axis_is_dropped_and_costs_no_consistency(tilt_deg: float) -> None:
    tilt = math.radians(tilt_deg)
    craft = Craft(seed=4, spin_body=(math.sin(tilt), 0.0, math.cos(tilt)))
    estimator = SpinFilter(CraftConfig("x", sensor=SensorConfig(noise_nt=300.0), spin=SpinConfig()))
    for tick in craft.ticks(3000):
        estimator.handle(tick)
    assert estimator.fallback is None
    error = estimator.estimate().x - TABLE_1
    assert error @ np.linalg.solve(estimator.estimate().covariance, error) < 27.9
