"""The Sun as a driver: its direction, the Earth's shadow, and first-order responses to light.

Separate from the simulator's Sun on purpose: what tests the diagnosis shares no code with what it explains with.
Source: Meeus 1998, Astronomical Algorithms, chapter 25 (low accuracy, 0.01 deg); Vallado 2013, section 5.3 (shadow).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.earth.geomagnetic import WGS84_A_KM
from magcal_service.model import Array

_DAY_S = 86400.0
"""Seconds in a day."""

_J2000_S = 946_728_000.0
"""2000-01-01T12:00 UTC, in seconds since 1970: where the elements of the Sun are counted from."""

_ROUND = np.array([1.0, 1.0, 1.0 / (1.0 - 1.0 / 298.257223563)])
"""Stretch of the axes that makes a sphere of the Earth: equatorial over polar radius along z (WGS 84)."""

_PENUMBRA_RAD = 0.00465
"""The Sun's radius as seen from the Earth [rad]: 16 arc minutes."""

_STRETCH: Final = 20.0
"""Time constants over which growing exponentials are summed: e^20 costs nine of sixteen digits of what is forgotten."""

_NOTHING: Final = 1e-20
"""Of a value, what no double sees beside it."""

_MANY: Final = 64
"""Steps from which on sums over stretches are faster than one step after another."""


def sun_eci(utc_s: Array, ahead_rad: float = 0.0) -> Array:
    """Unit vectors (n, 3) from the Earth to the Sun, ECI of date, at UTC seconds since 1970 (n,).

    ``ahead_rad``: how far along the ecliptic it is taken ahead of where it is then.
    """
    centuries = (utc_s - _J2000_S) / (36525.0 * _DAY_S)
    mean_longitude = np.radians(280.46646 + 36000.76983 * centuries)
    anomaly = np.radians(357.52911 + 35999.05029 * centuries)
    centre = np.radians(
        (1.914602 - 0.004817 * centuries) * np.sin(anomaly)
        + (0.019993 - 0.000101 * centuries) * np.sin(2.0 * anomaly)
        + 0.000289 * np.sin(3.0 * anomaly)
    )
    longitude = mean_longitude + centre + ahead_rad
    obliquity = np.radians(23.439291 - 0.0130042 * centuries)
    y = np.sin(longitude)
    return np.stack([np.cos(longitude), y * np.cos(obliquity), y * np.sin(obliquity)], axis=-1)


def sunlit(position_eci_km: Array, sun: Array) -> Array:
    """Share of sunlight (n,), 1 in light, 0 in shadow, linear through the penumbra.

    The Earth's flattening is taken by stretching z, of places and of the rays alike: a ray that touches the ellipsoid
    then touches a sphere.  What the air bends and takes up is left out.
    """
    stretched, ray = position_eci_km * _ROUND, sun * _ROUND
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    along = np.einsum("ni,ni->n", stretched, ray)
    across = np.sqrt(np.maximum((stretched**2).sum(axis=1) - along**2, 0.0))
    radius = WGS84_A_KM
    width = np.maximum(np.abs(along), 1.0) * _PENUMBRA_RAD
    share = np.clip((across - radius) / (2.0 * width) + 0.5, 0.0, 1.0)
    return np.where(along > 0.0, 1.0, share)


def first_order(time_s: Array, drive: Array, tau_s: float, start: Array | float | None = None) -> Array:
    """Response y (n, ...) of dy/dt = (drive - y) / tau at rising times (n,), the drive taken linear between samples.

    ``start`` is y at the first sample; None: the drive's first value.  Exact for a drive that is linear in between.
    """
    steps = np.diff(time_s)
    kept = np.exp(-steps / tau_s)
    # y1 = kept y0 + a u0 + c u1 with the ramp's exact weights
    ramp = np.where(steps > 1e-9 * tau_s, (1.0 - kept) * tau_s / np.maximum(steps, 1e-12), 1.0)
    late, early = 1.0 - ramp, ramp - kept
    answer = np.empty_like(drive, dtype=np.float64)
    value = np.array(drive[0] if start is None else start, dtype=np.float64)
    answer[0] = value
    shape = (-1,) + (1,) * (drive.ndim - 1)
    pushed = early.reshape(shape) * drive[:-1] + late.reshape(shape) * drive[1:]
    if len(steps) > _MANY and tau_s > 0.0:
        wide = pushed.reshape(len(pushed), -1)
        if _STRETCH * tau_s > _MANY * float(np.median(steps)):
            found = _in_stretches(np.cumsum(steps) / tau_s, wide, value.reshape(-1))
        else:
            found = carried(kept, wide, value.reshape(-1))
        answer[1:] = found.reshape(pushed.shape)
        return answer
    for index in range(len(steps)):
        value = kept[index] * value + pushed[index]
        answer[index + 1] = value
    return answer


def _in_stretches(aged: Array, pushed: Array, value: Array) -> Array:
    """``carried`` for a long memory: kept_k = exp(-(aged_k - aged_(k-1))), in a few stretches.

    Of ``_STRETCH`` time constants each: y_k = exp(-aged_k) (y_0 + sum exp(aged_j) pushed_j) within each.
    """
    found = np.empty_like(pushed)
    first, before = 0, 0.0
    while first < len(aged):
        last = max(int(np.searchsorted(aged, before + _STRETCH, side="right")), first + 1)
        since = (aged[first:last] - before)[:, None]
        if last == first + 1:  # one gap may be longer than a stretch
            found[first] = np.exp(-since[0]) * value + pushed[first]
        else:
            grown = np.exp(since)
            found[first:last] = (value + np.cumsum(grown * pushed[first:last], axis=0)) / grown
        value, before, first = found[last - 1], float(aged[last - 1]), last
    return found


def carried(kept: Array, pushed: Array, value: Array) -> Array:
    """y_k = kept_k y_(k-1) + pushed_k (n, m) from ``value`` (m,), for kept (n,) or (n, m) of 0 to 1, a short memory.

    By doubling (Hillis & Steele 1986): after each pass y_k holds twice as many terms, until what is kept over them is
    below the last bit.
    """
    found, share = np.array(pushed, dtype=np.float64), np.array(kept, dtype=np.float64).reshape(len(kept), -1)
    found[0] += share[0] * value
    share[0], reach = 0.0, 1
    while reach < len(found) and float(share.max()) > _NOTHING:
        found[reach:] += share[reach:] * found[:-reach]
        share[reach:] *= share[:-reach].copy()
        share[:reach] = 0.0
        reach *= 2
    return found


def hold_over_nan(values: Array) -> Array:
    """The values (n, k) with NaN filled by linear interpolation over the row number, ends held; all-NaN becomes 0.

    Where nothing is missing they are the same array.
    """
    if np.isfinite(values).all():
        return np.asarray(values, dtype=np.float64)
    filled = np.array(values, dtype=np.float64)
    rows = np.arange(len(filled))
    for column in filled.T:
        good: NDArray[np.bool_] = np.isfinite(column)
        column[~good] = np.interp(rows[~good], rows[good], column[good]) if good.any() else 0.0
    return filled
