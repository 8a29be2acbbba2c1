"""A recording as the scene that effects look at: places, reference in inertial axes, telemetry, attitude."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from magcal_service.base.errors import ExtraMissingError, InputRefusedError
from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.earth import geomagnetic
from magcal_service.model import Array, calibrate, measure
from magcal_service.physics.scene.scene import Scene, Telemetry
from magcal_service.physics.scene.smooth import smooth_course
from magcal_service.physics.scene.sunlight import hold_over_nan
from magcal_service.recordings.channels import Axes, QuaternionOrder
from magcal_service.recordings.places import filled
from magcal_service.recordings.recording import Channel, Recording
from magcal_service.recordings.specs import PlatformKind
from magcal_service.recordings.table import FloatArray
from magcal_service.wire.messages import Clock, Frame

_HALF_HOUR_S: Final = 1800.0  # over which a reference is looked at; choice: a third of a low orbit
_LEAST_CHANGE: Final = 0.15
"""Of the field, what half an hour changes in orbit: a third of an orbit, over which a dipole's size changes by a fifth
and more.  An aircraft's changes by 3 % on 500 km."""

_LOW_ORBIT_NT: Final = (15e3, 68e3)
"""Field that a low orbit passes through [nT]: 17 uT in the South Atlantic at 800 km, 66 uT near the poles' surface."""

_FASTEST_NT_S: Final = 100.0
"""Change of the field's size from which on no way through it is smooth [nT/s]: in low orbit it is 40 at the most."""


def scene_of(recording: Recording) -> Scene:
    """The scene of a recording's rows (in time order), nothing calibrated yet."""
    origin_ns = int(recording.time_ns[0])
    reference = recording.reference
    position = recording.position
    ecef = None
    time_s = np.asarray((recording.time_ns - origin_ns) * 1e-9, dtype=np.float64)
    places = None if position is None else filled(time_s, position.km)
    if position is not None and places is not None:
        if position.frame is Frame.ECEF:
            ecef = places
        elif recording.clock is Clock.UTC:
            ecef = geomagnetic.ecef_from_eci(recording.time_ns, places)
    return Scene(
        time_s=time_s,
        origin_ns=origin_ns,
        utc=recording.clock is Clock.UTC,
        field_nt=recording.field_body_nt,
        calibrated_nt=recording.field_body_nt,
        clean_field_nt=recording.field_body_nt,
        magnitude_nt=reference.magnitude_nt,
        reference_eci_nt=_reference_eci(recording, ecef),
        position_ecef_km=ecef,
        in_orbit=is_in_orbit(recording, ecef),
        channels={
            name: telemetry(channel) for name, channel in recording.channels.items() if channel.spec.order is None
        },
    )


def is_in_orbit(recording: Recording, ecef: FloatArray | None) -> bool:
    """Whether a recording was made in orbit: as stated, else by its altitude, else by an inertial reference, or by one
    whose size changes as along an orbit.

    A coil may change so, too, if it is driven through the Earth's own range; where that is taken for an orbit, errors
    of a field model are counted that it has not, and currents in space are looked for: ``[platform]`` says better.
    """
    stated = recording.descriptor.platform
    if stated is not None:
        return stated.kind is PlatformKind.ORBIT
    if ecef is not None:
        return float(np.median(np.linalg.norm(ecef, axis=1))) - geomagnetic.EARTH_KM > geomagnetic.LOWEST_ORBIT_KM
    return _is_inertial(recording) or _changes_as_in_orbit(recording)


def is_orbit_guessed(recording: Recording, ecef: FloatArray | None) -> bool:
    """Whether a recording is taken for one in orbit by nothing but how its reference's size changes.

    Parameters
    ----------
    ecef: its places as its scene has them (n, 3) [km]; None where there are none, or where gaps could not be filled.
    """
    is_known = recording.descriptor.platform is not None or ecef is not None or _is_inertial(recording)
    return not is_known and _changes_as_in_orbit(recording)


def _is_inertial(recording: Recording) -> bool:
    return recording.reference.vector_nt is not None and recording.reference.frame is Frame.ECI


def _changes_as_in_orbit(recording: Recording) -> bool:
    """Whether the reference's size changes by more in half an hour than on any way through the air, and smoothly, as a
    coil's seldom does."""
    time_s = (recording.time_ns - recording.time_ns[0]) * 1e-9
    size = recording.reference.magnitude_nt
    rate = np.abs(np.diff(size)) / np.maximum(np.diff(time_s), 1e-9)
    if len(size) < 2 or float(np.max(rate)) > _FASTEST_NT_S:
        return False
    if not _LOW_ORBIT_NT[0] < float(size.min()) <= float(size.max()) < _LOW_ORBIT_NT[1]:
        return False
    parts = np.searchsorted(time_s, np.arange(0.0, float(time_s[-1]), _HALF_HOUR_S))
    changes = [float(np.ptp(part)) for part in np.split(size, parts[1:]) if len(part)]
    return max(changes) > _LEAST_CHANGE * float(np.mean(size))


def telemetry(channel: Channel) -> Telemetry:
    """A channel in its base unit, gaps filled, a temperature without the noise of its own sensor."""
    unit = CHANNEL_UNITS[channel.spec.unit]
    values = hold_over_nan(unit.to_base(channel.values))
    if unit.quantity == "temperature":
        values = np.stack([smooth_course(column) for column in values.T], axis=1)
    return Telemetry(channel.spec.name, unit.quantity, values)


def _reference_eci(recording: Recording, ecef: FloatArray | None) -> Array | None:
    """The reference in axes that do not turn (n, 3) [nT].

    Without a date their x axis is where the vernal equinox would be if the log's time were counted from 1970: how the
    Earth turns below the craft is known, where it began is not, and no effect of the turn asks.  A recorded inertial
    attitude does, so beside one there is none.
    """
    reference = recording.reference
    if reference.vector_nt is None or not np.isfinite(reference.vector_nt).all():
        return _model_direction(recording, ecef)
    if reference.frame is Frame.ECI:
        return reference.vector_nt
    if recording.clock is not Clock.UTC and _is_attitude_inertial(recording):
        return None
    if reference.frame is Frame.ECEF:
        return geomagnetic.eci_from_ecef(recording.time_ns, reference.vector_nt)
    if ecef is None:
        return None
    latitude, longitude, _ = geomagnetic.geodetic_from_ecef(ecef)
    fixed = geomagnetic.ecef_from_ned(latitude, longitude, reference.vector_nt)
    return geomagnetic.eci_from_ecef(recording.time_ns, fixed)


def _is_attitude_inertial(recording: Recording) -> bool:
    attitude = recorded_attitude(recording)
    return attitude is not None and attitude[0] is Axes.ECI


def _model_direction(recording: Recording, ecef: FloatArray | None) -> Array | None:
    """(n, 3) ECI [nT]: the recorded magnitude along the main field of the model, where place and time are known."""
    if ecef is None or recording.clock is not Clock.UTC:
        return None
    time_s = (recording.time_ns - recording.time_ns[0]) * 1e-9
    rows = np.unique(
        np.concatenate([np.flatnonzero(np.diff(np.floor(time_s / 10.0), prepend=-1.0)), [len(time_s) - 1]])
    )
    try:
        knots = geomagnetic.igrf_ecef_nt(recording.time_ns[rows], ecef[rows])
    except (InputRefusedError, ExtraMissingError):
        return None
    inertial = geomagnetic.eci_from_ecef(recording.time_ns[rows], knots)
    field = np.stack([np.interp(time_s, time_s[rows], column) for column in inertial.T], axis=1)
    size = np.linalg.norm(field, axis=1)
    return np.asarray(field * (recording.reference.magnitude_nt / size)[:, None])


def cleaned(scene: Scene, x: Array) -> Scene:
    """The scene with vectors calibrated by nine errors and brought to the known magnitude: no radial noise is left."""
    w = calibrate(x, scene.field_nt)
    length = np.linalg.norm(w, axis=1)
    clean = w * (scene.magnitude_nt / np.maximum(length, 1.0))[:, None]
    return replace(scene, calibrated_nt=clean, clean_field_nt=measure(x, clean))


def recorded_attitude(recording: Recording) -> tuple[Axes, Array] | None:
    """The axes that a recorded attitude refers the body to, and (n, 3, 3) body from those axes; None without one."""
    for channel in recording.channels.values():
        spec = channel.spec
        if spec.order is None or spec.from_axes is None or spec.to_axes is None:
            continue
        quaternion = hold_over_nan(channel.values)
        if spec.order is QuaternionOrder.XYZW:
            quaternion = quaternion[:, [3, 0, 1, 2]]
        to_from = _matrices(quaternion)  # turns vectors of ``from`` into ``to``
        if spec.to_axes is Axes.BODY:
            return spec.from_axes, to_from
        if spec.from_axes is Axes.BODY:
            return spec.to_axes, np.transpose(to_from, (0, 2, 1))
    return None


def _matrices(quaternion: Array) -> Array:
    """(n, 3, 3) rotation matrices of quaternions (n, 4), scalar first."""
    w, x, y, z = (quaternion / np.maximum(np.linalg.norm(quaternion, axis=1), 1e-12)[:, None]).T
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]
    rows += [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]
    rows += [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
    return np.stack(rows, axis=1).reshape(-1, 3, 3)
