"""Where a craft is, where the Sun is, and whether it shines on the craft.

Kepler's orbit with the secular drifts of the oblateness; inertial axes are of date, as SGP4 has them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MU_KM3_S2 = 398600.4418
EQUATOR_KM = 6378.137
FLATTENING = 1.0 / 298.257223563
_J2 = 1.08262668e-3
_SUN_RADIUS_RAD = 0.00466


@dataclass(frozen=True, slots=True)
class Orbit:
    """Mean elements at t = 0: semi-major axis [km], eccentricity, and four angles [rad]."""

    axis_km: float
    eccentricity: float
    inclination: float
    node: float
    perigee: float
    anomaly: float

    @property
    def mean_motion(self) -> float:
        """Mean motion [rad/s]."""
        return math.sqrt(MU_KM3_S2 / self.axis_km**3)

    def position_km(self, t: Floats) -> Floats:
        """ECI positions (n, 3) [km] at seconds t (n,)."""
        n, e, i = self.mean_motion, self.eccentricity, self.inclination
        drag = 1.5 * _J2 * (EQUATOR_KM / (self.axis_km * (1.0 - e * e))) ** 2 * n
        node = self.node - drag * math.cos(i) * t
        perigee = self.perigee + drag * (2.0 - 2.5 * math.sin(i) ** 2) * t
        mean = self.anomaly + (n + drag * math.sqrt(1.0 - e * e) * (1.0 - 1.5 * math.sin(i) ** 2)) * t
        eccentric = mean + e * np.sin(mean)
        for _ in range(6):
            eccentric -= (eccentric - e * np.sin(eccentric) - mean) / (1.0 - e * np.cos(eccentric))
        radius = self.axis_km * (1.0 - e * np.cos(eccentric))
        true = 2.0 * np.arctan2(
            math.sqrt(1.0 + e) * np.sin(eccentric / 2.0), math.sqrt(1.0 - e) * np.cos(eccentric / 2.0)
        )
        u = perigee + true
        in_plane, across = np.cos(u), np.sin(u) * math.cos(i)
        x = in_plane * np.cos(node) - across * np.sin(node)
        y = in_plane * np.sin(node) + across * np.cos(node)
        return radius[:, None] * np.stack([x, y, np.sin(u) * math.sin(i)], axis=1)


def draw_orbit(rng: np.random.Generator) -> Orbit:
    """A low orbit, 420 to 780 km, nearly round, of any common inclination."""
    axis = EQUATOR_KM + rng.uniform(450.0, 750.0)
    inclination = math.radians(float(rng.choice([51.6, 64.0, 82.0, 97.5]) + rng.uniform(-1.0, 1.0)))
    angles = rng.uniform(0.0, math.tau, 3)
    return Orbit(axis, rng.uniform(1e-4, 4e-3), inclination, *(float(angle) for angle in angles))


def sidereal_angle(unix_s: Floats) -> Floats:
    """Greenwich mean sidereal angle [rad] (IAU 1982), UT1 taken as UTC."""
    days = (unix_s - 946_728_000.0) / 86400.0
    century = days / 36525.0
    degrees = 280.46061837 + 360.98564736629 * days + 0.000387933 * century**2 - century**3 / 38_710_000.0
    return np.radians(np.mod(degrees, 360.0))


def turned_about_z(vectors: Floats, angle: Floats) -> Floats:
    """Components of vectors (n, 3) in axes turned by +angle (n,) about z."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = vectors.T
    return np.stack([c * x + s * y, c * y - s * x, z], axis=1)


def sun_direction(unix_s: float) -> Floats:
    """Unit vector (3,) to the Sun, of date; the Astronomical Almanac's low-precision formula (0.01 deg)."""
    days = (unix_s - 946_728_000.0) / 86400.0
    anomaly = math.radians(357.528 + 0.9856003 * days)
    longitude = math.radians(280.460 + 0.9856474 * days + 1.915 * math.sin(anomaly) + 0.020 * math.sin(2.0 * anomaly))
    tilt = math.radians(23.439 - 4e-7 * days)
    return np.array([math.cos(longitude), math.cos(tilt) * math.sin(longitude), math.sin(tilt) * math.sin(longitude)])


def sunlight(position_km: Floats, sun: Floats) -> Floats:
    """Share (n,) of the Sun's light: 1 in light, 0 in shadow, smooth through the penumbra of the flattened Earth."""
    stretch = np.array([1.0, 1.0, 1.0 / (1.0 - FLATTENING)])  # to axes in which the Earth is a sphere
    place, ray = position_km * stretch, sun * stretch
    radius = np.linalg.norm(place, axis=1)
    separation = np.arccos(np.clip(-(place @ ray) / (radius * np.linalg.norm(ray)), -1.0, 1.0))
    limb = np.arcsin(np.minimum(EQUATOR_KM / radius, 1.0))
    share = np.clip((separation - limb) / (2.0 * _SUN_RADIUS_RAD) + 0.5, 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


def geodetic(ecef_km: Floats) -> Floats:
    """Latitude, longitude [deg] and height [km] above WGS84 (n, 3) of ECEF positions (n, 3) [km], by iteration."""
    x, y, z = ecef_km.T
    e2 = FLATTENING * (2.0 - FLATTENING)
    across = np.hypot(x, y)
    latitude = np.arctan2(z, across * (1.0 - e2))
    for _ in range(8):
        normal = EQUATOR_KM / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
        latitude = np.arctan2(z + e2 * normal * np.sin(latitude), across)
    normal = EQUATOR_KM / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
    height = across * np.cos(latitude) + z * np.sin(latitude) - normal * (1.0 - e2 * np.sin(latitude) ** 2)
    return np.stack([np.degrees(latitude), np.degrees(np.arctan2(y, x)), height], axis=1)
