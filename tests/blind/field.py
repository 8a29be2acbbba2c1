"""The main field along a path, and the field of a ring current round the Earth.

The main field is IGRF-14 through ``magcal_service.earth.geomagnetic`` on an even grid of times, with cubic pieces
between.  The part above a degree comes from ppigrf directly.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
import ppigrf

from magcal_service.earth import geomagnetic
from tests.blind.vectors import Floats, OverTime, dot, hermite, turn, unit

STEP_S = 20.0
YEAR_S = 365.25 * 86400.0
POLE_DEG = (80.65, -72.68)  # north geomagnetic pole of 2020, where the centred dipole's axis comes out
INDUCED = 0.27  # internal over external part of a ring current's field on the ground (Langel & Estes 1985)


@dataclass(frozen=True, slots=True, eq=False)
class FieldTrack:
    """A field (m, 3) [nT] ECI on an even grid; called with times (n,) it gives (n, 3)."""

    start_s: float
    values_nt: Floats

    def __call__(self, times_s: Floats) -> Floats:
        return hermite(self.start_s, STEP_S, self.values_nt, times_s)


def times_ns(start_unix_s: float, times_s: Floats) -> geomagnetic.Times:
    """UTC [ns] of times since the first sample."""
    return np.asarray(np.round((start_unix_s + times_s) * 1e3), dtype=np.int64) * 1_000_000


def main_field_track(
    position_km: OverTime,
    start_unix_s: float,
    span_s: tuple[float, float],
    years_old: float = 0.0,
    max_degree: int = 13,
) -> FieldTrack:
    """The main field along a path.

    Parameters
    ----------
    position_km: places (n, 3) ECI [km] at times (n,).
    start_unix_s: UTC of time zero.
    span_s: first and last time that may be asked for.
    years_old: how old the field's coefficients are; the Earth has turned all the same.
    max_degree: highest degree of the expansion.
    """
    times = np.arange(span_s[0] - 3.0 * STEP_S, span_s[1] + 4.0 * STEP_S, STEP_S)
    utc = times_ns(start_unix_s, times)
    position = geomagnetic.ecef_from_eci(utc, position_km(times))
    dates = utc - round(years_old * YEAR_S) * 10**9
    field = geomagnetic.igrf_ecef_nt(dates, position)
    if max_degree < 13:
        field = field - _degrees_above(max_degree, start_unix_s, position)
    return FieldTrack(float(times[0]), geomagnetic.eci_from_ecef(utc, field))


def _degrees_above(degree: int, unix_s: float, position_ecef_km: Floats) -> Floats:
    """The field's part of the degrees above one, (n, 3) [nT] ECEF, of one date."""
    radius = np.linalg.norm(position_ecef_km, axis=1)
    colatitude = np.arccos(position_ecef_km[:, 2] / radius)
    longitude = np.arctan2(position_ecef_km[:, 1], position_ecef_km[:, 0])
    date = datetime.fromtimestamp(unix_s, UTC).replace(tzinfo=None)
    parts = ppigrf.igrf_gc(radius, np.degrees(colatitude), np.degrees(longitude), date, min_degree=degree + 1)
    up, south, east = (np.asarray(part).reshape(-1) for part in parts)
    out = unit(position_ecef_km)
    easterly = np.stack([-np.sin(longitude), np.cos(longitude), np.zeros_like(longitude)], axis=-1)
    southerly = np.cross(easterly, out)
    return np.asarray(up[:, None] * out + south[:, None] * southerly + east[:, None] * easterly, dtype=np.float64)


def dipole_axis_eci(start_unix_s: float, times_s: Floats) -> Floats:
    """Unit vectors (n, 3) ECI along the centred dipole's axis, to the north."""
    latitude, longitude = np.radians(POLE_DEG)
    cosine = np.cos(latitude)
    axis = np.array([cosine * np.cos(longitude), cosine * np.sin(longitude), np.sin(latitude)])
    utc = times_ns(start_unix_s, times_s)
    return geomagnetic.eci_from_ecef(utc, np.broadcast_to(axis, (len(times_s), 3)))


def ring_current_field(dst_nt: Floats, axis: Floats, position_km: Floats) -> Floats:
    """Field (n, 3) [nT] of a ring current and of what it induces in the Earth.

    Parameters
    ----------
    dst_nt: (n,) northward field of both on the ground at the dipole's equator; negative in a storm.
    axis: (n, 3) dipole axis to the north.
    position_km: (n, 3) in the same axes.

    Outside the Earth the external part is uniform along the axis and the induced one is a dipole's.
    """
    # on the ground at the equator the uniform part q gives q to the north and the induced dipole gives INDUCED q
    uniform = dst_nt / (1.0 + INDUCED)
    radius = np.linalg.norm(position_km, axis=-1)
    up = unit(position_km)
    share = (uniform * INDUCED * (6371.2 / radius) ** 3)[:, None]
    # a dipole m along the axis gives (3 (m.r) r - m): at the equator -m, so m points south for a northward field
    induced = share * (axis - 3.0 * dot(axis, up)[:, None] * up)
    return np.asarray(uniform[:, None] * axis + induced, dtype=np.float64)


def to_body(attitude: OverTime, field_eci: OverTime) -> OverTime:
    """The field (n, 3) in the body as a function of time."""
    return lambda times: turn(attitude(times), field_eci(times))
