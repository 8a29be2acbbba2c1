"""Temperature of a small craft and of its magnetometer: two heat capacities, sunlight, radiation, conduction.

C1 dT1/dt = Q_sun + Q_earth + P - e s A T1^4 - G (T1 - T2),   C2 dT2/dt = G (T1 - T2) + P2
with 1 the structure and 2 the magnetometer behind a conductance G.  Source: Gilmore 2002, chapter 5 (lumped nodes).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tests.blind.attitude import Motion
from tests.blind.cause import Cause, Telemetry, plain, rounded
from tests.blind.sensor import Spoiling
from tests.blind.vectors import Floats, log_uniform, random_direction
from tests.blind.world import World

STEFAN_BOLTZMANN = 5.670374e-8  # W / m2 / K4
SOLAR_CONSTANT = 1361.0  # W / m2
EARTH_INFRARED = 240.0  # W / m2, leaving the Earth
KELVIN = 273.15
STEP_S = 10.0
PHASES = 16
LEAST_SWING_K = 3.0  # below, a craft in constant sunlight has no thermal cycle to be disturbed by
LARGEST_NT_PER_K = 150.0
LARGEST_PER_K = 6e-3
FACES = np.concatenate([np.eye(3), -np.eye(3)])


@dataclass(frozen=True, slots=True, eq=False)
class Craft:
    """Heat properties: face areas (6,) [m2] of +x +y +z -x -y -z, capacities [J/K], conductance [W/K], powers [W]."""

    areas_m2: Floats
    absorptivity: float
    emissivity: float
    capacity_j_k: float
    sensor_capacity_j_k: float
    conductance_w_k: float
    power_w: float
    sensor_power_w: float

    @property
    def sensor_tau_s(self) -> float:
        """Time constant of the magnetometer against the structure [s]."""
        return self.sensor_capacity_j_k / self.conductance_w_k


def draw_craft(rng: np.random.Generator) -> Craft:
    """A CubeSat of one to twelve units, balanced somewhere between -10 and 30 degC."""
    side, height = [(0.1, 0.1), (0.1, 0.3), (0.2, 0.3)][rng.integers(3)]
    areas = np.array([side * height, side * height, side * side] * 2)
    capacity = 900.0 * 1.2 * side * side * height * 1e3 * rng.uniform(0.6, 1.3)
    conductance = log_uniform(rng, 0.02, 0.2)
    emissivity = rng.uniform(0.5, 0.85)
    return Craft(
        areas_m2=areas,
        absorptivity=rng.uniform(0.5, 0.9),
        emissivity=emissivity,
        capacity_j_k=capacity,
        sensor_capacity_j_k=conductance * log_uniform(rng, 300.0, 3000.0),
        conductance_w_k=conductance,
        power_w=float(areas.sum()) * rng.uniform(20.0, 90.0),
        sensor_power_w=conductance * rng.uniform(0.0, 4.0),
    )


def absorbed_sunlight_w(craft: Craft, world: World, motion: Motion, times_s: Floats) -> Floats:
    """Sunlight taken up (n,) [W], averaged over the turn about each instant."""
    turn_s = 2.0 * np.pi / np.maximum(np.abs(motion.rate.rate(times_s)), 1e-3)
    offsets = (np.arange(PHASES) + 0.5) / PHASES - 0.5
    fine = (times_s[:, None] + turn_s[:, None] * offsets).ravel()
    sun = world.with_motion(motion).sun_body(fine)
    facing = np.maximum(sun @ FACES.T, 0.0) @ craft.areas_m2
    mean = facing.reshape(len(times_s), PHASES).mean(axis=1)
    return np.asarray(SOLAR_CONSTANT * craft.absorptivity * mean * world.sunlit(times_s), dtype=np.float64)


def heat_balance(craft: Craft, sunlight_w: Floats, earth_w: float, first_k: float) -> Floats:
    """Temperatures (n, 2) [K] of structure and magnetometer on a grid of ``STEP_S``, by Runge-Kutta of fourth order.

    Parameters
    ----------
    sunlight_w: (n,) absorbed sunlight [W] at the grid's times.
    earth_w: infrared of the Earth that is taken up [W].
    first_k: both temperatures at the first.
    """
    radiating = craft.emissivity * STEFAN_BOLTZMANN * float(craft.areas_m2.sum())
    steady = earth_w + craft.power_w

    def slopes(first: float, second: float, sun_w: float) -> tuple[float, float]:
        through = craft.conductance_w_k * (first - second)
        return (
            (sun_w + steady - radiating * first**4 - through) / craft.capacity_j_k,
            (through + craft.sensor_power_w) / craft.sensor_capacity_j_k,
        )

    sunlight = sunlight_w.tolist()
    result = [(first_k, first_k)]
    one, two = first_k, first_k
    for now, then in pairwise(sunlight):
        middle = 0.5 * (now + then)
        a1, a2 = slopes(one, two, now)
        b1, b2 = slopes(one + 0.5 * STEP_S * a1, two + 0.5 * STEP_S * a2, middle)
        c1, c2 = slopes(one + 0.5 * STEP_S * b1, two + 0.5 * STEP_S * b2, middle)
        d1, d2 = slopes(one + STEP_S * c1, two + STEP_S * c2, then)
        one += STEP_S / 6.0 * (a1 + 2.0 * b1 + 2.0 * c1 + d1)
        two += STEP_S / 6.0 * (a2 + 2.0 * b2 + 2.0 * c2 + d2)
        result.append((one, two))
    return np.array(result)


def temperatures_c(world: World, craft: Craft) -> Floats:
    """Temperatures (n, 2) [degC] of structure and magnetometer at the samples, settled over the orbits before."""
    start = -4.0 * world.orbit.period_s
    grid = np.arange(start, world.duration_s + 2.0 * STEP_S, STEP_S)
    sunlight = absorbed_sunlight_w(craft, world, world.motion, grid)
    earth = 0.3 * EARTH_INFRARED * craft.emissivity * float(craft.areas_m2.sum())
    mean = float(sunlight.mean()) + earth + craft.power_w
    first = (mean / (craft.emissivity * STEFAN_BOLTZMANN * float(craft.areas_m2.sum()))) ** 0.25
    kelvin = heat_balance(craft, sunlight, earth, first)
    columns = [np.interp(world.time_s, grid, column) for column in kelvin.T]
    return np.stack(columns, axis=-1) - KELVIN


def thermometer(world: World, temperature_c: Floats, name: str) -> Telemetry:
    """A recorded temperature (n,): 0.05 to 0.15 K of noise, in steps of 0.1 K (or of 1/16 K)."""
    rng = world.streams.rng(f"telemetry {name}")
    step = float(rng.choice([0.1, 0.0625]))
    noisy = temperature_c + rng.normal(0.0, rng.uniform(0.05, 0.15), len(temperature_c))
    return Telemetry(name, rounded(noisy, step)[:, None], "degC", decimals=4)


def thermal_bias(world: World, _recorded: bool) -> Cause:
    """d = k (T - T0): the bias follows the magnetometer's temperature."""
    return _thermal(world, "thermal_bias")


def thermal_scale(world: World, _recorded: bool) -> Cause:
    """D(T) = D + diag(a) (T - T0): the scale follows it, all axes alike or each its own way."""
    return _thermal(world, "thermal_scale")


def _thermal(world: World, name: str) -> Cause:
    rng = world.streams.rng(name)
    craft = draw_craft(rng)
    temperature = temperatures_c(world, craft)[:, 1]
    mean = float(temperature.mean())
    excess = (temperature - mean)[:, None]
    known = {"reference_degc": mean, "sensor_tau_s": craft.sensor_tau_s, "swing_k": float(np.ptp(temperature))}
    driver = (thermometer(world, temperature, "temperature"),)
    cycles = float(np.ptp(temperature) > LEAST_SWING_K)
    if name == "thermal_bias":
        gain = rng.uniform(5.0, 20.0) * random_direction(rng)
        return Cause(
            name=name,
            world=world,
            spoil=lambda scale: Spoiling(disturbance=lambda _tags, _body: scale * gain * excess),
            parameters=lambda scale: {"nt_per_k": plain(scale * gain), **known},
            drivers=driver,
            largest_scale=cycles * LARGEST_NT_PER_K / float(np.linalg.norm(gain)),
            needs_place=True,
        )
    gain = rng.uniform(-3e-4, 3e-4) * np.ones(3) if rng.random() < 0.5 else rng.uniform(-3e-4, 3e-4, 3)
    return Cause(
        name=name,
        world=world,
        spoil=lambda scale: Spoiling(scale_change=lambda _: scale * gain * excess),
        parameters=lambda scale: {"per_k": plain(scale * gain), **known},
        drivers=driver,
        largest_scale=cycles * LARGEST_PER_K / float(np.abs(gain).max()),
        needs_place=True,
    )
