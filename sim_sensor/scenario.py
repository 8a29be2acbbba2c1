"""A scenario: everything that decides what a simulated node sends, as frozen records read from TOML.

``resolve`` draws what the scenario leaves to chance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from magcal_service.base.typed_toml import Table, nearest
from magcal_service.base.typed_toml.keys import (
    choice,
    defaulted_section,
    flag,
    inline,
    number,
    sections,
    special,
    text,
    whole,
)
from magcal_service.base.typed_toml.record import Reading, read_record
from magcal_service.wire.fields import NAME
from magcal_service.wire.messages import Vector
from sim_sensor.attitude import Spin
from sim_sensor.beside import Beside
from sim_sensor.declarations import LONGEST_S, Z_AXIS, instant
from sim_sensor.faults import LinkFault, fault_sections
from sim_sensor.field import FieldModel
from sim_sensor.orbit import KeplerOrbit, Sgp4Orbit
from sim_sensor.orbit_section import orbit_section
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

    rate_hz: float = number(1.0, 0.001, 50.0, unit="Hz")
    offset_s: float = number(0.0, 0.0, 3600.0, unit="s")
    form: ReferenceForm = choice(ReferenceForm, ReferenceForm.VECTOR)
    noise_nt: float = number(0.0, 0.0, 1e5, unit="nT")


@dataclass(frozen=True)
class PositionPlan:
    """Rate [Hz] of position messages, 0 for none, and their noise [km per axis]."""

    rate_hz: float = number(0.0, 0.0, 50.0, unit="Hz")
    noise_km: float = number(0.0, 0.0, 100.0, unit="km")


def _channels(reading: Reading, name: str) -> tuple[Channel, ...]:
    """The channels that are named, in the order of ``Channel``."""
    known = [channel.value for channel in Channel]
    names = reading.table.texts(name) or ()
    for one in names:
        if one not in known:
            reading.table.refuse(name, one, nearest(one, known))
    return tuple(channel for channel in Channel if channel.value in names)


def _channel_noise(reading: Reading, _: str) -> tuple[float, ...]:
    """``temperature_noise`` and so on, of the channels that are sent; those of others may stand there as well."""
    keys = {channel: f"{channel.value}_noise" for channel in UNITS}
    noise = {channel: reading.table.real(key, 0.0, minimum=0.0, maximum=1e6) for channel, key in keys.items()}
    return tuple(noise[channel] for channel in reading.values["channels"])


@dataclass(frozen=True)
class TelemetryPlan:
    """Which channels are sent, at one rate [Hz], with the noise of each (in the channel's own unit)."""

    channels: tuple[Channel, ...] = special(_channels, ())
    rate_hz: float = number(1.0, 0.001, 50.0, unit="Hz")
    noise: tuple[float, ...] = special(_channel_noise, ())


@dataclass(frozen=True)
class Chance:
    """What is drawn from the seed: |b| uniform up to a limit [nT] in a random direction, each element of D uniform
    within plus and minus a limit, the spin's direction, and its phase."""

    bias_nt: float = number(0.0, 0.0, 1e5, unit="nT")
    D: float = number(0.0, 0.0, 0.5)
    phase: bool = flag(False)


_NAME = "1 to 32 characters of A-Z a-z 0-9 _ -"


def _check_craft(reading: Reading, name: str, craft: str) -> None:
    if not NAME.fullmatch(craft):
        reading.table.refuse(name, craft, f"{_NAME} are accepted")


def _spin(reading: Reading, name: str) -> Spin:
    """``[spin]``; its ``direction`` is a vector, or one of ``Direction``, which is kept as the scenario's own."""
    table = reading.table.table(name) or Table({}, reading.table.file, name, reading.table.faults)
    if isinstance(table.content.get("direction", ""), str):
        reading.values["direction"] = table.choice("direction", Direction, Direction.RANDOM)
        return read_record(table, Spin, {"direction_eci": Z_AXIS})
    return read_record(table, Spin)


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
    description: str = text(accepted="a paragraph on what the scenario shows")
    craft: str = text("sat", accepted=_NAME, check=_check_craft, file_only=True)
    start_ns: int = instant("2025-06-01T00:00:00Z", name="start")
    duration_s: float = number(18000.0, 1.0, LONGEST_S, unit="s", file_only=True)
    seed: int = whole(1, 0, 2**63 - 1, file_only=True)
    orbit: KeplerOrbit | Sgp4Orbit = special(orbit_section)
    field: FieldModel = defaulted_section(FieldModel, file_only=True)
    spin: Spin = special(_spin)
    sensor: Sensor = defaulted_section(Sensor, name="magnetometer", file_only=True)
    direction: Direction | None = None
    reference: ReferencePlan = defaulted_section(ReferencePlan)
    position: PositionPlan = defaulted_section(PositionPlan)
    telemetry: TelemetryPlan = defaulted_section(TelemetryPlan)
    effects: Effects = inline(Effects)
    chance: Chance = defaulted_section(Chance, name="random")
    beside: tuple[Beside, ...] = sections(Beside)
    faults: tuple[LinkFault, ...] = special(fault_sections, (), name="fault")


_LEAST_EIGENVALUE = 0.3
"""Of I + D drawn at random: three times what a scenario may state, so that steps leave it invertible."""


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
    while np.linalg.eigvalsh(np.eye(3) + symmetric(D))[0] < _LEAST_EIGENVALUE:
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
