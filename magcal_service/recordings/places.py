"""Places of rows that have none, from those around them: an orbit is smooth."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.recordings.table import FloatArray

_LONGEST_S: Final = 300.0
"""Gap between two places that is filled [s]: six places around it tell an orbit within it to less than 0.1 km, which
moves the field by 2 nT; a receiver that has lost its satellites for longer may come back with a wrong fix."""

_BEYOND_S: Final = 60.0
"""Beyond the first and the last place, the same [s]: three places on one side are off by 2 km there."""

_APART_S: Final = 60.0
"""From one of the places that a gap is filled by to the next [s]; choice: closer ones would carry a receiver's noise of
10 m far, and an orbit turns by 4 degrees in it."""

_ON_A_SIDE: Final = 3
"""Places on either side of a gap; choice: two would be off by kilometres in five minutes."""


def filled(time_s: FloatArray, position_km: FloatArray) -> FloatArray | None:
    """Places of all rows, or None where a gap is longer than five minutes, or one minute at an end.

    Parameters
    ----------
    time_s: (n,) rising [s].
    position_km: (n, 3), in a frame in which the craft moves smoothly [km]; not finite where there is none.
    """
    known = np.isfinite(position_km).all(axis=1)
    if known.all():
        return position_km
    rows = np.flatnonzero(known)
    if len(rows) < 2 * _ON_A_SIDE:
        return None
    found, at_s = np.array(position_km), time_s[rows]
    missing = np.flatnonzero(~known)
    for gap in np.split(missing, np.flatnonzero(np.diff(missing) > 1) + 1):
        after = int(np.searchsorted(rows, gap[0]))  # of the known ones, the first behind the gap
        if not _is_short(time_s[gap], at_s, after):
            return None
        by = rows[_support(at_s, after)]
        found[gap] = _through(time_s[by] - time_s[gap[0]], position_km[by], time_s[gap] - time_s[gap[0]])
    return found if np.isfinite(found).all() else None  # two rows of one time


def _is_short(gap_s: FloatArray, at_s: FloatArray, after: int) -> bool:
    """Whether a gap at some times lies between known ones (m,) near enough, of which the ``after``-th is behind it."""
    if 0 < after < len(at_s):
        return float(at_s[after] - at_s[after - 1]) <= _LONGEST_S
    edge = at_s[-1] if after else at_s[0]
    return float(np.abs(gap_s - edge).max()) <= _BEYOND_S


def _support(at_s: FloatArray, after: int) -> NDArray[np.intp]:
    """Of known times (m,) up to three on each side of a gap: the nearest and others a minute further each, as near as
    there are."""
    away = _APART_S * np.arange(_ON_A_SIDE)
    later = np.searchsorted(at_s, at_s[after] + away) if after < len(at_s) else []
    sooner = np.searchsorted(at_s, at_s[after - 1] - away, side="right") - 1 if after else []
    return np.unique(np.clip([*sooner, *later], 0, len(at_s) - 1))


def _through(times: FloatArray, places: FloatArray, at: FloatArray) -> FloatArray:
    """Values (m, 3) at some times (m,) of the polynomials through places (k, 3) at times (k,) (Lagrange)."""
    weights = np.ones((len(at), len(times)))
    for one, time in enumerate(times.tolist()):
        for other in np.delete(times, one).tolist():
            weights[:, one] *= (at - other) / (time - other)
    return np.asarray(weights @ places)
