"""Cells of a time to nanoseconds, by the form that a descriptor states."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from decimal import Decimal
from functools import partial
from typing import Final

from magcal_service.recordings.table import POINT
from magcal_service.recordings.time_spec import TimeFormat, TimeSpec
from magcal_service.recordings.timestamps import MAX_TIME_NS, NS_PER_S, days_to_ns, decimal_to_ns, iso8601_to_ns

Parser = Callable[[str], int | None]
"""From the text of a cell, or of several with a blank between, to ns; None where it is no time."""

_DAY_S: Final = 86400  # seconds in a day
_WEEK_NS: Final = 7 * _DAY_S * NS_PER_S  # nanoseconds in a week
_GPS_EPOCH_NS: Final = 315_964_800 * NS_PER_S  # 1980-01-06T00:00:00Z
_WEEKS: Final = 1024  # a week counted in ten bits begins again after as many
_FAR: Final = MAX_TIME_NS + 1
"""A time that is no instant of a log, whatever the descriptor says: counted as absurd."""

_EPOCH_DAY: Final = {
    TimeFormat.EXCEL_DAYS: Decimal(25569),  # 1970-01-01 in days since 1899-12-30
    TimeFormat.MJD_DAYS: Decimal(40587),
    TimeFormat.MATLAB_DAYS: Decimal(719529),  # datenum: 1 is the first of January of the year 0
    TimeFormat.MJD1950_DAYS: Decimal(7305),  # days since 1950-01-01, of CNES and SPENVIS
    TimeFormat.JULIAN_DAYS: Decimal("2440587.5"),
}

_LEAP_DAYS: Final = (
    "1981-07-01 1982-07-01 1983-07-01 1985-07-01 1988-01-01 1990-01-01 1991-01-01 1992-07-01 1993-07-01 1994-07-01 "
    "1996-01-01 1997-07-01 1999-01-01 2006-01-01 2009-01-01 2012-07-01 2015-07-01 2017-01-01"
)
"""First days after each leap second since GPS time began; source: IERS Bulletin C.  GPS is 18 s ahead since 2017."""

_LEAPS_NS: Final = tuple(iso8601_to_ns(f"{day}T00:00:00Z") or 0 for day in _LEAP_DAYS.split())
_UNIX_EPOCH: Final = datetime.datetime(1970, 1, 1)


def time_parser(spec: TimeSpec, decimal: str) -> Parser:
    """What makes nanoseconds of the time's cells, before its start is added; ``decimal`` is the log's decimal sign."""
    form = spec.format
    if spec.pattern:
        return partial(_by_pattern, *_parts(spec.pattern))
    if form is TimeFormat.ISO8601:
        return iso8601_to_ns
    parse: Parser
    if form in _EPOCH_DAY:
        parse = partial(days_to_ns, epoch=_EPOCH_DAY[form])
    elif form.kind == "gps":
        parse = partial(_gps, decimals=form.decimals, rollovers=spec.gps_rollovers)
    else:
        parse = partial(decimal_to_ns, decimals=form.decimals)
    return parse if decimal == "." else lambda text: parse(text.translate(POINT))


def _gps(text: str, decimals: int, rollovers: int | None) -> int | None:
    """GPS week and time of week, as UTC."""
    parts = text.split()
    if len(parts) != 2:
        return None
    week, of_week_ns = decimal_to_ns(parts[0], 0), decimal_to_ns(parts[1], decimals)
    if week is None or of_week_ns is None:
        return None
    full = week >= _WEEKS if rollovers is None else 0 <= week < _WEEKS
    if not full or not 0 <= of_week_ns <= _WEEK_NS:
        return _FAR
    gps_ns = _GPS_EPOCH_NS + (week + _WEEKS * (rollovers or 0)) * _WEEK_NS + of_week_ns
    passed = 0
    for at_ns in _LEAPS_NS:
        passed += gps_ns - (passed + 1) * NS_PER_S >= at_ns
    return gps_ns - passed * NS_PER_S


def _parts(pattern: str) -> tuple[str, str]:
    """A pattern without its fraction of a second at the end, and the sign before that; empty where it has none."""
    if pattern.endswith("%f") and pattern[-3:-2] in {".", ",", ":"}:
        return pattern[:-3], pattern[-3]
    return pattern, ""


def _by_pattern(pattern: str, sign: str, text: str) -> int | None:
    """An instant by a pattern; a fraction of a second at its end may have any length, or be missing."""
    text = text.strip()
    if sign:
        head, _, digits = text.rpartition(sign)
        instant = _instant(head, pattern) if digits.isdecimal() and digits.isascii() else None
        if instant is not None:
            return instant + int(f"{digits:0<9}"[:9])
    return _instant(text, pattern)


def _instant(text: str, pattern: str) -> int | None:
    try:
        instant = datetime.datetime.strptime(text, pattern)
        if instant.tzinfo is not None:
            instant = instant.astimezone(datetime.UTC).replace(tzinfo=None)
    except (ValueError, OverflowError):
        return None
    since = instant - _UNIX_EPOCH
    return (since.days * _DAY_S + since.seconds) * NS_PER_S + since.microseconds * 1000
