"""The time of a log: which column, or columns, in which form; by their names and by what the numbers can be."""

from __future__ import annotations

from collections.abc import Sequence
from operator import eq
from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.recordings.describe import dates
from magcal_service.recordings.describe.columns import Column, Log
from magcal_service.recordings.describe.draft import Draft, Question, answered
from magcal_service.recordings.describe.time_check import agrees, stated_rates
from magcal_service.recordings.describe.time_forms import NO_ZONE, ROLLOVERS, joined, of_columns, week_form
from magcal_service.recordings.describe.time_forms import forms as all_forms
from magcal_service.recordings.describe.time_numbers import MANY_REPEATED, Form, in_form, is_named, repeated, rises
from magcal_service.recordings.describe.times_found import Times
from magcal_service.recordings.timestamps import iso8601_to_ns

FloatArray = npt.NDArray[np.float64]

_FEW_SHARED: Final = 0.2  # of the shared stamps: a column that repeats so much less is the finer time
_ZONES: Final = {"tz", "zone", "timezone", "utcoffset", "utc_offset", "gmtoffset", "tzoffset"}
_TEN_BITS: Final = 1024  # weeks
_OF_WEEKS: Final = {"gps_week_s", "gps_week_ms"}
_SLOWEST_HZ: Final = 1e-4  # as a descriptor takes it


def find_times(draft: Draft) -> Times | None:
    """Put the time into the draft, or ask; the times where they are known."""
    answer = _by_answer(draft)
    if answer is not None:
        return answer
    log = draft.log
    forms = all_forms(log)
    dated = {column for form in forms if form.pattern for column in form.columns}
    forms = [form for form in forms if form.pattern or form.absolute or not set(form.columns) & dated]
    sure = sorted((form for form in forms if form.sure), key=lambda form: form.rank)
    if sure:
        _say_repeats(draft, sure[0])
        if not agrees(draft, sure[0], forms):
            return None
        return _take(draft, sure[0], sure[0].why)
    if forms:
        _ask_form(draft, forms)
        return None
    return _by_rate(draft)


def _take(draft: Draft, form: Form, why: str) -> Times:
    names = draft.names(form.columns)
    start = draft.answers.get("time.start")
    if len(names) == 1:
        draft.put("time", "column", names[0])
    else:
        draft.put("time", "columns", names)
    if form.pattern:
        comma = draft.log.layout.decimal == "," and form.columns[-1].numeric  # a number to us, and text to a pattern
        draft.put("time", "pattern", form.pattern.replace(".%f", ",%f") if comma else form.pattern)
    else:
        draft.put("time", "format", form.format)
    if form.format.startswith("gps_week"):
        _rollovers(draft, form.columns[0])
    _say_zone(draft, form)
    draft.conclude("time", f"{' + '.join(c.label for c in form.columns)} as {form.pattern or form.format}", why)
    if start is not None:
        if not form.format.startswith("elapsed"):
            raise InputRefusedError([Fault("--answer time.start", start, "it goes with an elapsed time only")])
        draft.put("time", "start", start)
        draft.conclude("time.start", start, answered("time.start"))
    offset = (_instant("time.start", start) if start is not None else 0.0) or 0.0
    numbers = tuple(column.number for column in form.columns)
    return Times(form.times + offset, form.absolute or start is not None, numbers, form.format)


def _say_zone(draft: Draft, form: Form) -> None:
    """Say where a column is called a zone and is not read as one beside times that have none."""
    if not form.why.endswith(NO_ZONE):
        return
    for column in draft.log.columns:
        words = set(column.words) | {column.stem.lower()}
        if words & _ZONES and column not in form.columns:
            cell = next((cell for cell in column.cells if cell), "")
            text = f"warning: UTC is taken, and {column.label} says {cell!r}: as +02:00 in each row it would be read"
            draft.said.append(text)


def _say_repeats(draft: Draft, form: Form) -> None:
    """Say how many rows share their stamp where many do, and which other column could be the time."""
    shared = repeated(form.times)
    if shared <= MANY_REPEATED * len(form.times):
        return
    label = " + ".join(column.label for column in form.columns)
    text = f"time: {shared} of {len(form.times)} rows have the stamp of the row before in {label}"
    left = [column for column in draft.log.columns if column not in form.columns]
    others = [c for c in left if c.numeric and rises(c.values) and repeated(c.values) < _FEW_SHARED * shared]
    others.sort(key=lambda column: not is_named(column))
    named = [c for c in left if is_named(c) and sum(map(eq, c.cells, c.cells[1:])) < _FEW_SHARED * shared]
    if others:
        text += f"; {others[0].label} repeats less and could be the time: --answer time.column={draft.name(others[0])}"
    elif named:
        text += f"; {named[0].label} repeats less and is called a time, but is none that a descriptor can read"
    draft.said.append(text)


def _rollovers(draft: Draft, week: Column) -> None:
    """A week counted in ten bits begins again every 1024 weeks; which time round it is, the log does not say."""
    answer = draft.answers.get("time.gps_rollovers")
    if answer is not None:
        if not answer.isdecimal() or int(answer) > ROLLOVERS + 1:
            raise InputRefusedError([Fault("--answer time.gps_rollovers", answer, "0 to 3 is accepted")])
        draft.put("time", "gps_rollovers", int(answer))
        draft.conclude("time.gps_rollovers", answer, answered("time.gps_rollovers"))
    elif float(np.nanmax(week.values)) < _TEN_BITS:
        asks = f"the weeks of {week.label} are below 1024: counted in ten bits, how often had they begun again?"
        candidates = (("2", "April 2019 to November 2038"), ("1", "August 1999 to April 2019"))
        draft.ask(Question("time.gps_rollovers", asks, candidates, "2"))


def _instant(key: str, text: str) -> float:
    ns = iso8601_to_ns(text)
    if ns is None:
        accepted = 'an ISO 8601 instant such as "2025-06-01T00:00:00Z" is accepted'
        raise InputRefusedError([Fault(f"--answer {key}", text, accepted)])
    return ns / 1e9


def _ask_form(draft: Draft, forms: Sequence[Form]) -> None:
    """Which column, or which form of it."""
    first = min(form.rank for form in forms)
    best = [form for form in forms if form.rank == first]
    columns = {form.columns for form in best}
    if len(columns) > 1:
        candidates = tuple((",".join(draft.names(columns)), "") for columns in dict.fromkeys(f.columns for f in best))
        asks = "which column is the time? several rise from row to row and no name decides"
        key = "time.column" if all(len(one) == 1 for one in columns) else "time.columns"
        draft.ask(Question(key, asks, candidates, candidates[0][0]))
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
    forms = all_forms(log)
    if columns is not None:
        together = [one for one in forms if one.columns == tuple(columns) and len(columns) > 1]
        forms = together + of_columns(tuple(columns))
        told = (
            week_form(columns[0], columns[1], answered("time.columns")) if len(columns) == 2 and not together else None
        )
        forms += [told] if told is not None else []
    wanted = [f for f in forms if (form in {None, f.format}) and (pattern in {None, f.pattern})]
    wanted.sort(key=lambda one: (not one.sure, one.rank))
    key = next(k for k in ("time.pattern", "time.format", "time.column") if answers.get(k) or k == "time.column")
    sure = [one for one in wanted if one.sure]
    if wanted and (len(wanted) == 1 or form or pattern or len(sure) == 1):
        return _take(draft, (sure or wanted)[0], f"{answered(key)}; {wanted[0].why}")
    if wanted:
        _ask_form(draft, wanted)
        return None
    likeliest = min((one for one in forms if one.sure), key=lambda one: one.rank, default=None)
    if columns is None and likeliest is not None:
        columns = list(likeliest.columns)
    if columns is not None and len(columns) == 1 and form is not None:
        told = in_form(columns[0], form)
        if told is not None:
            return _take(draft, told, told.why)
    if columns is not None and pattern is not None:
        cells = joined(tuple(columns))
        times = dates.seconds(cells, pattern)
        if np.isfinite(times).mean() > 0.5:
            return _take(draft, Form(tuple(columns), "", times, True, "", True, 0, pattern), answered("time.pattern"))
    given = pattern or form or ", ".join(column.label for column in columns or ())
    known = " ".join(dict.fromkeys(f.pattern or f.format for f in forms)) or "none that is known"
    accepted = f"the log's times can be read as: {known}"
    if form in _OF_WEEKS and answers.get("time.columns") is None:
        accepted = "week and time of week are two columns: --answer time.columns=WEEK,SECONDS as well"
    raise InputRefusedError([Fault(f"--answer {key}", given, accepted)])


def _positive(key: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not _SLOWEST_HZ <= value <= 1e5:
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
    rates = stated_rates(draft.log)
    if len(rates) == 1 and min(rates) >= _SLOWEST_HZ:
        return _put_rate(draft, rates.pop(), "no column is a time, and the lines before the rows state the rate")
    asks = "no column is a time by its name and numbers; how many rows come in a second, evenly?"
    rate, column = _rate_of_clock(draft.log)
    if column is not None:
        why = f"by the times of day in {column.label}, which have no date"
        draft.ask(Question("time.rate_hz", asks, ((f"{rate:.6g}", why),), f"{rate:.6g}"))
        return None
    draft.ask(Question("time.rate_hz", asks, (), "10"))
    return None


def _rate_of_clock(log: Log) -> tuple[float, Column | None]:
    """Rows a second by a column of times of day."""
    for column in log.columns:
        patterns = dates.fitting_clocks(column.cells) if not column.numeric and column.cells else []
        if patterns:
            steps = np.diff(dates.seconds(column.cells, patterns[0]))[log.neighbours()]
            steps = steps[np.isfinite(steps) & (steps >= 0)]
            if steps.size and float(steps.mean()) > 0:
                return 1.0 / float(steps.mean()), column
    return 0.0, None
