"""Where a log was made: latitude and longitude or three coordinates, checked by how fast they move."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.errors import Fault, InputRefusedError
from magcal_service.recordings.describe.columns import Column, Log, Triple
from magcal_service.recordings.describe.draft import NO, Draft, Question, answered
from magcal_service.recordings.describe.kinds import kind_of_triple
from magcal_service.recordings.describe.orbit_motion import frame_of_way, orbit_height_km
from magcal_service.recordings.describe.times import Times
from magcal_service.recordings.describe.vocabulary import ALTITUDE, LATITUDE, LONGITUDE, Kind, frame_of

FloatArray = npt.NDArray[np.float64]

_EARTH_KM: Final = 6371.0  # mean radius of the Earth
_ORBIT_KM_S: Final = (5.6, 8.2)
"""Ground speed of a low orbit: hardly anything else that a log holds moves so."""

_FASTEST_KM_S: Final = 12.0  # nothing near the Earth goes faster
_AIR_KM_S: Final = 0.6  # and no aircraft than this
_RADIUS_KM: Final = (6330.0, 60000.0)  # from the polar ice to beyond the geostationary ring
_LOW_KM: Final = (120.0, 2500.0)  # heights of a low orbit
_NO_LATITUDE: Final = "a latitude of"
_STRIDE: Final = 8  # rows that a speed is taken over
_NEEDED: Final = 8  # steps that a speed is judged by


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
        return _geodetic(draft, times, chosen[0], chosen[1], answered("position.columns"))
    if chosen is not None:
        x, y, z = chosen
        return _cartesian(draft, times, Triple((x, y, z), "", x.words), answered("position.columns"))
    return _by_names(draft, times) or _cartesian_by_names(draft, times, groups) or _by_motion(draft, times)


def ground_speed_km_s(latitude_deg: FloatArray, longitude_deg: FloatArray, times: Times, log: Log) -> FloatArray:
    """Speeds over the ground [km/s] over some rows each, so that stamps in whole seconds do not count."""
    stride = _STRIDE if len(latitude_deg) > 8 * _STRIDE else 1
    lat, lon = np.radians(latitude_deg), np.radians(longitude_deg)
    early, late = slice(None, -stride), slice(stride, None)
    chord = np.sin((lat[late] - lat[early]) / 2) ** 2
    chord += np.cos(lat[late]) * np.cos(lat[early]) * np.sin((lon[late] - lon[early]) / 2) ** 2
    distance = 2.0 * _EARTH_KM * np.arcsin(np.sqrt(np.clip(chord, 0.0, 1.0)))
    step = times.seconds[late] - times.seconds[early]
    good = np.isfinite(distance) & (step > 0) & (log.block[late] == log.block[early])
    return np.asarray(distance[good] / step[good], dtype=np.float64)


def _one(log: Log, words: set[str]) -> list[Column]:
    return [c for c in log.columns if c.numeric and (set(c.words) & words or c.stem.lower() in words)]


def _by_names(draft: Draft, times: Times | None) -> Place | None:
    latitudes, longitudes = _one(draft.log, LATITUDE), _one(draft.log, LONGITUDE)
    if not latitudes or not longitudes:
        return None
    latitude, longitude = latitudes[0], longitudes[0]
    fault = _no_place(latitude, longitude, draft.log, times)
    if not fault:
        moving = _moving_pair(draft.log, times, besides=(latitude.number, longitude.number))
        if moving is None or _in_orbit((latitude, longitude), draft.log, times):
            return _geodetic(draft, times, latitude, longitude, "")
        fault = "other columns move over the ground as a craft in orbit does, and these do not"
    swapped = fault.startswith(_NO_LATITUDE) and not _no_place(longitude, latitude, draft.log, times)
    moving = (longitude, latitude) if swapped else _moving_pair(draft.log, times)
    says = f"the header calls {latitude.label} and {longitude.label} a position, but {fault}"
    draft.said.append(f"position: not believed: {says}")
    if moving is not None:
        value = ",".join(draft.names(moving))
        why = "the same two the other way round" if swapped else "these move over the ground as a craft in orbit does"
        asks = f"{says}: the header seems to name the wrong columns. Which are latitude and longitude?"
        draft.ask(Question("position.columns", asks, ((value, why),), value))
        draft.doubted = True
        return None if swapped else _asked(moving)
    return None


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


def _still(values: FloatArray) -> bool:
    good = values[np.isfinite(values)]
    return not good.size or float(np.ptp(good)) == 0.0


def _no_place(latitude: Column, longitude: Column, log: Log, times: Times | None) -> str:
    """Why two columns are no latitude and longitude in degrees; empty where they can be."""
    lat, lon = latitude.values, longitude.values
    if not np.isfinite(lat).any() or not np.isfinite(lon).any():
        return "they hold no numbers"
    for column in (latitude, longitude):
        if column.unit not in {"", "deg"}:
            return f"the name says {column.unit}, and degrees are needed"
    if float(np.nanmax(np.abs(lat))) > 90.0 or float(np.nanmax(np.abs(lon))) > 360.0:
        most = float(np.nanmax(np.abs(lat)))
        scaled = "; are they in 1e-7 degrees? the log has to hold degrees" if most > 1e6 else ""
        return f"{_NO_LATITUDE} {most:.7g} is none in degrees{scaled}"
    if times is None:
        return ""
    speeds = ground_speed_km_s(lat, lon, times, log)
    if speeds.size >= _NEEDED and float(np.quantile(speeds, 0.75)) > _FASTEST_KM_S:
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
            if _in_orbit((lat, lon), log, times):
                return lat, lon
    return None


def _in_orbit(pair: tuple[Column, Column], log: Log, times: Times | None) -> bool:
    """Whether two columns, as latitude and longitude, move over the ground as a craft in a low orbit."""
    latitude, longitude = (column.values for column in pair)
    if times is None or _still(latitude) or _still(longitude):
        return False
    if np.nanmax(np.abs(latitude)) > 90.0 or np.nanmax(np.abs(longitude)) > 360.0:
        return False
    speeds = ground_speed_km_s(latitude, longitude, times, log)
    inside = (speeds > _ORBIT_KM_S[0]) & (speeds < _ORBIT_KM_S[1])
    return speeds.size >= 4 * _NEEDED and float(np.mean(inside)) > 0.9


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
    return None


def _geodetic(draft: Draft, times: Times | None, latitude: Column, longitude: Column, by: str) -> Place:
    speed = None
    if times is not None:
        speeds = ground_speed_km_s(latitude.values, longitude.values, times, draft.log)
        speed = float(np.median(speeds)) if speeds.size >= _NEEDED else None
        speed = float(speeds.mean()) if speed == 0.0 else speed  # a receiver that is slower than the rows
    moves = "" if speed is None else f", moving at {speed:.3g} km/s"
    why = by or f"the names say latitude and longitude, and the numbers are degrees of such{moves}"
    draft.put("position", "columns", draft.names((latitude, longitude)))
    draft.conclude("position.columns", f"{latitude.label}, {longitude.label}", why)
    in_orbit = None if speed is None else speed > 3.0
    numbers: tuple[int, ...] = (latitude.number, longitude.number)
    altitude = _altitude(draft, speed)
    if isinstance(altitude, tuple):
        column, height = altitude
        numbers = (*numbers, column)
    else:
        height = altitude
    return Place(numbers, in_orbit, latitude.values, longitude.values, height, altitude_open=height is None)


def _altitude(draft: Draft, speed: float | None) -> float | tuple[int, float | None] | None:
    """Put the altitude into the draft; its median [km], with its column where it has one; None where it is open."""
    answer = draft.answers.get("position.altitude_km")
    if answer is not None:
        value = _number("position.altitude_km", answer)
        draft.put("position", "altitude_km", value)
        draft.conclude("position.altitude_km", f"{value:g}", answered("position.altitude_km"))
        return value
    chosen = draft.columns("position.altitude", (1,))
    columns = chosen or _one(draft.log, ALTITUDE) or [c for c in _one(draft.log, {"h"}) if c.unit in {"km", "m"}]
    if not columns:
        return None
    column = columns[0]
    unit, why = _length_unit(column, speed)
    said = draft.answers.get("position.altitude.unit")
    if said is not None:
        unit, why = said, answered("position.altitude.unit")
    if not unit:
        candidates = tuple((one, "") for one in ("km", "m"))
        most = float(np.nanmedian(column.values))
        asks = f"in which unit is the altitude {column.label} (about {most:.6g})? {why}"
        draft.ask(Question("position.altitude.unit", asks, candidates, "m"))
        return column.number, None
    draft.put("position", "altitude", {"column": draft.name(column), "unit": unit})
    draft.conclude("position.altitude", f"{column.label} in {unit}", why)
    return column.number, float(np.nanmedian(column.values)) * (1e-3 if unit == "m" else 1.0)


def _length_unit(column: Column, speed: float | None) -> tuple[str, str]:
    """The unit of an altitude, and why; empty where names and numbers leave it open, or differ."""
    most = float(np.nanmedian(column.values)) if np.isfinite(column.values).any() else 0.0
    possible = []
    if speed is None or speed > 3.0:
        possible += [unit for unit, factor in (("km", 1.0), ("m", 1e-3)) if 120.0 <= most * factor <= 60000.0]
    if speed is None or speed <= _AIR_KM_S:
        possible += [unit for unit, factor in (("km", 1.0), ("m", 1e-3)) if -0.5 <= most * factor <= 45.0]
        if speed is not None and most > 45.0:
            possible = ["m"] if most < 45000.0 else []
        elif speed is not None and column.unit == "" and most < 10.0:
            possible = ["m"] if float(np.ptp(column.values[np.isfinite(column.values)])) > 0.5 else possible
    moves = "" if speed is None else f" at {speed:.3g} km/s over the ground"
    if column.unit in possible:
        return column.unit, f"the name says {column.unit}, and {most:.5g} {column.unit} can be{moves}"
    if column.unit:
        return "", f"the name says {column.unit}, but {most:.5g} {column.unit} cannot be{moves}"
    distinct = list(dict.fromkeys(possible))
    if len(distinct) == 1 and speed is not None:
        return distinct[0], f"the name says altitude, and{moves} only {most:.5g} {distinct[0]} can be"
    return "", "neither its name nor its numbers decide"


def _number(key: str, text: str) -> float:
    try:
        value = float(text.removesuffix("km").strip())
    except ValueError:
        value = float("nan")
    if not -10.0 <= value <= 1e5:
        raise InputRefusedError(
            [Fault(f"--answer {key}", text, "kilometres above the ellipsoid are accepted, such as 415")]
        )
    return value


def _cartesian_by_names(draft: Draft, times: Times | None, groups: list[Triple]) -> Place | None:
    for triple in groups:
        kind, unit = kind_of_triple(triple), _cartesian_unit(triple)
        if unit and (kind is Kind.POSITION or (kind is Kind.UNKNOWN and unit == "m")):  # km could be a field in nT
            return _cartesian(draft, times, triple, "")
    return None


def _cartesian_unit(triple: Triple) -> str:
    good = triple.values[np.isfinite(triple.values).all(axis=1)]
    if not len(good):
        return ""
    radius = np.sqrt((good**2).sum(axis=1))
    units = [
        u
        for u, f in (("km", 1.0), ("m", 1e-3))
        if np.quantile(radius, 0.02) * f > _RADIUS_KM[0] and np.quantile(radius, 0.98) * f < _RADIUS_KM[1]
    ]
    return units[0] if len(units) == 1 and triple.unit in {"", units[0]} else ""


def _cartesian(draft: Draft, times: Times | None, triple: Triple, by: str) -> Place | None:
    unit = draft.answers.get("position.unit") or _cartesian_unit(triple)
    radius = float(np.nanmedian(np.sqrt((triple.values**2).sum(axis=1))))
    frame = draft.answers.get("position.frame") or frame_of(triple.words)
    if not unit:
        asks = f"in which unit are {triple.label}? they are {radius:.6g} from the Earth's centre"
        draft.ask(Question("position.unit", asks, (("km", ""), ("m", "")), "km"))
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
    draft.put("position", "unit", unit)
    draft.put("position", "frame", frame)
    draft.conclude("position.columns", f"{triple.label} in {unit}, {frame}", why)
    km = triple.values * (1e-3 if unit == "m" else 1.0)
    numbers = tuple(column.number for column in triple.columns)
    high = radius * (1e-3 if unit == "m" else 1.0) > _EARTH_KM + 120.0
    return Place(numbers, high, cartesian_km=km, frame=frame)
