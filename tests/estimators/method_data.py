"""Flights for the tests of the methods: noise-free fields and attitudes, and ticks of measured samples."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from magcal_service.config.settings import SpinConfig
from magcal_service.estimators.interface import Estimator, TickOutcome
from magcal_service.model import Array, measure
from magcal_service.studies.bounds import Flight
from magcal_service.ticks.assembler import Tick

PAPER_X = np.array([5000.0, 3000.0, 4000.0, 0.05, 0.10, 0.05, 0.05, 0.05, 0.05])
PAPER_NOISE_NT = 300.0
NODE_DEG = 30.0
START_NS = 1_577_836_800 * 10**9
"""2020-01-01.  The paper states neither node nor date; with these the published bounds come out."""

NEAR_NORMAL = (0.5, -0.8, 0.28)
"""2 degrees from the normal of that orbit, towards the pole."""


@dataclass(frozen=True)
class RateTick(Tick):
    """A tick with the gyro's rates (n, 3) [rad/s]."""

    rate_body_rad_s: Array | None = None


@dataclass(frozen=True)
class Field:
    """A noise-free flight: times (n,) [s], A H (n, 3) [nT], H (n, 3) [nT] in ECI, gyro (n, 3) [rad/s], spin."""

    times_s: Array
    field_body_nt: Array
    reference_eci_nt: Array
    rate_body_rad_s: Array
    spin_axis: Array
    spin_rate_rad_s: float

    def until(self, seconds: float) -> Field:
        """The first ``seconds``."""
        part = self.times_s < seconds
        arrays = (self.times_s, self.field_body_nt, self.reference_eci_nt, self.rate_body_rad_s)
        return Field(*(values[part] for values in arrays), self.spin_axis, self.spin_rate_rad_s)

    def flight(self, x: Array = PAPER_X, noise_nt: float = PAPER_NOISE_NT) -> Flight:
        """The same for the bounds."""
        window_s = SpinConfig(rate_rpm=self.spin_rate_rad_s * 60.0 / (2.0 * np.pi)).window_s
        return Flight(self.times_s, self.field_body_nt, x, noise_nt, self.spin_axis, self.spin_rate_rad_s, window_s)

    def measured(self, rng: np.random.Generator, x: Array = PAPER_X, noise_nt: float = PAPER_NOISE_NT) -> Array:
        """Measured vectors B (n, 3) [nT] with the errors x and fresh noise."""
        return measure(x, self.field_body_nt + noise_nt * rng.standard_normal(self.field_body_nt.shape))

    def ticks(self, field_nt: Array, per_tick: int = 1) -> Iterator[RateTick]:
        """The samples B (n, 3) [nT] in ticks of ``per_tick``, the gyro's rates with them."""
        for index, first in enumerate(range(0, len(field_nt), per_tick)):
            yield self.tick(field_nt, index, slice(first, first + per_tick))

    def tick(self, field_nt: Array, index: int, part: slice, *, after_gap: bool = False) -> RateTick:
        """One tick of a part of the samples."""
        reference = self.reference_eci_nt[part]
        return RateTick(
            index,
            self.times_s[part],
            np.ascontiguousarray(field_nt[part]),  # as ticks are that were made of messages
            np.linalg.norm(reference, axis=1),
            reference,
            after_gap,
            rate_body_rad_s=self.rate_body_rad_s[part],
        )


@cache
def paper_field(direction: tuple[float, float, float] = (1.0, 1.0, 1.0), seconds: float = 18000.0) -> Field:
    """The paper's orbit and spin with the spin axis towards ``direction`` (ECI, any length), at 1 Hz."""
    from sim_sensor.scenario_reader import load_scenario
    from sim_sensor.simulation import Simulation

    scenario = load_scenario("paper")
    x, y, z = (np.array(direction) / np.linalg.norm(direction)).tolist()
    orbit = replace(scenario.orbit, raan_rad=math.radians(NODE_DEG), epoch_utc_ns=START_NS)
    spin = replace(scenario.spin, direction_eci=(x, y, z))
    block = Simulation(replace(scenario, start_ns=START_NS, orbit=orbit, spin=spin), duration_s=seconds).arrays()
    times_s = (block.times_ns - START_NS) * 1e-9
    return Field(
        times_s,
        block.ambient_body_nt,
        block.true_eci_nt,
        spin.rate_body_rad_s(times_s),
        np.array(spin.axis_body),
        spin.rate_rad_s,
    )


def play(estimator: Estimator, ticks: Iterable[Tick]) -> list[TickOutcome]:
    """Feed an estimator; what it made of each tick."""
    return [estimator.handle(tick) for tick in ticks]


def sigmas_off(estimator: Estimator, x: Array) -> Array:
    """Errors of the estimate in units of its own sigma (9,)."""
    state = estimator.estimate()
    off: Array = (state.x - x) / np.sqrt(np.diagonal(state.covariance))
    return off


def nees(error: Array, covariance: Array) -> float:
    """Normalised estimation error squared; 9 on average for a consistent covariance."""
    return float(error @ np.linalg.solve(covariance, error))
