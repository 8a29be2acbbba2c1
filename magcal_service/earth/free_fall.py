"""In orbit a place falls as gravity pulls at its height: a height that is off, however smooth, does not go with that.

With n^2 r^3 = GM on every orbit, and a place a time s before and one a time t behind that at r,

    2 / (s + t) ((a - 1) / t + (b - 1) / s) = -n^2 + n^4 (s^2 - s t + t^2) / 12,     a, b = (place . r) / r^2,

to fourth order of n s and n t times the eccentricity: n is measured and r told.  A height that is off by d makes
n^2 r^3 / GM = (1 + d/r)^3 where the orbit is nearly round; on any other it is off too, by another amount.  Source: f
and g series of the two-body problem, such as Vallado 2013, section 2.3.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.earth.geomagnetic import Floats

MU_KM3_S2: Final = 398_600.4418
"""Gravitational parameter of the Earth (WGS84)."""

OFF: Final = 0.03
"""Of n^2 r^3 / GM from 1: a hundredth of the radius, 70 km, which is 3 % of the field.  The Earth's flattening and
a height that is told as constant make 0.6 %, and field models hardly differ by what less does."""

_SLOWEST_RAD_S: Final = 3e-4  # 2 km/s at the ground: nothing that flies in air


def falls(before_s: Floats, before_km: Floats, here_km: Floats, after_s: Floats, after_km: Floats) -> Floats:
    """n^2 r^3 / GM (k,) of places (n, 3) in axes that do not turn, without those that are too slow for an orbit.

    Parameters
    ----------
    before_s, after_s: how long before and after each place the two beside it are (n,) [s].
    before_km, here_km, after_km: the places (n, 3) [km].
    """
    radius2 = (here_km**2).sum(axis=1)
    behind = (before_km * here_km).sum(axis=1) / radius2 - 1.0
    ahead = (after_km * here_km).sum(axis=1) / radius2 - 1.0
    fall = -2.0 / (before_s + after_s) * (ahead / after_s + behind / before_s)
    bent = (before_s**2 - before_s * after_s + after_s**2) / 12.0
    rate2 = (1.0 - np.sqrt(np.maximum(1.0 - 4.0 * bent * fall, 0.0))) / (2.0 * bent)
    ends = np.linalg.norm(before_km, axis=1) * np.linalg.norm(after_km, axis=1)
    turned = np.arccos(np.clip((before_km * after_km).sum(axis=1) / ends, -1.0, 1.0))
    flies = turned > _SLOWEST_RAD_S * (before_s + after_s)
    return np.asarray((rate2 * radius2**1.5 / MU_KM3_S2)[flies])
