"""How high a log was made: one height, or a column and the unit that it can be in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.base.units import LENGTH_KM, LengthUnit
from magcal_service.recordings.describe.columns import Column, Log
from magcal_service.recordings.describe.draft import Draft, Question, answered
from magcal_service.recordings.describe.over_ground import EARTH_KM
from magcal_service.recordings.describe.times_found import Times
from magcal_service.recordings.describe.unit_answer import AnsweredUnit
from magcal_service.recordings.describe.vocabulary import ALTITUDE
from magcal_service.recordings.inspect.motion import kepler_rad_s
from magcal_service.recordings.unit_words import unknown_unit

FloatArray = npt.NDArray[np.float64]

ORBITAL_KM_S: Final = 3.0  # over the ground: anything faster is in orbit
_AIR_KM_S: Final = 0.6  # no aircraft is faster
_ORBIT_KM: Final = (120.0, 60000.0)  # heights of a craft in orbit
_AIR_KM: Final = (-0.5, 45.0)  # of anything else, from the Dead Sea's shore to the highest balloon
_OF_KEPLER: Final = (0.6, 1.6)
"""Ground speed over that of a round orbit so high: an eccentric one and the Earth's turning are within."""

_CLIMB_KM_S: Final = 0.15  # no aircraft or balloon climbs or falls faster for long
_JAGGED: Final = 3.0
"""Whole units by which three neighbouring heights are out of line: metres of a craft in the air hardly ever are."""

_HIGH_KM: Final = 9.0  # nothing stands still as high
_STANDS_KM_S: Final = 0.01  # slower than a balloon in the wind up there
_TALL: Final = 1000.0  # whole units: below that a number of metres is usual, and of mm it is a stone's throw
_LARGE: Final = LENGTH_KM[LengthUnit.M] * _AIR_KM[1]
_DATUMS: Final = frozenset({"msl", "amsl", "agl", "gps", "hae"})  # what a height is above, in brackets as a unit is
_NAMED_FIRST: Final = (LengthUnit.KM, LengthUnit.M, LengthUnit.MM, LengthUnit.CM)  # of what no name says


@dataclass(frozen=True, slots=True)
class Heights:
    """A column of heights and what they are judged by.

    Parameters
    ----------
    speed_km_s: over the ground; None where it is not known.
    parts: whether the position beside it is in whole parts of a degree, as its height then mostly is of a metre.
    """

    column: Column
    log: Log
    times: Times | None
    speed_km_s: float | None
    parts: bool

    @property
    def usual(self) -> float:
        """Their median; 0 where there is none."""
        values = self.column.values
        return float(np.nanmedian(values)) if np.isfinite(values).any() else 0.0


def find_altitude(
    draft: Draft, times: Times | None, speed_km_s: float | None, *, parts: bool
) -> float | tuple[int, float | None] | None:
    """Put the altitude into the draft; its median [km], with its column where it has one; None where it is open."""
    answer = draft.answers.get("position.altitude_km")
    if answer is not None:
        value = _number("position.altitude_km", answer)
        draft.put("position", "altitude_km", value)
        draft.conclude("position.altitude_km", f"{value:g}", answered("position.altitude_km"))
        return value
    columns = draft.columns("position.altitude", (1,)) or _called_altitude(draft.log)
    if not columns:
        return None
    heights = Heights(columns[0], draft.log, times, speed_km_s, parts)
    column = columns[0]
    unit, why, possible = _unit(heights)
    told = draft.answers.unit("position.altitude.unit", LengthUnit)
    if told is not None:
        why = answered("position.altitude.unit")
    elif not unit:
        candidates = tuple((one, f"{heights.usual * LENGTH_KM[LengthUnit(one)]:.4g} km") for one in possible)
        asks = f"in which unit is the altitude {column.label} (about {heights.usual:.6g})? {why}"
        form = candidates[0][0] if candidates else "m"
        draft.ask(Question("position.altitude.unit", asks, candidates, form, scaled="1.852 km"))
        return column.number, None
    size = told or AnsweredUnit(unit)
    draft.put("position", "altitude", {"column": draft.name(column)} | size.entries)
    draft.conclude("position.altitude", f"{column.label} in {size}", why)
    draft.reserved.add(column.number)
    return column.number, heights.usual * size.factor * LENGTH_KM[LengthUnit(size.unit)]


def _called_altitude(log: Log) -> list[Column]:
    named = [c for c in log.columns if c.numeric and (set(c.words) & ALTITUDE or c.stem.lower() in ALTITUDE)]
    letter = [c for c in log.columns if c.numeric and (set(c.words) & {"h"} or c.stem.lower() == "h")]
    return named or [c for c in letter if c.unit in list(LengthUnit)]


def _unit(heights: Heights) -> tuple[str, str, tuple[str, ...]]:
    """The unit, why, and what is possible; empty where names and numbers leave it open, or differ."""
    column, usual = heights.column, heights.usual
    moves = "" if heights.speed_km_s is None else f" at {heights.speed_km_s:.3g} km/s over the ground"
    said = LengthUnit(column.unit) if column.unit in list(LengthUnit) else None
    if said is not None and _can_be(heights, said):
        return said, f"the name says {said}, and {usual:.5g} {said} can be{moves}", ()
    found = _possible(heights)
    if column.unit:
        return "", f"the name says {column.unit}, but {usual:.5g} {column.unit} cannot be{moves}", found
    strange = unknown_unit(column.name)
    if strange and strange.lower() not in _DATUMS:
        return "", f"the name says {strange}, which is no unit of a length here", found
    if len(found) == 1 and heights.speed_km_s is not None:
        return found[0], f"the name says altitude, and{moves} only {usual:.5g} {found[0]} can be", found
    return "", "neither its name nor its numbers decide", found


def _can_be(heights: Heights, unit: LengthUnit) -> bool:
    """Whether a craft of that speed can be so high, and climb so."""
    speed, km = heights.speed_km_s, heights.usual * LENGTH_KM[unit]
    orbit = speed is None or speed > ORBITAL_KM_S
    if orbit and _ORBIT_KM[0] <= km <= _ORBIT_KM[1]:
        kepler = kepler_rad_s(EARTH_KM + km) * EARTH_KM
        if speed is None or _OF_KEPLER[0] < speed / kepler < _OF_KEPLER[1]:
            return True
    if speed is not None and speed > _AIR_KM_S:
        return False
    if not _AIR_KM[0] <= km <= _AIR_KM[1]:
        return False
    stands = speed is not None and speed < _STANDS_KM_S and km > _HIGH_KM
    climb = _climb(heights)
    return not (stands and climb * LENGTH_KM[unit] < _STANDS_KM_S) and climb * LENGTH_KM[unit] < _CLIMB_KM_S


def _possible(heights: Heights) -> tuple[str, ...]:
    """Units that no name says and that the numbers allow, the likeliest first."""
    found = [unit for unit in _NAMED_FIRST if _can_be(heights, unit)]
    speed, usual, whole = heights.speed_km_s, heights.usual, heights.column.whole
    if speed is None or speed > _AIR_KM_S:
        return tuple(unit.value for unit in found)
    fine = whole and usual >= _TALL and (heights.parts or _jagged(heights) or LengthUnit.M not in found)
    if not fine:  # a height in small parts of a metre is a large whole number
        found = [unit for unit in found if unit in {LengthUnit.KM, LengthUnit.M}]
    elif _jagged(heights):
        found = [unit for unit in found if unit not in {LengthUnit.KM, LengthUnit.M}]
    if usual > _AIR_KM[1]:
        found = [unit for unit in found if unit is not LengthUnit.KM]
    elif not heights.column.unit and usual < 10.0 and _varies(heights):  # choice: so low, a kilometre is a mountain's
        found = [unit for unit in found if unit is LengthUnit.M]
    return tuple(unit.value for unit in found)


def _varies(heights: Heights) -> bool:
    values = heights.column.values
    return float(np.ptp(values[np.isfinite(values)])) > 0.5


def _climb(heights: Heights) -> float:
    """Units a second by which it usually changes where it does; 0 where that is not known."""
    if heights.times is None:
        return 0.0
    step, rise = np.diff(heights.times.seconds), np.abs(np.diff(heights.column.values))
    good = heights.log.neighbours() & np.isfinite(rise) & (step > 0)
    return float(np.median(rise[good] / step[good])) if good.any() else 0.0


def _jagged(heights: Heights) -> bool:
    """Whether neighbouring heights are out of line by more than metres are."""
    values = heights.column.values
    values = values[np.isfinite(values)]
    values = values[np.concatenate([[True], np.diff(values) != 0.0])]  # of a receiver slower than the rows
    return len(values) > 2 and float(np.median(np.abs(np.diff(values, 2)))) > _JAGGED


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
