"""What a craft's places say of its motion, and what an orbit would."""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.earth.free_fall import MU_KM3_S2
from magcal_service.earth.geomagnetic import WGS84_A_KM
from magcal_service.recordings.inspect.finding import Rows
from magcal_service.recordings.inspect.log import Log
from magcal_service.recordings.table import FloatArray

_POLE_KM: Final = 6356.752
"""Polar radius of the Earth (WGS84)."""

EARTH_RAD_S: Final = 7.292_115e-5
"""Rate of the Earth's rotation (WGS84)."""

_STRIDE_S: Final = 60.0
"""Steps over which the rate is taken [s]: 4 degrees of a low orbit, against which rounded places are exact."""


def placed_rows(log: Log) -> tuple[Rows, FloatArray] | None:
    """Rows (of the log's) with a place, in time order and one of each time, and their places; None where too few."""
    if log.place_km is None:
        return None
    finite = np.flatnonzero(np.isfinite(log.place_km).all(axis=1))
    finite = finite[np.unique(log.time_ns[finite], return_index=True)[1]]
    return (finite, log.place_km[finite]) if len(finite) > 2 else None


def kepler_rad_s(radius_km: float) -> float:
    """Rate of a circular orbit."""
    return float(np.sqrt(MU_KM3_S2 / radius_km**3))


def escape_km_s(radius_km: FloatArray) -> FloatArray:
    """Speed (n,) that leaves the Earth for good from radii (n,)."""
    return np.asarray(np.sqrt(2.0 * MU_KM3_S2 / radius_km))


def heights_km(place_km: FloatArray) -> FloatArray:
    """Heights (n,) of places (n, 3) above the ellipsoid, along the line to the Earth's centre."""
    radius = np.linalg.norm(place_km, axis=1)
    sin2 = (place_km[:, 2] / radius) ** 2
    return np.asarray(radius - WGS84_A_KM * _POLE_KM / np.sqrt(_POLE_KM**2 + (WGS84_A_KM**2 - _POLE_KM**2) * sin2))


def distinct(place_km: FloatArray) -> Rows:
    """Rows (k,) at which a place (n, 3) differs from that of the row before, the first included."""
    moved = np.any(np.diff(place_km, axis=0) != 0.0, axis=1)
    return np.concatenate([[0], np.flatnonzero(moved) + 1])


def inertial(time_s: FloatArray, place_km: FloatArray) -> FloatArray:
    """Places (n, 3) of Earth-fixed axes in axes that stood there at time 0 and do not turn."""
    angle = EARTH_RAD_S * time_s
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, z = place_km.T
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1)


def rate_rad_s(time_s: FloatArray, place_km: FloatArray) -> float:
    """Median rate at which the direction from the Earth's centre turns, over steps of about a minute."""
    steps = np.diff(time_s)
    usual = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    if usual <= 0.0:
        return 0.0
    stride = max(1, round(_STRIDE_S / usual)) if usual < _STRIDE_S else 1
    stride = min(stride, len(time_s) - 1)
    unit = place_km / np.linalg.norm(place_km, axis=1)[:, None]
    angle = 2.0 * np.arcsin(np.minimum(np.linalg.norm(unit[stride:] - unit[:-stride], axis=1) / 2.0, 1.0))
    passed = time_s[stride:] - time_s[:-stride]
    forward = passed > 0.0
    return float(np.median(angle[forward] / passed[forward])) if forward.any() else 0.0


def out_of_plane(time_s: FloatArray, place_km: FloatArray) -> tuple[float, float]:
    """How far inertial directions lie out of the best plane through the Earth's centre (rms), and the arc [rad]."""
    turned = inertial(time_s, place_km)
    unit = turned / np.linalg.norm(turned, axis=1)[:, None]
    values = np.linalg.eigvalsh(unit.T @ unit / len(unit))
    steps = np.linalg.norm(np.diff(unit, axis=0), axis=1)
    return float(np.sqrt(max(values[0], 0.0))), float(steps.sum())
