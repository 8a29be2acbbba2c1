"""Every reading of a log's columns as its time: numbers, texts, GPS weeks, and dates in several columns."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from magcal_service.recordings.describe import dates
from magcal_service.recordings.describe.columns import Column, Log
from magcal_service.recordings.describe.time_numbers import UNIX, FloatArray, Form, is_named, numbers, rises, within
from magcal_service.recordings.timestamps import iso8601_to_ns

_WEEK: Final = {"week", "wk", "gpsweek", "wn", "weekno", "gwk", "gpswk", "weeks"}

_OF_WEEK: Final = {"tow", "itow", "sow", "gms", "towms"}

_CALENDAR: Final = (
    ({"year", "yr", "yyyy"}, "%Y"),
    ({"month", "mon", "mo"}, "%m"),
    ({"day", "dd", "dom"}, "%d"),
    ({"hour", "hr", "hh", "hours"}, "%H"),
    ({"minute", "min", "minutes", "mn"}, "%M"),
    ({"second", "sec", "ss", "seconds", "s"}, "%S"),
)

NO_ZONE: Final = "; no zone is written, so UTC is taken"
"""How the reason of a time ends that states no zone."""

_MOSTLY: Final = 0.9  # of the cells have to fit

_DATE: Final = {"tarih", "date", "day", "datum", "fecha", "jour", "dates"}

_ZONE: Final = re.compile(r"Z|UTC|GMT|[+-]\d\d:?\d\d", re.ASCII)

_GPS_EPOCH_S: Final = 315964800.0  # 1980-01-06 in Unix seconds

_LAST_WEEK: Final = 4000.0  # of the year 2056
_FULL_WEEKS: Final = (1024.0, 3250.0)
"""From the first rollover of ten bits, 1999, to 2042, as long as Unix time is looked for."""

_RANK_OF_WEEKS: Final = 7  # before seconds since some start without a name, after all that is named
_WEEKS: Final = 1024  # a week counted in ten bits begins again after as many
ROLLOVERS: Final = 2
"""How often such a count has begun again for weeks from April 2019 to November 2038."""

_WEEK_S: Final = 604800.0  # seconds in a week


def forms(log: Log) -> list[Form]:
    """Every way in which columns of a log can be its time."""
    found = [*_gps_week(log), *_nameless_weeks(log), *_calendar(log), *_date_and_clock(log)]
    zones = zone_columns(log)
    for column in log.columns:
        if len(zones) == 1 and not column.numeric and not _states_zone(column):
            found += _texts((column, zones[0]), joined((column, zones[0])), 0)
        found += of_columns((column,))
    return found


def zone_columns(log: Log) -> list[Column]:
    """Columns that say each row's zone, as ``+02:00``."""
    return [c for c in log.columns if any(c.cells) and all(_ZONE.fullmatch(cell) for cell in c.cells if cell)]


def _states_zone(column: Column) -> bool:
    """Whether the cells of a column name their zone themselves."""
    filled = next((cell for cell in column.cells if cell), "")
    return re.search(r"(Z|z|UTC|GMT|\d[+-]\d\d:?\d\d)$", filled) is not None


def of_columns(columns: tuple[Column, ...]) -> list[Form]:
    """Every way in which these columns can be the time: one by itself, or the parts of a date and a clock."""
    if len(columns) > 1:
        return _texts(columns, joined(columns), 2)
    column = columns[0]
    if column.numeric:
        return numbers(column) + (_texts(columns, column.cells, 3) if is_named(column) and column.whole else [])
    return _texts(columns, column.cells, 1)


def joined(columns: Sequence[Column]) -> list[str]:
    """The cells of each row, a space between them."""
    return [" ".join(parts) for parts in zip(*(column.cells for column in columns), strict=True)]


def _texts(columns: tuple[Column, ...], cells: Sequence[str], rank: int) -> list[Form]:
    """Readings of text as an instant."""
    filled = [cell for cell in cells if cell]
    if not filled or not any(sign.isdigit() for sign in filled[0]) or len(filled[0]) < 8:
        return []
    if len(columns) == 1:
        parsed = [iso8601_to_ns(cell) for cell in cells]
        good = sum(value is not None for value in parsed)
        if good >= 0.9 * len(filled):
            times = np.array([np.nan if value is None else value / 1e9 for value in parsed])
            zone = "" if re.search(r"(Z|z|UTC|[+-]\d\d:?\d\d)$", filled[0]) else NO_ZONE
            why = f"every cell is an ISO 8601 instant such as {filled[0]!r}{zone}"
            return [Form(columns, "iso8601", times, True, why, True, rank)]
    patterns = dates.fitting(filled)
    if not patterns:
        return []
    times_of = {pattern: dates.seconds(cells, pattern) for pattern in patterns}
    patterns = [pattern for pattern in patterns if within(times_of[pattern], *UNIX)]
    if not patterns:
        return []
    running = [pattern for pattern in patterns if dates.in_order(times_of[pattern])] or patterns
    running = _same_instants(running, times_of)
    if len(running) > 1:
        running = _shortest_gaps(running, times_of)
    zone = "" if patterns[0].endswith(("Z", "z", "UTC", "GMT")) else NO_ZONE
    why = f"every cell fits, such as {filled[0]!r}, and the times run on{zone}"
    return [Form(columns, "", times_of[pattern], True, why, len(running) == 1, rank, pattern) for pattern in running]


def _same_instants(patterns: Sequence[str], times_of: dict[str, FloatArray]) -> list[str]:
    """The first of each group of patterns that read the same."""
    kept: list[str] = []
    for pattern in patterns:
        if not any(np.array_equal(times_of[pattern], times_of[other], equal_nan=True) for other in kept):
            kept.append(pattern)
    return kept


def _shortest_gaps(patterns: Sequence[str], times_of: dict[str, FloatArray]) -> list[str]:
    """Of readings that all run on, those whose longest gap is not a hundred times that of the best."""
    gaps = {p: float(np.nanmax(np.abs(np.diff(times_of[p])), initial=0.0)) for p in patterns}
    least = min(gaps.values())
    return [p for p in patterns if gaps[p] <= max(100.0 * least, 1.0)] if least < 86400.0 else list(patterns)


def _date_and_clock(log: Log) -> list[Form]:
    """A column of dates and one of times of day."""
    clocks = [
        c for c in log.columns if c.cells and not c.numeric and ":" in c.cells[0] and dates.fitting_clocks(c.cells)
    ]
    clocks += [
        c
        for c in log.columns
        if c.numeric and set(c.words) & {"time", "utc", "clock", "hms", "hhmmss"} and dates.fitting_clocks(c.cells)
    ]
    days = [c for c in log.columns if c.cells and _is_date(c)]
    zones = zone_columns(log)[:1] if len(zone_columns(log)) == 1 else []
    if any(_states_zone(clock) for clock in clocks):
        zones = []
    found = []
    for day in days[:2]:
        for clock in clocks[:2]:
            if day is clock:
                continue
            columns = (day, clock, *zones)
            found += _texts(columns, joined(columns), 0)
    return found


def _calendar(log: Log) -> list[Form]:
    """Year, month, day, hour, minute and second, each in a column of its own."""
    columns = []
    for words, _ in _CALENDAR:
        found = [c for c in log.columns if c.numeric and (set(c.words) | {c.stem.lower()}) & words]
        if not found:
            return []
        columns.append(found[0])
    cells = joined(columns)
    fraction = ".%f" if "." in columns[-1].cells[0] else ""
    pattern = " ".join(sign for _, sign in _CALENDAR) + fraction
    times = dates.seconds(cells, pattern)
    if not within(times, *UNIX) or np.isfinite(times).mean() < _MOSTLY:
        return []
    why = "the names say year to second, and the numbers are those of such" + NO_ZONE
    return [Form(tuple(columns), "", times, True, why, dates.in_order(times), 0, pattern)]


def _is_date(column: Column) -> bool:
    named = bool(set(column.words) & _DATE)
    if column.numeric and not (named and column.whole):
        return False
    return bool(dates.fitting_dates(column.cells))


def _gps_week(log: Log) -> list[Form]:
    weeks = [
        c for c in log.columns if c.numeric and c.whole and set(c.words) & _WEEK and within(c.values, 0.0, _LAST_WEEK)
    ]
    seconds = [
        c for c in log.columns if c.numeric and not set(c.words) & _WEEK and (set(c.words) & _OF_WEEK or is_named(c))
    ]
    found = []
    for week in weeks[:1]:
        for column in sorted(seconds, key=lambda c: not set(c.words) & _OF_WEEK):
            form = week_form(week, column, "the names say GPS week and time of week, and the numbers are those of such")
            if form is not None:
                found.append(form)
                break
    return found


def week_form(week: Column, column: Column, why: str) -> Form | None:
    """A GPS week and the time within it, in s or ms; None where the numbers cannot be that."""
    if not (week.numeric and week.whole and column.numeric and within(week.values, 0.0, _LAST_WEEK)):
        return None
    milli = column.unit == "ms" or not within(column.values, 0.0, _WEEK_S)
    if not within(column.values, 0.0, _WEEK_S * (1000.0 if milli else 1.0)):
        return None
    counted = week.values + _WEEKS * ROLLOVERS * (week.values < _WEEKS)
    times = _GPS_EPOCH_S + counted * _WEEK_S + column.values * (1e-3 if milli else 1.0)
    return Form((week, column), "gps_week_ms" if milli else "gps_week_s", times, True, why, rises(times), 0)


def _nameless_weeks(log: Log) -> list[Form]:
    """Neighbours without names of which the first keeps a full GPS week of a digital sensor's years: to be asked."""
    found = []
    for week, column in zip(log.columns, log.columns[1:], strict=False):
        if week.name or column.name or not within(week.values, *_FULL_WEEKS) or np.nanmax(np.diff(week.values)) > 1.0:
            continue
        form = week_form(week, column, "the first is a GPS week of these years, and the other the time within it")
        if form is not None and form.sure:
            found.append(replace(form, sure=False, rank=_RANK_OF_WEEKS))
    return found
