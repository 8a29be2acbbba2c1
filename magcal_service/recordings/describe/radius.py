"""A distance from the Earth's centre beside latitude and longitude, which are then geocentric."""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.base.units import LENGTH_KM, LengthUnit
from magcal_service.recordings.describe.columns import Column, Log
from magcal_service.recordings.describe.draft import NO, Draft, Question, answered

RADIUS_KM: Final = (6330.0, 60000.0)  # from the polar ice to beyond the geostationary ring
CENTRED: Final = (LengthUnit.KM, LengthUnit.M, LengthUnit.CM, LengthUnit.MM)  # no two make the same radius possible
_NAMES: Final = {"radius", "r", "geocentric", "rad", "rmag"}
_GEOCENTRIC: Final = {"geocentric", "geoc", "gc", "gclat"}
_ALTITUDES: Final = ("position.altitude_km", "position.altitude", "position.altitude.unit")


def find_radius(draft: Draft, latitude: Column, longitude: Column) -> tuple[Column, LengthUnit] | None:
    """Put the radius into the draft where there is one; asks for that of a latitude that is called geocentric."""
    answer = draft.answers.get("position.radius")
    if answer == NO:
        draft.conclude("position.columns", "geodetic", answered("position.radius"))
        return None
    chosen = None if answer is None else draft.named("position.radius", answer, (1,))
    if chosen is None and any(draft.answers.get(key) is not None for key in _ALTITUDES):
        return None
    column = chosen[0] if chosen else _called(draft.log, (latitude, longitude))
    if column is None:
        if set(latitude.words) & _GEOCENTRIC:
            asks = (
                f"the name of {latitude.label} says geocentric; which column is the distance from the Earth's centre?"
            )
            draft.ask(Question("position.radius", asks, ((NO, "they are geodetic after all"),), NO))
        return None
    unit = unit_of_radius(column)
    if unit is None:
        accepted = "a column that is a distance from the Earth's centre in km, m, cm or mm is accepted"
        raise InputRefusedError([Fault("--answer position.radius", answer or column.name, accepted)])
    draft.put("position", "radius", {"column": draft.name(column), "unit": unit.value})
    why = (
        answered("position.radius") if chosen else "the name says a radius, and the numbers can be one in no other unit"
    )
    draft.conclude("position.radius", f"{column.label} in {unit}", why)
    draft.said.append(
        f"position: {latitude.label} is taken as geocentric, as beside a radius it mostly is; where it is geodetic, "
        "--answer position.radius=none and the altitude"
    )
    return column, unit


def _called(log: Log, besides: tuple[Column, Column]) -> Column | None:
    named = [
        column
        for column in log.columns
        if column.numeric
        and column not in besides
        and set(column.words) & _NAMES
        and unit_of_radius(column) is not None
    ]
    return named[0] if len(named) == 1 else None


def unit_of_radius(column: Column) -> LengthUnit | None:
    """The one unit in which the numbers are such a distance, where the name says no other."""
    good = column.values[np.isfinite(column.values)]
    if not len(good):
        return None
    shortest, longest = (float(q) for q in np.quantile(good, (0.02, 0.98)))
    units = [u for u in CENTRED if RADIUS_KM[0] < shortest * LENGTH_KM[u] and longest * LENGTH_KM[u] < RADIUS_KM[1]]
    return units[0] if len(units) == 1 and column.unit in {"", units[0].value} else None
