"""Spikes among the first samples delay or spoil nothing."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.config.settings import CraftConfig, SensorConfig, SpinConfig
from magcal_service.estimators.interface import Phase
from magcal_service.estimators.ukf import Ukf
from magcal_service.ticks.assembler import Tick
from tests.estimators.estimator_ticks import TABLE_1, Craft


def spiked(craft: Craft, seconds: int, share: float) -> Iterator[Tick]:
    """The craft's ticks, some of them with a vector of up to 200 uT that has nothing to do with the field."""
    rng = np.random.default_rng(craft.seed + 1000)
    for tick in craft.ticks(seconds):
        hit = rng.random() < share
        wrong = rng.uniform(-200_000.0, 200_000.0, (1, 3))
        yield replace(tick, field_body_nt=wrong) if hit else tick


@pytest.mark.parametrize("noise_nt", [300.0, None])
@pytest.mark.parametrize("share", [0.01, 0.1])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_start_among_spikes(share: float, noise_nt: float | None, seed: int) -> None:
    craft = Craft(seed=seed)
    estimator = Ukf(CraftConfig("x", sensor=SensorConfig(noise_nt=noise_nt), spin=SpinConfig()))
    for tick in spiked(craft, 5000, share):
        estimator.handle(tick)
    estimate = estimator.estimate()
    assert estimate.phase is Phase.RUNNING
    assert not estimate.spin_given_up
    error = estimate.x - TABLE_1
    assert error @ np.linalg.solve(estimate.covariance, error) < 27.9
