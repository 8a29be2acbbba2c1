"""The batched spin estimator is ``spin``, run by run, to rounding."""

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig, SpinConfig
from magcal_service.estimators.interface import Phase
from magcal_service.estimators.spin import SpinFilter
from magcal_service.studies.batched.spin import BatchedSpin
from magcal_service.ticks.assembler import Tick
from tests.estimators.estimator_ticks import Craft
from tests.estimators.spin_motions import kicked, steady, ticks_of

NOISE = SensorConfig(noise_nt=300.0)


def config_of(spin: SpinConfig | None = SpinConfig()) -> CraftConfig:  # noqa: B008
    return CraftConfig("craft", sensor=NOISE, spin=spin)


def spoiled(ticks: list[Tick], at: range, by_nt: float) -> list[Tick]:
    """The same ticks with something on top of some."""
    return [replace(t, field_body_nt=t.field_body_nt + by_nt) if i in at else t for i, t in enumerate(ticks)]


def play(batch: BatchedSpin, runs: list[list[Tick]]) -> None:
    for row in zip(*runs, strict=True):
        batch.handle(row[0], np.concatenate([tick.field_body_nt for tick in row]))


def assert_equal_at_every_tick(config: CraftConfig, runs: list[list[Tick]]) -> list[SpinFilter]:
    """Batch and estimators alone side by side; the estimators as they end."""
    batch, alone = BatchedSpin(config, len(runs)), [SpinFilter(config) for _ in runs]
    for row in zip(*runs, strict=True):
        batch.handle(row[0], np.concatenate([tick.field_body_nt for tick in row]))
        x, covariance = batch.x, batch.covariance
        for run, (tick, estimator) in enumerate(zip(row, alone, strict=True)):
            estimator.handle(tick)
            expected = estimator.estimate()
            sigma = np.sqrt(np.diagonal(expected.covariance))
            assert batch.running[run] == (expected.phase is Phase.RUNNING)
            assert np.abs((x[run] - expected.x) / sigma).max() < 1e-9
            assert np.abs((covariance[run] - expected.covariance) / np.outer(sigma, sigma)).max() < 1e-9
    assert not batch.left.any()
    return alone


@pytest.mark.parametrize("spin", [SpinConfig(), None], ids=["configured", "free"])
def test_every_tick_of_every_run_equals_the_estimator_alone(spin: SpinConfig | None) -> None:
    runs = [list(Craft(seed).ticks(900)) for seed in range(3)]
    alone = assert_equal_at_every_tick(config_of(spin), runs)
    assert [estimator.fallback for estimator in alone] == [None] * 3


def test_a_rejected_sample_is_left_out_as_it_is_alone() -> None:
    runs = [list(Craft(seed).ticks(1000)) for seed in (4, 5)]
    runs[1] = spoiled(runs[1], range(800, 802), 20_000.0)
    alone = assert_equal_at_every_tick(config_of(), runs)
    assert alone[1].estimate().rejected == 2


def test_a_run_that_loses_its_spin_leaves_and_the_other_goes_on() -> None:
    runs = [list(ticks_of(motion, 1100, seed=6)) for motion in (steady, kicked(900.0))]
    reference, batch = BatchedSpin(config_of(), 1), BatchedSpin(config_of(), 2)
    play(reference, runs[:1])
    play(batch, runs)
    assert batch.left.tolist() == [False, True]
    sigma = np.sqrt(np.diagonal(reference.covariance[0]))
    assert np.abs((batch.x[0] - reference.x[0]) / sigma).max() < 1e-9


def test_a_run_whose_scalar_filter_leaves_before_the_spin_has_started_leaves() -> None:
    runs = [list(Craft(seed).ticks(700)) for seed in (7, 8)]
    runs[0] = spoiled(runs[0], range(60, 61), 20_000.0)
    batch = BatchedSpin(config_of(), 2)
    play(batch, runs)
    assert batch.left.tolist() == [True, False]


@pytest.mark.parametrize(
    "config",
    [
        CraftConfig("craft"),
        CraftConfig("craft", sensor=NOISE, filter=FilterConfig(process_noise_bias_nt=(0.3, 0.3, 0.3))),
    ],
    ids=["unknown-noise", "random-walk"],
)
def test_what_needs_the_estimator_alone_is_refused(config: CraftConfig) -> None:
    with pytest.raises(ValueError, match="batch"):
        BatchedSpin(config, 2)


def test_a_tick_without_a_reference_vector_is_refused() -> None:
    tick = replace(next(iter(Craft(1).ticks(1))), reference_eci_nt=None)
    with pytest.raises(ValueError, match="reference vector"):
        BatchedSpin(config_of(), 1).handle(tick, tick.field_body_nt)
