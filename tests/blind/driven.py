"""Disturbances that no catalogue has, and whose driver is recorded: ``unknown`` by name, and yet to be followed."""

from __future__ import annotations

import numpy as np

from tests.blind.cause import Cause, plain
from tests.blind.power import ammeter, draw_currents, draw_loop, loop_field_nt_a
from tests.blind.sensor import Spoiling
from tests.blind.thermal import LEAST_SWING_K, draw_craft, temperatures_c, thermometer
from tests.blind.vectors import log_uniform
from tests.blind.world import World


def hopkinson(world: World, _recorded: bool) -> Cause:
    """A soft alloy near its Curie point: its susceptibility has a narrow peak in temperature (Hopkinson 1889)."""
    rng = world.streams.rng("hopkinson")
    temperature = temperatures_c(world, draw_craft(rng))[:, 1]
    low, high = np.quantile(temperature, [0.0, 1.0])
    swing = float(high - low)
    peak, width = low + rng.uniform(0.35, 0.65) * swing, rng.uniform(0.08, 0.16) * swing
    course = np.exp(-0.5 * ((temperature - peak) / max(width, 1e-9)) ** 2)[:, None]
    gain = rng.uniform(0.3, 1.0, 3) * rng.choice([-1.0, 1.0], 3)
    return Cause(
        name="hopkinson",
        world=world,
        spoil=lambda scale: Spoiling(scale_change=lambda _: scale * gain * course),
        parameters=lambda scale: {"peak_degc": float(peak), "width_k": width, "gain": plain(scale * gain)},
        drivers=(thermometer(world, temperature, "temperature"),),
        scale=1e-3,
        largest_scale=0.05 * float(swing > LEAST_SWING_K),
        needs_place=True,
    )


def two_paths(world: World, _recorded: bool) -> Cause:
    """A battery is charged through one loop of wire and discharged through another, which is turned against it."""
    rng = world.streams.rng("two_paths")
    current = draw_currents(world, rng, passes=True).battery
    charging = loop_field_nt_a(draw_loop(rng))
    discharging = -charging * log_uniform(rng, 0.7, 1.4)
    field = current[:, None] * np.where(current[:, None] > 0.0, charging, discharging)
    return Cause(
        name="two_paths",
        world=world,
        spoil=lambda scale: Spoiling(disturbance=lambda _tags, _body: scale * field),
        parameters=lambda scale: {
            "charging_nt_per_a": plain(scale * charging),
            "discharging_nt_per_a": plain(scale * discharging),
        },
        drivers=(ammeter(world, current, "current_battery"),),
        needs_place=True,
    )
