"""Times that are none of the rows' own: shared, in another unit, from another epoch, going back."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from magcal_service.recordings.inspect.bursts import burst, is_even
from magcal_service.recordings.inspect.finding import Code, Seen, Spoils, rows_that
from magcal_service.recordings.inspect.log import Log
from magcal_service.recordings.time_spec import TimeFormat
from magcal_service.recordings.timestamps import ns_to_iso8601
from magcal_service.wire.messages import Clock

_FEWEST_SHARED: Final = 10
"""Rows with the time of another from which it is said; choice: fewer are doubled rows, which the reader counts."""

_COARSE_S: Final = 2.0
"""Of shared stamps this far apart nobody knows where within them a row belongs: the reference moves on meanwhile."""

_SLOW_S: Final = 300.0
"""Rows this far apart: less than twenty an orbit."""

_FAST_S: Final = 1.0 / 600.0
"""Rows this close: faster than magnetometers are logged."""

_IN_PARTS: Final = ("unix", "elapsed")
"""Kinds of time that are written in s, ms, us or ns."""

_EPOCHS: Final = (
    ("GPS seconds (since 1980-01-06)", 315_964_800),
    ("seconds since 2000-01-01T12:00:00", 946_728_000),
    ("a GPS receiver that has lost 1024 weeks", 1024 * 7 * 86_400),
    ("seconds since 1900 (NTP)", -2_208_988_800),
    ("seconds since 1904", -2_082_844_800),
)
_YEARS: Final = (2006, 2036)
"""UTC that small satellites fly in; GPS week counters rolled over in 1999 and 2019."""

_YEAR_S: Final = 31_556_952
"""Mean length of a year of the calendar, 365.2425 days [s]."""

_NS: Final = 1_000_000_000
"""Nanoseconds in a second."""

_NEVER_SET_S: Final = 30 * 86_400
"""Jump at the beginning that means a clock was set; choice: a month, longer than a safe mode is usually off."""


def shared_times(log: Log) -> Iterator[Seen]:
    """Many rows have the time of another row and another reading."""
    _, first, inverse = np.unique(log.time_ns, return_index=True, return_inverse=True)
    doubled = np.ones(len(log), dtype=np.bool_)
    doubled[first] = False
    other = np.any(log.field_nt != log.field_nt[first[inverse.ravel()]], axis=1)
    at = np.flatnonzero(doubled & other)
    if len(at) < _FEWEST_SHARED:
        return
    span_s = float(log.time_s.max() - log.time_s.min()) + log.step_s
    rate_hz = len(log) / span_s if span_s > 0.0 else 1.0
    says = f"{len(at)} of {len(log)} rows have the time of another row; the stamps are {log.step_s:g} s apart"
    remedy = "only the first row of each time is used: log times with their fractions of a second"
    length, _ = burst(log)
    if length:
        says += f", and rows seem to come in bursts of {length}, so that no rate_hz makes their times"
    elif len(at) >= len(log) // 2 and is_even(log.time_ns):
        even = f"write rate_hz = {rate_hz:.4g} and start in place of column and format under [time]"
        remedy += f", or, if rows come evenly, {even}"
    yield Seen(Code.SHARED_TIMES, log.step_s <= _COARSE_S, log.rows[at], says, remedy)


def time_unit(log: Log) -> Iterator[Seen]:
    """The step between rows is none that a magnetometer is logged at; written in another unit it would be."""
    step_s, spec = log.step_s, log.recording.descriptor.time
    if len(log) < 3 or spec.format.kind not in _IN_PARTS or _FAST_S < step_s < _SLOW_S or step_s <= 0.0:
        return
    name, factor = _unit(step_s)
    written = f'; is it {name}? then write format = "{spec.format.kind}_{name}"' if name else ""
    says = f"the median step between rows is {step_s:g} s, {log.time_s.max() - log.time_s.min():.4g} s in all"
    if name:
        says += f"; in {name} it would be {step_s * factor:g} s"
    remedy = f"check the unit of the times{written}"
    yield Seen(Code.TIME_UNIT, False, log.rows, says, remedy)


def _unit(step_s: float) -> tuple[str, float]:
    """The unit of time by which a step makes sense, and what to multiply the step by; empty where there is none."""
    for name, factor in (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9), ("s", 1e3), ("s", 1e6), ("ms", 1e3)):
        if 0.002 <= step_s * factor <= 60.0:
            return name, factor
    return "", 1.0


def time_epoch(log: Log) -> Iterator[Seen]:
    """The year is none in which this can have been logged, or a clock was set only later."""
    if log.recording.clock is not Clock.UTC or not len(log):
        return
    yield from _clock_not_set(log)
    middle = int(np.median(log.time_ns))
    if _YEARS[0] <= _year(middle) < _YEARS[1]:
        return
    guesses = [name for name, offset_s in _EPOCHS if _YEARS[0] <= _year(middle + offset_s * _NS) < _YEARS[1]]
    guess = f"; are they {' or '.join(guesses[:2])}?" if guesses else ""
    if abs(middle) < 8 * 86_400 * _NS:
        guess = "; are they seconds since the start, of the day or of the week?"
    says = f"the times lie around {ns_to_iso8601(middle)[:10]}"
    other, other_ns = _in_another_unit(log.recording.descriptor.time.format, middle)
    if other is not None:
        unit = other.value.removeprefix("unix_")
        says += f", and around {ns_to_iso8601(other_ns)[:10]} if they are in {unit}"
        remedy = f'check the unit of the times; if they are in {unit}, write format = "{other}"'
        yield Seen(Code.TIME_EPOCH, False, log.rows, says, remedy)
        return
    remedy = f'check the epoch of the times{guess} with format = "elapsed_s", start says what instant their zero is'
    yield Seen(Code.TIME_EPOCH, False, log.rows, says, remedy)


def _in_another_unit(form: TimeFormat, time_ns: int) -> tuple[TimeFormat | None, int]:
    """The format by which a time since 1970 lies in these years, and that time [ns]; None where there is none."""
    for other in (one for one in TimeFormat if one.kind == form.kind == "unix"):
        other_ns = time_ns * 10**other.decimals // 10**form.decimals
        if _YEARS[0] <= _year(other_ns) < _YEARS[1]:
            return other, other_ns
    return None, 0


def _clock_not_set(log: Log) -> Iterator[Seen]:
    """Rows at the beginning whose clock had not been set yet: years before the rest."""
    jump = np.flatnonzero(np.diff(log.time_ns) > _NEVER_SET_S * _NS)
    middle = int(np.median(log.time_ns))
    if not len(jump) or not _YEARS[0] <= _year(middle) < _YEARS[1]:
        return
    count = int(jump[0]) + 1
    if count > len(log) // 4 or _year(int(log.time_ns[:count].max())) >= _YEARS[0]:
        return
    says = f"the first {rows_that(count, 'lie')} around {ns_to_iso8601(int(log.time_ns[0]))[:10]}, the rest years later"
    remedy = "they are left out: the clock had not been set yet"
    yield Seen(Code.TIME_EPOCH, True, log.rows[:count], says, remedy, Spoils.ROW)


def _year(time_ns: int) -> int:
    return 1970 + time_ns // _NS // _YEAR_S


def time_order(log: Log) -> Iterator[Seen]:
    """Times go back: by a wrapped counter, by a step of the clock, or by rows out of order."""
    back = np.flatnonzero(np.diff(log.time_ns) < 0)
    if not len(back):
        return
    behind = np.flatnonzero(log.time_ns < np.maximum.accumulate(log.time_ns))
    step_s = float(np.min(np.diff(log.time_ns)[back])) * 1e-9
    name = _counter(-step_s, log.step_s)
    says = (
        f"time goes back {len(back)} times, by {-step_s:.6g} s at most; {rows_that(len(behind), 'lie')} behind others"
    )
    if name:
        says += f", as where {name} begins anew"
    remedy = (
        "rows are taken in the order of their times; if a counter wraps or a clock was set, log a time that goes on"
    )
    yield Seen(Code.TIME_ORDER, not name, log.rows[behind], says, remedy)


_COUNTERS: Final = (
    ("a time of the week", 604_800.0),
    ("a time of the day", 86_400.0),
    ("a time of the hour", 3600.0),
    ("a time of the minute", 60.0),
    ("a counter of 32 bits in ms", 2.0**32 / 1e3),
    ("a counter of 32 bits in us", 2.0**32 / 1e6),
    ("a counter of 16 bits in ms", 2.0**16 / 1e3),
)


def _counter(back_s: float, step_s: float) -> str:
    """The counter that begins anew with such a step back; empty where there is none."""
    for name, length_s in _COUNTERS:
        if length_s > 20.0 * step_s and abs(back_s + step_s - length_s) <= max(2.0 * step_s, 1e-4 * length_s):
            return name
    return ""
