"""Bias from magnetometer and gyro: what the turning shows, and what it does not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_service.config.settings import CraftConfig, SensorConfig
from magcal_service.estimators.interface import Phase
from magcal_service.estimators.rate_aided import RateAided, rotation
from tests.estimators.method_data import Field, RateTick, paper_field, play

BIAS_ONLY = np.array([5000.0, 3000.0, 4000.0, *[0.0] * 6])
CRAFT = CraftConfig("craft", sensor=SensorConfig(noise_nt=300.0))


def with_gyro_noise(field: Field, sigma_rad_s: float, seed: int) -> Field:
    noise = np.random.default_rng(seed).normal(0.0, 1.0, field.rate_body_rad_s.shape)
    return replace(field, rate_body_rad_s=field.rate_body_rad_s + sigma_rad_s * noise)


@cache
def coning(seconds: float = 3600.0) -> Field:
    """The paper's orbit with a coning of 25 degrees: the axis of turning moves in the body."""
    from sim_sensor.attitude import Spin

    steady = paper_field().until(seconds)
    towards = tuple((np.ones(3) / np.sqrt(3.0)).tolist())
    spin = Spin((0.0, 0.0, 1.0), towards, 0.3, nutation_rad=0.44, inertia_ratio=1.6)
    attitude = spin.body_from_eci(steady.times_s)
    body = np.einsum("nij,nj->ni", attitude, steady.reference_eci_nt)
    return replace(steady, field_body_nt=body, rate_body_rad_s=spin.rate_body_rad_s(steady.times_s))


def final(field: Field, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Error and sigma of the bias [nT]."""
    estimator = RateAided(CRAFT)
    play(estimator, field.ticks(field.measured(np.random.default_rng(seed), BIAS_ONLY)))
    state = estimator.estimate()
    return state.x[:3] - BIAS_ONLY[:3], np.sqrt(np.diagonal(state.covariance)[:3])


def test_about_a_steady_axis_the_bias_across_it_is_found() -> None:
    error, sigma = final(with_gyro_noise(paper_field().until(3600.0), 1e-3, 80), 81)
    assert np.all(sigma[:2] < 20.0)
    assert np.all(np.abs(error[:2]) < 4.0 * sigma[:2])


@pytest.mark.parametrize("gyro_rad_s", [0.0, 1e-3, 5e-3])
def test_about_a_steady_axis_the_bias_along_it_is_left_to_the_prior(gyro_rad_s: float) -> None:
    """Also with a noisy gyro, whose noise looks like a changing axis."""
    _, sigma = final(with_gyro_noise(paper_field().until(2400.0), gyro_rad_s, 82), 83)
    assert sigma[2] == pytest.approx(CRAFT.filter.prior_bias_nt, rel=1e-3)


def test_under_coning_all_three_are_found() -> None:
    error, sigma = final(with_gyro_noise(coning(), 1e-3, 84), 85)
    assert np.all(sigma < 60.0)
    assert np.all(np.abs(error) < 4.0 * sigma)


def test_ticks_without_rates_are_not_used() -> None:
    field = paper_field().until(300.0)
    estimator = RateAided(CRAFT)
    ticks = (replace(tick, rate_body_rad_s=None) for tick in field.ticks(field.measured(np.random.default_rng(86))))
    outcomes = play(estimator, ticks)
    assert {outcome.used for outcome in outcomes} == {0}
    assert estimator.estimate().phase is Phase.STARTING
    assert estimator.estimate().samples == 0


def test_it_needs_no_reference_vector() -> None:
    field = paper_field().until(2400.0)

    def magnitude_only(tick: RateTick) -> RateTick:
        return replace(tick, reference_eci_nt=None)

    estimator = RateAided(CRAFT)
    measured = field.measured(np.random.default_rng(87), BIAS_ONLY)
    play(estimator, map(magnitude_only, field.ticks(measured)))
    state = estimator.estimate()
    sigma = np.sqrt(np.diagonal(state.covariance))
    assert np.all(np.abs(state.x - BIAS_ONLY)[:2] < 4.0 * sigma[:2])
    assert np.all(sigma[:2] < 30.0)


def test_a_gyro_that_is_wrong_widens_the_sigma() -> None:
    """A scale error of 5 %: the innovations grow, and the variances with them."""
    field = paper_field().until(2400.0)
    wrong = replace(field, rate_body_rad_s=1.05 * field.rate_body_rad_s)
    assert np.all(final(wrong, 88)[1][:2] > 2.0 * final(field, 88)[1][:2])


@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3), st.floats(0.0, 2.0))
def test_a_rotation_keeps_lengths_and_its_axis(rate: tuple[float, float, float], seconds: float) -> None:
    turned = rotation(np.array(rate), seconds)
    np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(turned @ np.array(rate), rate, atol=1e-9)


def test_a_rotation_obeys_the_kinematic_equation() -> None:
    """dm/dt = -w x m, the method's own."""
    rate, m, h = np.array([0.3, -0.2, 0.5]), np.array([1.0, 2.0, 3.0]), 1e-6
    slope = (rotation(rate, h) @ m - rotation(rate, -h) @ m) / (2 * h)
    np.testing.assert_allclose(slope, -np.cross(rate, m), atol=1e-8)
