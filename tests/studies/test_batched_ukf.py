"""The batched filter is ``ukf``, run by run, to rounding."""

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig, SpinConfig, SpinWindow
from magcal_service.estimators.interface import Phase
from magcal_service.estimators.ukf import Ukf
from magcal_service.studies.batched.ukf import BatchedUkf
from magcal_service.ticks.assembler import Tick
from tests.estimators.estimator_ticks import Craft

NOISE = SensorConfig(noise_nt=300.0)
WALK = FilterConfig(process_noise_bias_nt=(0.3, 0.3, 0.3), process_noise_D=(1e-7,) * 6)


def flights(runs: int, seconds: int) -> list[list[Tick]]:
    return [list(Craft(seed).ticks(seconds)) for seed in range(runs)]


def spiked(ticks: list[Tick], at: range) -> list[Tick]:
    """The same ticks with 20 uT on top of some."""
    return [replace(t, field_body_nt=t.field_body_nt + 20_000.0) if i in at else t for i, t in enumerate(ticks)]


def play(batch: BatchedUkf, runs: list[list[Tick]]) -> None:
    for row in zip(*runs, strict=True):
        batch.handle(row[0], np.concatenate([tick.field_body_nt for tick in row]))


@pytest.mark.parametrize(
    ("spin", "settings", "seconds"),
    [
        pytest.param(SpinConfig(), FilterConfig(), 1200, id="harmonic"),
        pytest.param(SpinConfig(), WALK, 1200, id="random-walk"),
        pytest.param(
            SpinConfig(window=SpinWindow.MEAN, window_samples=8), FilterConfig(start_s=180.0), 1100, id="mean"
        ),
        pytest.param(None, FilterConfig(), 1200, id="no-spin"),
    ],
)
def test_every_tick_of_every_run_equals_the_filter_alone(
    spin: SpinConfig | None, settings: FilterConfig, seconds: int
) -> None:
    config = CraftConfig("craft", sensor=NOISE, spin=spin, filter=settings)
    runs = flights(3, seconds)
    batch, alone = BatchedUkf(config, len(runs)), [Ukf(config) for _ in runs]
    started = set()
    for index, row in enumerate(zip(*runs, strict=True)):
        batch.handle(row[0], np.concatenate([tick.field_body_nt for tick in row]))
        for run, (tick, estimator) in enumerate(zip(row, alone, strict=True)):
            estimator.handle(tick)
            expected = estimator.estimate()
            sigma = np.sqrt(np.diagonal(expected.covariance))
            assert batch.running[run] == (expected.phase is Phase.RUNNING)
            assert np.abs((batch.x[run] - expected.x) / sigma).max() < 1e-9
            assert np.abs((batch.covariance[run] - expected.covariance) / np.outer(sigma, sigma)).max() < 1e-9
            if batch.running[run]:
                started.add((run, index))
    assert {run for run, _ in started} == {0, 1, 2}
    assert not batch.left.any()


def test_runs_start_at_their_own_time() -> None:
    config = CraftConfig("craft", sensor=NOISE, spin=SpinConfig())
    quiet = list(Craft(1, noise_nt=30.0).ticks(500))
    loud = list(Craft(2).ticks(500))
    batch = BatchedUkf(config, 2)
    first: dict[int, int] = {}
    for index, row in enumerate(zip(quiet, loud, strict=True)):
        batch.handle(row[0], np.concatenate([tick.field_body_nt for tick in row]))
        for run in np.flatnonzero(batch.running).tolist():
            first.setdefault(run, index)
    alone = []
    for ticks in (quiet, loud):
        estimator = Ukf(config)
        phases = [estimator.handle(tick).phase for tick in ticks]
        alone.append(phases.index(Phase.RUNNING) if Phase.RUNNING in phases else None)
    assert [first.get(run) for run in (0, 1)] == alone


def test_a_sample_beyond_the_gate_changes_nothing_and_its_run_leaves() -> None:
    config = CraftConfig("craft", sensor=NOISE, spin=None)
    clean, other = flights(2, 1500)
    batch = BatchedUkf(config, 2)
    play(batch, [clean, other])
    assert batch.running.all()
    before = batch.x.copy()
    tick = Craft(3).ticks(1501)
    last = list(tick)[-1]
    batch.handle(last, np.stack([last.field_body_nt[0] + 30_000.0, last.field_body_nt[0]]))
    assert (batch.x[0] == before[0]).all()
    assert (batch.x[1] != before[1]).any()
    assert batch.left.tolist() == [True, False]


def test_a_run_with_an_outlier_before_its_start_leaves_and_the_others_go_on() -> None:
    config = CraftConfig("craft", sensor=NOISE, spin=None)
    clean, spoiled = flights(2, 1200)
    batch = BatchedUkf(config, 2)
    play(batch, [clean, spiked(spoiled, range(60, 61))])
    assert batch.left.tolist() == [False, True]
    assert batch.running.tolist() == [True, False]


def test_a_run_that_loses_consistency_leaves_and_the_others_go_on() -> None:
    config = CraftConfig("craft", sensor=NOISE, spin=None)
    clean, spoiled = flights(2, 1500)
    reference = BatchedUkf(config, 1)
    play(reference, [clean])
    batch = BatchedUkf(config, 2)
    play(batch, [clean, spiked(spoiled, range(1300, 1500))])
    assert batch.left.tolist() == [False, True]
    assert np.abs((batch.x[0] - reference.x[0]) / np.sqrt(np.diagonal(reference.covariance[0]))).max() < 1e-9


@pytest.mark.parametrize(
    "config",
    [CraftConfig("craft"), CraftConfig("craft", sensor=NOISE, spin=SpinConfig(fourth=True))],
    ids=["unknown-noise", "fourth"],
)
def test_what_needs_the_filter_alone_is_refused(config: CraftConfig) -> None:
    with pytest.raises(ValueError, match="batch"):
        BatchedUkf(config, 2)
