"""A scenario: everything that decides what a simulated node sends, as frozen records read from TOML.

``resolve`` draws what the scenario leaves to chance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from dataclasses import field as dataclass_field
from enum import StrEnum

import numpy as np

from magcal_service.wire.messages import Vector
from sim_sensor.attitude import Spin
from sim_sensor.faults import LinkFault
from sim_sensor.field import FieldModel
from sim_sensor.orbit import KeplerOrbit, Sgp4Orbit
from sim_sensor.sensor import Effects, Sensor, symmetric
from sim_sensor.streams import Stream, generator


class Direction(StrEnum):
    """Spin directions that are not a fixed vector."""

    ORBIT_NORMAL = "orbit-normal"
    RANDOM = "random"


class ReferenceForm(StrEnum):
    """What the reference sends: a vector in ECI, its magnitude alone, or nothing."""

    VECTOR = "vector"
    MAGNITUDE = "magnitude"
    NONE = "none"


class Channel(StrEnum):
    """Telemetry that a scenario may ask for."""

    TEMPERATURE = "temperature"
    CURRENT = "current"
    TORQUER = "torquer"
    SUN = "sun"
    GYRO = "gyro"


UNITS = {
    Channel.TEMPERATURE: "degC",
    Channel.CURRENT: "A",
    Channel.TORQUER: "A m2",
    Channel.SUN: "1",
    Channel.GYRO: "rad/s",
}


@dataclass(frozen=True)
class ReferencePlan:
    """The reference's own rate [Hz], its first sample's time after the start [s], form and noise [nT per axis]."""

    rate_hz: float = 1.0
    offset_s: float = 0.0
    form: ReferenceForm = ReferenceForm.VECTOR
    noise_nt: float = 0.0


@dataclass(frozen=True)
class PositionPlan:
    """Rate [Hz] of position messages, 0 for none, and their noise [km per axis]."""

    rate_hz: float = 0.0
    noise_km: float = 0.0


@dataclass(frozen=True)
class TelemetryPlan:
    """Which channels are sent, at one rate [Hz], with the noise of each (in the channel's own unit)."""

    channels: tuple[Channel, ...] = ()
    rate_hz: float = 1.0
    noise: tuple[float, ...] = ()


@dataclass(frozen=True)
class Chance:
    """What is drawn from the seed: |b| uniform up to a limit [nT] in a random direction, each element of D uniform
    within plus and minus a limit, the spin's direction, and its phase."""

    bias_nt: float = 0.0
    D: float = 0.0
    phase: bool = False


@dataclass(frozen=True)
class Scenario:
    """One simulated craft with its sensor and link.

    Parameters
    ----------
    start_ns: UTC of elapsed time 0 [ns since 1970].
    duration_s: length [s].
    direction: where the spin axis points if not at ``spin.direction_eci``.
    """

    name: str
    description: str
    craft: str
    start_ns: int
    duration_s: float
    seed: int
    orbit: KeplerOrbit | Sgp4Orbit
    field: FieldModel
    spin: Spin
    sensor: Sensor
    direction: Direction | None = None
    reference: ReferencePlan = ReferencePlan()
    position: PositionPlan = PositionPlan()
    telemetry: TelemetryPlan = TelemetryPlan()
    effects: Effects = dataclass_field(default_factory=Effects)
    chance: Chance = Chance()
    faults: tuple[LinkFault, ...] = ()


def resolve(scenario: Scenario, seed: int) -> Scenario:
    """The scenario with everything random drawn from ``seed`` and the spin's direction as a vector.

    All numbers are drawn always, in one order, so that fixing one parameter leaves the others as they were.
    D is drawn again until I + D is clearly invertible (its eigenvalues above 0.3).
    """
    rng = generator(seed, Stream.PARAMETERS)
    bias = _direction(rng) * rng.uniform(0.0, 1.0) * scenario.chance.bias_nt
    towards = _direction(rng)
    phase = rng.uniform(0.0, math.tau)
    D = rng.uniform(-1.0, 1.0, 6) * scenario.chance.D
    while np.linalg.eigvalsh(np.eye(3) + symmetric(D))[0] < 0.3:
        D = rng.uniform(-1.0, 1.0, 6) * scenario.chance.D
    sensor, spin = scenario.sensor, scenario.spin
    if scenario.chance.bias_nt > 0.0:
        sensor = replace(sensor, bias_nt=_vector(bias))
    if scenario.chance.D > 0.0:
        d11, d22, d33, d12, d13, d23 = D.tolist()
        sensor = replace(sensor, D=(d11, d22, d33, d12, d13, d23))
    if scenario.chance.phase:
        spin = replace(spin, phase_rad=float(phase))
    if scenario.direction is Direction.RANDOM:
        spin = replace(spin, direction_eci=_vector(towards))
    elif scenario.direction is Direction.ORBIT_NORMAL:
        spin = replace(spin, direction_eci=_vector(scenario.orbit.normal_eci(scenario.start_ns)))
    return replace(scenario, seed=seed, sensor=sensor, spin=spin, direction=None, chance=Chance())


def _direction(rng: np.random.Generator) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    vector = rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def _vector(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> Vector:
    x, y, z = values.tolist()
    return x, y, z
