"""Where a log was made: latitude and longitude or three coordinates, checked by how fast they move."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.base.units import LENGTH_KM, AngleUnit, LengthUnit
from magcal_service.earth.geomagnetic import ecef_from_geocentric
from magcal_service.recordings.describe.altitude import ORBITAL_KM_S, find_altitude
from magcal_service.recordings.describe.columns import Column, Log, Triple
from magcal_service.recordings.describe.draft import NO, Draft, Question, answered
from magcal_service.recordings.describe.kinds import kind_of_triple
from magcal_service.recordings.describe.orbit_motion import frame_of_way, orbit_height_km
from magcal_service.recordings.describe.over_ground import (
    EARTH_KM,
    NEEDED,
    ground_speed_km_s,
    is_place,
    moves_as_orbit,
    other_way_round,
)
from magcal_service.recordings.describe.place_unit import Degrees, in_degrees
from magcal_service.recordings.describe.radius import CENTRED, RADIUS_KM, find_radius
from magcal_service.recordings.describe.time_check import doubt_by_way
from magcal_service.recordings.describe.times_found import Times
from magcal_service.recordings.describe.unit_answer import AnsweredUnit
from magcal_service.recordings.describe.vocabulary import LATITUDE, LONGITUDE, Kind, frame_of

FloatArray = npt.NDArray[np.float64]

_FASTEST_KM_S: Final = 12.0  # nothing near the Earth goes faster
_LOW_KM: Final = (120.0, 2500.0)  # heights of a low orbit
_NO_LATITUDE: Final = "a latitude of"


@dataclass(frozen=True, slots=True)
class Place:
    """A position as the draft has it.

    Parameters
    ----------
    columns: numbers of its columns.
    in_orbit: whether it moves as a craft in orbit; None where that is not known.
    latitude_deg: (n,) where it is geodetic.
    altitude_open: whether the altitude has to be asked.
    """

    columns: tuple[int, ...]
    in_orbit: bool | None
    latitude_deg: FloatArray | None = None
    longitude_deg: FloatArray | None = None
    altitude_km: float | None = None
    cartesian_km: FloatArray | None = None
    frame: str = ""
    altitude_open: bool = False


def find_place(draft: Draft, times: Times | None, groups: list[Triple]) -> Place | None:
    """Put the position into the draft where there is one; asks what is open."""
    tle = draft.answers.get("position.tle")
    if tle is not None:
        if not Path(tle).is_file():
            raise InputRefusedError(
                [Fault("--answer position.tle", tle, "a file of two-line element sets is accepted")]
            )
        draft.put("position", "tle", draft.beside(Path(tle)))
        draft.conclude("position.tle", tle, answered("position.tle"))
        return Place((), True)
    if draft.answers.get("position.columns") == NO:
        draft.conclude("position", "left out", answered("position.columns"))
        return None
    chosen = draft.columns("position.columns", (2, 3))
    if chosen is not None and len(chosen) == 2:
        degrees = in_degrees(draft, chosen[0], chosen[1], times)
        return _geodetic(draft, times, degrees, answered("position.columns"))
    if chosen is not None:
        x, y, z = chosen
        return _cartesian(draft, times, Triple((x, y, z), "", x.words), answered("position.columns"))
    return _by_names(draft, times) or _cartesian_by_names(draft, times, groups) or _by_motion(draft, times)


def _one(log: Log, words: set[str]) -> list[Column]:
    return [c for c in log.columns if c.numeric and (set(c.words) & words or c.stem.lower() in words)]


def _by_names(draft: Draft, times: Times | None) -> Place | None:
    latitudes, longitudes = _one(draft.log, LATITUDE), _one(draft.log, LONGITUDE)
    if not latitudes or not longitudes:
        return None
    degrees = in_degrees(draft, latitudes[0], longitudes[0], times)
    latitude, longitude = degrees.columns
    doubt_by_way(draft, times, latitude, longitude)
    fault = _no_place(latitude, longitude, draft.log, times)
    exchanged = fault.startswith(_NO_LATITUDE) and not _no_place(longitude, latitude, draft.log, times)
    by_plane = other_way_round(latitude, longitude, draft.log, times)
    if by_plane:
        fault, exchanged = by_plane, True
    if not fault:
        moving = _moving_pair(draft.log, times, besides=(latitude.number, longitude.number))
        if moving is None or moves_as_orbit(latitude.values, longitude.values, draft.log, times):
            return _geodetic(draft, times, degrees, "")
        fault = "other columns move over the ground as a craft in orbit does, and these do not"
    return _doubted(draft, times, degrees, fault, exchanged=exchanged)


def _doubted(draft: Draft, times: Times | None, degrees: Degrees, fault: str, *, exchanged: bool) -> Place | None:
    """Ask for the columns where the header's are not believed and others are likelier."""
    latitude, longitude = degrees.columns
    moving = (longitude, latitude) if exchanged else _moving_pair(draft.log, times)
    says = f"the header calls {latitude.label} and {longitude.label} a position, but {fault}"
    draft.said.append(f"position: not believed: {says}")
    if moving is None:
        return None
    value = ",".join(draft.names(moving))
    why = "the same two the other way round" if exchanged else "these move over the ground as a craft in orbit does"
    asks = f"{says}: the header seems to name the wrong columns. Which are latitude and longitude?"
    draft.ask(Question("position.columns", asks, ((value, why),), value))
    draft.doubted = not exchanged
    return _asked(moving) if moves_as_orbit(moving[0].values, moving[1].values, draft.log, times) else None


def _asked(pair: tuple[Column, Column]) -> Place:
    """What is likely to be answered: good enough to judge the magnetometer by."""
    latitude, longitude = pair
    numbers = (latitude.number, longitude.number)
    return Place(numbers, True, latitude.values, longitude.values, altitude_open=True)


def likely_height(place: Place, times: Times | None) -> tuple[tuple[str, str], ...]:
    """The height [km] that the motion of a craft in orbit speaks for, as a candidate for an answer."""
    if times is None or not place.in_orbit or place.latitude_deg is None or place.longitude_deg is None:
        return ()
    height = orbit_height_km(place.latitude_deg, place.longitude_deg, times.seconds)
    if height is None or not _LOW_KM[0] < height < _LOW_KM[1]:
        return ()
    return ((f"{height:.0f}", "that of a round orbit that moves so"),)


def _no_place(latitude: Column, longitude: Column, log: Log, times: Times | None) -> str:
    """Why two columns are no latitude and longitude in degrees; empty where they can be."""
    lat, lon = latitude.values, longitude.values
    if not np.isfinite(lat).any() or not np.isfinite(lon).any():
        return "they hold no numbers"
    for column in (latitude, longitude):
        if column.unit not in {"", "deg"}:
            return f"the name says {column.unit}, and degrees are needed"
    if not is_place(lat, lon):
        return f"{_NO_LATITUDE} {float(np.nanmax(np.abs(lat))):.7g} is none in degrees"
    if times is None:
        return ""
    speeds = ground_speed_km_s(lat, lon, times, log)
    if speeds.size >= NEEDED and float(np.quantile(speeds, 0.75)) > _FASTEST_KM_S:
        return f"they would move at {float(np.median(speeds)):.3g} km/s"
    return ""


def _moving_pair(log: Log, times: Times | None, besides: tuple[int, ...] = ()) -> tuple[Column, Column] | None:
    """Two neighbouring columns that move over the ground as a craft in a low orbit."""
    if times is None:
        return None
    for first, second in zip(log.columns, log.columns[1:], strict=False):
        for lat, lon in ((first, second), (second, first)):
            if {lat.number, lon.number} <= set(besides) or not (lat.numeric and lon.numeric):
                continue
            if moves_as_orbit(lat.values, lon.values, log, times):
                return (lon, lat) if other_way_round(lat, lon, log, times) else (lat, lon)
    return None


def _by_motion(draft: Draft, times: Times | None) -> Place | None:
    """No name says a position: ask where two columns move as one."""
    if any(question.key == "position.columns" for question in draft.questions):
        return None
    moving = _moving_pair(draft.log, times)
    if moving is not None:
        value = ",".join(draft.names(moving))
        asks = "no name says a position; are these latitude and longitude, which move as a craft in orbit does?"
        candidates = ((value, "ground speed of a low orbit"), (NO, "no position"))
        draft.ask(Question("position.columns", asks, candidates, value))
        return _asked(moving)
    found = _orbiting(draft, times)
    if found is not None:
        triple, frame = found
        value = ",".join(draft.names(triple.columns))
        asks = "no name says a position; are these its x, y, z, which go round the Earth in a plane?"
        candidates = ((value, f"as {frame} the plane of the orbit stands still"), (NO, "no position"))
        draft.ask(Question("position.columns", asks, candidates, value))
        km = triple.values * LENGTH_KM[LengthUnit(_cartesian_unit(triple))]
        return Place(tuple(column.number for column in triple.columns), True, cartesian_km=km, frame=frame)
    return None


def _orbiting(draft: Draft, times: Times | None) -> tuple[Triple, str] | None:
    """Three neighbouring columns without a name that go round the Earth's centre, and in which frame."""
    free = [column for column in draft.log.columns if column.numeric and column.number not in draft.reserved]
    for three in zip(free, free[1:], free[2:], strict=False):
        if times is None or any(column.name for column in three):
            continue
        triple = Triple(three, "", ())
        unit = _cartesian_unit(triple)
        frame = frame_of_way(triple.values * LENGTH_KM[LengthUnit(unit)], times.seconds) if unit else ""
        if frame:
            return triple, frame
    return None


def _geodetic(draft: Draft, times: Times | None, degrees: Degrees, by: str) -> Place:
    latitude, longitude = degrees.columns
    speed = None
    if times is not None:
        speeds = ground_speed_km_s(latitude.values, longitude.values, times, draft.log)
        speed = float(np.median(speeds)) if speeds.size >= NEEDED else None
        speed = float(speeds.mean()) if speed == 0.0 else speed  # a receiver that is slower than the rows
    moves = "" if speed is None else f", moving at {speed:.3g} km/s"
    why = by or f"the names say latitude and longitude, and the numbers are degrees of such{moves}"
    draft.put("position", "columns", draft.names((latitude, longitude)))
    draft.conclude("position.columns", f"{latitude.label}, {longitude.label}", why)
    if degrees.unit is not AngleUnit.DEG:
        draft.put("position", "unit", degrees.unit.value)
        draft.conclude("position.unit", degrees.unit, degrees.why)
    in_orbit = None if speed is None else speed > ORBITAL_KM_S
    numbers: tuple[int, ...] = (latitude.number, longitude.number)
    radius = find_radius(draft, latitude, longitude)
    if radius is not None:
        out, unit = radius
        km = ecef_from_geocentric(latitude.values, longitude.values, out.values * LENGTH_KM[unit])
        known = (latitude.values, longitude.values)
        return Place((*numbers, out.number), in_orbit, *known, cartesian_km=km, frame="ecef")
    parts = degrees.unit in {AngleUnit.E7, AngleUnit.E6}
    altitude = find_altitude(draft, times, speed, parts=parts)
    if isinstance(altitude, tuple):
        column, height = altitude
        numbers = (*numbers, column)
    else:
        height = altitude
    return Place(numbers, in_orbit, latitude.values, longitude.values, height, altitude_open=height is None)


def _cartesian_by_names(draft: Draft, times: Times | None, groups: list[Triple]) -> Place | None:
    for triple in groups:
        kind, unit = kind_of_triple(triple), _cartesian_unit(triple)
        if unit and (kind is Kind.POSITION or (kind is Kind.UNKNOWN and unit != "km")):  # km could be a field in nT
            return _cartesian(draft, times, triple, "")
    return None


def _cartesian_unit(triple: Triple) -> str:
    good = triple.values[np.isfinite(triple.values).all(axis=1)]
    if not len(good):
        return ""
    radius = np.sqrt((good**2).sum(axis=1))
    shortest, longest = (float(q) for q in np.quantile(radius, (0.02, 0.98)))
    units = [u for u in CENTRED if RADIUS_KM[0] < shortest * LENGTH_KM[u] and longest * LENGTH_KM[u] < RADIUS_KM[1]]
    return units[0] if len(units) == 1 and triple.unit in {"", units[0]} else ""


def _cartesian(draft: Draft, times: Times | None, triple: Triple, by: str) -> Place | None:
    told = draft.answers.unit("position.unit", LengthUnit)
    unit = _cartesian_unit(triple) if told is None else told.unit
    radius = float(np.nanmedian(np.sqrt((triple.values**2).sum(axis=1))))
    frame = draft.frame("position.frame", ("ecef", "eci")) or frame_of(triple.words)
    if not unit:
        asks = f"in which unit are {triple.label}? they are {radius:.6g} from the Earth's centre"
        candidates = tuple((one.value, "") for one in CENTRED)
        draft.ask(Question("position.unit", asks, candidates, "km", scaled="1.852 km"))
        return None
    by_way = "" if frame or times is None else frame_of_way(triple.values, times.seconds)
    if by_way:
        frame = by_way
        draft.conclude("position.frame", frame, "the plane of the orbit stands still in it, and turns in the other")
    if not frame:
        asks = f"in which frame are {triple.label}? no name says whether it turns with the Earth"
        candidates = (("ecef", "turns with the Earth, as GPS gives"), ("eci", "inertial, as SGP4 gives"))
        draft.ask(Question("position.frame", asks, candidates, "ecef"))
        return None
    why = by or f"the names and a distance of {radius:.6g} {unit} from the Earth's centre say so"
    draft.put("position", "columns", draft.names(triple.columns))
    size = told or AnsweredUnit(unit)
    draft.put_unit("position", size)
    draft.put("position", "frame", frame)
    draft.conclude("position.columns", f"{triple.label} in {size}, {frame}", why)
    unit_km = size.factor * LENGTH_KM[LengthUnit(unit)]
    km = triple.values * unit_km
    numbers = tuple(column.number for column in triple.columns)
    high = radius * unit_km > EARTH_KM + _LOW_KM[0]
    return Place(numbers, high, cartesian_km=km, frame=frame)
