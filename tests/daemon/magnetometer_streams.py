"""A craft with two magnetometers, as scenario and as messages."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import numpy as np

from magcal_service.config.settings import CraftConfig, SensorConfig, TrustConfig
from magcal_service.wire.messages import MagnetometerSample, Message
from sim_sensor.beside import Magnet
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation

PAIR = CraftConfig("pair", sensor=SensorConfig(noise_nt=100.0), trust=TrustConfig(protection_nt=1e5))
MAGNET_S = 700.0


@cache
def pair(seconds: float, apart_nt: float = 1000.0, offset_s: float = 0.5) -> Simulation:
    """Two magnetometers whose biases differ by ``apart_nt`` [nT], a magnet near the second one from 700 s on."""
    scenario = load_scenario("two-sensors")
    bias = np.array(scenario.sensor.bias_nt) + apart_nt * np.array([0.6, -0.8, 0.0])
    (one,) = scenario.beside
    x, y, z = bias.tolist()
    magnet = Magnet(MAGNET_S, 1e4, (600.0, -300.0, 300.0))
    other = replace(one, offset_s=offset_s, sensor=replace(one.sensor, bias_nt=(x, y, z)), magnets=(magnet,))
    return Simulation(replace(scenario, beside=(other,)), duration_s=seconds)


@cache
def messages(seconds: float = 60.0) -> tuple[Message, ...]:
    return tuple(pair(seconds).messages())


def of_source(source: str, stream: Iterable[Message]) -> list[Message]:
    """The stream with the samples of one magnetometer alone."""
    return [one for one in stream if not isinstance(one, MagnetometerSample) or one.source == source]
