"""Does the motion of the places go with their height, and with one plane?  Units and signs show there."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from magcal_service.base.units import LengthUnit
from magcal_service.earth.geomagnetic import EARTH_KM, LOWEST_ORBIT_KM
from magcal_service.recordings.inspect.finding import Code, Seen
from magcal_service.recordings.inspect.free_fall import orbit_height
from magcal_service.recordings.inspect.log import Log
from magcal_service.recordings.inspect.motion import (
    distinct,
    heights_km,
    inertial,
    kepler_rad_s,
    out_of_plane,
    placed_rows,
    rate_rad_s,
)
from magcal_service.recordings.specs import GeodeticPosition, PlatformKind
from magcal_service.recordings.table import FloatArray
from magcal_service.wire.messages import Frame

_MOST_PLACES: Final = 400
"""Places looked at; choice: the plane and the rate of an orbit need no more."""

_FEWEST_PLACES: Final = 5
"""Places from which on there is a motion to speak of; choice: fewer, and one false place decides."""

_ORBITS_KM: Final = (LOWEST_ORBIT_KM, 60_000.0)
_AGREES: Final = (0.5, 1.5)
"""Of the rate over that of a circular orbit at this height, for eccentric ones too."""

_CLOSE: Final = (0.75, 1.3)
"""The same for a unit that is only guessed: a wrong guess should not fit by chance."""

_ORBITAL_RAD_S: Final = 3e-4
"""2 km/s at the ground: nothing that flies in air."""

_CENTRE: Final = "the distance from the Earth's centre"
"""What a height may be in place of one above the ground."""

_BALLOON_KM: Final = 60.0
"""Height below which a slow craft is no satellite: balloons stay under it."""

_ARC_RAD: Final = 0.35
"""Least arc that is asked for its plane [rad], 20 degrees; choice: a shorter one lies in some plane whatever it is."""

_PLANAR: Final = 3e-3
"""Distance from its plane (rms) that an orbit keeps, as a share of the radius: 20 km.

Choice: places rounded to 0.1 degrees (1.7e-3) keep it; a larger one lets a wrong sign over a short arc pass.
"""

_WORSE: Final = 8.0
"""Times that the plane has to be better with the other sign; choice: noise alone makes no such difference."""


def _track(log: Log) -> tuple[FloatArray, FloatArray] | None:
    """Times (k,) [s] and Earth-fixed or inertial places (k, 3) [km], distinct and thinned; None where too few."""
    placed = placed_rows(log)
    if placed is None or len(placed[0]) < _FEWEST_PLACES:
        return None
    rows, place_km = placed
    kept = distinct(place_km)
    kept = kept[:: -(-len(kept) // _MOST_PLACES)]
    return (log.time_s[rows[kept]], place_km[kept]) if len(kept) >= _FEWEST_PLACES else None


def _is_fixed(log: Log) -> bool:
    return log.recording.position is not None and log.recording.position.frame is Frame.ECEF


def heights_and_times(log: Log) -> Iterator[Seen]:
    """A craft turns about the Earth at the rate of its height, or the height or the time is in another unit."""
    track = _track(log)
    if track is None:
        return
    time_s, place = track
    fixed = _is_fixed(log)
    rate = rate_rad_s(time_s, place)
    true_rate = rate_rad_s(time_s, inertial(time_s, place)) if fixed else rate
    height = float(np.median(heights_km(place)))
    radius = EARTH_KM + height
    if rate <= 0.0:
        return
    if _is_orbit(height, rate) or _is_orbit(height, true_rate):
        yield from orbit_height(log)
        return
    if rate > _ORBITAL_RAD_S and height < LOWEST_ORBIT_KM:
        yield _wrong_height(log, height, rate * radius, _height_units(height, rate))
    elif _ORBITS_KM[0] < height < _ORBITS_KM[1] and (units := _time_units(height, rate)):
        yield _wrong_time(log, height, rate * radius, units)
    elif height > _BALLOON_KM and not _is_stated_elsewhere(log):
        yield _wrong_height(log, height, rate * radius, _height_units(height, rate))


def _is_stated_elsewhere(log: Log) -> bool:
    """Whether the descriptor says that it was made in no orbit: a rocket is high and slow."""
    platform = log.recording.descriptor.platform
    return platform is not None and platform.kind is not PlatformKind.ORBIT


def _is_orbit(height_km: float, rate: float, close: tuple[float, float] = _AGREES) -> bool:
    inside = _ORBITS_KM[0] < height_km < _ORBITS_KM[1]
    return inside and close[0] < rate / kepler_rad_s(EARTH_KM + height_km) < close[1]


def _height_units(height_km: float, rate: float) -> list[str]:
    """What the height may be written in, so that it goes with the motion."""
    guesses = (("km", 1e3), ("m", 1e-3), ("miles", 1.609344e3), ("ft", 3.048e-4))
    found = [name for name, factor in guesses if _is_orbit(height_km * factor, rate, _CLOSE)]
    if _is_orbit(height_km - EARTH_KM, rate, _CLOSE):
        found.append(_CENTRE)
    units = [name for name in found if name in set(LengthUnit)]
    slow = rate < _ORBITAL_RAD_S and 0.0 <= height_km * 1e-3 < _BALLOON_KM
    return units[:1] or found or (["m"] if slow else [])


def _time_units(height_km: float, rate: float) -> list[str]:
    return [
        name
        for name, factor in (("ms", 1e3), ("us", 1e6), ("ns", 1e9), ("s", 1e-3), ("s", 1e-6))
        if _is_orbit(height_km, rate * factor, _CLOSE)
    ]


def _wrong_height(log: Log, height_km: float, speed_km_s: float, units: list[str]) -> Seen:
    says = f"the places move at {speed_km_s:.3g} km/s at a height of {height_km:.3g} km, where no orbit does"
    guess = f"is it in {' or '.join(units)}? " if units else ""
    spec = log.recording.descriptor.position
    if isinstance(spec, GeodeticPosition) and spec.height is not None:
        key = "altitude" if spec.radius is None and _CENTRE not in units else "radius"
        written = f'{key} = {{ column = "{spec.height.column}", unit = "{_unit(units)}" }}'
        remedy = f"check the height's unit: {guess}then write {written} under [position]"
    else:
        remedy = f"check the unit of [position]: {guess or 'is it the right one?'}"
    return Seen(Code.ALTITUDE_UNIT, False, log.rows, says, remedy.strip())


def _unit(guesses: list[str]) -> str:
    return guesses[0] if guesses and guesses[0] in set(LengthUnit) else "km"


def _wrong_time(log: Log, height_km: float, speed_km_s: float, units: list[str]) -> Seen:
    says = (
        f"the places move at {speed_km_s:.3g} km/s at a height of {height_km:.0f} km, where an orbit is far from that"
    )
    kind = log.recording.descriptor.time.format.kind
    remedy = f'check the unit of the times: are they {units[0]}? then write format = "{kind}_{units[0]}" under [time]'
    return Seen(Code.TIME_UNIT, False, log.rows, says, remedy)


def longitude_sign(log: Log) -> Iterator[Seen]:
    """An orbit lies in a plane that does not turn; with longitude (or latitude and longitude) mistaken it does not."""
    track = _track(log)
    if track is None or not _is_fixed(log):
        return
    time_s, place = track
    height = float(np.median(heights_km(place)))
    off, arc = out_of_plane(time_s, place)
    if arc < _ARC_RAD or height < LOWEST_ORBIT_KM or off < _PLANAR:
        return
    mirrored, _ = out_of_plane(time_s, place * np.array([1.0, -1.0, 1.0]))
    if mirrored > _PLANAR or mirrored * _WORSE > off:
        return
    says = (
        f"the places lie {off:.2g} rad out of one plane over an arc of {np.degrees(arc):.0f} deg; "
        f"with the other sign of the longitude {mirrored:.1g} rad"
    )
    remedy = "check the longitude: degrees east are positive; write the column with the other sign into the log"
    yield Seen(Code.LONGITUDE_SIGN, False, log.rows, says, remedy)
