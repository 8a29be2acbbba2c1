"""The reference was computed at the wrong place: stale orbit elements, a wrong altitude."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from magcal_service.earth import geomagnetic
from magcal_service.earth.geomagnetic import Places
from magcal_service.earth.igrf14 import RADIUS_KM
from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn, Watched
from magcal_service.physics.columns import Columns
from magcal_service.physics.drivers.far import shifted, within
from magcal_service.physics.interface import Block, Effect, Hypothesis
from magcal_service.physics.scene.scene import Scene

_STEP_KM = 10.0
"""Step of the differences [km]: |H| bends over thousands of km, and rounding of the model is far below."""

_PLANE_BESIDE = 2.0
"""Nats against places that are off to one side alone: the plane of no orbit passes beside the Earth's centre.  Choice:
odds of 7 to 1; elements that are wrong in all put a short arc there."""

_LARGEST_NT = 3000.0  # of a place that is wrong by about 100 km


def gradients(scene: Scene) -> dict[str, Array]:
    """d|H| (n,) [nT/km] for a craft further out, along its track, and to the left of it, by central differences; speed
    along the track (n,) [km/s]."""
    rows = scene.knots
    assert scene.position_ecef_km is not None
    position = scene.position_ecef_km[rows]
    inertial = geomagnetic.eci_from_ecef(scene.time_ns[rows], position)
    time_s = scene.time_s[rows]
    velocity = np.gradient(inertial, time_s, axis=0) if len(rows) > 2 else np.zeros_like(inertial)
    up = inertial / np.linalg.norm(inertial, axis=1)[:, None]
    normal = np.cross(up, velocity)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
    found = {}
    for name, direction in (("radial", up), ("along", np.cross(normal, up)), ("cross", normal)):
        step = geomagnetic.ecef_from_eci(scene.time_ns[rows], _STEP_KM * direction)
        further, nearer = (scene.model_magnitude(Places(position + way * step)) for way in (1.0, -1.0))
        found[name] = scene.from_knots((further - nearer) / (2.0 * _STEP_KM))
    found["speed"] = scene.from_knots(np.linalg.norm(velocity, axis=1))
    return found


def _as_geocentric(scene: Scene) -> Array:
    """(n,) growth of |H| [nT] over that at the place whose geocentric latitude and height are the geodetic ones."""
    rows = scene.knots
    assert scene.position_ecef_km is not None
    position = scene.position_ecef_km[rows]
    latitude_deg, longitude_deg, height_km = geomagnetic.geodetic_from_ecef(position)
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    unit = [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)]
    read = (RADIUS_KM + height_km)[:, None] * np.stack(unit, axis=1)
    return np.asarray(scene.from_knots(scene.model_magnitude() - scene.model_magnitude(Places(read))))


def _there(scene: Scene, gradient: dict[str, Array]) -> dict[str, Array]:
    """The gradients where a fit has moved the reference to: halfway for what moves along the track itself."""
    if scene.moved_s is None:
        return gradient
    moved_s = within(scene.moved_s)
    return {
        name: gradient[name] + part * scene.smooth_slope(gradient[name]) * moved_s
        for name, part in (("radial", 1.0), ("along", 0.5), ("cross", 1.0))
    }


def _along_km(names: tuple[str, ...], amplitudes: Array, hours: Array) -> Array:
    """How far ahead amplitudes (k,) of these names place the craft (n,) [km]."""
    powers = {"along_km": 0, "along_km_per_h": 1, "along_km_per_h2": 2}
    found = np.zeros(len(hours))
    for name, size in zip(names, amplitudes.tolist(), strict=True):
        if name in powers:
            found += size * hours ** powers[name]
    return found


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    if not scene.has_model:
        if scene.position_ecef_km is not None:
            radius = np.linalg.norm(scene.position_ecef_km, axis=1)
            column = (-3.0 * scene.magnitude_nt / radius)[None]
            block = Block("radial_km", "km", ())
            yield Hypothesis("position_offset", "none", lambda _: Columns(magnitude=column), (block,), "radial, dipole")
        return
    yield Hypothesis(
        "position_offset",
        "none",
        lambda _: Columns(magnitude=scene.once("geocentric", lambda: _as_geocentric(scene))[None]),
        (Block("geocentric_share", "1", ()),),
        "geodetic as geocentric",
        largest_nt=_LARGEST_NT,
        is_whole=True,
    )
    known = scene.once("gradients", lambda: gradients(scene))
    gradient, speed_km_s = _there(scene, known), np.maximum(known["speed"], 1e-3)
    hours = scene.time_s / 3600.0

    def of(*columns: Array) -> Columns:
        return Columns(magnitude=np.stack(columns))

    radial, along, cross = gradient["radial"], gradient["along"], gradient["cross"]
    forms = {
        "radial": ((radial,), ("radial_km",)),
        "along": ((along,), ("along_km",)),
        "cross": ((cross,), ("cross_km",)),
        "radial and along": ((radial, along), ("radial_km", "along_km")),
        "three axes": ((radial, along, cross), ("radial_km", "along_km", "cross_km")),
        "along, growing": ((along, along * hours), ("along_km", "along_km_per_h")),
        "along, growing faster": (
            (along, along * hours, along * hours**2),
            ("along_km", "along_km_per_h", "along_km_per_h2"),
        ),
        "three axes, growing along": (
            (radial, along, cross, along * hours),
            ("radial_km", "along_km", "cross_km", "along_km_per_h"),
        ),
    }
    for variant, (columns, names) in forms.items():
        made = of(*columns)
        blocks = tuple(Block(name, name.partition("_")[2].replace("_per_", "/"), ()) for name in names)
        yield Hypothesis(
            "position_offset",
            "none",
            lambda _, made=made: made,  # type: ignore[misc]
            blocks,
            variant,
            odds=_PLANE_BESIDE if variant == "cross" else 0.0,
            largest_nt=_LARGEST_NT,
            moves_s=lambda a, names=names: _along_km(names, a, hours) / speed_km_s,  # type: ignore[misc]
        )
    yield from shifted(scene, "position_offset", "far along", ("ahead_s", "ahead_s_per_h"), with_earth=False)


EFFECT = Effect(
    name="position_offset",
    acts_on=ActsOn.REFERENCE,
    not_live=("far along",),
    watched=((Watched.SLOPE, ""),),
    title="the reference was computed at the wrong place",
    equation="H_ref at r + dr: |A H| = |H_ref| + grad|H| . dr, dr radial, along the track and across it",
    units={
        "radial_km": "km",
        "along_km": "km",
        "cross_km": "km",
        "along_km_per_h": "km/h",
        "along_km_per_h2": "km/h2",
        "ahead_s": "s",
        "ahead_s_per_h": "s/h",
        "share": "1",
        "geocentric_share": "1",
    },
    in_orbit_only=True,
    prior=(10.0, 30000.0),
    valid="to first order, along the track to second: below about 100 km; far along the orbit, up to 20 minutes",
    confused_with=("time_offset", "reference_epoch", "external_field"),
    separated_by="newer orbit elements or a GNSS fix: along the track a wrong place and a wrong clock are nearly one",
    source="at most 25 nT/km radial, 5.5 nT/km along (IGRF at 500 km); Vallado 2013, section 9 (along-track error)",
    says=(
        "The reference was computed at the wrong place: the craft is {radial_km:further out|further in}, "
        "{along_km:ahead|behind} at the start, moving by {along_km_per_h:forwards|backwards}, "
        "{cross_km:to the left|to the right}.",
        "The reference was computed at the wrong place: after t hours the craft is {along_km.signed}, "
        "{along_km_per_h.signed} times t and {along_km_per_h2.signed} times t squared ahead.",
        "The reference was computed at the wrong place: the craft is {radial_km:further out|further in}, "
        "{along_km:ahead|behind}, {cross_km:to the left|to the right}.",
        "The reference was computed at the wrong place: the craft is {radial_km:further out|further in} and "
        "{along_km:ahead|behind}.",
        "The reference was computed at the wrong place: the craft is {along_km:ahead|behind} at the start, moving "
        "by {along_km_per_h:forwards|backwards}.",
        "The reference was computed at the wrong place: the craft is {radial_km:further out|further in}.",
        "The reference was computed at the wrong place: the craft is {along_km:ahead|behind}.",
        "The reference was computed at the wrong place: the craft is {cross_km:to the left|to the right} of it.",
        "The reference's places were read wrongly, geodetic latitude and height as geocentric: {geocentric_share.size} "
        "of what that does is there.",
        "The reference was computed at the wrong place: the craft is {ahead_s:ahead|behind} on its orbit at the "
        "start, moving by {ahead_s_per_h:forwards|backwards}.",
    ),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
)
