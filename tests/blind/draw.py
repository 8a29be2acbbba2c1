"""A case from its seed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from magcal_service.earth import geomagnetic
from tests.blind.attitude import RPM
from tests.blind.case import Answer, Case, EffectTruth, Verdict
from tests.blind.catalogue import ABSORBED, BUILDERS, DRIVEN, DRIVEN_OUTSIDE, EFFECTS, OUTSIDE, PAIRS, SEVERAL
from tests.blind.cause import Cause, Telemetry
from tests.blind.decoys import draw_decoys
from tests.blind.field import times_ns
from tests.blind.orbit import EQUATOR_KM
from tests.blind.sensor import measure
from tests.blind.streams import Streams
from tests.blind.strength import Tuned, tune, without
from tests.blind.vectors import Floats
from tests.blind.world import World, draw_world

STRENGTHS = (0.1, 2.0)
INVISIBLE = (0.0, 2.0)
ATTEMPTS = 200
Span = tuple[float, float]


def draw_case(
    seed: int,
    kind: str,
    *,
    driver_recorded: bool = True,
    detectability: Span = (12.0, math.inf),
    strengths: Span = STRENGTHS,
) -> Case:
    """Draw one concealed case; the same arguments give the same numbers.

    Parameters
    ----------
    seed: 0 or more.
    kind: an effect of the catalogue, or one that happens more than once (``SEVERAL``), ``"pair"`` or
        ``"tone+bias_step"``, ``"none"``, ``"absorbed"`` (an effect that the calibration takes up whole, detectability
        below 2), ``"outside"`` or ``"outside:walk"``; see ``KINDS``.
    driver_recorded: whether the channels that drive an effect are in the recording.
    detectability: range of every effect's detectability; in a pair it is taken beside the other effect.
    strengths: range of every effect's rms [sigma], wherever it has one to choose.

    Worlds are drawn until one allows the effect within both ranges (a craft that never sees the shadow has no thermal
    cycle to speak of); ``Answer.attempt`` says how many were passed over.  Raises ValueError for an unknown kind, and
    where 200 worlds allow none.
    """
    names, verdict = _names(seed, kind)
    if not names:
        return _assemble(seed, kind, draw_world(Streams(seed, kind)), (), verdict, driver_recorded=driver_recorded)
    detectability = INVISIBLE if verdict == "none" else detectability
    for attempt in range(ATTEMPTS):
        world = draw_world(Streams(seed, kind, attempt))
        tuned = _tuned(world, names, strengths, detectability, driver_recorded=driver_recorded)
        if tuned:
            return _assemble(seed, kind, tuned[0].cause.world, tuned, verdict, driver_recorded=driver_recorded)
    raise ValueError(f"{kind}, seed {seed}: none of {ATTEMPTS} worlds has strength {strengths} at {detectability}")


def _names(seed: int, kind: str) -> tuple[tuple[str, ...], Verdict]:
    """The causes of a kind and what a diagnosis ought to say of it."""
    rng = Streams(seed, kind).rng("kind")
    if kind == "none":
        return (), "none"
    if kind == "pair":
        return PAIRS[rng.integers(len(PAIRS))], "named"
    if kind == "absorbed":
        return (str(rng.choice(sorted(ABSORBED))),), "none"
    if kind == "outside":
        return (str(rng.choice(sorted(OUTSIDE))),), "unknown"
    outer, _, name = kind.partition(":")
    if outer == "outside" and name in {*OUTSIDE, *DRIVEN_OUTSIDE}:
        return (name,), "unknown"
    names = tuple(kind.split("+"))
    if 1 <= len(names) <= 2 and all(name in EFFECTS or name in SEVERAL for name in names):
        return names, "named"
    raise ValueError(f"{kind!r}: an effect, two joined by '+', 'pair', 'none', 'absorbed', 'outside' or 'outside:NAME'")


def _tuned(
    world: World, names: Sequence[str], strengths: Span, detectability: Span, *, driver_recorded: bool
) -> tuple[Tuned, ...]:
    """Every cause at its strength in one world; nothing where this world does not allow one of them."""
    found: list[Tuned] = []
    # those that change the world itself are made first, so that the others act in the changed one
    for name in sorted(names, key=lambda name: name not in {"response_lag", "axis_skew"}):
        cause = BUILDERS[name](world, driver_recorded)
        world = cause.world
        tuned = tune(cause, world.streams.rng(f"strength {name}"), strengths, detectability)
        if tuned is None:
            return ()
        found.append(tuned)
    if len(found) == 2 and min(_beside(found)) < detectability[0]:
        return ()
    return tuple(replace(tuned, cause=replace(tuned.cause, world=world)) for tuned in found)


def _beside(found: Sequence[Tuned]) -> list[float]:
    """Detectability of each of two effects when the other's signature is projected out as well."""
    result = []
    for one, other in ((found[0], found[1]), (found[1], found[0])):
        direction = other.signature / max(float(np.linalg.norm(other.signature)), 1e-12)
        result.append(float(np.linalg.norm(without(direction[:, None], one.signature))))
    return result


def _assemble(
    seed: int, kind: str, world: World, tuned: tuple[Tuned, ...], verdict: Verdict, *, driver_recorded: bool
) -> Case:
    causes = [found.cause for found in tuned]
    rng = world.streams.rng("recording")
    noise = world.streams.rng("noise").normal(0.0, world.noise_nt, (len(world.time_s), 3))
    for found in tuned:
        if found.cause.noise is not None:
            noise = found.cause.noise(found.scale, noise)
    measured = measure(world, [found.cause.spoil(found.scale) for found in tuned], noise)
    drivers = [channel for cause in causes for channel in cause.drivers if driver_recorded]
    decoys = draw_decoys(world, [cause.name for cause in causes])
    channels = _rounded([*drivers, *decoys])
    order = world.streams.rng("order").permutation(len(channels))
    needs_place = any(cause.needs_place for cause in causes)
    form = _reference_form(rng)
    placed = needs_place or form == "ned" or rng.random() < 0.8
    timed = needs_place or rng.random() < 0.85
    cartesian = form != "ned" and rng.random() < 0.12
    place = _place(world, cartesian=cartesian)
    reference = _reference(world, measured.reference_nt, form)
    axis, rpm = _stated_spin(world, causes, rng)
    return Case(
        time_s=world.time_s,
        start_unix_s=world.start_unix_s if timed else None,
        field_nt=np.round(measured.field_nt, 2),
        reference_nt=np.round(reference, 2),
        reference_frame=form,
        position=place if placed else None,
        position_form=("ecef" if cartesian else "geodetic") if placed else None,
        channels=tuple(channels[index] for index in order),
        spin_axis=axis,
        spin_rpm=rpm,
        stated_noise_nt=round(world.noise_nt, 1) if rng.random() < 0.7 else None,
        answer=_answer(seed, kind, world, tuned, verdict, decoys, driver_recorded=driver_recorded),
    )


def _rounded(channels: Sequence[Telemetry]) -> list[Telemetry]:
    """Channels as they are written."""
    return [replace(channel, values=np.round(channel.values, channel.decimals)) for channel in channels]


def _reference_form(rng: np.random.Generator) -> Literal["eci", "ned"] | None:
    choice = rng.random()
    if choice < 0.72:
        return "eci"
    return "ned" if choice < 0.88 else None


def _place(world: World, *, cartesian: bool) -> Floats:
    """Where the craft is said to be: ECEF to a metre, or geodetic to 1e-5 deg and a metre."""
    utc = times_ns(world.start_unix_s, world.time_s)
    ecef = geomagnetic.ecef_from_eci(utc, world.orbit.position_km(world.time_s))
    if cartesian:
        return np.round(ecef, 3)
    latitude, longitude, altitude = geomagnetic.geodetic_from_ecef(ecef)
    return np.stack([np.round(latitude, 5), np.round(longitude, 5), np.round(altitude, 3)], axis=-1)


def _reference(world: World, eci_nt: Floats, form: Literal["eci", "ned"] | None) -> Floats:
    if form is None:
        return np.asarray(np.linalg.norm(eci_nt, axis=1), dtype=np.float64)
    if form == "eci":
        return eci_nt
    latitude, longitude, _ = _place(world, cartesian=False).T
    ecef = geomagnetic.ecef_from_eci(times_ns(world.start_unix_s, world.time_s), eci_nt)
    return geomagnetic.ned_from_ecef(latitude, longitude, ecef)


def _stated_spin(
    world: World, causes: Sequence[Cause], rng: np.random.Generator
) -> tuple[tuple[float, ...] | None, float | None]:
    """Axis and rate of the descriptor: mostly given, and true unless a cause is about them."""
    stated = rng.random() < 0.85
    axis = tuple(float(x) for x in np.round(world.motion.axis_body, 6))
    rate: float | None = round(world.motion.rate.start_rad_s / RPM, 6)
    for cause in causes:
        if cause.needs_spin:
            return axis, cause.stated_rpm if cause.stated_rpm is not None else rate
    if any("spin_rate" in cause.also for cause in causes):
        rate = None
    return (axis, rate) if stated else (None, None)


def _answer(
    seed: int,
    kind: str,
    world: World,
    tuned: tuple[Tuned, ...],
    verdict: Verdict,
    decoys: Sequence[Telemetry],
    *,
    driver_recorded: bool,
) -> Answer:
    motion = world.motion
    for found in tuned:
        motion = found.cause.spoil(found.scale).motion or motion
    return Answer(
        seed=seed,
        kind=kind,
        attempt=world.streams.attempt,
        verdict=verdict,
        effects=_truths(tuned, driver_recorded=driver_recorded),
        also=tuple(sorted({name for found in tuned for name in found.cause.also})),
        driver_recorded=driver_recorded and any(found.cause.name in DRIVEN for found in tuned),
        decoys=tuple(channel.name for channel in decoys),
        noise_nt=world.noise_nt,
        bias_nt=tuple(world.bias_nt.tolist()),
        scale=tuple(map(tuple, world.scale.tolist())),
        spin_rpm=motion.rate.start_rad_s / RPM,
        spin_axis=tuple(motion.axis_body.tolist()),
        orbit=_orbit(world),
    )


def _truths(tuned: Sequence[Tuned], *, driver_recorded: bool) -> tuple[EffectTruth, ...]:
    joint = _beside(tuned) if len(tuned) == 2 else [found.detectability for found in tuned]
    return tuple(
        EffectTruth(
            effect=found.cause.name,
            parameters=found.cause.parameters(found.scale),
            driver=tuple(channel.name for channel in found.cause.drivers) if driver_recorded else (),
            scalar=found.cause.scalar,
            strength=found.strength,
            detectability=beside,
            alone=found.detectability,
        )
        for found, beside in zip(tuned, joint, strict=True)
    )


def _orbit(world: World) -> dict[str, float]:
    orbit = world.orbit
    low, high = (orbit.semi_major_km * (1.0 + sign * orbit.eccentricity) - EQUATOR_KM for sign in (-1.0, 1.0))
    return {
        "perigee_km": low,
        "apogee_km": high,
        "inclination_deg": math.degrees(orbit.inclination_rad),
        "lit_share": float(world.sunlit(world.time_s).mean()),
    }
