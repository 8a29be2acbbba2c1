"""What the way of a craft in orbit shows: its height, and whether its axes turn with the Earth."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.earth.free_fall import MU_KM3_S2
from magcal_service.recordings.inspect.motion import EARTH_RAD_S

FloatArray = npt.NDArray[np.float64]

Indices = npt.NDArray[np.intp]

_RADIUS_KM: Final = 6371.0  # mean, of the Earth
_E2: Final = 6.69438e-3  # squared eccentricity of WGS84
_STILL: Final = 1e-5  # of the normal: a plane that goes round the pole by half a degree
_CLEARLY: Final = 20.0  # times as unsteady the other reading has to be

_FEWEST: Final = 10  # pieces of the way

_OVER_S: Final = (60.0, 900.0)
"""A piece of the way is as long as this: whole seconds do not count then, and it is far from half a turn."""


def orbit_height_km(latitude_deg: FloatArray, longitude_deg: FloatArray, time_s: FloatArray) -> float | None:
    """The mean height [km] over the mean radius of a round orbit that moves so; None where the rows are too few.

    Parameters
    ----------
    latitude_deg, longitude_deg, time_s: (n,) geodetic, and seconds; NaN where there is none.

    The orbit's angle per second gives its size by Kepler's third law.  Within 5 km for a low orbit of an eccentricity
    below 0.002 and rows over an hour; an eccentric one is off by its radius times the eccentricity at worst.
    """
    place, time = _directions(latitude_deg, longitude_deg, time_s)
    if len(time) < 2:
        return None
    first, later, step = _pieces(time)
    if len(first) < 2:
        return None
    cosine = np.clip((place[first] * place[later]).sum(axis=1), -1.0, 1.0)
    rate = float(np.arccos(cosine).sum() / step.sum())
    return None if rate <= 0.0 else float((MU_KM3_S2 / rate**2) ** (1.0 / 3.0)) - _RADIUS_KM


def unsteady_plane(latitude_deg: FloatArray, longitude_deg: FloatArray, time_s: FloatArray) -> float | None:
    """How much the plane swings that a craft's place and a later one span: 0 in an orbit; None where rows are too few.

    Parameters
    ----------
    latitude_deg, longitude_deg, time_s: (n,) geodetic, and seconds; NaN where there is none.
    """
    place, time = _directions(latitude_deg, longitude_deg, time_s)
    first, later, _ = _pieces(time) if len(time) > 1 else (None, None, None)
    if first is None or later is None or len(first) < _FEWEST:
        return None
    return _unsteady(place[first], place[later])


def _directions(
    latitude_deg: FloatArray, longitude_deg: FloatArray, time_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Directions (k, 3) from the Earth's centre in axes that do not turn, and their times (k,) in order."""
    good = np.isfinite(latitude_deg) & np.isfinite(longitude_deg) & np.isfinite(time_s)
    rows = np.flatnonzero(good)[np.argsort(time_s[good], kind="stable")]
    latitude, longitude, time = latitude_deg[rows], longitude_deg[rows], time_s[rows]
    geocentric = np.arctan((1.0 - _E2) * np.tan(np.radians(latitude)))
    inertial = np.radians(longitude) + EARTH_RAD_S * (time - time[:1])
    across = np.cos(geocentric)
    return np.column_stack([across * np.cos(inertial), across * np.sin(inertial), np.sin(geocentric)]), time


def frame_of_way(position_km: FloatArray, time_s: FloatArray) -> str:
    """``eci`` or ``ecef``, whichever holds the plane of the orbit still; empty where neither stands out.

    Parameters
    ----------
    position_km, time_s: (n, 3) and (n,), NaN where there is none.
    """
    good = np.isfinite(position_km).all(axis=1) & np.isfinite(time_s)
    rows = np.flatnonzero(good)[np.argsort(time_s[good], kind="stable")]
    position, time = position_km[rows], time_s[rows]
    first, later, _ = _pieces(time)
    if len(first) < _FEWEST:
        return ""
    angle = EARTH_RAD_S * (time - time[0])
    x, y, z = position.T
    turned = np.column_stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle), z])
    eci, ecef = (_unsteady(one[first], one[later]) for one in (position, turned))
    if min(eci, ecef) > _STILL or max(eci, ecef) < _CLEARLY * min(eci, ecef):
        return ""
    return "eci" if eci < ecef else "ecef"


def _unsteady(place: FloatArray, later: FloatArray) -> float:
    """1 - |mean direction| of the orbit's normal."""
    normal = np.cross(place, later)
    normal = normal / np.sqrt((normal**2).sum(axis=1))[:, None]
    return 1.0 - float(np.linalg.norm(normal.mean(axis=0)))


def _pieces(time_s: FloatArray) -> tuple[Indices, Indices, FloatArray]:
    """First and last row, and length [s], of pieces of the way that begin at each row."""
    last = np.searchsorted(time_s, time_s + _OVER_S[0])
    first = np.flatnonzero(last < len(time_s))
    step = time_s[last[first]] - time_s[first]
    fits = (step > 0) & (step < _OVER_S[1])
    return first[fits], last[first][fits], step[fits]
