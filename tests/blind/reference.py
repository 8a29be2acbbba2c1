"""Causes in the reference rather than in the sensor: clocks, places, old coefficients, currents above."""

from __future__ import annotations

import numpy as np

from tests.blind.cause import Cause
from tests.blind.field import FieldTrack, dipole_axis_eci, main_field_track, ring_current_field
from tests.blind.sensor import Spoiling
from tests.blind.vectors import Floats, OverTime, log_uniform
from tests.blind.world import MARGIN_S, World


def time_offset(world: World, _recorded: bool) -> Cause:
    """Two clocks: the field at the sensor's tag t is the reference's at t + offset + drift t."""
    rng = world.streams.rng("time_offset")
    sign = float(rng.choice([-1.0, 1.0]))
    drift = rng.normal(0.0, 60e-6) if rng.random() < 0.35 else 0.0  # of one second of offset

    def clock(scale: float) -> OverTime:
        return lambda tags: scale * (sign + drift * tags)

    return Cause(
        name="time_offset",
        world=world,
        spoil=lambda scale: Spoiling(clock_s=clock(scale)),
        parameters=lambda scale: {"offset_s": scale * sign, "drift_ppm": 1e6 * scale * drift},
        largest_scale=0.25 * MARGIN_S,
        needs_place=True,
    )


def position_offset(world: World, _recorded: bool) -> Cause:
    """The craft is elsewhere: its place is the recorded one plus radial, along-track and cross-track kilometres.

    Along track the distance may grow, as with elements that become stale.
    """
    rng = world.streams.rng("position_offset")
    if rng.random() < 0.5:
        amounts = np.zeros(3)
        amounts[rng.integers(3)] = rng.choice([-1.0, 1.0])
    else:
        amounts = rng.normal(0.0, 1.0, 3)
    growth = rng.normal(0.0, 1e-4) if rng.random() < 0.3 else 0.0

    def track(scale: float) -> FieldTrack:
        def place(times: Floats) -> Floats:
            radial, along, across = world.orbit.axes(times)
            forward = (amounts[1] + growth * times)[:, None] * along
            offset = amounts[0] * radial + forward + amounts[2] * across
            return np.asarray(world.orbit.position_km(times) + scale * offset, dtype=np.float64)

        return main_field_track(place, world.start_unix_s, world.span_s)

    return Cause(
        name="position_offset",
        world=world,
        spoil=lambda scale: Spoiling(field_eci=track(scale)),
        parameters=lambda scale: {
            "radial_km": scale * amounts[0],
            "along_km": scale * amounts[1],
            "cross_km": scale * amounts[2],
            "along_km_per_s": scale * growth,
        },
        scale=5.0,
        largest_scale=100.0,
        needs_place=True,
    )


def reference_epoch(world: World, _recorded: bool) -> Cause:
    """The reference comes from old coefficients, or from an expansion that was cut short."""
    rng = world.streams.rng("reference_epoch")
    if rng.random() < 0.75:
        return Cause(
            name="reference_epoch",
            world=world,
            spoil=lambda scale: Spoiling(reference_eci=_old_field(world, scale)),
            parameters=lambda scale: {"years": scale},
            scale=3.0,
            largest_scale=25.0,
            needs_place=True,
        )
    degree = int(rng.integers(6, 11))
    cut = main_field_track(world.orbit.position_km, world.start_unix_s, world.span_s, max_degree=degree)
    missing = FieldTrack(cut.start_s, cut.values_nt - world.main_field.values_nt)

    def spoil(scale: float) -> Spoiling:
        if scale == 0.0:
            return Spoiling()
        return Spoiling(reference_eci=lambda times: world.field_eci(times) + missing(times))

    return Cause(
        name="reference_epoch",
        world=world,
        spoil=spoil,
        parameters=lambda scale: {"max_degree": degree if scale else 13},
        fixed=True,
        needs_place=True,
    )


def _old_field(world: World, years: float) -> FieldTrack:
    return main_field_track(world.orbit.position_km, world.start_unix_s, world.span_s, years_old=years)


def dst_profile(rng: np.random.Generator, duration_s: float) -> OverTime:
    """A storm's ring current over time with a largest size of about one: main phase, then recovery.

    The recording begins somewhere in the storm, with its strongest moment inside or shortly before it.
    """
    peak = rng.uniform(-0.3, 0.9) * duration_s
    onset = peak - log_uniform(rng, 3600.0, 6.0 * 3600.0)
    decay = log_uniform(rng, 2.0 * 3600.0, 12.0 * 3600.0)
    quiet = rng.uniform(0.0, 0.15)

    def profile(times: Floats) -> Floats:
        rise = np.clip((times - onset) / (peak - onset), 0.0, 1.0)
        main = np.sin(0.5 * np.pi * rise) ** 2
        return np.asarray(quiet + (1.0 - quiet) * np.where(times < peak, main, np.exp(-(times - peak) / decay)))

    return profile


def external_field(world: World, _recorded: bool) -> Cause:
    """A ring current: uniform along the dipole's axis, with the field that it induces in the Earth."""
    rng = world.streams.rng("external_field")
    profile = dst_profile(rng, world.duration_s)
    largest = float(profile(world.time_s).max())

    def spoil(scale: float) -> Spoiling:
        def field(times: Floats) -> Floats:
            axis = dipole_axis_eci(world.start_unix_s, times)
            return ring_current_field(-scale * profile(times), axis, world.orbit.position_km(times))

        return Spoiling(extra_eci=field)

    return Cause(
        name="external_field",
        world=world,
        spoil=spoil,
        parameters=lambda scale: {"peak_nt": -scale * largest},
        scale=100.0,
        largest_scale=800.0,
        needs_place=True,
    )
