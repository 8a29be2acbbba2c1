"""A column of numbers read as times: since 1970, in days, or since some start."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.recordings.describe.columns import Column
from magcal_service.recordings.describe.draft import answered

FloatArray = npt.NDArray[np.float64]

TIME_WORDS: Final = {
    "t", "time", "times", "timestamp", "timestamps", "ts", "unix", "unixtime", "utc", "epoch", "date", "datetime",
    "clock", "elapsed", "sec", "secs", "second", "seconds", "ms", "millis", "micros", "us", "met", "tow", "tick",
    "ticks", "posix", "gps", "jd", "mjd", "julian", "excel", "uptime", "sow", "itow", "stamp", "serial", "datenum",
    "cnes", "spenvis", "cjd", "zaman", "saat", "zeit",
}  # fmt: skip

S: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}

UNIX: Final = (7.9e8, 2.3e9)
"""Unix seconds from 1995 to 2042: a log of the years that a digital sensor can be from."""

DAYS: Final = {
    "excel_days": (34000.0, 51000.0, 25569.0),
    "mjd_days": (51000.0, 66000.0, 40587.0),
    "matlab_days": (728000.0, 745000.0, 719529.0),
    "mjd1950_days": (16400.0, 34000.0, 7305.0),
    "julian_days": (2.4495e6, 2.4665e6, 2440587.5),
}
"""First and last day of about the same years, and the day of 1970-01-01."""

_OF_1950: Final = {"cnes", "spenvis", "cjd", "1950"}
"""What says that days count from 1950."""

_OF_ANY_DAY: Final = {"mjd", "jd", "julian"} | _OF_1950
"""What days are called; without such a name numbers like those since 1950 are as well the seconds of some hours."""

_OF_DAYS: Final = {"excel", "serial", "datenum", "matlab", "day", "days", "date", "datetime"} | _OF_ANY_DAY
"""What says that a number counts days; 34000 to 51000 may be Excel's, or the seconds of a day from 9 to 14 h."""

_COUNTERS: Final = {"millis", "micros", "uptime", "elapsed", "met", "ticks", "tick"}
"""What a count since some start is called."""

_OF_1970: Final = {"unix", "unixtime", "posix", "epoch"}
"""What says that seconds count from 1970."""

_EARLY_UNIX_S: Final = 1.1e9
"""Unix seconds of 2004, before the first CubeSats but one: numbers below it are seconds since 2000 more often."""

_GPS_BEHIND_S: Final = 315964782.0
"""GPS seconds are so far behind Unix seconds: 1980-01-06 less the 18 leap seconds since 2017."""

_GPS_LATEST: Final = 1.48e9
"""GPS seconds of 2026-12; above it a number is Unix time, whatever receiver its name says."""

_STEP_S: Final = (0.0009, 3700.0)
"""Seconds between rows: a magnetometer is read between 1000 times a second and once an hour."""

_SLOW_S: Final = 61.0
"""Seconds between rows up to which a unit that a name says is believed: telemetry comes once a minute or oftener."""

_FAR_BACK: Final = 0.3  # of all that a column runs through: no row comes that late

_FRACTIONS_S: Final = 2.0
"""Steps up to here with a fraction are seconds; longer ones may as well be ms with a fraction."""

_USUAL_STEP_S: Final = 0.1  # of a logger: of several readings, the one nearest to it is named first

MANY_REPEATED: Final = 0.3  # of the rows: more that share their stamp with the row before are told

_CLEAR_STEP_S: Final = (0.0045, 130.0)
"""Between these bounds the usual logs are; a unit that leads outside is less likely than one within."""


@dataclass(frozen=True, slots=True)
class Form:
    """One reading of a column, or columns."""

    columns: tuple[Column, ...]
    format: str
    times: FloatArray
    absolute: bool
    why: str
    sure: bool
    rank: int
    pattern: str = ""


def in_form(column: Column, form: str) -> Form | None:
    """A column of numbers in the form that was answered, whatever its numbers look like; None for an unknown form."""
    kind, _, unit = form.partition("_")
    why = answered("time.format")
    if kind in {"unix", "elapsed"} and unit in S:
        return Form((column,), form, column.values * S[unit], kind == "unix", why, True, 0)
    if form in DAYS:
        return Form((column,), form, (column.values - DAYS[form][2]) * 86400.0, True, why, True, 0)
    return None


def is_named(column: Column) -> bool:
    """Whether a column is called a time."""
    words = set(column.words) | {column.stem.lower()}
    return bool(words & TIME_WORDS) or any(word.startswith(("time", "unix", "epoch")) for word in words)


def repeated(times: FloatArray) -> int:
    """How many rows have the stamp of the row before."""
    return int(np.sum(np.diff(times) == 0.0))


def within(values: FloatArray, low: float, high: float) -> bool:
    """Whether nearly all finite values (n,) lie from ``low`` to ``high``."""
    good = values[np.isfinite(values)]
    return bool(good.size) and float(np.mean((good >= low) & (good <= high))) > 0.99


def rises(times: FloatArray) -> bool:
    """Whether it rises from row to row, but for repeats and a few steps back, and rises at all."""
    good = times[np.isfinite(times)]
    if good.size < 2:
        return False
    steps = np.diff(good)
    if float(steps.min()) < -_FAR_BACK * float(np.ptp(good)):
        return False  # begins again, as seconds within a minute do
    return float(np.mean(steps < 0)) <= 0.02 and float(np.mean(steps > 0)) >= 0.02 and bool(good[-1] > good[0])


def numbers(column: Column) -> list[Form]:
    """Readings of a numeric column."""
    values = column.values
    if not rises(values):
        return []
    named, found = is_named(column), []
    step = _usual_step(values)
    for unit, factor in S.items():
        if within(values * factor, *UNIX) and step * factor <= 86400.0:
            fits = column.unit in {"", unit}
            # in the unit that its name has no counter comes so far: it would have run for 25 years
            counter = bool(set(column.words) & _COUNTERS) and column.unit != unit
            years = f"{_year(values[0] * factor)}"
            runs = (
                "rises from row to row"
                if repeated(values) <= MANY_REPEATED * len(values)
                else "rises, though not in each row,"
            )
            why = f"it {runs} and as Unix time in {unit} it is of the year {years}" + (
                ", as the name says" if named else ""
            )
            other = _other_epoch(column, float(values[0]) * factor)
            spaced = named or _as_rows(step * factor)
            sure = fits and not counter and not other and (named or not column.name) and spaced
            found.append(Form((column,), f"unix_{unit}", values * factor, True, why + other, sure, 1 if named else 3))
            if other or not spaced or (counter and fits):
                return [*found, *_in_rank(_elapsed(column, step, named), found[-1].rank)]
    for form, (low, high, epoch) in DAYS.items():
        since_1950 = form == "mjd1950_days"
        if since_1950 and not set(column.words) & _OF_ANY_DAY:
            continue
        if within(values, low, high) and step * 86400.0 <= 86400.0 and (not column.whole or "jd" in column.words):
            year = 1970 + int((values[0] - epoch) / 365.2425)
            why = f"it rises from row to row by {step * 86400.0:.3g} s and its days are of the year {year}"
            called = bool(set(column.words) & _OF_DAYS)
            sure = bool(set(column.words) & _OF_1950) if since_1950 else called or named or not column.name
            times = (values - epoch) * 86400.0
            if not called and not _only_as_days(step):  # as likely seconds
                elapsed = _elapsed(column, step, named)
                if step * 86400.0 > _STEP_S[1]:
                    return [*found, *elapsed]
                return [*found, Form((column,), form, times, True, why, False, 6), *_in_rank(elapsed, 6)]
            found.append(Form((column,), form, times, True, why, sure, 2 if named else 4))
    if any(form.sure for form in found) or (found and not named):
        return found
    return found + _elapsed(column, step, named)


def _year(unix_s: float) -> int:
    return 1970 + int(unix_s / 31556952)


def _as_rows(step_s: float) -> bool:
    """Whether a step is what rows of a log are apart."""
    return _STEP_S[0] <= step_s <= _SLOW_S


def _only_as_days(step: float) -> bool:
    """Whether rows are spaced as a log's by days, and as no log's by any usual unit of a clock."""
    return _as_rows(step * 86400.0) and not any(_CLEAR_STEP_S[0] <= step * one <= _SLOW_S for one in S.values())


def _in_rank(forms: list[Form], rank: int) -> list[Form]:
    """Forms beside others that are as likely."""
    return [replace(form, sure=False, rank=rank) for form in forms]


def _other_epoch(column: Column, unix_s: float) -> str:
    """What speaks for another epoch than 1970; empty where nothing does."""
    words = set(column.words)
    if words & _OF_1970:
        return ""
    if words & {"gps", "gpst"} and unix_s < _GPS_LATEST:
        year = _year(unix_s + _GPS_BEHIND_S)
        return f"; as GPS seconds it is of {year}: elapsed_s with --answer time.start=1980-01-05T23:59:42Z"
    if unix_s < _EARLY_UNIX_S:
        return "; as seconds since 2000 it is later: elapsed_s with --answer time.start=2000-01-01T12:00:00Z"
    return ""


def _usual_step(values: FloatArray) -> float:
    """The usual step from row to row; of stamps that repeat, their mean one."""
    steps = np.diff(values[np.isfinite(values)])
    middle = float(np.median(steps))
    if middle > 0:
        return middle
    up = steps[(steps >= 0) & (steps <= 1000.0 * max(float(np.median(steps[steps > 0])), 0.0))]
    return float(up.mean())


def _elapsed(column: Column, step: float, named: bool) -> list[Form]:
    unit = column.unit if column.unit in S else next((w for w in column.words if w in S), "")
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
    fits = bool(unit) and _STEP_S[0] <= step * S[unit] <= _STEP_S[1]
    usual = fits and _CLEAR_STEP_S[0] <= step * S[unit] <= _SLOW_S
    others = [one for one, factor in S.items() if one != unit and _CLEAR_STEP_S[0] <= step * factor <= _SLOW_S]
    if fits and (usual or not others):
        why = f"the name says {unit}, and it rises by {step * S[unit]:.4g} s a row"
        return [Form((column,), f"elapsed_{unit}", column.values * S[unit], False, why, True, 5)]
    possible = [one for one, factor in S.items() if _CLEAR_STEP_S[0] <= step * factor <= _CLEAR_STEP_S[1]]
    possible += [unit] if fits and unit not in possible else []
    possible = possible or [one for one, factor in S.items() if _STEP_S[0] <= step * factor <= _STEP_S[1]]
    if not column.whole and step <= _FRACTIONS_S and "s" in possible and not unit:
        possible = ["s"]
    possible.sort(key=lambda one: abs(np.log(step * S[one] / _USUAL_STEP_S)))
    counts = column.whole and _steps_are_one(column.values)
    forms = []
    for one in possible:
        says = "the name says a time, and" if named else "it rises from row to row:"
        says = f"the name says {unit}, but" if unit else says
        why = f"{says} as {one} it rises by {step * S[one]:.4g} s"
        sure = (
            len(possible) == 1
            and named
            and not unit
            and not (counts and set(column.words) & {"tick", "ticks", "serial"})
        )
        forms.append(Form((column,), f"elapsed_{one}", column.values * S[one], False, why, sure, 6 if named else 8))
    return forms


def _steps_are_one(values: FloatArray) -> bool:
    steps = np.diff(values[np.isfinite(values)])
    return float(np.mean(steps == 1.0)) > 0.9
