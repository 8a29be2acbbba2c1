"""The Earth's main field (IGRF-14) and the frames it is given in.

Frames: ``ECI`` is inertial with the true equator of date (TEME, as SGP4 uses it), ``ECEF`` turns with the Earth,
``NED`` is local north, east, down on the WGS84 ellipsoid.  ECI and ECEF differ by the Greenwich mean sidereal angle
alone: polar motion (0.3 arcsec) and UT1 - UTC (< 0.9 s) are left out, together under 0.2 nT here against a full
rotation chain, and at most 3 nT while |UT1 - UTC| is at its limit.

Source: IAGA 2024 (IGRF-14, doi:10.5281/zenodo.14012302); frames: Vallado 2013, sections 3.4-3.5.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime
from functools import cached_property

import numpy as np
import numpy.typing as npt

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.earth import igrf14

Floats = npt.NDArray[np.float64]
Times = npt.NDArray[np.int64]

WGS84_A_KM = 6378.137  # equatorial radius that defines the WGS84 ellipsoid
WGS84_E2 = 6.69437999014e-3  # its first eccentricity squared, f (2 - f) with 1/f = 298.257223563
EARTH_KM = 6371.0  # mean radius, for heights that need no ellipsoid
LOWEST_ORBIT_KM = 120.0  # height below which nothing completes an orbit
IGRF_YEARS = (1900, 2030)  # first epoch of IGRF-14, and the end of its secular variation
RADIUS_KM = (6300.0, 60000.0)  # below the surface, and beyond synchronous orbit, the model says nothing useful

_J2000_NS = 946_728_000 * 10**9  # 2000-01-01T12:00:00Z
_CENTURY_NS = 36525 * 86400 * 10**9  # Julian century, the unit of time of the sidereal polynomial
_ROWS = 4096  # positions per call of the model: bounds its memory to 50 MB; twice as many take twice as long each
_POLE_DEG = 1e-7  # the model divides by sin(colatitude); 1e-7 deg is 11 mm on the ground


def _epoch_ns(year: int) -> int:
    return round(datetime(year, 1, 1, tzinfo=UTC).timestamp()) * 10**9


def gmst_rad(times_utc_ns: Times) -> Floats:
    """Greenwich mean sidereal time [rad] in [0, 2 pi) at ``times_utc_ns`` (n,) [ns since 1970], with UT1 = UTC.

    Source: IAU 1982, as printed in Vallado 2013, equation 3-47.
    """
    centuries = (np.asarray(times_utc_ns, dtype=np.int64) - _J2000_NS) / _CENTURY_NS
    polynomial_s = 67310.54841 + centuries * (8640184.812866 + centuries * (0.093104 - 6.2e-6 * centuries))
    seconds = np.mod(876600.0 * 3600.0 * centuries, 86400.0) + polynomial_s
    return np.asarray(np.mod(seconds, 86400.0) * (math.tau / 86400.0), dtype=np.float64)


def _turn_about_z(vectors: Floats, angle_rad: Floats) -> Floats:
    """Components of ``vectors`` (n, 3) in axes turned by +angle (n,) about z."""
    vectors = np.asarray(vectors, dtype=np.float64)
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, np.broadcast_to(vectors[..., 2], x.shape)], axis=-1)


def ecef_from_eci(times_utc_ns: Times, vectors_eci: Floats) -> Floats:
    """Vectors (n, 3) of any unit from ECI to ECEF at ``times_utc_ns`` (n,)."""
    return _turn_about_z(vectors_eci, gmst_rad(times_utc_ns))


def eci_from_ecef(times_utc_ns: Times, vectors_ecef: Floats) -> Floats:
    """Vectors (n, 3) of any unit from ECEF to ECI at ``times_utc_ns`` (n,)."""
    return _turn_about_z(vectors_ecef, -gmst_rad(times_utc_ns))


def ecef_from_geodetic(latitude_deg: Floats, longitude_deg: Floats, altitude_km: Floats) -> Floats:
    """Position (n, 3) ECEF [km] of geodetic latitude, longitude [deg] and height above WGS84 [km], each (n,)."""
    latitude, longitude, height = np.broadcast_arrays(np.radians(latitude_deg), np.radians(longitude_deg), altitude_km)
    sine = np.sin(latitude)
    normal_km = WGS84_A_KM / np.sqrt(1.0 - WGS84_E2 * sine**2)
    across = (normal_km + height) * np.cos(latitude)
    up = (normal_km * (1.0 - WGS84_E2) + height) * sine
    return np.stack([across * np.cos(longitude), across * np.sin(longitude), up], axis=-1)


def ecef_from_geocentric(latitude_deg: Floats, longitude_deg: Floats, radius_km: Floats) -> Floats:
    """Position (n, 3) ECEF [km] of geocentric latitude, longitude [deg] and distance from the centre [km]."""
    latitude, longitude, radius = np.broadcast_arrays(np.radians(latitude_deg), np.radians(longitude_deg), radius_km)
    across = radius * np.cos(latitude)
    return np.stack([across * np.cos(longitude), across * np.sin(longitude), radius * np.sin(latitude)], axis=-1)


def geodetic_from_ecef(position_ecef_km: Floats) -> tuple[Floats, Floats, Floats]:
    """Geodetic latitude, longitude [deg] and height above WGS84 [km], each (n,), of (n, 3) ECEF [km].

    Bowring's parametric latitude with two refinements: exact to 1e-9 deg and 1 um from the ground to 60000 km.
    Source: Bowring 1976, Survey Review 23, 323-327.
    """
    x, y, z = np.moveaxis(np.asarray(position_ecef_km, dtype=np.float64), -1, 0)
    b_km = WGS84_A_KM * math.sqrt(1.0 - WGS84_E2)
    second_e2 = WGS84_E2 / (1.0 - WGS84_E2)
    across = np.hypot(x, y)
    beta = np.arctan2(z * WGS84_A_KM, across * b_km)
    for _ in range(3):
        latitude = np.arctan2(
            z + second_e2 * b_km * np.sin(beta) ** 3, across - WGS84_E2 * WGS84_A_KM * np.cos(beta) ** 3
        )
        beta = np.arctan2(math.sqrt(1.0 - WGS84_E2) * np.sin(latitude), np.cos(latitude))
    sine, cosine = np.sin(latitude), np.cos(latitude)
    height = across * cosine + z * sine - WGS84_A_KM * np.sqrt(1.0 - WGS84_E2 * sine**2)
    return np.degrees(latitude), np.degrees(np.arctan2(y, x)), height


def ecef_from_ned(latitude_deg: Floats, longitude_deg: Floats, vectors_ned: Floats) -> Floats:
    """Vectors (n, 3) of any unit from local north, east, down at geodetic latitude, longitude (n,) [deg] to ECEF."""
    rows = _ned_from_ecef(latitude_deg, longitude_deg)
    return np.asarray(np.einsum("...ji,...j->...i", rows, vectors_ned), dtype=np.float64)


def ned_from_ecef(latitude_deg: Floats, longitude_deg: Floats, vectors_ecef: Floats) -> Floats:
    """Vectors (n, 3) of any unit from ECEF to local north, east, down at geodetic latitude, longitude (n,) [deg]."""
    rows = _ned_from_ecef(latitude_deg, longitude_deg)
    return np.asarray(np.einsum("...ij,...j->...i", rows, vectors_ecef), dtype=np.float64)


def _ned_from_ecef(latitude_deg: Floats, longitude_deg: Floats) -> Floats:
    latitude, longitude = np.broadcast_arrays(np.radians(latitude_deg), np.radians(longitude_deg))
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    zero = np.zeros_like(sin_lat)
    rows = [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat, -sin_lon, cos_lon, zero]
    rows += [-cos_lat * cos_lon, -cos_lat * sin_lon, -sin_lat]
    return np.stack(rows, axis=-1).reshape(*sin_lat.shape, 3, 3)


def igrf_ecef_nt(times_utc_ns: Times, position_ecef_km: Floats, max_degree: int = 13) -> Floats:
    """IGRF-14 main field in ECEF.

    Parameters
    ----------
    times_utc_ns: (n,) UTC [ns since 1970], from 1900-01-01 to 2030-01-01.
    position_ecef_km: (n, 3) ECEF [km], 6300 to 60000 km from the Earth's centre.
    max_degree: terms above this degree are left out, 1 to 13.

    Returns (n, 3) [nT], ECEF.  The main field alone: crust (5 nT rms at 400 km) and currents above (20-400 nT) are
    not in it.  Raises InputRefusedError outside the domain.
    Source: IAGA, IGRF-14; within 0.2 nT of the Fortran ``igrf14syn``.
    """
    return Places(position_ecef_km, max_degree).field_nt(times_utc_ns, max_degree)


class Places:
    """Positions (n, 3) ECEF [km] at which the main field is wanted at more than one date, or to more than one degree.

    What depends on the place alone takes most of the time: of no more than ``_ROWS`` positions, which are 20 MB of it,
    it is computed once.

    Parameters
    ----------
    max_degree: the highest that is asked for.
    """

    def __init__(self, position_ecef_km: Floats, max_degree: int = igrf14.HIGHEST_DEGREE) -> None:
        self._position: Floats = np.asarray(position_ecef_km, dtype=np.float64).reshape(-1, 3)
        self._degree = max_degree

    def field_nt(self, times_utc_ns: Times, max_degree: int) -> Floats:
        """As ``igrf_ecef_nt`` at these places, one for each time."""
        times = np.asarray(times_utc_ns, dtype=np.int64).reshape(-1)
        position = self._position
        if times.shape[0] != position.shape[0]:
            accepted = "one time for each position is accepted"
            raise InputRefusedError([Fault("igrf", f"{len(times)} times, {len(position)} positions", accepted)])
        _refuse_outside_domain(times, position)
        field = np.empty_like(position)
        intervals = (times.astype("datetime64[ns]").astype("datetime64[Y]").astype(np.int64) + 1970) // 5 * 5
        intervals = np.clip(intervals, IGRF_YEARS[0], IGRF_YEARS[1] - 5)
        for year in np.unique(intervals):
            rows = np.flatnonzero(intervals == year)
            for part in np.array_split(rows, max(1, math.ceil(len(rows) / _ROWS))):
                there = self._whole if len(part) == len(position) else _There(position[part], max_degree)
                field[part] = there.within_interval(int(year), times[part], max_degree)
        return field

    @cached_property
    def _whole(self) -> _There:
        return _There(self._position, self._degree)


def _refuse_outside_domain(times: Times, position: Floats) -> None:
    faults = []
    first, last = (_epoch_ns(year) for year in IGRF_YEARS)
    outside = times[(times < first) | (times > last)]
    if outside.size:
        date = str(np.datetime64(int(outside[0]), "ns"))
        accepted = f"IGRF-14 covers {IGRF_YEARS[0]}-01-01 to {IGRF_YEARS[1]}-01-01; check the time's format and start"
        faults.append(Fault("igrf: time", date, accepted))
    radius = np.linalg.norm(position, axis=1)
    wrong = radius[~((radius >= RADIUS_KM[0]) & (radius <= RADIUS_KM[1]))]
    if wrong.size:
        accepted = f"{RADIUS_KM[0]:g} to {RADIUS_KM[1]:g} km from the Earth's centre is accepted; check the unit"
        faults.append(Fault("igrf: position", f"radius {wrong[0]:.6g} km", accepted))
    if faults:
        raise InputRefusedError(faults)


class _There:
    """What the field at positions (n, 3) ECEF [km] depends on beside the date."""

    def __init__(self, position: Floats, max_degree: int) -> None:
        x, y, z = position.T
        colatitude = np.clip(np.degrees(np.arctan2(np.hypot(x, y), z)), _POLE_DEG, 180.0 - _POLE_DEG)
        self._longitude = np.arctan2(y, x)
        self._theta = np.radians(colatitude)
        self._basis = igrf14.basis_at(np.linalg.norm(position, axis=1), self._theta, self._longitude, max_degree)

    def within_interval(self, year: int, times: Times, max_degree: int) -> Floats:
        """Field (n, 3) [nT] at times (n,) that lie in one five-year interval.

        The coefficients are linear in time between epochs, so the field at fixed place is too: two epochs (one outer
        product over positions) and a weight per sample are exact, at the cost of one date.
        """
        theta, longitude = self._theta, self._longitude
        parts = igrf14.field((year, year + 5), self._basis, max_degree)
        weight = (times - _epoch_ns(year)) / float(_epoch_ns(year + 5) - _epoch_ns(year))
        up, south, east = (part[0] + weight * (part[1] - part[0]) for part in parts)
        across = up * np.sin(theta) + south * np.cos(theta)
        cosine, sine = np.cos(longitude), np.sin(longitude)
        return np.stack(
            [across * cosine - east * sine, across * sine + east * cosine, up * np.cos(theta) - south * np.sin(theta)],
            axis=-1,
        )


def igrf_eci_nt(times_utc_ns: Times, position_eci_km: Floats) -> Floats:
    """IGRF-14 main field (n, 3) [nT] in ECI at positions (n, 3) ECI [km]; domain and errors of ``igrf_ecef_nt``."""
    times = np.asarray(times_utc_ns, dtype=np.int64).reshape(-1)
    return eci_from_ecef(times, igrf_ecef_nt(times, ecef_from_eci(times, position_eci_km)))
