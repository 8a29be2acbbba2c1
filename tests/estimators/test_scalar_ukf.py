"""The scalar-only UKF is the UKF without its spin windows, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magcal_service.config.settings import CraftConfig, SensorConfig, SpinConfig
from magcal_service.estimators.interface import InformationSet
from magcal_service.estimators.scalar_ukf import ScalarUkf
from magcal_service.estimators.ukf import Ukf
from magcal_service.studies.bounds import bound_sigma
from tests.estimators.method_data import PAPER_X, paper_field, play, sigmas_off

SPINNING = CraftConfig("craft", sensor=SensorConfig(noise_nt=300.0), spin=SpinConfig())


def test_it_equals_the_ukf_of_a_craft_without_spin() -> None:
    field = paper_field().until(2400.0)
    measured = field.measured(np.random.default_rng(40))
    one, other = ScalarUkf(SPINNING), Ukf(replace(SPINNING, spin=None))
    for estimator in (one, other):
        play(estimator, field.ticks(measured))
    np.testing.assert_array_equal(one.estimate().x, other.estimate().x)
    np.testing.assert_array_equal(one.estimate().covariance, other.estimate().covariance)


def test_its_sigmas_approach_the_scalar_bound() -> None:
    """From above: the batch of the start is handed over with four times its sigma, 7 % of the information here."""
    field = paper_field().until(6000.0)
    estimator = ScalarUkf(SPINNING)
    play(estimator, field.ticks(field.measured(np.random.default_rng(41))))
    sigma = np.sqrt(np.diagonal(estimator.estimate().covariance))
    bound = bound_sigma(field.flight(), InformationSet.SCALAR)
    assert np.all((sigma / bound > 0.98) & (sigma / bound < 1.1))
    assert np.all(np.abs(sigmas_off(estimator, PAPER_X)) < 4.0)
