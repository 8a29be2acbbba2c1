"""A recording that goes on, as nobody has flown it yet: as long again, as it was or with the craft turned otherwise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.earth import geomagnetic
from magcal_service.model import Array, measure
from magcal_service.physics.scene.scene import Scene, Telemetry

_PAUSE_PERIODS: Final = 20.0
"""Sample periods between the recording and its continuation: enough for both to count as stretches of their own."""


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """How a craft flies the continuation.

    Parameters
    ----------
    rotation: (n, 3, 3) from the body's axes as they were recorded to those it would have.
    rate_rad_s: (3,) its turn beside the recorded one, in the body.
    """

    rotation: Array
    rate_rad_s: Array


def about(axis: Array, angle_rad: Array) -> Array:
    """Rotations (n, 3, 3) of the axes by angles (n,) about a unit axis (3,): components of a fixed vector go back."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(angle_rad)[:, None, None], np.cos(angle_rad)[:, None, None]
    return np.asarray(np.eye(3) - sine * cross + (1.0 - cosine) * (cross @ cross))


def steady(scene: Scene) -> Turn:
    """The craft as it was."""
    return Turn(np.broadcast_to(np.eye(3), (len(scene), 3, 3)), np.zeros(3))


def tilted(scene: Scene, axis: Array, angle_rad: float) -> Turn:
    """The craft in another attitude, turned about an axis (3,) of its own."""
    return Turn(about(axis, np.full(len(scene), angle_rad)), np.zeros(3))


def spun(scene: Scene, axis: Array, rate_rad_s: float) -> Turn:
    """The craft turning faster about an axis (3,) of its own."""
    return Turn(about(axis, rate_rad_s * scene.time_s), rate_rad_s * axis)


def continued(scene: Scene, turn: Turn, x: Array) -> Scene:
    """The samples (2 n) of a recording and of its continuation along the same orbit in space, free of noise.

    Parameters
    ----------
    scene: the recording.
    turn: how the craft flies the continuation.
    x: nine errors (9 or more,).
    """
    later = float(scene.time_s[-1]) + _PAUSE_PERIODS * scene.period_s
    turned = _turned(scene.calibrated_nt, turn.rotation)
    body = np.concatenate([scene.calibrated_nt, turned])
    attitude, turning = scene.body_from_eci, scene.turning_rad_s
    if turning is not None:
        turning = np.broadcast_to(turning, (len(scene), 3))
        turning = np.concatenate([turning, _turned(turning, turn.rotation) + turn.rate_rad_s])
    return replace(
        scene,
        time_s=np.concatenate([scene.time_s, later + scene.time_s]),
        field_nt=measure(x[:9], body),
        calibrated_nt=body,
        clean_field_nt=np.concatenate([scene.clean_field_nt, measure(x[:9], turned)]),
        undisturbed_nt=measure(x[:9], body),
        magnitude_nt=np.tile(scene.magnitude_nt, 2),
        reference_eci_nt=None if scene.reference_eci_nt is None else np.tile(scene.reference_eci_nt, (2, 1)),
        position_ecef_km=_places(scene, later),
        channels={name: _channel(channel, turn) for name, channel in scene.channels.items()},
        body_from_eci=None if attitude is None else np.concatenate([attitude, turn.rotation @ attitude]),
        turning_rad_s=turning,
        moved_s=None if scene.moved_s is None else np.tile(scene.moved_s, 2),
    )


def _places(scene: Scene, later_s: float) -> NDArray[np.float64] | None:
    """The same orbit in space; without a clock, the same places on the Earth."""
    if scene.position_ecef_km is None:
        return None
    if scene.position_eci_km is None:
        return np.tile(scene.position_ecef_km, (2, 1))
    times = scene.time_ns + np.int64(round(later_s * 1e9))
    later: NDArray[np.float64] = np.asarray(geomagnetic.ecef_from_eci(times, scene.position_eci_km), dtype=np.float64)
    return np.concatenate([scene.position_ecef_km, later])


def _channel(channel: Telemetry, turn: Turn) -> Telemetry:
    values = channel.values
    if channel.quantity == "angular rate" and values.shape[1] == 3:
        return replace(channel, values=np.concatenate([values, _turned(values, turn.rotation) + turn.rate_rad_s]))
    return replace(channel, values=np.tile(values, (2, 1)))


def _turned(vectors: Array, rotation: Array) -> Array:
    return np.asarray(np.einsum("nij,nj->ni", rotation, vectors))
