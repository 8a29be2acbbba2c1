"""The gate of single samples: by hand, and what a spike right after a start may do."""

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig
from magcal_service.estimators.interface import Phase
from magcal_service.estimators.parts.sample_gate import SampleGate
from magcal_service.estimators.ukf import Ukf
from magcal_service.ticks.assembler import Tick
from tests.estimators.estimator_ticks import Craft


@pytest.mark.parametrize(
    ("spread", "limit"),
    [
        (0.0, 36.0),  # an estimate without a spread: gate_sigma squared
        (1.0, 36.0 * (1.0 + 1.0 / 16.0) / 2.0),  # as far as 6 sigma of what it was before a start_inflation of 4
        (4.0, 36.0 * (1.0 + 4.0 / 16.0) / 5.0),
        (1e6, 9.0),  # never below 3 sigma of the innovation
    ],
)
def test_limits_by_hand(spread: float, limit: float) -> None:
    gate = SampleGate.of(FilterConfig())
    assert gate.limit(1.0 + spread, 1.0) == pytest.approx(limit, rel=1e-12)
    assert gate.limits(np.array([1.0 + spread, 1.0]), 1.0) == pytest.approx([limit, 36.0], rel=1e-12)


def test_without_an_inflation_nothing_is_judged_more_strictly() -> None:
    gate = SampleGate.of(FilterConfig(start_inflation=1.0))
    assert gate.limit(100.0, 1.0) == pytest.approx(36.0, rel=1e-12)


@pytest.mark.parametrize(
    "settings",
    [
        FilterConfig(adaptive=True),
        FilterConfig(process_noise_bias_nt=(0.0, 0.0, 5.0)),
        FilterConfig(process_noise_D=(0.0,) * 5 + (1e-6,)),
    ],
)
def test_a_spread_that_widens_in_flight_is_believed(settings: FilterConfig) -> None:
    """After a pause of an hour sound samples would be refused in a row, and the filter would start anew."""
    assert SampleGate.of(settings).limit(100.0, 1.0) == pytest.approx(36.0, rel=1e-12)


def spiked(tick: Tick, nt: float) -> Tick:
    """The tick with its vector longer by so much."""
    length = np.linalg.norm(tick.field_body_nt, axis=1, keepdims=True)
    return replace(tick, field_body_nt=tick.field_body_nt * (1.0 + nt / length))


def started(seed: int) -> tuple[Ukf, list[Tick], int]:
    """A filter right after its start, the ticks of its flight, and the number of the next one."""
    craft = Craft(seed=seed)
    estimator = Ukf(CraftConfig("x", sensor=SensorConfig(noise_nt=craft.noise_nt)))
    ticks = list(craft.ticks(3000))
    for number, tick in enumerate(ticks):
        estimator.handle(tick)
        if estimator.estimate().phase is Phase.RUNNING:
            return estimator, ticks, number + 1
    raise AssertionError("no start")


@pytest.mark.parametrize("seed", range(4))
def test_a_spike_right_after_a_start_moves_the_estimate_by_few_of_its_sigmas(seed: int) -> None:
    """Whatever the spike's size: beyond the gate it is not used, within it its share is bounded."""
    worst = 0.0
    for factor in (2.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0):
        estimator, ticks, following = started(seed)
        before = estimator.estimate()
        estimator.handle(spiked(ticks[following], factor * before.noise_nt))
        after = estimator.estimate()
        moved = after.x - before.x
        worst = max(worst, float(np.sqrt(moved @ np.linalg.solve(after.covariance, moved))))
    assert 0.0 < worst < 4.5, f"{worst:.1f} sigma"  # 4.6 to 5.4 with a gate of 6 sigma of the innovation


@pytest.mark.parametrize("seed", range(4))
def test_no_sound_sample_is_left_out_after_a_start(seed: int) -> None:
    estimator, ticks, following = started(seed)
    for tick in ticks[following : following + 300]:
        estimator.handle(tick)
    assert estimator.estimate().rejected == 0
