"""The watch over the model names what is left out, keeps quiet where nothing is, and says where it does not know."""

from __future__ import annotations

from functools import cache
from itertools import islice

import numpy as np
import pytest

from magcal_service.daemon.pipeline import Pipeline
from magcal_service.estimators.interface import Phase, StateEstimate
from magcal_service.trust.reasons import Reason
from magcal_service.watch.residual_watch import CHUNK, TICKS, Finding, ModelWatch
from magcal_service.wire.messages import Verdict
from sim_sensor.scenario import Scenario
from tests.watch.watch_runs import NOISE_NT, Clean, Known, craft, flight, fly, stream

LEFT_OUT: dict[str, tuple[Scenario, float]] = {
    "thermal_bias": (flight(thermal_nt_per_k=6.0), 3900.0),
    "thermal_scale": (flight(scale_per_k=4e-4), 3900.0),
    "current_loop": (flight(panel_nt_per_a=500.0, towards=(1.0, -1.0, 1.0)), 3000.0),
    "torquer": (flight(torquer_nt=250.0), 2200.0),
    "bias_step": (flight(step_nt=200.0, step_at_s=1700.0), 3000.0),
    "saturation": (flight(full_scale_nt=42_000.0), 2400.0),
}


@pytest.mark.parametrize("effect", LEFT_OUT)
def test_an_effect_of_the_simulator_is_named_and_doubted(effect: str) -> None:
    """Through the whole pipeline, every driver on the link: the finding's first name is the effect's."""
    flown = fly(Pipeline(craft()), stream(*LEFT_OUT[effect]))
    finding = flown.pipeline.watch.finding
    assert finding is not None
    assert finding.effects[0] == effect
    assert flown.pipeline.trust.verdict is Verdict.DOUBTFUL
    assert Reason.MODEL_DOUBTFUL in flown.pipeline.trust.reasons
    assert [event.what for event in flown.findings] == ["model_doubtful"] * len(flown.findings)
    assert effect in flown.findings[-1].cause


@cache
def prepared(rate_rpm: float, noise_nt: float) -> tuple[Clean, Known]:
    flown = Clean.of(flight(rate_rpm=rate_rpm, noise_nt=noise_nt), 1, TICKS)
    return flown, Known(flown)


def clean(rate_rpm: float = 7.5, noise_nt: float = NOISE_NT) -> Clean:
    """A window's flight in which nothing is left out."""
    return prepared(rate_rpm, noise_nt)[0]


def known(flown: Clean) -> Known:
    """The drivers of such a flight."""
    scenario = flown.scenario
    return prepared(round(scenario.spin.rate_rad_s * 30.0 / np.pi, 6), scenario.sensor.noise_nt[0])[1]


def settled(flown: Clean) -> StateEstimate:
    """A little off the truth, as a filter is."""
    x = flown.x + np.array([15.0, -10.0, 20.0, 2e-4, -3e-4, 1e-4, 2e-4, 1e-4, -1e-4])
    noise_nt = flown.scenario.sensor.noise_nt[0]
    return StateEstimate(x, np.diag([20.0**2] * 3 + [3e-4**2] * 6), Phase.RUNNING, noise_nt, 1000, 0, 0, None, False)


def watched(flown: Clean, noise: np.ndarray, *, walks: bool = False) -> Finding | None:
    """What a watch has found just before its window ends."""
    watch, estimate = ModelWatch(5.0), settled(flown)
    watch.drivers = known(flown)
    for tick in islice(flown.ticks(noise, None), TICKS - CHUNK):
        watch.push(tick, estimate, walks=walks)
    return watch.finding


def remembering(rng: np.random.Generator, shape: tuple[int, ...], correlation: float) -> np.ndarray:
    noise = rng.standard_normal(shape)
    for row in range(1, len(noise)):
        noise[row] = correlation * noise[row - 1] + np.sqrt(1.0 - correlation**2) * noise[row]
    return noise


def flips(rng: np.random.Generator, count: int, dwell_s: float) -> np.ndarray:
    ends = np.cumsum(rng.exponential(dwell_s, count))
    return 1.0 - 2.0 * (np.searchsorted(ends, np.arange(count)) % 2)


ALONG = np.array([0.6, -0.5, 0.62])
TIME_S = np.arange(float(TICKS))

WITHOUT_DRIVER = {
    "bias_drift": lambda rng: np.outer(120.0 * (TIME_S / TICKS - 0.5), ALONG),
    "tone": lambda rng: np.outer(100.0 * np.sin(2.0 * np.pi * 0.0713 * TIME_S), ALONG),
    "unknown": lambda rng: np.outer(150.0 * flips(rng, TICKS, 300.0), ALONG),
}


@pytest.mark.parametrize("effect", WITHOUT_DRIVER)
def test_what_has_no_driver_is_named_too(effect: str) -> None:
    """A drift, a line, and a magnet that flips at random, which is in no catalogue and is said to be unknown."""
    rng = np.random.default_rng(5)
    flown = clean()
    finding = watched(flown, flown.noise(rng) + WITHOUT_DRIVER[effect](rng))
    assert finding is not None
    assert finding.effects[0] == effect


def test_noise_with_a_memory_is_no_drift_and_no_temperature() -> None:
    """Correlation 0.7 from second to second raises what is slow sixfold; it is told as what it is."""
    flown = clean()
    finding = watched(flown, NOISE_NT * remembering(np.random.default_rng(6), flown.field_nt.shape, 0.7))
    assert finding is not None
    assert finding.effects == ("coloured_noise",)


@pytest.mark.parametrize(("rate_rpm", "noise_nt"), [(0.5, 100.0), (2.0, 20.0), (15.0, 300.0)])
def test_where_nothing_is_left_out_nothing_is_found(rate_rpm: float, noise_nt: float) -> None:
    """Three windows each, slow and fast turns, quiet and loud sensors, all drivers on board."""
    flown = clean(rate_rpm, noise_nt)
    for seed in range(3):
        assert watched(flown, flown.noise(np.random.default_rng(seed))) is None


def test_a_clean_flight_stays_trusted() -> None:
    """The filter's own flight of a window and more: no event of the watch, no doubt."""
    flown = fly(Pipeline(craft()), stream(flight(), 5800.0))
    assert (flown.findings, flown.pipeline.trust.verdict) == ((), Verdict.TRUSTED)


def test_errors_that_may_walk_are_no_finding() -> None:
    """With process noise the same drift is the filter's to follow; a coil is named all the same."""
    rng = np.random.default_rng(5)
    flown = clean()
    noise = flown.noise(rng)
    assert watched(flown, noise + WITHOUT_DRIVER["bias_drift"](rng), walks=True) is None
    driven = np.outer(200.0 * _commanded(), ALONG)
    found = watched(flown, noise + driven, walks=True)
    assert found is not None
    assert found.effects[0] == "torquer"


def _commanded() -> np.ndarray:
    """What the coil of the flight does: 6 s of every 60 s, with alternating sign."""
    return (TIME_S % 60.0 < 6.0) * (1.0 - 2.0 * ((TIME_S // 60.0) % 2.0))


def test_absurd_samples_by_themselves_are_no_structure() -> None:
    """One in a hundred is 20 sigma and more off, always to the same side of the craft."""
    rng = np.random.default_rng(8)
    flown = clean()
    absurd = np.outer(rng.random(TICKS) < 0.01, (3000.0, -2000.0, 2500.0))
    assert watched(flown, flown.noise(rng) + absurd) is None
