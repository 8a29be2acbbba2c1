"""``[position]`` of a descriptor: latitude and longitude with an altitude, three columns, or a file of element sets."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from magcal_service.base.typed_toml.keys import choice, number, section, text
from magcal_service.base.typed_toml.record import Reading, read_record
from magcal_service.base.units import AngleUnit
from magcal_service.recordings.scaled import LengthCells
from magcal_service.wire.messages import Frame

_GEODETIC = 2  # columns: latitude and longitude
_CARTESIAN = 3  # columns: x, y, z

DEFAULT_MAX_AGE_DAYS: Final = 3.0
"""Choice: up to here elements of a low orbit cost about what crust and currents do, which no model has."""


class PositionFrame(StrEnum):
    """Frames of a position given as three columns."""

    ECI = "eci"
    ECEF = "ecef"


@dataclass(frozen=True, slots=True)
class AltitudeColumn(LengthCells):
    """The altitude, or the distance from the Earth's centre, per row."""

    column: str = text()


def _check_altitude(reading: Reading, name: str, _: AltitudeColumn | None) -> None:
    """Either a constant or a column, or the distance from the Earth's centre."""
    table = reading.table
    given = [key for key in ("altitude_km", name, "radius") if table.has(key)]
    if len(given) != 1:
        accepted = 'exactly one of altitude_km = 415.0, altitude = {column = "alt", unit = "km"}'
        accepted += ', and radius = {column = "r", unit = "km"} beside a geocentric latitude'
        table.refuse(name, " and ".join(given) or "neither", accepted)


@dataclass(frozen=True, slots=True)
class GeodeticPosition:
    """Latitude and longitude columns and their unit, and the altitude: either one constant [km] or a column.

    With ``radius``, the distance from the Earth's centre, in place of the altitude, the latitude is geocentric.
    """

    columns: tuple[str, ...]
    unit: AngleUnit = choice(AngleUnit, AngleUnit.DEG)
    altitude_km: float | None = number(None, -10.0, 1e5, unit="km")
    altitude: AltitudeColumn | None = section(AltitudeColumn, None, check=_check_altitude)
    radius: AltitudeColumn | None = section(AltitudeColumn, None)

    @property
    def height(self) -> AltitudeColumn | None:
        """The column that says how far out a row was, from whatever."""
        return self.altitude or self.radius


@dataclass(frozen=True, slots=True)
class CartesianPosition(LengthCells):
    """Three columns, their unit and frame."""

    columns: tuple[str, ...]
    frame: Frame = choice(PositionFrame, convert=lambda frame: Frame(frame.value))


@dataclass(frozen=True, slots=True)
class ElementsPosition:
    """A file of two-line element sets of the craft; the position is that of the set nearest in time, by SGP4.

    Parameters
    ----------
    file: beside the descriptor.
    max_age_days: rows further from the epoch of every set have no position.
    """

    file: str = text(accepted="the name of a file of two-line element sets", name="tle")
    max_age_days: float = number(DEFAULT_MAX_AGE_DAYS, 0.01, 60.0, unit="days")

    @property
    def columns(self) -> tuple[str, ...]:
        """None of the log's."""
        return ()


PositionSpec = GeodeticPosition | CartesianPosition | ElementsPosition


def read_position(reading: Reading, name: str) -> PositionSpec | None:
    """The position; None where the section is absent or its columns are neither two nor three."""
    table = reading.table.table(name)
    if table is not None and table.has("tle"):
        return read_record(table, ElementsPosition)
    columns = None if table is None else table.texts("columns", required=True)
    if table is None or columns is None:
        return None
    if len(columns) == _GEODETIC:
        return read_record(table, GeodeticPosition, {"columns": columns})
    if len(columns) == _CARTESIAN:
        return read_record(table, CartesianPosition, {"columns": columns})
    table.refuse("columns", list(columns), "two columns (latitude, longitude) or three (x, y, z) are accepted")
    return None
