"""The main field at a place on the Earth, as tables of it have it."""

from __future__ import annotations

from magcal_service.earth.geomagnetic import Floats, Times, ecef_from_geodetic, igrf_ecef_nt, ned_from_ecef


def igrf_ned_nt(times_utc_ns: Times, latitude_deg: Floats, longitude_deg: Floats, altitude_km: Floats) -> Floats:
    """IGRF-14 main field (n, 3) [nT] north, east, down at geodetic latitude, longitude [deg], height [km], each (n,).

    Domain and errors of ``igrf_ecef_nt``.
    """
    field_ecef_nt = igrf_ecef_nt(times_utc_ns, ecef_from_geodetic(latitude_deg, longitude_deg, altitude_km))
    return ned_from_ecef(latitude_deg, longitude_deg, field_ecef_nt)
