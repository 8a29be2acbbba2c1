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

_MANY: Final = 64
"""Steps from which on blocks of them are faster than one step after another."""

_BLOCK: Final = 48
"""Steps of a block; 32 and 64 take longer for one to six columns of 18 000 rows."""


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
    answer[0] = drive[0] if start is None else start
    shape = (-1,) + (1,) * (drive.ndim - 1)
    pushed = early.reshape(shape) * drive[:-1] + late.reshape(shape) * drive[1:]
    first = np.reshape(answer[0], -1)
    answer[1:] = carried(kept, pushed.reshape(-1, len(first)), first).reshape(pushed.shape)
    return answer


def carried(kept: Array, pushed: Array, value: Array) -> Array:
    """y_k = kept_k y_(k-1) + pushed_k (n, m) from ``value`` (m,), for kept (n,) or (n, m) of 0 to 1.

    Many are worked out by blocks: a row of all of them at a time, from zero, with what is kept since its block began;
    then in the same way the values that blocks begin with (Blelloch 1990, Prefix sums and their applications).
    """
    count, columns = pushed.shape
    each = kept[:, None] if kept.ndim == 1 else kept
    if count <= _MANY:
        answer = np.empty((count, columns))
        for row in range(count):
            value = each[row] * value + pushed[row]
            answer[row] = value
        return answer
    share, found = _blocks(each), _blocks(pushed)
    for row in range(1, _BLOCK):
        found[row] += share[row] * found[row - 1]
        share[row] *= share[row - 1]
    ends = carried(share[-1], found[-1], value)
    found += share * np.concatenate([value[None], ends[:-1]])
    return found.swapaxes(0, 1).reshape(-1, columns)[:count]


def _blocks(rows: Array) -> Array:
    """Rows (n, m) by their place in blocks: (``_BLOCK``, blocks, m), with zeros after the last."""
    count = -(-len(rows) // _BLOCK)
    whole = np.zeros((count * _BLOCK, rows.shape[1]))
    whole[: len(rows)] = rows
    return np.ascontiguousarray(whole.reshape(count, _BLOCK, -1).swapaxes(0, 1))


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
