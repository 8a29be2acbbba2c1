"""Cells of a line: how it is cut, and what can stand in a row."""

from __future__ import annotations

import csv
import re
from typing import Final

WHITESPACE: Final = "whitespace"
"""The delimiter of columns that any number of blanks keep apart."""

NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?", re.ASCII)
COMMA_NUMBER: Final = re.compile(r"[+-]?(?:\d+,\d+|,\d+)(?:[eE][+-]?\d{1,3})?", re.ASCII)
_NOT_A_VALUE: Final = {"", "nan", "-nan", "+nan", "null", "none", "na", "n/a", "inf", "-inf", "--", "?"}
_DATE: Final = re.compile(
    r"\d{1,4}[-/.]\d{1,3}([-/.]\d{1,4})?([T ].*)?|\d{1,2}[- ][A-Za-z]{3}[- ]\d{2,4}.*|[A-Za-z]{3} \d.*"
)
_CLOCK: Final = re.compile(r"\d{1,2}:\d\d(:\d\d)?([.,:]\d+)?\s*([AaPp][Mm]|Z|UTC)?")


def split(line: str, delimiter: str) -> list[str] | None:
    """Cells of a line, blanks stripped; None where its quotes make no sense."""
    if delimiter == WHITESPACE:
        return line.split()
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)]
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, strict=True))]
    except csv.Error:
        return None


def is_value(cell: str) -> bool:
    """Whether a cell is what stands in a row: a number, a date, a time of day, or a way to say that there is none."""
    return bool(
        NUMBER.fullmatch(cell)
        or COMMA_NUMBER.fullmatch(cell)
        or cell.lower() in _NOT_A_VALUE
        or _CLOCK.fullmatch(cell)
        or _DATE.fullmatch(cell)
    )
