"""Flights for the watch: every driver is on the link, and what it does to the sensor is as strong as told."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from magcal_service.config.settings import CraftConfig, SensorConfig, SpinConfig
from magcal_service.daemon.events import Event
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.model import measure, state_of
from magcal_service.ticks.assembler import Tick
from magcal_service.watch.drivers import Driver, DriverTrack
from magcal_service.wire.messages import (
    Clock,
    Message,
    PositionSample,
    TelemetrySample,
)
from sim_sensor.disturbances import Panel, Step, Thermal, Torquer
from sim_sensor.scenario import Channel, PositionPlan, Scenario, TelemetryPlan
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.sensor import symmetric
from sim_sensor.simulation import Simulation

NOISE_NT = 100.0
SHIPPED_PANELS = load_scenario("noisy-panels").effects.panels


def flight(
    *,
    thermal_nt_per_k: float = 0.0,
    scale_per_k: float = 0.0,
    panel_nt_per_a: float = 0.0,
    torquer_nt: float = 0.0,
    step_nt: float = 0.0,
    step_at_s: float = 4000.0,
    rate_rpm: float = 7.5,
    noise_nt: float = NOISE_NT,
    full_scale_nt: float = 0.0,
    towards: tuple[float, float, float] | None = None,
) -> Scenario:
    """The paper's craft with a thermometer, four panels, a coil, a Sun sensor and a receiver on board."""
    scenario = load_scenario("paper")
    thermal = Thermal(
        hot_degc=45.0,
        cold_degc=-10.0,
        time_constant_s=1200.0,
        start_degc=20.0,
        zero_degc=20.0,
        bias_nt_per_k=(0.5 * thermal_nt_per_k, -0.4 * thermal_nt_per_k, 0.77 * thermal_nt_per_k),
        scale_per_k=(scale_per_k, -scale_per_k, 0.5 * scale_per_k),
    )
    share = panel_nt_per_a / 500.0
    panels = tuple(Panel(one.normal_body, one.max_a, _times(share, one.field_nt_per_a)) for one in SHIPPED_PANELS)
    k = torquer_nt / 0.1
    towards = towards or scenario.spin.direction_eci
    torquer = Torquer((0.1, 0.0, 0.0), 60.0, 6.0, (0.8 * k, 0.0, 0.0, 0.0, k, 0.0, 0.6 * k, 0.0, k))
    steps = (Step(step_at_s, (0.6 * step_nt, -0.6 * step_nt, 0.5 * step_nt)),) if step_nt else ()
    return replace(
        scenario,
        spin=replace(
            scenario.spin,
            rate_rad_s=rate_rpm * math.tau / 60.0,
            direction_eci=_times(1.0 / math.hypot(*towards), towards),
        ),
        sensor=replace(scenario.sensor, noise_nt=(noise_nt,) * 3, full_scale_nt=full_scale_nt),
        effects=replace(scenario.effects, thermal=thermal, panels=panels, torquer=torquer, steps=steps),
        position=PositionPlan(rate_hz=0.1),
        telemetry=TelemetryPlan(
            (Channel.TEMPERATURE, Channel.CURRENT, Channel.TORQUER, Channel.SUN), 1.0, (0.1, 0.002, 0.0, 0.005)
        ),
    )


def _times(factor: float, vector: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = vector
    return factor * x, factor * y, factor * z


def craft(noise_nt: float = NOISE_NT, rate_rpm: float = 7.5, **changes: object) -> CraftConfig:
    """What the operator of this craft configures."""
    settings = {"sensor": SensorConfig(noise_nt=noise_nt), "spin": SpinConfig(rate_rpm=rate_rpm)} | changes
    return CraftConfig("paper", **settings)  # type: ignore[arg-type]


@cache
def stream(scenario: Scenario, duration_s: float, seed: int = 1) -> tuple[Message, ...]:
    """Everything the node sends."""
    return tuple(Simulation(scenario, seed, duration_s).messages())


@dataclass(frozen=True)
class Flown:
    """A pipeline after a stream, and what it told on the way."""

    pipeline: Pipeline
    events: tuple[Event, ...]

    @property
    def findings(self) -> tuple[Event, ...]:
        """What the watch has told."""
        return tuple(event for event in self.events if event.what.startswith("model_"))


def fly(pipeline: Pipeline, messages: tuple[Message, ...]) -> Flown:
    """Play a stream through a pipeline."""
    events = []
    for message in messages:
        pipeline.handle(message)
        events += pipeline.take_events()
    return Flown(pipeline, tuple(events))


@dataclass(frozen=True)
class Clean:
    """A flight whose noise is drawn again and again: ticks for the watch alone, without a filter."""

    scenario: Scenario
    field_nt: np.ndarray
    magnitude_nt: np.ndarray
    times_ns: np.ndarray
    x: np.ndarray
    messages: tuple[Message, ...]

    @classmethod
    def of(cls, scenario: Scenario, seed: int, duration_s: float) -> Clean:
        """From a scenario without disturbances."""
        simulation = Simulation(
            replace(scenario, sensor=replace(scenario.sensor, noise_nt=(0.0,) * 3)), seed, duration_s
        )
        block = simulation.arrays()
        others = tuple(m for m in simulation.messages() if isinstance(m, TelemetrySample | PositionSample))
        truth = simulation.truth.sensor
        x = state_of(np.array(truth.bias_nt), symmetric(truth.D))
        corrected = block.ambient_body_nt
        return cls(scenario, corrected, np.linalg.norm(block.true_eci_nt, axis=1), block.times_ns, x, others)

    def noise(self, rng: np.random.Generator) -> np.ndarray:
        """White noise (n, 3) [nT], body."""
        return rng.standard_normal(self.field_nt.shape) * np.array(self.scenario.sensor.noise_nt)

    def ticks(self, noise: np.ndarray, drivers: DriverTrack | None) -> Iterator[Tick]:
        """Ticks with noise, or more than noise (n, 3) [nT]; the drivers are told what was sent before each of them."""
        measured = measure(self.x, self.field_nt + noise)
        waiting = iter(self.messages if drivers is not None else ())
        message = next(waiting, None)
        for row, time_ns in enumerate(self.times_ns.tolist()):
            while message is not None and message.time_ns <= time_ns + 10**9:
                if drivers is not None and isinstance(message, TelemetrySample):
                    drivers.telemetry(message)
                elif drivers is not None and isinstance(message, PositionSample):
                    drivers.position(message)
                message = next(waiting, None)
            yield Tick(
                index=row,
                times_s=np.array([(time_ns - self.times_ns[0]) * 1e-9]),
                field_body_nt=measured[row : row + 1],
                reference_magnitude_nt=self.magnitude_nt[row : row + 1],
                time_ns=time_ns,
                clock=Clock.UTC,
            )


class Known(DriverTrack):
    """A flight's drivers, worked out once from what is on its link, for many watches."""

    def __init__(self, flown: Clean) -> None:
        super().__init__()
        track, self._at = DriverTrack(), dict[int, dict[str, tuple[float, ...]]]()
        for tick in flown.ticks(np.zeros_like(flown.field_nt), track):
            self._at[tick.time_ns] = track.at(tick.time_ns)
        self._known = track.drivers()

    def drivers(self) -> list[Driver]:
        """Those at the end of the flight."""
        return self._known

    def at(self, time_ns: int) -> dict[str, tuple[float, ...]]:
        """Values at a sample's time."""
        return self._at[time_ns]
