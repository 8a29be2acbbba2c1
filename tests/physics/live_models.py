"""Models and streams for live compensation: the hot board's, as its scenario has it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from magcal_service.config.settings import CraftConfig, FilterConfig, PhysicsConfig, SensorConfig, SpinConfig
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.physics.apply.model_file import ModelTerm, PhysicsModel, text_of
from magcal_service.wire.messages import Clock, Estimate, Message
from sim_sensor.scenario import Scenario
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation

NOISE_NT = 100.0
HOT_X = np.array([5000.0, 1000.0, 4000.0, 0.05, 0.10, 0.05, 0.05, 0.05, 0.05])
ZERO = {"zero_degc": 20.0, "column": 0.0}
THERMAL = (
    ModelTerm("thermal_bias", "channel:temperature", "", {"nt_per_k": np.array([8.0, -6.0, 12.0])}, constants=ZERO),
    ModelTerm("thermal_scale", "channel:temperature", "", {"per_k": np.full(3, 2e-4)}, constants=ZERO),
)


def hot(**changes: object) -> Scenario:
    """The shipped scenario."""
    return replace(load_scenario("hot-electronics"), **changes)


def model_of(*terms: ModelTerm, origin_ns: int, **changes: object) -> PhysicsModel:
    """A model with the hot board's nine errors."""
    made = PhysicsModel("hot", origin_ns, Clock.UTC, HOT_X, np.ones(9), NOISE_NT, terms)
    return replace(made, **changes)  # type: ignore[arg-type]


def physics(*terms: ModelTerm, origin_ns: int, **changes: object) -> PhysicsConfig:
    """The same as a configuration holds it."""
    return PhysicsConfig(Path("physics.toml"), text_of(model_of(*terms, origin_ns=origin_ns, **changes)))


def craft(name: str, model: PhysicsConfig | None, method: str = "ukf") -> CraftConfig:
    """A craft that turns at 7.5 rpm about z."""
    return CraftConfig(
        name, SensorConfig(noise_nt=NOISE_NT), SpinConfig(rate_rpm=7.5), FilterConfig(method=method), physics=model
    )


@cache
def stream(scenario: Scenario, duration_s: float, seed: int = 3) -> tuple[Message, ...]:
    """Everything the node sends."""
    return tuple(Simulation(scenario, seed, duration_s).messages())


def last_estimate(pipeline: Pipeline, messages: tuple[Message, ...]) -> Estimate:
    """The estimate after a whole stream."""
    found = [out for message in messages for out in pipeline.handle(message) if isinstance(out, Estimate)]
    return found[-1]
