"""Patterns of dates and times as logs write them, and which of them fit."""

from __future__ import annotations

import datetime
import re
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

_DATES: Final = (
    "%Y-%m-%d", "%Y/%m/%d", "%Y.%m.%d", "%Y:%m:%d", "%d/%m/%Y", "%m/%d/%Y", "%d.%m.%Y", "%m.%d.%Y", "%d-%m-%Y",
    "%m-%d-%Y", "%d-%b-%Y", "%d %b %Y", "%b %d %Y", "%b %d, %Y", "%d %B %Y", "%B %d, %Y", "%a %b %d %Y", "%Y%m%d",
    "%Y-%j", "%Y/%j", "%d/%m/%y", "%m/%d/%y", "%y/%m/%d", "%d.%m.%y", "%d-%m-%y", "%m-%d-%y", "%y-%m-%d", "%d-%b-%y",
    "%d%m%y", "%y%m%d",
)  # fmt: skip
_CLOCKS: Final = (
    "%H:%M:%S", "%H:%M:%S.%f", "%H:%M:%S,%f", "%H:%M:%S:%f", "%H:%M", "%I:%M:%S %p", "%I:%M:%S.%f %p", "%I:%M %p",
    "%I:%M:%S%p", "%H%M%S", "%H%M%S.%f", "%H.%M.%S",
)  # fmt: skip
_BETWEEN: Final = (" ", "T", "_", " - ", ", ", "  ", ":", "-", "/")
_ZONE: Final = re.compile(r"(\s*)(?:Z|UTC|GMT|[+-]\d\d:?\d\d)$")
_TRIED: Final = 40  # cells that a pattern is first tried on


def parse(text: str, pattern: str) -> float | None:
    """Unix seconds of a text in a pattern, UTC; None where it does not fit."""
    try:
        instant = datetime.datetime.strptime(text, pattern)
    except ValueError:
        return None
    return instant.replace(tzinfo=instant.tzinfo or datetime.UTC).timestamp()


def fitting(cells: Sequence[str]) -> list[str]:
    """Patterns of date with time of day that every filled cell fits."""
    first = next((cell for cell in cells if cell), "")
    american = first.upper().endswith(("AM", "PM"))
    patterns = ["%a %b %d %H:%M:%S %Y"]
    zone = _zone(first)
    for between in _BETWEEN:
        for day, of_day in _halves(first, between):
            clocks = [clock + zone for clock in _CLOCKS if parse(of_day, clock + zone) is not None]
            days = [date for date in _DATES if clocks and parse(day, date) is not None]
            patterns += [f"{date}{between}{clock}" for clock in clocks for date in days]
    found = _fitting(cells, patterns)
    return sorted(found, key=lambda pattern: not pattern.startswith("%m")) if american else found


def _zone(text: str) -> str:
    """The end of a pattern for the zone that a text ends with; empty where it names none."""
    match = _ZONE.search(text)
    if match is None:
        return ""
    return match.group() if match.group().strip() in {"Z", "UTC", "GMT"} else match.group(1) + "%z"


def _halves(text: str, between: str) -> list[tuple[str, str]]:
    """Every way to part a text in two at ``between``."""
    parts = text.split(between)
    return [(between.join(parts[:at]), between.join(parts[at:])) for at in range(1, len(parts))]


def fitting_dates(cells: Sequence[str]) -> list[str]:
    """Patterns of a date alone that every filled cell fits."""
    return _fitting(cells, _DATES)


def fitting_clocks(cells: Sequence[str]) -> list[str]:
    """Patterns of a time of day alone that every filled cell fits."""
    return _fitting(cells, _CLOCKS)


def _fitting(cells: Sequence[str], patterns: Sequence[str]) -> list[str]:
    filled = [cell for cell in cells if cell]
    if not filled:
        return []
    few = filled[:: max(len(filled) // _TRIED, 1)]
    left = [pattern for pattern in dict.fromkeys(patterns) if parse(filled[0], pattern) is not None]
    left = [pattern for pattern in left if all(parse(cell, pattern) is not None for cell in few)]
    all_of_them = dict.fromkeys(filled)
    return [p for p in left if sum(parse(cell, p) is not None for cell in all_of_them) >= 0.98 * len(all_of_them)]


def seconds(cells: Sequence[str], pattern: str) -> npt.NDArray[np.float64]:
    """(n,) Unix seconds, NaN where a cell does not fit."""
    values = [parse(cell, pattern) for cell in cells]
    return np.array([np.nan if value is None else value for value in values])


def in_order(times_s: npt.NDArray[np.float64]) -> bool:
    """Whether times run on: hardly a step back, and no step of a week and more where the usual one is small."""
    good = times_s[np.isfinite(times_s)]
    if good.size < 2:
        return False
    steps = np.diff(good)
    return float(np.mean(steps < 0)) < 0.01 and float(good[-1]) > float(good[0])
