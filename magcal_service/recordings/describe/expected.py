"""The field that IGRF has where and when a log was made, for a few of its rows."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.base.errors import MagcalError
from magcal_service.earth import geomagnetic
from magcal_service.recordings.describe.place import Place
from magcal_service.recordings.describe.times_found import Times

FloatArray = npt.NDArray[np.float64]

_ROWS: Final = 400  # spread over the sample: enough for a fit, and quick
_NEAR: Final = 0.05  # of the field: another model or year, and not another frame
_LOW_ORBIT_KM: Final = 450.0  # taken for a height that is not known: the field changes by a twentieth in 100 km


def expected_nt(times: Times | None, place: Place | None) -> FloatArray | None:
    """The model's magnitude [nT] of some rows, NaN in the others (n,); None where place or date are not known."""
    if times is None or place is None or not times.absolute:
        return None
    position = _ecef_km(times, place)
    if position is None:
        return None
    good = np.flatnonzero(np.isfinite(position).all(axis=1) & np.isfinite(times.seconds))
    good = good[:: max(len(good) // _ROWS, 1)]
    if not len(good):
        return None
    try:
        field = geomagnetic.igrf_ecef_nt((times.seconds[good] * 1e9).astype(np.int64), position[good])
    except MagcalError:  # outside the model's years or heights, or its package is not there
        return None
    magnitude = np.full(len(times.seconds), np.nan)
    magnitude[good] = np.sqrt((field**2).sum(axis=1))
    return magnitude


def frame_of_field(vectors_nt: FloatArray, times: Times | None, place: Place | None) -> str:
    """The frame in which a reference (n, 3) [nT] is the model's; empty where it is in none, or that cannot be told."""
    if times is None or place is None or not times.absolute or (position := _ecef_km(times, place)) is None:
        return ""
    good = np.flatnonzero(np.isfinite(np.column_stack([position, vectors_nt, times.seconds])).all(axis=1))
    good = good[:: max(len(good) // _ROWS, 1)]
    if not len(good):
        return ""
    time_ns, position, vectors = (times.seconds[good] * 1e9).astype(np.int64), position[good], vectors_nt[good]
    try:
        field = geomagnetic.igrf_ecef_nt(time_ns, position)
    except MagcalError:
        return ""
    latitude, longitude, _ = geomagnetic.geodetic_from_ecef(position)
    in_frame = {
        "ecef": field,
        "eci": geomagnetic.eci_from_ecef(time_ns, field),
        "ned": geomagnetic.ned_from_ecef(latitude, longitude, field),
    }
    off = {frame: float(np.median(np.linalg.norm(one - vectors, axis=1))) for frame, one in in_frame.items()}
    usual = float(np.median(np.linalg.norm(field, axis=1)))
    near = [frame for frame, distance in off.items() if distance < _NEAR * usual]
    return near[0] if len(near) == 1 else ""


def _ecef_km(times: Times, place: Place) -> geomagnetic.Floats | None:
    if place.cartesian_km is not None:
        if place.frame == "ecef":
            return place.cartesian_km
        good = np.nan_to_num(times.seconds)
        return geomagnetic.ecef_from_eci((good * 1e9).astype(np.int64), place.cartesian_km)
    if place.latitude_deg is None or place.longitude_deg is None:
        return None
    height = place.altitude_km
    if height is None:
        height = _LOW_ORBIT_KM if place.in_orbit else 0.0
    return geomagnetic.ecef_from_geodetic(
        place.latitude_deg, place.longitude_deg, np.full(len(place.latitude_deg), height)
    )
