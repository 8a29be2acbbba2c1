"""Telemetry that comes with a recording and has nothing to do with what is wrong."""

from __future__ import annotations

from collections.abc import Callable, Collection

import numpy as np

from tests.blind.body import sun_sensor
from tests.blind.cause import Telemetry
from tests.blind.power import ammeter, draw_currents
from tests.blind.thermal import draw_craft, temperatures_c, thermometer
from tests.blind.torquer import detumbling, dumping
from tests.blind.world import World


def _temperature(world: World, rng: np.random.Generator) -> Telemetry:
    name = str(rng.choice(["temperature", "temp_battery", "temp_structure"]))
    return thermometer(world, temperatures_c(world, draw_craft(rng))[:, int(rng.integers(2))], name)


def _current(world: World, rng: np.random.Generator) -> Telemetry:
    currents = draw_currents(world, rng, passes=rng.random() < 0.5)
    kinds = {"current_array": currents.array, "current_bus": currents.load, "current_battery": currents.battery}
    name = str(rng.choice(list(kinds)))
    return ammeter(world, kinds[name], name)


def _torquer(world: World, rng: np.random.Generator) -> Telemetry:
    firing = detumbling(world, rng) if rng.random() < 0.6 else dumping(world, rng)
    return Telemetry("torquer", firing.at(world.time_s)[0], "A m2", decimals=5)


def _sun(world: World, _rng: np.random.Generator) -> Telemetry:
    return sun_sensor(world)


def _gyro(world: World, rng: np.random.Generator) -> Telemetry:
    rate = world.motion.body_rate(world.time_s)
    noise = rng.normal(0.0, rng.uniform(1e-4, 1e-3), rate.shape)
    return Telemetry("gyro", rate + rng.normal(0.0, 2e-4, 3) + noise, "rad/s", decimals=5)


_DECOYS: dict[str, tuple[float, Callable[[World, np.random.Generator], Telemetry]]] = {
    "temperature": (0.4, _temperature),
    "current": (0.4, _current),
    "torquer": (0.2, _torquer),
    "sun": (0.25, _sun),
    "gyro": (0.2, _gyro),
}

DRIVES = {
    "thermal_bias": "temperature",
    "thermal_scale": "temperature",
    "current_loop": "current",
    "torquer": "torquer",
    "sun_disturbance": "sun",
}
"""What kind of telemetry drives an effect: no decoy of that kind goes with it."""


def draw_decoys(world: World, effects: Collection[str]) -> tuple[Telemetry, ...]:
    """Up to five channels of kinds that drive none of the effects."""
    taken = {DRIVES[effect] for effect in effects if effect in DRIVES}
    rng = world.streams.rng("which decoys")
    chosen = [name for name, (share, _) in _DECOYS.items() if rng.random() < share and name not in taken]
    return tuple(_DECOYS[name][1](world, world.streams.rng(f"decoy {name}")) for name in chosen)
