"""The time of a log: which column, or columns, in which form; by their names and by what the numbers can be."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.errors import Fault, InputRefusedError
from magcal_service.recordings.describe import dates
from magcal_service.recordings.describe.columns import Column, Log
from magcal_service.recordings.describe.draft import Draft, Question, answered
from magcal_service.recordings.timestamps import iso8601_to_ns

FloatArray = npt.NDArray[np.float64]

_TIME_WORDS: Final = {
    "t", "time", "times", "timestamp", "timestamps", "ts", "unix", "unixtime", "utc", "epoch", "date", "datetime",
    "clock", "elapsed", "sec", "secs", "second", "seconds", "ms", "millis", "micros", "us", "met", "tow", "tick",
    "ticks", "posix", "gps", "jd", "mjd", "julian", "excel", "uptime", "sow", "itow", "stamp", "serial", "datenum",
}  # fmt: skip
_WEEK: Final = {"week", "wk", "gpsweek", "wn", "weekno", "gwk", "gpswk", "weeks"}
_OF_WEEK: Final = {"tow", "itow", "sow", "gms", "towms"}
_DATE: Final = {"date", "day", "datum", "fecha", "jour", "dates"}
_S: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_UNIX: Final = (7.9e8, 2.3e9)
"""Unix seconds from 1995 to 2042: a log of the years that a digital sensor can be from."""

_DAYS: Final = {
    "excel_days": (34000.0, 51000.0, 25569.0),
    "mjd_days": (51000.0, 66000.0, 40587.0),
    "julian_days": (2.4495e6, 2.4665e6, 2440587.5),
}
"""First and last day of about the same years, and the day of 1970-01-01."""

_STEP_S: Final = (0.0009, 3700.0)
"""Seconds between rows: a magnetometer is read between 1000 times a second and once an hour."""

_CLEAR_STEP_S: Final = (0.0045, 130.0)
"""Between these bounds the usual logs are; a unit that leads outside is less likely than one within."""

_RATE: Final = re.compile(
    r"(?:rate|freq\w*|fs)\b[^0-9\n]{0,24}([0-9]+(?:\.[0-9]+)?)\s*(?:hz|sps|samples)", re.IGNORECASE
)
_START: Final = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d(?:\.\d+)?)?(?:Z|[+-]\d\d:?\d\d)?")
_GPS_EPOCH_S: Final = 315964800.0  # 1980-01-06 in Unix seconds
_WEEK_S: Final = 604800.0  # seconds in a week


@dataclass(frozen=True, slots=True)
class Times:
    """The sampled rows' times.

    Parameters
    ----------
    seconds: (n,) Unix seconds where ``absolute``, else since some start; NaN where there is none.
    absolute: whether the date is known.
    columns: numbers of the columns that they are from.
    """

    seconds: FloatArray
    absolute: bool
    columns: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class _Form:
    """One reading of a column, or columns."""

    columns: tuple[Column, ...]
    format: str
    times: FloatArray
    absolute: bool
    why: str
    sure: bool
    rank: int
    pattern: str = ""


def find_times(draft: Draft) -> Times | None:
    """Put the time into the draft, or ask; the times where they are known."""
    answer = _by_answer(draft)
    if answer is not None:
        return answer
    log = draft.log
    forms = _forms(log)
    sure = sorted((form for form in forms if form.sure), key=lambda form: form.rank)
    if sure:
        return _take(draft, sure[0], sure[0].why)
    if forms:
        _ask_form(draft, forms)
        return None
    return _by_rate(draft)


def _take(draft: Draft, form: _Form, why: str) -> Times:
    names = draft.names(form.columns)
    start = draft.answers.get("time.start")
    if len(names) == 1:
        draft.put("time", "column", names[0])
    else:
        draft.put("time", "columns", names)
    if form.pattern:
        draft.put("time", "pattern", form.pattern)
    else:
        draft.put("time", "format", form.format)
    draft.conclude("time", f"{' + '.join(c.label for c in form.columns)} as {form.pattern or form.format}", why)
    if start is not None:
        if not form.format.startswith("elapsed"):
            raise InputRefusedError([Fault("--answer time.start", start, "it goes with an elapsed time only")])
        draft.put("time", "start", start)
        draft.conclude("time.start", start, answered("time.start"))
    offset = (_instant("time.start", start) if start is not None else 0.0) or 0.0
    numbers = tuple(column.number for column in form.columns)
    return Times(form.times + offset, form.absolute or start is not None, numbers)


def _instant(key: str, text: str) -> float:
    ns = iso8601_to_ns(text)
    if ns is None:
        accepted = 'an ISO 8601 instant such as "2025-06-01T00:00:00Z" is accepted'
        raise InputRefusedError([Fault(f"--answer {key}", text, accepted)])
    return ns / 1e9


def _ask_form(draft: Draft, forms: Sequence[_Form]) -> None:
    """Which column, or which form of it."""
    first = min(form.rank for form in forms)
    best = [form for form in forms if form.rank == first]
    columns = {form.columns for form in best}
    if len(columns) > 1:
        candidates = tuple((",".join(draft.names(columns)), "") for columns in dict.fromkeys(f.columns for f in best))
        asks = "which column is the time? several rise from row to row and no name decides"
        draft.ask(Question("time.column", asks, candidates, candidates[0][0]))
        return
    label = " + ".join(column.label for column in best[0].columns)
    if best[0].pattern:
        asks = f"how are day and month written in {label}? every date fits more than one way"
        draft.ask(Question("time.pattern", asks, tuple((form.pattern, form.why) for form in best), best[0].pattern))
        return
    asks = f"in which form is the time of {label}? neither its name nor its numbers decide"
    draft.ask(Question("time.format", asks, tuple((form.format, form.why) for form in best), best[0].format))


def _by_answer(draft: Draft) -> Times | None:
    """The time as it was answered: a rate, a column, a format or a pattern."""
    answers, log = draft.answers, draft.log
    rate = answers.get("time.rate_hz")
    if rate is not None:
        return _put_rate(draft, _positive("time.rate_hz", rate), answered("time.rate_hz"))
    columns = draft.columns("time.columns", (1, 2, 3, 4, 5, 6)) or draft.columns("time.column", (1,))
    form, pattern = answers.get("time.format"), answers.get("time.pattern")
    if columns is None and form is None and pattern is None:
        return None
    forms = _forms(log) if columns is None else [one for one in _of_columns(tuple(columns)) if one is not None]
    wanted = [f for f in forms if (form in {None, f.format}) and (pattern in {None, f.pattern})]
    wanted.sort(key=lambda one: (not one.sure, one.rank))
    key = next(k for k in ("time.pattern", "time.format", "time.column") if answers.get(k) or k == "time.column")
    sure = [one for one in wanted if one.sure]
    if wanted and (len(wanted) == 1 or form or pattern or len(sure) == 1):
        return _take(draft, (sure or wanted)[0], f"{answered(key)}; {wanted[0].why}")
    if wanted:
        _ask_form(draft, wanted)
        return None
    if columns is not None and pattern is not None:
        cells = _joined(tuple(columns))
        times = dates.seconds(cells, pattern)
        if np.isfinite(times).mean() > 0.5:
            return _take(draft, _Form(tuple(columns), "", times, True, "", True, 0, pattern), answered("time.pattern"))
    given = pattern or form or ", ".join(column.label for column in columns or ())
    known = " ".join(dict.fromkeys(f.pattern or f.format for f in forms)) or "none that is known"
    raise InputRefusedError([Fault(f"--answer {key}", given, f"the log's times can be read as: {known}")])


def _positive(key: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 1e-4 <= value <= 1e5:
        raise InputRefusedError([Fault(f"--answer {key}", text, "a number of rows a second is accepted, such as 10")])
    return value


def _put_rate(draft: Draft, rate_hz: float, why: str) -> Times:
    draft.put("time", "rate_hz", rate_hz)
    draft.conclude("time", f"{rate_hz:g} rows a second", why)
    start = draft.answers.get("time.start")
    if start is not None:
        draft.put("time", "start", start)
        draft.conclude("time.start", start, answered("time.start"))
    rows = np.arange(draft.log.rows, dtype=np.float64) / rate_hz
    return Times(rows + (_instant("time.start", start) if start else 0.0), start is not None)


def _by_rate(draft: Draft) -> Times | None:
    """Rows that come evenly, where a line of the preamble says how fast."""
    text = "\n".join(draft.log.layout.preamble)
    rates = {float(rate) for rate in _RATE.findall(text)}
    if len(rates) == 1:
        return _put_rate(draft, rates.pop(), "no column is a time, and the lines before the rows state the rate")
    asks = "no column is a time by its name and numbers; how many rows come in a second, evenly?"
    draft.ask(Question("time.rate_hz", asks, (), "10"))
    return None


def _forms(log: Log) -> list[_Form]:
    found = [*_gps_week(log), *_date_and_clock(log)]
    for column in log.columns:
        found += _of_columns((column,))
    return found


def _of_columns(columns: tuple[Column, ...]) -> list[_Form]:
    if len(columns) > 1:
        return _texts(columns, _joined(columns), 2)
    column = columns[0]
    if column.numeric:
        return _numbers(column) + (_texts(columns, column.cells, 3) if _named(column) and column.whole else [])
    return _texts(columns, column.cells, 1)


def _joined(columns: Sequence[Column]) -> list[str]:
    return [" ".join(parts) for parts in zip(*(column.cells for column in columns), strict=True)]


def _named(column: Column) -> bool:
    words = set(column.words) | {column.stem.lower()}
    return bool(words & _TIME_WORDS) or any(word.startswith(("time", "unix", "epoch")) for word in words)


def _texts(columns: tuple[Column, ...], cells: Sequence[str], rank: int) -> list[_Form]:
    """Readings of text as an instant."""
    filled = [cell for cell in cells if cell]
    if not filled or not any(sign.isdigit() for sign in filled[0]) or len(filled[0]) < 8:
        return []
    if len(columns) == 1:
        parsed = [iso8601_to_ns(cell) for cell in cells]
        good = sum(value is not None for value in parsed)
        if good >= 0.9 * len(filled):
            times = np.array([np.nan if value is None else value / 1e9 for value in parsed])
            zone = "" if re.search(r"(Z|z|UTC|[+-]\d\d:?\d\d)$", filled[0]) else "; no zone is written, so UTC is taken"
            why = f"every cell is an ISO 8601 instant such as {filled[0]!r}{zone}"
            return [_Form(columns, "iso8601", times, True, why, True, rank)]
    patterns = dates.fitting(filled)
    if not patterns:
        return []
    times_of = {pattern: dates.seconds(cells, pattern) for pattern in patterns}
    running = [pattern for pattern in patterns if dates.in_order(times_of[pattern])] or patterns
    running = _same_instants(running, times_of)
    if len(running) > 1:
        running = _shortest_gaps(running, times_of)
    why = f"every cell fits, such as {filled[0]!r}, and the times run on; no zone is written, so UTC is taken"
    return [_Form(columns, "", times_of[pattern], True, why, len(running) == 1, rank, pattern) for pattern in running]


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


def _date_and_clock(log: Log) -> list[_Form]:
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
    found = []
    for day in days[:2]:
        for clock in clocks[:2]:
            if day is clock:
                continue
            found += _texts((day, clock), _joined((day, clock)), 0)
    return found


def _is_date(column: Column) -> bool:
    named = bool(set(column.words) & _DATE)
    if column.numeric and not (named and column.whole):
        return False
    return bool(dates.fitting_dates(column.cells))


def _gps_week(log: Log) -> list[_Form]:
    weeks = [
        c for c in log.columns if c.numeric and c.whole and set(c.words) & _WEEK and _within(c.values, 700.0, 4000.0)
    ]
    seconds = [
        c for c in log.columns if c.numeric and not set(c.words) & _WEEK and (set(c.words) & _OF_WEEK or _named(c))
    ]
    found = []
    for week in weeks[:1]:
        for column in sorted(seconds, key=lambda c: not set(c.words) & _OF_WEEK):
            milli = column.unit == "ms" or not _within(column.values, 0.0, _WEEK_S)
            if not _within(column.values, 0.0, _WEEK_S * (1000.0 if milli else 1.0)):
                continue
            times = _GPS_EPOCH_S + week.values * _WEEK_S + column.values * (1e-3 if milli else 1.0)
            form = "gps_week_ms" if milli else "gps_week_s"
            why = "the names say GPS week and time of week, and the numbers are those of such"
            found.append(_Form((week, column), form, times, True, why, _rises(times, log.neighbours()), 0))
            break
    return found


def _within(values: FloatArray, low: float, high: float) -> bool:
    good = values[np.isfinite(values)]
    return bool(good.size) and float(np.mean((good >= low) & (good <= high))) > 0.99


def _rises(times: FloatArray, _: npt.NDArray[np.bool_] | None = None) -> bool:
    """Whether it rises from row to row, but for repeats and a few steps back, and rises at all."""
    good = times[np.isfinite(times)]
    if good.size < 2:
        return False
    steps = np.diff(good)
    return float(np.mean(steps < 0)) <= 0.02 and float(np.mean(steps > 0)) >= 0.02 and good[-1] > good[0]


def _numbers(column: Column) -> list[_Form]:
    """Readings of a numeric column."""
    values = column.values
    if not _rises(values):
        return []
    named, found = _named(column), []
    step = _usual_step(values)
    for unit, factor in _S.items():
        if _within(values * factor, *_UNIX) and step * factor <= 86400.0:
            fits = column.unit in {"", unit}
            counter = bool(set(column.words) & {"millis", "micros", "uptime", "elapsed", "met", "ticks", "tick"})
            years = f"{1970 + int(values[0] * factor / 31556952)}"
            why = f"it rises from row to row and as Unix time in {unit} it is of the year {years}" + (
                ", as the name says" if named else ""
            )
            sure = fits and not counter and (named or not column.name)
            found.append(_Form((column,), f"unix_{unit}", values * factor, True, why, sure, 1 if named else 3))
    for form, (low, high, epoch) in _DAYS.items():
        if _within(values, low, high) and step * 86400.0 <= 86400.0 and (not column.whole or "jd" in column.words):
            year = 1970 + int((values[0] - epoch) / 365.2425)
            why = f"it rises from row to row by {step * 86400.0:.3g} s and its days are of the year {year}"
            found.append(
                _Form(
                    (column,), form, (values - epoch) * 86400.0, True, why, named or not column.name, 2 if named else 4
                )
            )
    if any(form.sure for form in found) or (found and not named):
        return found
    return found + _elapsed(column, step, named)


def _usual_step(values: FloatArray) -> float:
    """The usual step from row to row; of stamps that repeat, their mean one."""
    steps = np.diff(values[np.isfinite(values)])
    middle = float(np.median(steps))
    if middle > 0:
        return middle
    up = steps[(steps >= 0) & (steps <= 1000.0 * max(float(np.median(steps[steps > 0])), 0.0))]
    return float(up.mean())


def _elapsed(column: Column, step: float, named: bool) -> list[_Form]:
    unit = column.unit if column.unit in _S else next((w for w in column.words if w in _S), "")
    said = {
        "millis": "ms",
        "milliseconds": "ms",
        "micros": "us",
        "microseconds": "us",
        "seconds": "s",
        "sec": "s",
        "secs": "s",
    }
    unit = unit or next((said[word] for word in column.words if word in said), "")
    if not named and not unit and column.name:
        return []
    if unit:
        fits = _STEP_S[0] <= step * _S[unit] <= _STEP_S[1]
        why = f"the name says {unit}, and it rises by {step * _S[unit]:.4g} s a row"
        return [_Form((column,), f"elapsed_{unit}", column.values * _S[unit], False, why, fits, 5)]
    possible = [one for one, factor in _S.items() if _CLEAR_STEP_S[0] <= step * factor <= _CLEAR_STEP_S[1]]
    possible = possible or [one for one, factor in _S.items() if _STEP_S[0] <= step * factor <= _STEP_S[1]]
    if not column.whole and "s" in possible:
        possible = ["s"]
    counts = column.whole and _steps_are_one(column.values)
    forms = []
    for one in possible:
        why = f"the name says a time, and as {one} it rises by {step * _S[one]:.4g} s a row"
        sure = len(possible) == 1 and named and not (counts and set(column.words) & {"tick", "ticks", "serial"})
        forms.append(_Form((column,), f"elapsed_{one}", column.values * _S[one], False, why, sure, 6 if named else 8))
    return forms


def _steps_are_one(values: FloatArray) -> bool:
    steps = np.diff(values[np.isfinite(values)])
    return float(np.mean(steps == 1.0)) > 0.9
