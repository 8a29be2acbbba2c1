"""In orbit a place falls as gravity pulls at its height (``earth.free_fall``): one in miles does not go with that."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from magcal_service.earth.free_fall import OFF, falls
from magcal_service.earth.geomagnetic import LOWEST_ORBIT_KM
from magcal_service.recordings.inspect.finding import Code, Seen
from magcal_service.recordings.inspect.log import Log
from magcal_service.recordings.inspect.motion import heights_km, inertial, placed_rows
from magcal_service.recordings.table import FloatArray
from magcal_service.residuals import median_and_sigma
from magcal_service.wire.messages import Frame

_STEP_S: Final = 300.0
"""Between the three places [s]: 18 degrees of a low orbit, in which places rounded to 0.01 degrees are 0.3 % off."""

_LONGEST_S: Final = 600.0  # where rows are further apart: a tenth of a low orbit
_EVEN: Final = 0.01  # share of the step by which the two may differ: what that adds is as small a share of the fall
_FEWEST: Final = 10  # choice: fewer falls than this may be a few false places

_PLANAR: Final = 0.01
"""Distance from its plane (rms) that an orbit keeps, as a share of the radius: in a day the plane turns by 0.1 of that,
and places rounded to a degree keep it."""

_SCATTER: Final = 5.0  # the median has to be off by so many of its own sigma


def orbit_height(log: Log) -> Iterator[Seen]:
    """Places in orbit that fall otherwise than at their height."""
    placed, position = placed_rows(log), log.recording.position
    if placed is None or position is None:
        return
    rows, place = placed
    if float(np.median(heights_km(place))) < LOWEST_ORBIT_KM:
        return
    time_s = log.time_s[rows]
    if position.frame is Frame.ECEF:
        place = inertial(time_s, place)
    unit = place / np.linalg.norm(place, axis=1)[:, None]
    if np.sqrt(max(float(np.linalg.eigvalsh(unit.T @ unit / len(unit))[0]), 0.0)) > _PLANAR:
        return  # something else is wrong with them: a sign, or the frame
    found = falls_of(time_s, place)
    if len(found) < _FEWEST:
        return
    middle, sigma = median_and_sigma(found)
    if abs(middle - 1.0) < max(OFF, _SCATTER * sigma):
        return
    radius = float(np.median(np.linalg.norm(place, axis=1)))
    off_km = radius * (1.0 - middle ** (-1.0 / 3.0))
    says = (
        f"the places fall towards the Earth {middle:.3g} times as fast as an orbit at their height does; "
        f"that of one {abs(off_km):.0f} km {'lower' if off_km > 0.0 else 'higher'} would fit"
    )
    remedy = (
        "check the height's unit and what it is counted from (above the ellipsoid is accepted; a distance from the "
        "centre is a radius), and the frame and the time of the places"
    )
    yield Seen(Code.ORBIT_HEIGHT, False, log.rows, says, remedy)


def falls_of(time_s: FloatArray, place_km: FloatArray) -> FloatArray:
    """n^2 r^3 / GM (k,) of places (n, 3) at times (n,), by those a step before and behind each."""
    after = np.searchsorted(time_s, time_s + _STEP_S - 1e-6)
    before = np.searchsorted(time_s, time_s - _STEP_S + 1e-6, side="right") - 1
    inside = np.flatnonzero((after < len(time_s)) & (before >= 0))
    after, before = after[inside], before[inside]
    ahead, behind = time_s[after] - time_s[inside], time_s[inside] - time_s[before]
    step = 0.5 * (ahead + behind)
    even = (np.abs(ahead - behind) < _EVEN * step) & (step <= _LONGEST_S)
    here, first, last = place_km[inside[even]], place_km[before[even]], place_km[after[even]]
    return falls(behind[even], first, here, ahead[even], last)
