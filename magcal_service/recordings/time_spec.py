"""``[time]`` of a descriptor: columns of times in one of several forms, or rows that come evenly."""

from __future__ import annotations

import datetime
import re
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from magcal_service.base.typed_toml.keys import number, special
from magcal_service.base.typed_toml.record import Reading
from magcal_service.recordings.timestamps import iso8601_to_ns
from magcal_service.wire.messages import Clock


class TimeFormat(StrEnum):
    """How a time cell is written."""

    ISO8601 = "iso8601"
    UNIX_S = "unix_s"
    UNIX_MS = "unix_ms"
    UNIX_US = "unix_us"
    UNIX_NS = "unix_ns"
    ELAPSED_S = "elapsed_s"
    ELAPSED_MS = "elapsed_ms"
    ELAPSED_US = "elapsed_us"
    ELAPSED_NS = "elapsed_ns"
    GPS_WEEK_S = "gps_week_s"
    GPS_WEEK_MS = "gps_week_ms"
    EXCEL_DAYS = "excel_days"
    JULIAN_DAYS = "julian_days"
    MJD_DAYS = "mjd_days"
    MATLAB_DAYS = "matlab_days"
    MJD1950_DAYS = "mjd1950_days"

    @property
    def kind(self) -> str:
        """``iso8601``, ``unix``, ``elapsed``, ``gps``, ``excel``, ``julian``, ``mjd``, ``matlab`` or ``mjd1950``."""
        return self.value.split("_")[0]

    @property
    def decimals(self) -> int:
        """Decimal places from the cell's unit, a second or a part of one, down to nanoseconds."""
        return _DECIMALS[self.value.rpartition("_")[2]]

    @property
    def expects(self) -> str:
        """What has to stand in a cell, in words."""
        return _EXPECTS[self.kind]


_DECIMALS: Final = {"s": 9, "ms": 6, "us": 3, "ns": 0, "iso8601": 9}
_EXPECTS: Final = {
    "iso8601": "an ISO 8601 instant",
    "unix": "a number",
    "elapsed": "a number",
    "gps": "a GPS week from 1024 on and a time within a week",
    "excel": "a number of days",
    "julian": "a number of days",
    "mjd": "a number of days",
    "matlab": "a number of days",
    "mjd1950": "a number of days",
}

_GPS_COLUMNS: Final = 2  # week, and time of week
_MOST_COLUMNS: Final = 6  # year to second
_DIRECTIVES: Final = frozenset("YymbBdjHIpMSfaAz%")
_ROLLOVERS: Final = (0, 3)
"""Of a week counted in ten bits: 3 is 2038 to 2058."""


def _by_rate(reading: Reading) -> bool:
    return reading.table.has("rate_hz")


def _refuse_beside_rate(reading: Reading, name: str) -> None:
    if reading.table.has(name):
        reading.table.refuse(name, reading.table.content[name], "it goes without rate_hz only; remove one of the two")


def _column(reading: Reading, name: str) -> str:
    """Required, but where rows come evenly or several columns hold the time."""
    table = reading.table
    if _by_rate(reading):
        _refuse_beside_rate(reading, name)
        return ""
    if table.has("columns"):
        if table.has(name):
            table.refuse(name, table.content[name], "it goes without columns only; remove one of the two")
        return ""
    return table.text(name, accepted='the name of the time column, or columns = ["date", "time"],')


def _format(reading: Reading, name: str) -> TimeFormat:
    table = reading.table
    if _by_rate(reading):
        _refuse_beside_rate(reading, name)
        return TimeFormat.ELAPSED_S
    if table.has("pattern"):
        if table.has(name):
            table.refuse(name, table.content[name], "it goes without pattern only; remove one of the two")
        return TimeFormat.ISO8601
    return table.choice(name, TimeFormat)


def _start(reading: Reading, name: str) -> int | None:
    """A string or TOML's own date-time, which is UTC where it names no zone."""
    if not reading.table.has(name):
        return None
    value = reading.table.content[name]
    written = value.isoformat() if isinstance(value, datetime.datetime) else value
    start_ns = iso8601_to_ns(written) if isinstance(written, str) else None
    if start_ns is None:
        accepted = 'an ISO 8601 instant such as "2025-06-01T00:00:00Z" is accepted'
        reading.table.refuse(name, str(value), accepted)
    return start_ns


def _check_start(reading: Reading, name: str, start_ns: int | None) -> None:
    if start_ns is not None and reading.values["format"].kind != "elapsed":
        accepted = 'it goes with format = "elapsed_s" (ms, us, ns) or rate_hz only; remove it'
        reading.table.refuse(name, reading.table.content[name], accepted)


def _columns(reading: Reading, name: str) -> tuple[str, ...]:
    """Several columns: a date in parts, or GPS week and time of week."""
    table, form = reading.table, reading.values["format"]
    if _by_rate(reading):
        _refuse_beside_rate(reading, name)
        return ()
    columns = table.texts(name) or ()
    if form.kind == "gps" and len(columns) != _GPS_COLUMNS:
        accepted = f'{form.value} needs columns = ["week", "tow"]: the week, and the time within it'
        if given := list(columns) or reading.values["column"]:
            table.refuse(name, given, accepted)
        else:
            table.lack(name, accepted)
    elif columns and form.kind != "gps" and not table.has("pattern"):
        accepted = 'several columns go with pattern = "%Y-%m-%d %H:%M:%S" or format = "gps_week_s"'
        table.refuse(name, list(columns), accepted)
    elif len(columns) > _MOST_COLUMNS or len(set(columns)) != len(columns):
        table.refuse(name, list(columns), f"up to {_MOST_COLUMNS} different columns are accepted")
    elif table.has(name) and not columns and isinstance(table.content[name], list):
        table.refuse(name, [], f"1 to {_MOST_COLUMNS} different columns are accepted")
    return columns


def _pattern(reading: Reading, name: str) -> str:
    """A pattern in the directives of ``strptime`` that gives a date with its year."""
    table = reading.table
    if not table.has(name):
        return ""
    if _by_rate(reading):
        _refuse_beside_rate(reading, name)
        return ""
    pattern = table.text(name, "")
    signs = re.findall("%(.?)", pattern)
    unknown = [f"%{sign}" for sign in signs if sign not in _DIRECTIVES]
    if unknown:
        known = " ".join(f"%{sign}" for sign in sorted(_DIRECTIVES - {"%"}))
        table.refuse(name, pattern, f"{unknown[0]} is not known; known: {known} (as of strptime)")
    elif len(set(signs)) != len(signs) or not _dated(set(signs)):
        accepted = "a pattern that gives year, month and day, each once, is accepted, such as %Y-%m-%d %H:%M:%S"
        table.refuse(name, pattern, accepted)
    return pattern


def _dated(signs: set[str]) -> bool:
    """Whether there is exactly one year, and one month with its day or one day of the year."""
    years, months = len(signs & set("Yy")), len(signs & set("mbB"))
    return years == 1 and (months, "d" in signs, "j" in signs) in {(1, True, False), (0, False, True)}


def _rollovers(reading: Reading, name: str) -> int | None:
    table = reading.table
    if table.has(name) and reading.values["format"].kind != "gps":
        table.refuse(name, table.content[name], 'it goes with format = "gps_week_s" or "gps_week_ms" only; remove it')
        return None
    given: int | None = table.integer(name, 0, minimum=_ROLLOVERS[0], maximum=_ROLLOVERS[1])
    return given if table.has(name) else None


@dataclass(frozen=True, slots=True)
class TimeSpec:
    """Columns and format of the time, or the rate at which rows come.

    Parameters
    ----------
    column: its name; empty where rows come evenly, or several columns hold the time.
    format: how it is written; ``iso8601`` stands where a pattern says it.
    start_ns: UTC instant [ns] of elapsed 0 (of the first row, where rows come evenly), where known.
    rate_hz: rows a second where they come evenly and no time was logged.
    columns: where several columns hold the time: their cells, with a blank between, go by ``pattern``; or GPS week
        and time of week.
    pattern: in the directives of ``strptime``, UTC where it has no ``%z``; empty where ``format`` says it.
    gps_rollovers: how often a week counted in ten bits has begun again since 1980; None: weeks are counted in full.
    """

    column: str = special(_column)
    format: TimeFormat = special(_format)
    start_ns: int | None = special(_start, None, name="start", check=_check_start)
    rate_hz: float | None = number(None, 1e-4, 1e5, unit="Hz")
    columns: tuple[str, ...] = special(_columns, ())
    pattern: str = special(_pattern, "")
    gps_rollovers: int | None = special(_rollovers, None)

    @property
    def clock(self) -> Clock:
        """UTC unless only the elapsed time is known."""
        return Clock.ELAPSED if self.format.kind == "elapsed" and self.start_ns is None else Clock.UTC

    @property
    def named(self) -> tuple[str, ...]:
        """Every column that holds the time or a part of it."""
        return self.columns or ((self.column,) if self.column else ())

    @property
    def expects(self) -> str:
        """What has to stand in the cells, in words."""
        return f"a time as {self.pattern}" if self.pattern else self.format.expects
