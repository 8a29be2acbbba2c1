"""Where the craft is: Keplerian elements (with the secular effect of J2 if asked), or SGP4 from an element set.

Positions are ECI with the true equator of date (SGP4's TEME), in km, at UTC times in ns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.base.typed_toml.keys import flag, number
from magcal_service.base.typed_toml.record import Reading
from magcal_service.earth.orbit_elements import propagate, satellite

Floats = npt.NDArray[np.float64]
Times = npt.NDArray[np.int64]

EARTH_GM_KM3_S2 = 398600.4418  # WGS84
EARTH_RADIUS_KM = 6378.137  # WGS84 equatorial
EARTH_J2 = 1.08262668e-3  # EGM96
DAY_NS = 86400 * 10**9  # nanoseconds in a day
_LOWEST_PERIGEE_KM = 100.0
"""The edge of space by convention; an orbit that dips below is over within a turn."""

_KEPLER_STEPS = 50
"""Newton's method needs under ten for e up to 0.9; the bound only ends a loop that rounding keeps alive."""

_KEPLER_RAD = 1e-14  # some roundings of an angle up to 2 pi; 1e-10 km along the orbit


class Orbit(Protocol):
    """Anything that says where the craft is."""

    def position_eci_km(self, times_utc_ns: Times) -> Floats:
        """Positions (n, 3) ECI [km] at UTC times (n,) [ns since 1970]."""
        ...

    def normal_eci(self, time_utc_ns: int) -> Floats:
        """Unit normal of the orbit (3,) ECI at one time, along the angular momentum."""
        ...


def _check_perigee(reading: Reading, name: str, eccentricity: float) -> None:
    perigee_km = reading.values["semi_major_km"] * (1.0 - eccentricity) - EARTH_RADIUS_KM
    if perigee_km < _LOWEST_PERIGEE_KM:
        accepted = f"it puts the perigee at {perigee_km:.0f} km; at least 100 km"
        reading.table.refuse(name, eccentricity, accepted)


@dataclass(frozen=True)
class KeplerOrbit:
    """An ellipse, turning in space by J2 where ``j2`` is set.

    Parameters
    ----------
    epoch_utc_ns: time of the elements [ns since 1970].
    semi_major_km: semi-major axis [km].
    eccentricity: 0 to below 1.
    inclination_rad, raan_rad, argument_of_perigee_rad, mean_anomaly_rad: angles [rad].
    j2: apply the secular rates of node, perigee and mean anomaly (Vallado 2013, 9.6.1); short-period terms
        (up to 10 km) are left out.
    """

    epoch_utc_ns: int
    semi_major_km: float = number(
        612.0, 150.0, 40000.0, name="altitude_km", unit="km", convert=lambda km: EARTH_RADIUS_KM + km, file_only=True
    )
    eccentricity: float = number(0.0, 0.0, 0.9, check=_check_perigee, file_only=True)
    inclination_rad: float = number(
        74.0, 0.0, 180.0, name="inclination_deg", unit="deg", convert=math.radians, file_only=True
    )
    raan_rad: float = number(0.0, -360.0, 360.0, name="raan_deg", unit="deg", convert=math.radians, file_only=True)
    argument_of_perigee_rad: float = number(
        0.0, -360.0, 360.0, name="argument_of_perigee_deg", unit="deg", convert=math.radians, file_only=True
    )
    mean_anomaly_rad: float = number(
        0.0, -360.0, 360.0, name="mean_anomaly_deg", unit="deg", convert=math.radians, file_only=True
    )
    j2: bool = flag(False)

    @property
    def mean_motion_rad_s(self) -> float:
        """Kepler's third law [rad/s], without J2."""
        return math.sqrt(EARTH_GM_KM3_S2 / self.semi_major_km**3)

    def rates_rad_s(self) -> tuple[float, float, float]:
        """Rates of node, argument of perigee and mean anomaly [rad/s]."""
        n = self.mean_motion_rad_s
        if not self.j2:
            return 0.0, 0.0, n
        factor = 1.5 * EARTH_J2 * (EARTH_RADIUS_KM / (self.semi_major_km * (1.0 - self.eccentricity**2))) ** 2 * n
        sin2 = math.sin(self.inclination_rad) ** 2
        node = -factor * math.cos(self.inclination_rad)
        perigee = factor * (2.0 - 2.5 * sin2)
        mean = n + factor * math.sqrt(1.0 - self.eccentricity**2) * (1.0 - 1.5 * sin2)
        return node, perigee, mean

    def position_eci_km(self, times_utc_ns: Times) -> Floats:
        """See ``Orbit``."""
        elapsed_s = np.asarray((times_utc_ns - self.epoch_utc_ns) * 1e-9, dtype=np.float64)
        node_rate, perigee_rate, mean_rate = self.rates_rad_s()
        anomaly = _eccentric_anomaly(self.mean_anomaly_rad + mean_rate * elapsed_s, self.eccentricity)
        x = self.semi_major_km * (np.cos(anomaly) - self.eccentricity)
        y = self.semi_major_km * math.sqrt(1.0 - self.eccentricity**2) * np.sin(anomaly)
        perigee = self.argument_of_perigee_rad + perigee_rate * elapsed_s
        along = np.cos(perigee) * x - np.sin(perigee) * y
        across = np.sin(perigee) * x + np.cos(perigee) * y
        node = self.raan_rad + node_rate * elapsed_s
        cos_i, sin_i = math.cos(self.inclination_rad), math.sin(self.inclination_rad)
        return np.stack(
            [
                np.cos(node) * along - np.sin(node) * cos_i * across,
                np.sin(node) * along + np.cos(node) * cos_i * across,
                sin_i * across,
            ],
            axis=-1,
        )

    def normal_eci(self, time_utc_ns: int) -> Floats:
        """See ``Orbit``."""
        node = self.raan_rad + self.rates_rad_s()[0] * (time_utc_ns - self.epoch_utc_ns) * 1e-9
        sin_i = math.sin(self.inclination_rad)
        return np.array([sin_i * math.sin(node), -sin_i * math.cos(node), math.cos(self.inclination_rad)])


def _eccentric_anomaly(mean_anomaly: Floats, eccentricity: float) -> Floats:
    """Solve Kepler's equation M = E - e sin E by Newton's method from E = M + e sin M, to 1e-14 rad."""
    mean = np.mod(mean_anomaly, math.tau)
    anomaly = mean + eccentricity * np.sin(mean)
    for _ in range(_KEPLER_STEPS):
        step = (anomaly - eccentricity * np.sin(anomaly) - mean) / (1.0 - eccentricity * np.cos(anomaly))
        anomaly = anomaly - step
        if not np.any(np.abs(step) > _KEPLER_RAD):
            break
    return np.asarray(anomaly, dtype=np.float64)


@dataclass(frozen=True)
class Sgp4Orbit:
    """SGP4 on a two-line element set; good to a few km within days of its epoch.  Needs the extra ``sim``.

    Source: Vallado, Crawford, Hujsak, Kelso 2006, AIAA 2006-6753 (package ``sgp4``).
    """

    line1: str
    line2: str

    def _state(self, times_utc_ns: Times) -> tuple[Floats, Floats]:
        codes, position, velocity = propagate(satellite(self.line1, self.line2), times_utc_ns)
        if np.any(codes):
            from sgp4.api import SGP4_ERRORS

            said = SGP4_ERRORS[int(codes[codes != 0][0])]
            raise InputRefusedError([Fault("orbit.tle", self.line1, f"SGP4 cannot propagate it: {said}")])
        return position, velocity

    def position_eci_km(self, times_utc_ns: Times) -> Floats:
        """See ``Orbit``; raises InputRefusedError where SGP4 reports an error such as decay."""
        return self._state(times_utc_ns)[0]

    def normal_eci(self, time_utc_ns: int) -> Floats:
        """See ``Orbit``."""
        position, velocity = self._state(np.array([time_utc_ns], dtype=np.int64))
        normal = np.cross(position[0], velocity[0])
        return np.asarray(normal / np.linalg.norm(normal))
