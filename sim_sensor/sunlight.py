"""Where the Sun is, and how much of it the craft sees."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sim_sensor.orbit import DAY_NS, EARTH_RADIUS_KM

Floats = npt.NDArray[np.float64]
Times = npt.NDArray[np.int64]

SUN_RADIUS_KM = 695_700.0  # IAU 2015 nominal
ASTRONOMICAL_UNIT_KM = 149_597_870.7  # IAU 2012
_TO_SPHERE = np.array([1.0, 1.0, 298.257223563 / 297.257223563])  # a ray past the WGS84 ellipsoid, past a sphere
_J2000_NS = 946_728_000 * 10**9  # 2000-01-01T12:00 UTC, the epoch of the formulas [ns since 1970]


def sun_direction_eci(times_utc_ns: Times) -> Floats:
    """Unit vectors (n, 3) from the Earth to the Sun, ECI of date.

    Good to 0.01 deg from 1950 to 2050.  Source: Astronomical Almanac, low-precision formulas for the Sun, page C5.
    """
    days = (np.asarray(times_utc_ns, dtype=np.int64) - _J2000_NS) / DAY_NS
    mean_longitude = 280.460 + 0.9856474 * days
    anomaly = np.radians(357.528 + 0.9856003 * days)
    longitude = np.radians(mean_longitude + 1.915 * np.sin(anomaly) + 0.020 * np.sin(2.0 * anomaly))
    obliquity = np.radians(23.439 - 4.0e-7 * days)
    across = np.sin(longitude)
    return np.stack([np.cos(longitude), np.cos(obliquity) * across, np.sin(obliquity) * across], axis=-1)


def lit_fraction(times_utc_ns: Times, position_eci_km: Floats) -> Floats:
    """Share of the Sun's disc that is seen (n,), 1 in light, 0 in umbra, from positions (n, 3) ECI [km].

    Linear in angle through the penumbra (about 8 s wide in low orbit): at most 0.06 from the true share there.
    The Earth is the WGS84 ellipsoid, by stretching the axes of places and rays alike; air is left out.
    Source: Montenbruck and Gill 2000, section 3.4.2.
    """
    place, ray = position_eci_km * _TO_SPHERE, sun_direction_eci(times_utc_ns) * _TO_SPHERE
    radius = np.linalg.norm(place, axis=-1)
    earth = np.arcsin(np.minimum(1.0, EARTH_RADIUS_KM / radius))
    sun = np.arcsin(SUN_RADIUS_KM / ASTRONOMICAL_UNIT_KM)
    towards_earth = -np.sum(place * ray, axis=-1) / (radius * np.linalg.norm(ray, axis=-1))
    apart = np.arccos(np.clip(towards_earth, -1.0, 1.0))
    return np.asarray(np.clip((apart - earth + sun) / (2.0 * sun), 0.0, 1.0), dtype=np.float64)
