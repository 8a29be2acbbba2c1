"""Where the Sun stands and how much of it the Earth hides.

Sources: Sun, Astronomical Almanac, section C, low-precision formulas (0.01 deg from 1950 to 2050); shadow, Montenbruck
& Gill 2000, section 3.4.2 (overlap of the two apparent discs).
"""

from __future__ import annotations

import numpy as np

from tests.blind.vectors import Floats, dot, unit

J2000_UNIX_S = 946_728_000.0
ASTRONOMICAL_UNIT_KM = 149_597_870.7
SUN_RADIUS_KM = 695_700.0
EARTH_RADIUS_KM = 6378.137  # at the equator
STRETCH = np.array([1.0, 1.0, 6378.137 / 6356.752])  # of axes in which the Earth is a sphere of that radius (WGS 84)


def sun_direction(unix_s: Floats) -> Floats:
    """Unit vectors (n, 3) from the Earth to the Sun, ECI of date."""
    days = (np.asarray(unix_s, dtype=np.float64) - J2000_UNIX_S) / 86400.0
    longitude = np.radians(280.460 + 0.9856474 * days)
    anomaly = np.radians(357.528 + 0.9856003 * days)
    ecliptic = longitude + np.radians(1.915 * np.sin(anomaly) + 0.020 * np.sin(2.0 * anomaly))
    tilt = np.radians(23.439 - 4e-7 * days)
    return np.stack([np.cos(ecliptic), np.cos(tilt) * np.sin(ecliptic), np.sin(tilt) * np.sin(ecliptic)], axis=-1)


def sunlit(position_km: Floats, sun: Floats) -> Floats:
    """Visible share (n,) of the Sun's disc at places (n, 3) [km], 0 in the umbra to 1; ``sun`` (n, 3) unit vectors."""
    place, towards = position_km * STRETCH, unit(sun * STRETCH)
    distance = np.linalg.norm(place, axis=-1)
    a = np.arcsin(SUN_RADIUS_KM / ASTRONOMICAL_UNIT_KM)
    b = np.arcsin(np.minimum(EARTH_RADIUS_KM / distance, 1.0))
    c = np.arccos(np.clip(-dot(unit(place), towards), -1.0, 1.0))
    inside = np.clip((c**2 + a**2 - b**2) / (2.0 * np.maximum(c, 1e-9)), -a, a)
    height = np.sqrt(np.maximum(a**2 - inside**2, 0.0))
    hidden = a**2 * np.arccos(inside / a) + b**2 * np.arccos(np.clip((c - inside) / b, -1.0, 1.0)) - c * height
    share = 1.0 - hidden / (np.pi * a**2)
    return np.asarray(np.where(c >= a + b, 1.0, np.where(c <= b - a, 0.0, np.clip(share, 0.0, 1.0))), dtype=np.float64)
