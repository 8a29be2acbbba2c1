"""How two columns move over the ground, and which of them is the latitude where both can be."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.recordings.describe.columns import Column, Log
from magcal_service.recordings.describe.orbit_motion import unsteady_plane
from magcal_service.recordings.describe.times_found import Times

FloatArray = npt.NDArray[np.float64]

EARTH_KM: Final = 6371.0  # mean radius of the Earth

_ORBIT_KM_S: Final = (5.6, 8.2)
"""Ground speed of a low orbit: hardly anything else that a log holds moves so."""

_STRIDE: Final = 8  # rows that a speed is taken over
NEEDED: Final = 8  # steps that a speed is judged by
POLE_DEG: Final = 90.0  # no latitude is beyond
_ROUND_DEG: Final = 360.0  # nor a longitude beyond, whichever way it is counted
_STILL: Final = 1e-4
"""1 - |mean normal|: a plane that goes round the pole by 1.6 degrees, as one of some orbits does."""

_CLEARLY: Final = 20.0  # times as unsteady the other reading has to be


def ground_speed_km_s(latitude_deg: FloatArray, longitude_deg: FloatArray, times: Times, log: Log) -> FloatArray:
    """Speeds over the ground [km/s] over some rows each, so that stamps in whole seconds do not count."""
    stride = _STRIDE if len(latitude_deg) > 8 * _STRIDE else 1
    lat, lon = np.radians(latitude_deg), np.radians(longitude_deg)
    early, late = slice(None, -stride), slice(stride, None)
    chord = np.sin((lat[late] - lat[early]) / 2) ** 2
    chord += np.cos(lat[late]) * np.cos(lat[early]) * np.sin((lon[late] - lon[early]) / 2) ** 2
    distance = 2.0 * EARTH_KM * np.arcsin(np.sqrt(np.clip(chord, 0.0, 1.0)))
    step = times.seconds[late] - times.seconds[early]
    good = np.isfinite(distance) & (step > 0) & (log.block[late] == log.block[early])
    return np.asarray(distance[good] / step[good], dtype=np.float64)


def is_place(latitude_deg: FloatArray, longitude_deg: FloatArray) -> bool:
    """Whether numbers are within the degrees of a latitude and a longitude."""
    return _most(latitude_deg) <= POLE_DEG and _most(longitude_deg) <= _ROUND_DEG


def _most(values: FloatArray) -> float:
    return float(np.nanmax(np.abs(values))) if np.isfinite(values).any() else np.inf


def moves_as_orbit(latitude_deg: FloatArray, longitude_deg: FloatArray, log: Log, times: Times | None) -> bool:
    """Whether degrees (n,) move over the ground as a craft in a low orbit."""
    if times is None or _still(latitude_deg) or _still(longitude_deg) or not is_place(latitude_deg, longitude_deg):
        return False
    speeds = ground_speed_km_s(latitude_deg, longitude_deg, times, log)
    inside = (speeds > _ORBIT_KM_S[0]) & (speeds < _ORBIT_KM_S[1])
    return speeds.size >= 4 * NEEDED and float(np.mean(inside)) > 0.9


def _still(values: FloatArray) -> bool:
    good = values[np.isfinite(values)]
    return not good.size or float(np.ptp(good)) == 0.0


def other_way_round(latitude: Column, longitude: Column, log: Log, times: Times | None) -> str:
    """Why two columns [deg] of a craft in orbit are longitude and latitude; empty where nothing speaks for that.

    An orbit keeps its plane, so the place and a later one span it still while the Earth turns below; with latitude
    and longitude exchanged it swings.  Where no craft in orbit is, or both are within a minute, nothing is said.
    """
    lat, lon = latitude.values, longitude.values
    if times is None or not is_place(lon, lat):
        return ""
    if not moves_as_orbit(lat, lon, log, times) and not moves_as_orbit(lon, lat, log, times):
        return ""
    given, exchanged = unsteady_plane(lat, lon, times.seconds), unsteady_plane(lon, lat, times.seconds)
    if given is None or exchanged is None or exchanged > _STILL or given < _CLEARLY * exchanged:
        return ""
    return "the plane of the orbit stands still only where they are taken the other way round"
