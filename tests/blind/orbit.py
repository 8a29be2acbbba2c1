"""A Kepler orbit whose node, perigee and mean anomaly drift with the Earth's oblateness.

Source: Vallado 2013, section 9.6.1 (secular rates by J2) and algorithm 10 (elements to position).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tests.blind.vectors import Floats, unit

MU_KM3_S2 = 398600.4418
EQUATOR_KM = 6378.137
J2 = 1.08262668e-3
ALTITUDES_KM = (400.0, 800.0)


@dataclass(frozen=True, slots=True)
class Orbit:
    """Elements at time zero: a [km], e, and the angles [rad]."""

    semi_major_km: float
    eccentricity: float
    inclination_rad: float
    node_rad: float
    perigee_rad: float
    anomaly_rad: float

    @property
    def motion_rad_s(self) -> float:
        """Mean motion without the drift [rad/s]."""
        return math.sqrt(MU_KM3_S2 / self.semi_major_km**3)

    @property
    def period_s(self) -> float:
        """Keplerian period [s]."""
        return math.tau / self.motion_rad_s

    @property
    def drifts_rad_s(self) -> tuple[float, float, float]:
        """Secular rates of node, perigee and mean anomaly by J2 [rad/s]."""
        round_orbit = 1.0 - self.eccentricity**2
        factor = 1.5 * J2 * (EQUATOR_KM / (self.semi_major_km * round_orbit)) ** 2 * self.motion_rad_s
        cosine = math.cos(self.inclination_rad)
        node = -factor * cosine
        perigee = 0.5 * factor * (5.0 * cosine**2 - 1.0)
        anomaly = 0.5 * factor * math.sqrt(round_orbit) * (3.0 * cosine**2 - 1.0)
        return node, perigee, anomaly

    def position_km(self, times_s: Floats) -> Floats:
        """Places (n, 3) ECI [km]."""
        e = self.eccentricity
        node_rate, perigee_rate, anomaly_rate = self.drifts_rad_s
        mean = self.anomaly_rad + (self.motion_rad_s + anomaly_rate) * times_s
        eccentric = solve_kepler(mean, e)
        true = 2.0 * np.arctan2(
            math.sqrt(1.0 + e) * np.sin(eccentric / 2.0), math.sqrt(1.0 - e) * np.cos(eccentric / 2.0)
        )
        radius = self.semi_major_km * (1.0 - e * np.cos(eccentric))
        along = true + self.perigee_rad + perigee_rate * times_s
        node = self.node_rad + node_rate * times_s
        cos_i, sin_i = math.cos(self.inclination_rad), math.sin(self.inclination_rad)
        in_plane, out = radius * np.cos(along), radius * np.sin(along)
        x = in_plane * np.cos(node) - out * cos_i * np.sin(node)
        y = in_plane * np.sin(node) + out * cos_i * np.cos(node)
        return np.stack([x, y, out * sin_i], axis=-1)

    def velocity_km_s(self, times_s: Floats) -> Floats:
        """Velocities (n, 3) ECI [km/s], by central differences over 2 s (error below 1e-6 km/s)."""
        return (self.position_km(times_s + 1.0) - self.position_km(times_s - 1.0)) / 2.0

    def axes(self, times_s: Floats) -> tuple[Floats, Floats, Floats]:
        """Unit vectors (n, 3) radial (up), along track and across (the orbit's normal)."""
        radial = unit(self.position_km(times_s))
        across = unit(np.cross(radial, self.velocity_km_s(times_s)))
        return radial, np.cross(across, radial), across

    def turned(self, node_rad: float) -> Orbit:
        """The same orbit with another node."""
        return replace(self, node_rad=node_rad)


def solve_kepler(mean_rad: Floats, eccentricity: float) -> Floats:
    """Eccentric anomaly (n,) from M = E - e sin E by Newton's method; to rounding for e < 0.1 after four steps."""
    anomaly = mean_rad + eccentricity * np.sin(mean_rad)
    for _ in range(4):
        error = anomaly - eccentricity * np.sin(anomaly) - mean_rad
        anomaly = anomaly - error / (1.0 - eccentricity * np.cos(anomaly))
    return np.asarray(anomaly, dtype=np.float64)


def draw_orbit(rng: np.random.Generator) -> Orbit:
    """An orbit between 400 and 800 km: circular or elliptic, of any node, of the inclinations that are flown."""
    low, high = ALTITUDES_KM
    if rng.random() < 0.6:
        perigee = apogee = rng.uniform(low, high)
    else:
        perigee, apogee = np.sort(rng.uniform(low, high, 2))
    semi_major = EQUATOR_KM + (perigee + apogee) / 2.0
    choice = rng.random()
    if choice < 0.3:
        inclination = rng.uniform(97.0, 98.6)  # Sun-synchronous
    elif choice < 0.5:
        inclination = 51.6  # from the station
    else:
        inclination = rng.uniform(25.0, 115.0)
    node, argument, anomaly = rng.uniform(0.0, math.tau, 3)
    eccentricity = (apogee - perigee) / 2.0 / semi_major
    return Orbit(semi_major, eccentricity, math.radians(inclination), node, argument, anomaly)
