"""Disturbances that no catalogue has: each is to be answered ``unknown``."""

from __future__ import annotations

import numpy as np

from magcal_service.earth import geomagnetic
from tests.blind.cause import Cause, plain
from tests.blind.field import times_ns
from tests.blind.noise import remembering
from tests.blind.sensor import Spoiling
from tests.blind.vectors import Floats, dot, log_uniform, random_direction, unit
from tests.blind.world import World


def _additive(name: str, world: World, field: Floats, says: dict[str, object]) -> Cause:
    """A cause whose field in the body is known over time; scale 1 is an rms of 1 nT."""
    field = field / np.sqrt(dot(field, field).mean())
    return Cause(
        name=name,
        world=world,
        spoil=lambda scale: Spoiling(disturbance=lambda _tags, _body: scale * field),
        parameters=lambda scale: {"rms_nt": scale, **says},
        scale=100.0,
    )


def field_product(world: World, _recorded: bool) -> Cause:
    """One axis picks up the product of two components of the field, as two stray windings in series would."""
    rng = world.streams.rng("field_product")
    axis, first, second = rng.permutation(3)
    if rng.random() < 0.5:
        first = axis

    def curve(scale: float, field: Floats) -> Floats:
        result = np.zeros_like(field)
        result[:, axis] = scale * field[:, first] * field[:, second]
        return result

    return Cause(
        name="field_product",
        world=world,
        spoil=lambda scale: Spoiling(nonlinear=lambda field: curve(scale, field)),
        parameters=lambda scale: {"per_nt": scale, "axis": int(axis), "factors": [int(first), int(second)]},
        scale=1e-7,
    )


def telegraph(world: World, _recorded: bool) -> Cause:
    """A nearby magnet flips between two states at random instants."""
    rng = world.streams.rng("telegraph")
    dwell = log_uniform(rng, 60.0, 500.0)
    flips = np.cumsum(rng.exponential(dwell, round(4.0 * world.duration_s / dwell) + 20))
    state = 1.0 - 2.0 * (np.searchsorted(flips, world.time_s) % 2)
    return _additive("telegraph", world, state[:, None] * random_direction(rng), {"mean_dwell_s": dwell})


def bursts(world: World, _recorded: bool) -> Cause:
    """Something fires at irregular times, with irregular force, and dies away."""
    rng = world.streams.rng("bursts")
    starts = np.sort(rng.uniform(0.0, world.duration_s, int(rng.integers(15, 45))))
    decays = np.exp(rng.uniform(np.log(10.0), np.log(120.0), len(starts)))
    sizes = rng.exponential(1.0, len(starts)) * rng.choice([-1.0, 1.0], len(starts))
    course = np.zeros_like(world.time_s)
    for start, decay, size in zip(starts, decays, sizes, strict=True):
        since = np.maximum(world.time_s - start, 0.0)
        course += np.where(world.time_s >= start, size * np.exp(-since / decay), 0.0)
    return _additive("bursts", world, course[:, None] * random_direction(rng), {"bursts": len(starts)})


def pendulum(world: World, _recorded: bool) -> Cause:
    """A loose magnetic part swings at its own frequency, knocked at random and damped: its amplitude wanders."""
    rng = world.streams.rng("pendulum")
    swing_hz = log_uniform(rng, 0.01, 0.3 / world.period_s)
    damping_s = log_uniform(rng, 100.0, 500.0)
    step = np.exp(complex(-1.0 / damping_s, 2.0 * np.pi * swing_hz) * world.period_s)
    kicks = rng.normal(0.0, 1.0, (len(world.time_s), 2)) @ np.array([1.0, 1.0j])
    state, course = 0j, []
    for kick in kicks.tolist():
        state = step * state + kick
        course.append(state)
    angle = np.array(course) / np.std(course)
    # a tilted dipole: to first order across its rest direction, to second order along it
    rest, across = random_direction(rng), random_direction(rng)
    tilt = 0.4 * angle.real
    field = np.sin(tilt)[:, None] * across + (np.cos(tilt) - 1.0)[:, None] * rest
    return _additive("pendulum", world, field, {"swing_hz": swing_hz, "damping_s": damping_s})


def chirp(world: World, _recorded: bool) -> Cause:
    """A wheel's unbalanced magnet while the wheel's speed sweeps up and down."""
    rng = world.streams.rng("chirp")
    nyquist = 0.5 / world.period_s
    low, high = np.sort(rng.uniform(0.05, 0.9, 2)) * nyquist
    high = max(high, low + 0.15 * nyquist)
    sweep_s = rng.uniform(0.3, 1.2) * world.duration_s
    sweep = 0.5 - 0.5 * np.cos(2.0 * np.pi * world.time_s / sweep_s + rng.uniform(0.0, 2.0 * np.pi))
    phase = 2.0 * np.pi * world.period_s * np.cumsum(low + (high - low) * sweep)
    first, second = random_direction(rng), random_direction(rng)
    field = np.cos(phase)[:, None] * first + np.sin(phase)[:, None] * second
    return _additive("chirp", world, field, {"band_hz": [float(low), float(high)], "sweep_s": sweep_s})


def patch(world: World, _recorded: bool) -> Cause:
    """A magnetised region of the ground below the path: a cluster of buried dipoles that turn with the Earth."""
    rng = world.streams.rng("patch")
    passing = np.array([rng.uniform(0.1, 0.9) * world.duration_s])
    utc = times_ns(world.start_unix_s, passing)
    centre = unit(geomagnetic.ecef_from_eci(utc, world.orbit.position_km(passing)))[0]
    places = 6271.0 * unit(centre + rng.normal(0.0, 0.08, (12, 3)))
    moments = random_direction(rng) + rng.normal(0.0, 0.4, (12, 3))

    def field_eci(times: Floats) -> Floats:
        utc = times_ns(world.start_unix_s, times)
        craft = geomagnetic.ecef_from_eci(utc, world.orbit.position_km(times))
        total = np.zeros_like(craft)
        for place, moment in zip(places, moments, strict=True):
            distance = np.linalg.norm(craft - place, axis=1, keepdims=True)
            towards = (craft - place) / distance
            total += (500.0 / distance) ** 3 * (3.0 * (towards @ moment)[:, None] * towards - moment)
        return geomagnetic.eci_from_ecef(utc, total)

    return Cause(
        name="patch",
        world=world,
        spoil=lambda scale: Spoiling(extra_eci=lambda times: scale * field_eci(times)),
        parameters=lambda scale: {"size_nt": scale, "centre_ecef": plain(centre)},
        scale=100.0,
        needs_place=True,
    )


def walk(world: World, _recorded: bool) -> Cause:
    """The bias wanders at random and is drawn back: an Ornstein-Uhlenbeck process in each axis."""
    rng = world.streams.rng("walk")
    memory_s = log_uniform(rng, 300.0, 2000.0)
    keep = float(np.exp(-world.period_s / memory_s))
    kicks = rng.normal(0.0, 1.0, (len(world.time_s) + 1, 3))
    course = remembering(kicks[1:], keep, kicks[0])
    return _additive("walk", world, course * rng.uniform(0.3, 1.0, 3), {"memory_s": memory_s})


def thermostat(world: World, _recorded: bool) -> Cause:
    """A heater that nobody records, switched by a thermostat whose thresholds wander: an irregular limit cycle."""
    rng = world.streams.rng("thermostat")
    tau = log_uniform(rng, 150.0, 600.0)
    warm, band = rng.uniform(4.0, 8.0), rng.uniform(0.8, 2.0)
    level, temperature, on = rng.uniform(0.3, 0.7) * warm, 0.0, True
    drive, threshold, course = 0.0, level + band / 2.0, []
    knocks = rng.normal(0.0, 1.0, (len(world.time_s), 2)).tolist()
    keep = float(np.exp(-world.period_s / 250.0))
    for knock, jitter in knocks:
        drive = keep * drive + np.sqrt(1.0 - keep**2) * 0.12 * warm * knock  # what else warms and cools the part
        temperature += world.period_s / tau * ((warm if on else 0.0) + drive - temperature)
        if (temperature > threshold) if on else (temperature < threshold):
            on = not on
            side = 1.0 if on else -1.0
            threshold = level + side * band / 2.0 * (1.0 + 0.4 * jitter)
        course.append(float(on))
    switched = np.array(course)
    return _additive("thermostat", world, switched[:, None] * random_direction(rng), {"share_on": switched.mean()})
