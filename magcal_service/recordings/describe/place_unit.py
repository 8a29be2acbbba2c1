"""The unit of a latitude and a longitude: degrees, radians, or whole parts of a degree, as receivers keep them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.base.units import ANGLE_DEG, AngleUnit
from magcal_service.recordings.describe.columns import Column
from magcal_service.recordings.describe.draft import Draft, Question, answered
from magcal_service.recordings.describe.over_ground import is_place, moves_as_orbit
from magcal_service.recordings.describe.times_found import Times

_PARTS: Final = (AngleUnit.E7, AngleUnit.E6)
_BY_WORD: Final = {"7": AngleUnit.E7, "6": AngleUnit.E6}
_HALF_DEG: Final = 0.5  # of degrees below that are no radians: a place that somebody set to 0, 0


@dataclass(frozen=True, slots=True)
class Degrees:
    """Two columns in degrees.

    Parameters
    ----------
    columns: what the log calls latitude and longitude, their values in degrees.
    unit: what they are written in.
    why: the evidence, empty for degrees that names and numbers agree on.
    """

    columns: tuple[Column, Column]
    unit: AngleUnit
    why: str = ""


def in_degrees(draft: Draft, latitude: Column, longitude: Column, times: Times | None) -> Degrees:
    """Two columns as degrees, with the unit that they are written in; asks where that is open.

    Raises
    ------
    InputRefusedError: the answer is no unit of an angle.
    """
    pair = (latitude, longitude)
    answer = draft.answers.get("position.unit")
    if answer is not None:
        if answer not in list(AngleUnit):
            accepted = f"{', '.join(AngleUnit)} are accepted for a latitude and a longitude"
            raise InputRefusedError([Fault("--answer position.unit", answer, accepted)])
        return _scaled(pair, AngleUnit(answer), answered("position.unit"))
    said = _said(pair)
    possible = [unit for unit in AngleUnit if _can_be(pair, unit)]
    if not possible or possible == [said] or (said is None and possible == [AngleUnit.DEG]):
        return _scaled(pair, said or AngleUnit.DEG, f"the names say {said}" if said not in {None, "deg"} else "")
    moving = [unit for unit in possible if _moves(draft, pair, unit, times)]
    if len(moving) == 1 and moving[0] is (said or AngleUnit.DEG):
        return _scaled(pair, moving[0], f"the names say {said}" if said not in {None, "deg"} else "")
    if said in possible and not moving:
        return _scaled(pair, AngleUnit(said), f"the names say {said}" if said != "deg" else "")
    found = moving if len(moving) == 1 else possible
    if len(found) == 1 and said is None:
        why = "they move as a craft in orbit does" if moving else "no other unit makes them a place"
        return _scaled(pair, found[0], f"in {found[0]} {why}")
    return _ask(draft, pair, said, [*found, *(unit for unit in possible if unit not in found)])


def _said(pair: tuple[Column, Column]) -> AngleUnit | None:
    """The unit that both names say."""
    told = {_of_name(column) for column in pair}
    return told.pop() if len(told) == 1 else None


def _of_name(column: Column) -> AngleUnit | None:
    for word, digit in pairwise(column.words):
        if word == "e" and digit in _BY_WORD:  # as lat_e7, latitudeE7, lat_1e7
            return _BY_WORD[digit]
    return AngleUnit(column.unit) if column.unit in list(AngleUnit) else None


def _can_be(pair: tuple[Column, Column], unit: AngleUnit) -> bool:
    """Whether the numbers can be this unit, whichever of the two is the latitude."""
    first, second = (column.values * ANGLE_DEG[unit] for column in pair)
    if not is_place(first, second) and not is_place(second, first):
        return False
    if unit is AngleUnit.DEG:
        return True
    if unit in _PARTS:
        return all(column.whole for column in pair) and not _can_be(pair, AngleUnit.DEG)
    large = max(float(np.nanmax(np.abs(column.values))) for column in pair)
    return large > _HALF_DEG and not all(column.whole for column in pair)


def _moves(draft: Draft, pair: tuple[Column, Column], unit: AngleUnit, times: Times | None) -> bool:
    first, second = (column.values * ANGLE_DEG[unit] for column in pair)
    return moves_as_orbit(first, second, draft.log, times) or moves_as_orbit(second, first, draft.log, times)


def _scaled(pair: tuple[Column, Column], unit: AngleUnit, why: str) -> Degrees:
    if unit is AngleUnit.DEG:
        return Degrees(pair, unit, why)
    first, second = (replace(c, values=c.values * ANGLE_DEG[unit], unit=AngleUnit.DEG.value) for c in pair)
    return Degrees((first, second), unit, why)


def _ask(draft: Draft, pair: tuple[Column, Column], said: AngleUnit | None, found: list[AngleUnit]) -> Degrees:
    middle = ", ".join(f"{float(np.nanmedian(column.values)):.9g}" for column in pair)
    says = f"the names say {said}" if said else "no name says"
    asks = f"in which unit are {pair[0].label}, {pair[1].label} (about {middle})? {says}, and the numbers leave it open"
    candidates = tuple((unit.value, _place(pair, unit)) for unit in found)
    draft.ask(Question("position.unit", asks, candidates, found[0].value))
    return _scaled(pair, found[0], "asked")


def _place(pair: tuple[Column, Column], unit: AngleUnit) -> str:
    first, second = (float(np.nanmedian(column.values)) * ANGLE_DEG[unit] for column in pair)
    return f"about {first:.4g}, {second:.4g} degrees"
