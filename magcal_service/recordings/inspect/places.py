"""Places that are none: no fix, jumps no orbit makes, a place that is held while the craft flies on."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.earth.geomagnetic import LOWEST_ORBIT_KM, WGS84_A_KM
from magcal_service.recordings.inspect.finding import NO_ROWS, Code, Rows, Seen, Spoils, rows_text, rows_that, verb_of
from magcal_service.recordings.inspect.log import Log, runs
from magcal_service.recordings.inspect.motion import distinct, escape_km_s, placed_rows
from magcal_service.recordings.report import RowFault
from magcal_service.recordings.table import FloatArray
from magcal_service.wire.messages import Frame

_SHORTEST_JUMP_KM: Final = 30.0
"""A place this far off is a thousandth of the field off; what is nearer may be the receiver's noise."""

_FASTER: Final = 1.2
"""Factor on the speed that leaves the Earth: what is faster is no orbit, with room for coarse times."""

_MOVING_KM_S: Final = 1.0
"""Speed from which a craft is in flight: an eighth of an orbit's, beyond what flies in air."""

_LONGEST_HOLD: Final = 3.0
"""Times the usual renewal that a place may be held: two fixes may be missed."""

_HOLD_S: Final = 5.0
"""Hold that is no fault however fast places come: 40 km of a low orbit, a thousandth of the field."""


def position_zero(log: Log) -> Iterator[Seen]:
    """Latitude and longitude are exactly 0, or a place that the reader refused lies within the Earth."""
    for entry in log.recording.report.entries:
        if entry.part == "position" and entry.fault is RowFault.ABSURD:
            shows = f" ({entry.shows})" if entry.shows else ""
            says = f"{rows_text(entry.count)}, first on {entry.place} {entry.first_line}{shows}, "
            says += f"{verb_of(entry.count, 'lie')} where no craft is: "
            says += "in the Earth, far off it, or beyond a latitude of 90 degrees"
            remedy = (
                "they have no place; if many have none, check the unit of [position], and its columns: the latitude "
            )
            remedy += "comes first, then the longitude"
            yield Seen(Code.POSITION_ZERO, True, NO_ROWS, says, remedy, refused=entry)
    if log.place_km is None or log.recording.position is None or log.recording.position.frame is not Frame.ECEF:
        return
    x, y, z = log.place_km.T
    at = np.flatnonzero((y == 0.0) & (z == 0.0) & (x > 0.0))
    heights = np.unique(np.round(x[at] - WGS84_A_KM, 6))
    if not len(at) or (len(at) < 2 and heights[0] != 0.0):
        return
    says = f"{rows_that(len(at), 'have', len(log))} the place 0, 0, {heights[0]:g} km high: the receiver had no fix"
    remedy = "their place is not used; where the receiver tells of a fix, leave the cells empty without one"
    yield Seen(Code.POSITION_ZERO, True, log.rows[at], says, remedy, Spoils.PLACE)


def position_jump(log: Log) -> Iterator[Seen]:
    """Places that can be reached from the others only faster than anything leaves the Earth.

    The longest stretch without a jump is believed, and every place that can be reached from what is believed.
    """
    known = placed_rows(log)
    if known is None:
        return
    rows, place = known
    at = distinct(place)  # a place that is held is as old as its first row
    time_s, place = log.time_s[rows[at]], place[at]
    if len(at) < 3:
        return
    far = _jumps(time_s[:-1], place[:-1], time_s[1:], place[1:])
    if not far.any():
        return
    edges = np.concatenate([[0], np.flatnonzero(far) + 1, [len(at)]])
    good = _reachable(time_s, place, edges)
    if good.all() or np.count_nonzero(good) < 0.5 * len(good):
        return
    held = np.repeat(good, np.diff(np.concatenate([at, [len(rows)]])))
    bad = rows[~held]
    fastest = float(np.max((np.linalg.norm(np.diff(place, axis=0), axis=1) / np.diff(time_s))[far]))
    says = f"{rows_that(len(bad), 'have', len(log))} a place {fastest:.3g} km/s from the next: no orbit is so fast"
    remedy = (
        "their place is not used; leave the cells empty where the receiver has no fix; if many jump, check columns "
    )
    remedy += "and unit of [position]"
    yield Seen(Code.POSITION_JUMP, True, log.rows[np.sort(bad)], says, remedy, Spoils.PLACE)


def _jumps(from_s: FloatArray, from_km: FloatArray, to_s: FloatArray, to_km: FloatArray) -> NDArray[np.bool_]:
    distance = np.linalg.norm(to_km - from_km, axis=-1)
    radius = np.minimum(np.linalg.norm(to_km, axis=-1), np.linalg.norm(from_km, axis=-1))
    fastest = _FASTER * escape_km_s(radius)
    return np.asarray(distance - _SHORTEST_JUMP_KM > fastest * np.abs(to_s - from_s))


def _reachable(time_s: FloatArray, place: FloatArray, edges: Rows) -> NDArray[np.bool_]:
    """Flag (k,) of the places in stretches that can be reached from the longest, one after the other to both sides."""
    longest = int(np.argmax(np.diff(edges)))
    good = np.zeros(len(place), dtype=np.bool_)
    good[edges[longest] : edges[longest + 1]] = True
    last = edges[longest + 1] - 1
    for stretch in range(longest + 1, len(edges) - 1):
        first = edges[stretch]
        if not _jumps(time_s[last], place[last], time_s[first], place[first]):
            good[first : edges[stretch + 1]] = True
            last = edges[stretch + 1] - 1
    last = edges[longest]
    for stretch in range(longest - 1, -1, -1):
        end = edges[stretch + 1] - 1
        if not _jumps(time_s[last], place[last], time_s[end], place[end]):
            good[edges[stretch] : end + 1] = True
            last = edges[stretch]
    return good


def position_still(log: Log) -> Iterator[Seen]:
    """The place is held for longer than the receiver takes to renew it, while the craft flies; or it never moves."""
    known = placed_rows(log)
    if known is None:
        return
    rows, place = known
    still = ~np.any(np.diff(place, axis=0), axis=1)
    if still.all():
        yield from _never_moves(log, float(np.linalg.norm(place[0])))
        return
    time_s = log.time_s[rows]
    first, end = runs(still)
    at = distinct(place)
    speed = np.linalg.norm(np.diff(place[at], axis=0), axis=1) / np.diff(time_s[at])
    if not len(first) or float(np.median(speed)) < _MOVING_KM_S:
        return
    usual_s = float(np.median(np.diff(time_s[at])))
    lasting = time_s[end] - time_s[first]
    long = lasting > max(_HOLD_S, _LONGEST_HOLD * usual_s)
    if not long.any():
        return
    bad = np.concatenate([np.arange(a + 1, b + 1) for a, b in zip(first[long], end[long], strict=True)])
    says = (
        f"{rows_that(len(bad), 'repeat', len(log))} a place for up to {lasting.max():.4g} s, "
        f"in which the craft flies {float(np.median(speed)) * lasting.max():.0f} km"
    )
    remedy = "their place is not used; leave the cells empty where the receiver has no new fix"
    yield Seen(Code.POSITION_STILL, True, log.rows[rows[bad]], says, remedy, Spoils.PLACE)


_SYNCHRONOUS_KM: Final = (40_000.0, 44_000.0)
"""Radii at which a craft may stand still over the Earth: geostationary is 42 164 km."""


def _never_moves(log: Log, radius_km: float) -> Iterator[Seen]:
    """One place for all, where only a craft in orbit can be."""
    fixed = log.recording.position is not None and log.recording.position.frame is Frame.ECEF
    synchronous = fixed and _SYNCHRONOUS_KM[0] < radius_km < _SYNCHRONOUS_KM[1]
    if radius_km < WGS84_A_KM + LOWEST_ORBIT_KM or synchronous or float(np.ptp(log.time_s)) < _HOLD_S:
        return
    says = f"all {len(log)} rows have one place, {radius_km - WGS84_A_KM:.0f} km above the equator's radius"
    remedy = (
        "check [position]: a craft at that height moves; give the columns that its orbit is logged in, or leave it out"
    )
    yield Seen(Code.POSITION_STILL, False, log.rows, says, remedy)
