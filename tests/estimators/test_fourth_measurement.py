"""Equation (8), the fourth pseudo-measurement: little help at low noise, harm at high noise, as the paper says."""

from __future__ import annotations

from functools import cache

import numpy as np

from magcal_service.config.settings import CraftConfig, SensorConfig, SpinConfig
from magcal_service.estimators.interface import StateEstimate
from magcal_service.estimators.ukf import Ukf
from tests.estimators.method_data import PAPER_X, nees, paper_field, play

BZ = 2


@cache
def runs(noise_nt: float, fourth: bool) -> list[StateEstimate]:
    field, results = paper_field().until(2400.0), []
    for seed in np.random.SeedSequence(60).spawn(3):
        sensor, spin = SensorConfig(noise_nt=noise_nt), SpinConfig(fourth=fourth)
        estimator = Ukf(CraftConfig("craft", sensor=sensor, spin=spin))
        play(estimator, field.ticks(field.measured(np.random.default_rng(seed), noise_nt=noise_nt)))
        results.append(estimator.estimate())
    return results


def error_rms(noise_nt: float, fourth: bool) -> float:
    return float(np.sqrt(np.mean([(e.x[BZ] - PAPER_X[BZ]) ** 2 for e in runs(noise_nt, fourth)])))


def mean_nees(noise_nt: float, fourth: bool) -> float:
    return float(np.mean([nees(e.x - PAPER_X, e.covariance) for e in runs(noise_nt, fourth)]))


def test_at_low_noise_it_changes_the_sigma_of_bz_by_less_than_a_tenth() -> None:
    without, with_it = (runs(20.0, fourth)[0].covariance[BZ, BZ] ** 0.5 for fourth in (False, True))
    assert 0.9 < with_it / without <= 1.0


def test_at_high_noise_it_makes_bz_several_times_worse() -> None:
    assert error_rms(1000.0, True) > 2.0 * error_rms(1000.0, False)


def test_at_high_noise_the_covariance_no_longer_contains_the_error() -> None:
    assert mean_nees(1000.0, True) > 25.0


def test_without_it_the_covariance_at_high_noise_is_consistent() -> None:
    assert mean_nees(1000.0, False) < 17.0
