"""Ticks of the paper's scenario, spoiled in one way each, through the filter and its watch."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from magcal_service.config.settings import CraftConfig, SensorConfig, SpinConfig, TrustConfig
from magcal_service.estimators.interface import StateEstimate
from magcal_service.estimators.ukf import Ukf
from magcal_service.ticks.assembler import Tick
from magcal_service.trust.monitor import TrustMonitor
from magcal_service.trust.reasons import Reason
from magcal_service.trust.verdict import Trust
from magcal_service.wire.messages import Verdict
from sim_sensor.scenario import Scenario
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation

TRUTH = np.array([5000.0, 3000.0, 4000.0, 0.05, 0.10, 0.05, 0.05, 0.05, 0.05])
Ticks = tuple[Tick, ...]


def craft(
    noise_nt: float | None = 300.0, rate_rpm: float = 7.5, axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
) -> CraftConfig:
    """What the operator of the paper's craft configures, without protection levels: they would hide other reasons."""
    spin = SpinConfig(axis=axis, rate_rpm=rate_rpm)
    return CraftConfig("paper", SensorConfig(noise_nt), spin, trust=TrustConfig(protection=False))


@cache
def good(seed: int = 1, seconds: int = 1300, rate_rpm: float = 7.5, noise_nt: float = 300.0) -> Ticks:
    """The paper's scenario at 1 Hz, spin rate and noise as told."""
    scenario: Scenario = load_scenario("paper")
    scenario = replace(
        scenario,
        spin=replace(scenario.spin, rate_rad_s=rate_rpm * math.tau / 60.0),
        sensor=replace(scenario.sensor, noise_nt=(noise_nt, noise_nt, noise_nt)),
    )
    block = Simulation(scenario, seed, float(seconds)).arrays()
    magnitude = np.linalg.norm(block.true_eci_nt, axis=1)
    return tuple(
        Tick(row, np.array([float(row)]), block.measured_nt[row : row + 1], magnitude[row : row + 1], eci[None])
        for row, eci in enumerate(block.true_eci_nt)
    )


def from_second(first: int, ticks: Iterable[Tick], change: Callable[[Tick], Tick]) -> Iterator[Tick]:
    """The ticks with those from one second on changed."""
    return (change(tick) if tick.index >= first else tick for tick in ticks)


def added(vector_nt: Callable[[Tick], np.ndarray]) -> Callable[[Tick], Tick]:
    """A change that adds a body vector to each sample."""
    return lambda tick: replace(tick, field_body_nt=tick.field_body_nt + vector_nt(tick))


def stretched(nt: Callable[[float], float]) -> Callable[[Tick], Tick]:
    """A change that makes each measured vector longer by so much [nT] at its time [s]."""

    def change(tick: Tick) -> Tick:
        length = np.linalg.norm(tick.field_body_nt, axis=1)[:, None]
        return replace(tick, field_body_nt=tick.field_body_nt * (1.0 + nt(float(tick.times_s[0])) / length))

    return change


@dataclass(frozen=True)
class Run:
    """What was judged after each tick, the state at the end, and how many spin windows the gate stopped."""

    judged: tuple[Trust, ...]
    state: StateEstimate
    windows_rejected: int

    @property
    def last(self) -> Trust:
        """The verdict at the end."""
        return self.judged[-1]

    def reasons(self, first: int = 0) -> set[Reason]:
        """Every reason given from a tick on."""
        return {reason for trust in self.judged[first:] for reason in trust.reasons}

    def verdicts(self, first: int = 0) -> set[Verdict]:
        """Every verdict from a tick on."""
        return {trust.verdict for trust in self.judged[first:]}


def run(ticks: Iterable[Tick], config: CraftConfig | None = None) -> Run:
    """Ticks through the filter and the watch."""
    config = config or craft()
    estimator, monitor = Ukf(config), TrustMonitor(config)
    judged, windows_rejected = [], 0
    for tick in ticks:
        outcome = estimator.handle(tick)
        windows_rejected += outcome.spin_rejected
        monitor.observe(tick, outcome, estimator.estimate())
        judged.append(monitor.judge(estimator.estimate()))
    return Run(tuple(judged), estimator.estimate(), windows_rejected)


def errors_in_sigma(state: StateEstimate) -> np.ndarray:
    """Errors of the nine states in units of their own sigma (9,)."""
    return np.asarray((state.x - TRUTH) / np.sqrt(np.diagonal(state.covariance)))
