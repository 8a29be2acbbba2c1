"""Causes that add to the sensor's field or scale by themselves: steps, drifts, tones, the Sun's heat."""

from __future__ import annotations

import math

import numpy as np

from tests.blind.cause import Cause, Telemetry, plain
from tests.blind.sensor import Spoiling
from tests.blind.vectors import Floats, random_direction, unit
from tests.blind.world import World


def bias_step(world: World, _recorded: bool) -> Cause:
    """Something becomes magnetic at one instant."""
    rng = world.streams.rng("bias_step")
    at_s = rng.uniform(0.12, 0.88) * world.duration_s
    step = random_direction(rng)
    after = (world.time_s >= at_s)[:, None]
    return Cause(
        name="bias_step",
        world=world,
        spoil=lambda scale: Spoiling(disturbance=lambda _tags, _body: scale * step * after),
        parameters=lambda scale: {"step_nt": plain(scale * step), "at_s": at_s},
        scale=200.0,
    )


def _on_and_off(world: World, at_s: Floats, step: Floats) -> Cause:
    """A field along ``step`` (3,) that comes at the first of the instants, goes at the second, and so on."""
    on = (np.searchsorted(at_s, world.time_s, side="right") % 2)[:, None]
    return Cause(
        name="bias_step",
        world=world,
        spoil=lambda scale: Spoiling(disturbance=lambda _tags, _body: scale * step * on),
        parameters=lambda scale: {"switched_nt": plain(scale * step), "at_s": plain(at_s)},
        scale=200.0,
    )


def switched(world: World, _recorded: bool) -> Cause:
    """A magnet near the sensor, or the current that makes one, comes on and goes again at instants of its own."""
    rng = world.streams.rng("switched")
    count = int(rng.integers(2, 7))
    at_s = _spread(rng, world, count)
    return _on_and_off(world, at_s, random_direction(rng))


def duty(world: World, _recorded: bool) -> Cause:
    """A heater's or a payload's current during two or three equally long intervals, one as far from the next."""
    rng = world.streams.rng("duty")
    intervals = int(rng.integers(2, 4))
    every_s = rng.uniform(0.8, 1.0) / (intervals + 0.5) * world.duration_s
    begin = rng.uniform(0.1, 0.4) * every_s + every_s * np.arange(intervals)
    at_s = np.sort(np.concatenate([begin, begin + rng.uniform(0.2, 0.5) * every_s]))
    return _on_and_off(world, at_s, random_direction(rng))


def steps(world: World, _recorded: bool) -> Cause:
    """Something becomes magnetic, another way, at each of several instants."""
    rng = world.streams.rng("steps")
    at_s = _spread(rng, world, int(rng.integers(2, 6)))
    amounts = np.array([random_direction(rng) * rng.uniform(0.6, 1.6) for _ in at_s])
    after = np.asarray(world.time_s[:, None] >= at_s, dtype=np.float64)
    return Cause(
        name="bias_step",
        world=world,
        spoil=lambda scale: Spoiling(disturbance=lambda _tags, _body: scale * after @ amounts),
        parameters=lambda scale: {"steps_nt": plain(scale * amounts), "at_s": plain(at_s)},
        scale=200.0,
    )


def _spread(rng: np.random.Generator, world: World, count: int) -> Floats:
    """Instants (count,), a twentieth of the recording from one another and from its ends at least."""
    free = np.sort(rng.uniform(0.0, 1.0, count))
    return (0.05 * (np.arange(count) + 1.0) + (1.0 - 0.05 * (count + 1)) * free) * world.duration_s


def scale_step(world: World, _recorded: bool) -> Cause:
    """The gain of one axis, or of all, changes at one instant: a range switch, a reset, an upset."""
    rng = world.streams.rng("scale_step")
    at_s = rng.uniform(0.12, 0.88) * world.duration_s
    step = _per_axis(rng)
    after = (world.time_s >= at_s)[:, None]
    return Cause(
        name="scale_step",
        world=world,
        spoil=lambda scale: Spoiling(scale_change=lambda _tags: scale * step * after),
        parameters=lambda scale: {"step": plain(scale * step), "at_s": at_s},
        scale=3e-3,
    )


def _per_axis(rng: np.random.Generator) -> Floats:
    """Relative amounts (3,): one axis alone, all alike, or each its own."""
    choice = rng.random()
    sign = float(rng.choice([-1.0, 1.0]))
    if choice < 0.4:
        return np.asarray(sign * np.eye(3)[rng.integers(3)], dtype=np.float64)
    return sign * np.ones(3) if choice < 0.6 else rng.uniform(-1.0, 1.0, 3)


def drift_shape(rng: np.random.Generator, time_s: Floats) -> tuple[Floats, dict[str, object]]:
    """A smooth course (n,) of about one over the recording, and what the answer says of it."""
    duration = float(time_s[-1])
    choice = rng.random()
    if choice < 0.5:
        return (time_s - time_s.mean()) / duration, {"shape": "linear"}
    if choice < 0.8:
        tau = rng.uniform(0.2, 0.8) * duration
        course = -np.exp(-time_s / tau)
        return course - course.mean(), {"shape": "relaxation", "tau_s": tau}
    course = np.sqrt(time_s / duration)
    return course - course.mean(), {"shape": "square root"}


def bias_drift(world: World, _recorded: bool) -> Cause:
    """The bias wanders off smoothly; its mean over the recording is the world's own."""
    rng = world.streams.rng("bias_drift")
    course, says = drift_shape(rng, world.time_s)
    direction = random_direction(rng)

    def parameters(scale: float) -> dict[str, object]:
        linear = {"nt_per_s": plain(scale * direction / world.duration_s)} if says["shape"] == "linear" else {}
        return says | linear | {"end_minus_start_nt": plain(scale * direction * (course[-1] - course[0]))}

    return Cause(
        name="bias_drift",
        world=world,
        spoil=lambda scale: Spoiling(disturbance=lambda _tags, _body: scale * direction * course[:, None]),
        parameters=parameters,
        scale=300.0,
    )


def scale_drift(world: World, _recorded: bool) -> Cause:
    """The scale wanders off smoothly; its mean over the recording is the world's own."""
    rng = world.streams.rng("scale_drift")
    course, says = drift_shape(rng, world.time_s)
    amounts = _per_axis(rng)

    def parameters(scale: float) -> dict[str, object]:
        linear = {"per_s": plain(scale * amounts / world.duration_s)} if says["shape"] == "linear" else {}
        return says | linear | {"end_minus_start": plain(scale * amounts * (course[-1] - course[0]))}

    return Cause(
        name="scale_drift",
        world=world,
        spoil=lambda scale: Spoiling(scale_change=lambda _tags: scale * amounts * course[:, None]),
        parameters=parameters,
        scale=5e-3,
    )


def apparent_hz(true_hz: float, sample_hz: float) -> float:
    """Frequency at which samples show a tone: the distance to the nearest multiple of the sampling rate [Hz]."""
    return abs(true_hz - round(true_hz / sample_hz) * sample_hz)


def draw_tone_hz(world: World, rng: np.random.Generator) -> float:
    """A true frequency, often far above sampling, that shows clear of zero, of the spin's lines and of Nyquist's."""
    sample_hz = 1.0 / world.period_s
    spin_hz = abs(world.motion.rate.start_rad_s) / math.tau
    clearance = 20.0 / world.duration_s
    while True:
        true = float(rng.choice([rng.uniform(0.01, 0.5), rng.uniform(1.0, 100.0), rng.uniform(100.0, 20000.0)]))
        shown = apparent_hz(true, sample_hz)
        lines = [apparent_hz(k * spin_hz, sample_hz) for k in range(5)]
        if min(abs(shown - line) for line in [*lines, sample_hz / 2.0]) > clearance:
            return true


def tone(world: World, _recorded: bool) -> Cause:
    """A converter, a wheel or a heater at one frequency, often aliased: along one line, or turning as a wheel does."""
    rng = world.streams.rng("tone")
    true_hz = draw_tone_hz(world, rng)
    phase = 2.0 * np.pi * (true_hz * world.time_s % 1.0) + rng.uniform(0.0, 2.0 * np.pi)
    main = random_direction(rng)
    across = unit(np.cross(main, random_direction(rng))) * (rng.uniform(0.3, 1.0) if rng.random() < 0.4 else 0.0)
    size = float(np.sqrt(1.0 + across @ across))
    field = (np.cos(phase)[:, None] * main + np.sin(phase)[:, None] * across) / size
    shown = apparent_hz(true_hz, 1.0 / world.period_s)
    return Cause(
        name="tone",
        world=world,
        spoil=lambda scale: Spoiling(disturbance=lambda _tags, _body: scale * field),
        parameters=lambda scale: {"frequency_hz": shown, "amplitude_nt": scale, "true_frequency_hz": true_hz},
        scale=100.0,
    )


def sun_disturbance(world: World, _recorded: bool) -> Cause:
    """Thermoelectric currents: sunlight warms one side, and joints of unlike metals carry current round the body.

    The difference of temperature between opposite sides is as the Sun's components in the body; the warmth that
    spreads behind the lit face is as their products.  In shadow both vanish.
    """
    rng = world.streams.rng("sun_disturbance")
    sun = world.sun_body(world.time_s)
    lit = world.sunlit(world.time_s)[:, None]
    joints = rng.normal(0.0, 1.0, (3, 3))
    products = np.stack([sun[:, 0] * sun[:, 1], sun[:, 0] * sun[:, 2], sun[:, 1] * sun[:, 2]], axis=-1)
    spread = rng.normal(0.0, 0.5, (3, 3)) * float(rng.random() < 0.6)
    field = (sun @ joints.T + products @ spread.T) * lit
    return Cause(
        name="sun_disturbance",
        world=world,
        spoil=lambda scale: Spoiling(disturbance=lambda _tags, _body: scale * field),
        parameters=lambda scale: {"nt_linear": plain(scale * joints), "nt_products": plain(scale * spread)},
        drivers=(sun_sensor(world),),
        scale=50.0,
        needs_place=True,
    )


def sun_sensor(world: World) -> Telemetry:
    """The Sun's direction in the body, to about half a degree; empty cells in shadow, or zeros."""
    rng = world.streams.rng("telemetry sun")
    noise = np.radians(rng.uniform(0.2, 1.0))
    measured = unit(world.sun_body(world.time_s) + rng.normal(0.0, noise, (len(world.time_s), 3)))
    dark = world.sunlit(world.time_s) < 0.5
    measured[dark] = 0.0 if rng.random() < 0.5 else np.nan
    return Telemetry("sun", measured, "", frame="body", decimals=4)
