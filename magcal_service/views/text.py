"""Lines of a terminal: spans with a style, cut to a width, and bars for a row of values."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from magcal_service.base.errors import printable

BARS: Final = "▁▂▃▄▅▆▇█"
ASCII_BARS: Final = "_.-:=+*#"
"""Where the terminal's encoding lacks blocks."""


class Style(StrEnum):
    """How a span is shown, as the parameters of ANSI's SGR; every style says something that the words say too."""

    PLAIN = ""
    DIM = "2"
    BOLD = "1"
    GOOD = "1;32"
    WAIT = "33"
    BAD = "1;31"
    BAR = "36"


@dataclass(frozen=True, slots=True)
class Span:
    """A piece of a line."""

    text: str
    style: Style = Style.PLAIN


Line = list[Span]


def columns(text: str) -> int:
    """How many columns of a terminal a text takes."""
    return len(text) if text.isascii() else sum(map(_columns_of, text))


def _columns_of(one: str) -> int:
    if unicodedata.combining(one):
        return 0
    return 2 if unicodedata.east_asian_width(one) in "WF" else 1


def cut(text: str, width: int) -> str:
    """A text in at most ``width`` columns; where it is longer it ends with two dots."""
    text = printable(text)
    if columns(text) <= width:
        return text
    kept, room = "", max(width - 2, 0)
    for one in text:
        if columns(kept) + _columns_of(one) > room:
            break
        kept += one
    return (kept + "..")[: max(width, 0)]


def wrapped(text: str, width: int, rows: int) -> list[str]:
    """A text in at most ``rows`` lines of ``width`` columns, broken at spaces; what does not fit is cut."""
    lines, left = list[str](), printable(text)
    while left and len(lines) < rows - 1 and columns(left) > width:
        head = left[: width + 1]
        at = head.rfind(" ")
        at = width if at <= 0 else at
        lines.append(left[:at])
        left = left[at:].lstrip()
    return [*lines, cut(left, width)] if left else lines


def fitted(line: Iterable[Span], width: int) -> Line:
    """A line in at most ``width`` columns."""
    kept, room = Line(), width
    for span in line:
        text = cut(span.text, room)
        kept.append(Span(text, span.style))
        room -= columns(text)
        if room <= 0:
            break
    return kept


def painted(line: Iterable[Span], colour: bool) -> str:
    """A line as a terminal takes it."""
    return "".join(
        f"\x1b[{span.style}m{span.text}\x1b[0m" if colour and span.style and span.text else span.text for span in line
    )


def bars(values: Sequence[float], low: float, high: float, marks: str = BARS) -> str:
    """One mark for each value, from the first of ``marks`` at ``low`` to the last at ``high``; a space for NaN."""
    reach = high - low
    return "".join(" " if math.isnan(one) else marks[_level(one - low, reach, len(marks))] for one in values)


def _level(above: float, reach: float, levels: int) -> int:
    return 0 if reach <= 0.0 else min(max(int(above / reach * levels), 0), levels - 1)
