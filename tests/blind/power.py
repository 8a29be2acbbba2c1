"""Currents of a small craft's power system, and the fields of the loops they flow in.

Panels give current by the cosine of the Sun's angle while they are lit; a battery takes the balance with the loads and,
when it is full, only a trickle, so that the panels are shunted.  Each circuit is a flat loop of wire; its field at the
magnetometer is the Biot-Savart integral along the wire's straight pieces.  Source: Jackson 1998, equation 5.4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.blind.cause import Cause, Telemetry, plain, rounded
from tests.blind.sensor import Spoiling
from tests.blind.vectors import Floats, frame_with_z_along, log_uniform, random_direction
from tests.blind.world import World

PANELS = {"px": (1.0, 0.0, 0.0), "nx": (-1.0, 0.0, 0.0), "py": (0.0, 1.0, 0.0), "ny": (0.0, -1.0, 0.0)}
LARGEST_NT_PER_A = 4000.0
LEAST_CHANGE_A = 0.02
TOP = {"pz": (0.0, 0.0, 1.0), "nz": (0.0, 0.0, -1.0)}


@dataclass(frozen=True, slots=True, eq=False)
class Currents:
    """Currents (n,) [A] at the samples: of each panel by name, of all, of the loads, and into the battery."""

    panels: dict[str, Floats]
    array: Floats
    load: Floats
    battery: Floats


def panel_currents(world: World, names: dict[str, tuple[float, float, float]], full_a: float) -> dict[str, Floats]:
    """Current (n,) [A] of each panel: ``full_a`` times the cosine of the Sun's angle, none in shadow."""
    sun = world.sun_body(world.time_s)
    lit = world.sunlit(world.time_s)
    return {name: full_a * np.maximum(sun @ np.array(normal), 0.0) * lit for name, normal in names.items()}


def transmitter_on(world: World, rng: np.random.Generator) -> Floats:
    """1 while the transmitter works (n,): two to five passes of four to eleven minutes."""
    on = np.zeros_like(world.time_s)
    for start in rng.uniform(0.0, world.duration_s, rng.integers(2, 6)):
        length = rng.uniform(240.0, 660.0)
        on[(world.time_s >= start) & (world.time_s < start + length)] = 1.0
    return on


def battery_current(world: World, array_a: Floats, load_a: Floats, capacity_ah: float, first: float) -> Floats:
    """Current into the battery (n,) [A]; above 95 % of its charge it tapers off to nothing at 100 %.

    Parameters
    ----------
    array_a, load_a: (n,) what the panels could give and what the loads take.
    capacity_ah: of the battery.
    first: charge at the first sample, 0 to 1.
    """
    share = world.period_s / 3600.0 / capacity_ah
    wanted = (array_a - load_a).tolist()
    charge, result = first, []
    for surplus in wanted:
        current = min(surplus, max(0.0, (1.0 - charge) / 0.05) * capacity_ah) if surplus > 0.0 else surplus
        charge = min(max(charge + share * current, 0.0), 1.0)
        result.append(current)
    return np.array(result)


def draw_currents(world: World, rng: np.random.Generator, *, passes: bool) -> Currents:
    """The power system of a CubeSat; ``passes`` switches a transmitter on at times."""
    names = PANELS | (TOP if rng.random() < 0.6 else {})
    full = rng.uniform(0.4, 1.2)
    panels = panel_currents(world, names, full)
    array = np.sum(list(panels.values()), axis=0)
    load = np.full_like(array, rng.uniform(0.4, 0.8) * float(array.mean()) + 0.05)
    if passes:
        load = load + rng.uniform(0.3, 1.0) * transmitter_on(world, rng)
    battery = battery_current(world, array, load, rng.uniform(1.0, 4.0), rng.uniform(0.55, 0.95))
    shunted = load + np.maximum(battery, 0.0)
    used = np.where(array > shunted, shunted, array)  # a full battery leaves the rest in the panels
    ratio = np.divide(used, array, out=np.ones_like(array), where=array > 1e-9)
    return Currents({name: current * ratio for name, current in panels.items()}, used, load, battery)


def loop_field_nt_a(corners_m: Floats) -> Floats:
    """Field (3,) [nT] at the origin for 1 A round a closed polygon of corners (k, 3) [m]."""
    field = np.zeros(3)
    for start, end in zip(corners_m, np.roll(corners_m, -1, axis=0), strict=True):
        cross = np.cross(start, end)
        from_start, to_end = float(np.linalg.norm(start)), float(np.linalg.norm(end))
        factor = (from_start + to_end) / (from_start * to_end * (from_start * to_end + float(start @ end)))
        field += factor * cross
    return np.asarray(field * 100.0, dtype=np.float64)  # mu0 / 4 pi = 1e-7 T m/A


def draw_loop(rng: np.random.Generator) -> Floats:
    """Corners (4, 3) [m] of a harness loop of some square centimetres, 8 to 25 cm from the magnetometer."""
    sides = frame_with_z_along(random_direction(rng))
    centre = rng.uniform(0.08, 0.25) * random_direction(rng)
    half = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * rng.uniform(0.005, 0.02, 2)
    return np.asarray(centre + half @ sides[:2], dtype=np.float64)


def ammeter(world: World, current_a: Floats, name: str) -> Telemetry:
    """A recorded current (n,): 0.5 to 3 mA of noise, in steps of 1 mA."""
    rng = world.streams.rng(f"telemetry {name}")
    noisy = current_a + rng.normal(0.0, rng.uniform(0.5e-3, 3e-3), len(current_a))
    return Telemetry(name, rounded(noisy, 1e-3)[:, None], "A", decimals=3)


def choose_circuits(world: World, rng: np.random.Generator, *, recorded: bool) -> dict[str, Floats]:
    """One to four circuits with their currents (n,) [A] by the names of their channels.

    Where nothing is recorded the transmitter stays silent: nobody could know when it was on.
    """
    choice = rng.random()
    currents = draw_currents(world, rng, passes=recorded and choice < 0.75)
    if choice < 0.35:
        return {"current_array": currents.array}
    if choice < 0.6:
        return {"current_battery": currents.battery}
    if choice < 0.75 and recorded:
        return {"current_bus": currents.load, "current_array": currents.array}
    panels = {name: values for name, values in currents.panels.items() if name in PANELS}
    changing = {name: values for name, values in panels.items() if values.std() > LEAST_CHANGE_A}
    return {f"current_{name}": values for name, values in (changing or panels).items()}


def current_loop(world: World, recorded: bool) -> Cause:
    """d = sum of c_j I_j(t) over the circuits: sharp at the edges of the shadow, turning with the craft."""
    rng = world.streams.rng("current_loop")
    circuits = choose_circuits(world, rng, recorded=recorded)
    flowing = np.stack(list(circuits.values()), axis=-1)
    per_a = np.stack([loop_field_nt_a(draw_loop(rng)) * log_uniform(rng, 0.5, 2.0) for _ in circuits])
    field = flowing @ per_a

    return Cause(
        name="current_loop",
        world=world,
        spoil=lambda scale: Spoiling(disturbance=lambda _tags, _body: scale * field),
        parameters=lambda scale: {"nt_per_a": plain(scale * per_a), "channels": list(circuits)},
        largest_scale=LARGEST_NT_PER_A / float(np.linalg.norm(per_a, axis=1).max()),
        drivers=tuple(ammeter(world, column, name) for name, column in circuits.items()),
        needs_place=True,
    )
