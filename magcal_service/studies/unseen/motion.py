"""How a craft turns: a steady spin, a slow tumble, and one that points at the Earth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import Final

import numpy as np

from magcal_service.earth.geomagnetic import WGS84_A_KM, igrf_eci_nt
from magcal_service.model import Array
from magcal_service.studies.flights import EARTH_GM_KM3_S2, START_UTC_NS

ALTITUDE_KM: Final = 550.0  # where most of them fly
INCLINATION_RAD: Final = math.radians(97.6)
"""A sun-synchronous orbit, as most small craft have."""

SPIN_RPM: Final = 3.0  # as craft spin that are stabilised by it, and slow enough to be sampled every 4 s
SPIN_AXIS: Final = (0.0, 0.0, 1.0)  # the axis that most of them spin about
_SPIN_ECI: Final = (0.4, -0.7, 0.59)
"""A slow spin about z, of an axis that is neither along nor across the orbit's plane; a choice."""

_TUMBLE_RAD_S: Final = (0.021, 0.0043)
"""About an axis of the body, and about one of inertial space: 1.2 and 0.25 deg/s, as after a detumbling."""

_WOBBLE_RAD, _WOBBLE_S = math.radians(3.0), (410.0, 730.0)
"""A nadir-pointing craft's own errors of pointing: three degrees, by wheels or torquers."""


class Motion(StrEnum):
    """How a craft turns."""

    SPIN = "spin"
    TUMBLE = "tumble"
    NADIR = "nadir"


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """A craft's way: times (n,) [s], positions (n, 3) [km] ECI, and attitude, body from ECI (n, 3, 3)."""

    time_s: Array
    position_eci_km: Array
    body_from_eci: Array

    @property
    def time_ns(self) -> Array:
        """(n,) UTC [ns]."""
        return np.asarray(START_UTC_NS + np.rint(self.time_s * 1e9).astype(np.int64))


def track(motion: Motion, duration_s: int, rng: np.random.Generator) -> Track:
    """The way of a craft, its node, place, axes and phase drawn."""
    time_s = np.arange(float(duration_s))
    node, start = rng.uniform(0.0, 2.0 * math.pi, 2)
    position = place_eci_km(time_s, node, start)
    phase = rng.uniform(0.0, 2.0 * math.pi)
    if motion is Motion.NADIR:
        return Track(time_s, position, _nadir(time_s, position, normal(node), phase))
    if motion is Motion.SPIN:
        turned = about((0.0, 0.0, 1.0), -(phase + SPIN_RPM * 2.0 * math.pi / 60.0 * time_s))
        return Track(time_s, position, turned @ _towards(np.array(_SPIN_ECI)))
    inner, outer = (phase + rate * time_s for rate in _TUMBLE_RAD_S)
    return Track(time_s, position, about((0.6, 0.0, 0.8), inner) @ about((0.0, 1.0, 0.0), outer))


def place_eci_km(time_s: Array, node: float, start: float) -> Array:
    """Positions (n, 3) [km], ECI, on a circle."""
    radius = WGS84_A_KM + ALTITUDE_KM
    angle = start + math.sqrt(EARTH_GM_KM3_S2 / radius**3) * time_s
    along = np.array([math.cos(node), math.sin(node), 0.0])
    ahead = np.cross(normal(node), along)
    return np.asarray(radius * (np.outer(np.cos(angle), along) + np.outer(np.sin(angle), ahead)))


def normal(node: float) -> Array:
    """Unit vector (3,) of the orbit's angular momentum, ECI."""
    sine = math.sin(INCLINATION_RAD)
    return np.array([sine * math.sin(node), -sine * math.cos(node), math.cos(INCLINATION_RAD)])


def about(axis: tuple[float, float, float], angle: Array) -> Array:
    """Rotations (n, 3, 3) of vectors by angles (n,) about a unit axis, right-handed (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross))


@lru_cache(maxsize=8)
def _field(key: bytes, duration_s: int) -> Array:
    position = np.frombuffer(key).reshape(-1, 3)
    time_ns = START_UTC_NS + np.arange(duration_s) * 10**9
    return igrf_eci_nt(time_ns, position)


def field_eci_nt(position_eci_km: Array) -> Array:
    """IGRF-14 (n, 3) [nT] at positions (n, 3), one a second; the last few are kept."""
    return _field(np.ascontiguousarray(position_eci_km, dtype=np.float64).tobytes(), len(position_eci_km))


def _towards(axis_eci: Array) -> Array:
    """A right-handed triad (3, 3), rows, whose last row is along the axis."""
    last = axis_eci / np.linalg.norm(axis_eci)
    first = np.cross(last, [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(last, first), last])


def _nadir(time_s: Array, position: Array, orbit_normal: Array, phase: float) -> Array:
    down = -position / np.linalg.norm(position, axis=1)[:, None]
    right = np.broadcast_to(-orbit_normal, down.shape)
    frame = np.stack([np.cross(right, down), right, down], axis=1)
    roll, pitch = (_WOBBLE_RAD * np.sin(2.0 * math.pi * time_s / period + phase) for period in _WOBBLE_S)
    return np.asarray(about((1.0, 0.0, 0.0), roll) @ about((0.0, 1.0, 0.0), pitch) @ frame)
