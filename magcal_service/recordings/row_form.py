"""``[samples]`` of a log in rows: how its text is laid out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from magcal_service.base.typed_toml.keys import flag, text, whole
from magcal_service.base.typed_toml.record import Reading

WHITESPACE: Final = "whitespace"
"""The delimiter of columns that any number of blanks keep apart."""

_DELIMITERS: Final = (",", ";", "\t", "|", WHITESPACE)
_LONGEST_COMMENT: Final = 8  # characters; choice: "//", "REM" and the like
_MOST_SKIPPED: Final = 1_000_000  # lines


def _check_delimiter(reading: Reading, name: str, delimiter: str) -> None:
    if delimiter not in _DELIMITERS:
        reading.table.refuse(name, delimiter, r'"," ";" "\t" "|" or "whitespace" is accepted')


def _check_decimal(reading: Reading, name: str, decimal: str) -> None:
    if decimal not in {".", ","}:
        reading.table.refuse(name, decimal, '"." or "," is accepted')


def _check_comment(reading: Reading, name: str, comment: str) -> None:
    if reading.table.has(name) and (not comment.strip() or len(comment) > _LONGEST_COMMENT):
        accepted = f'what comment lines begin with, such as "#", up to {_LONGEST_COMMENT} characters, is accepted'
        reading.table.refuse(name, comment, accepted)


@dataclass(frozen=True, slots=True)
class RowForm:
    """How rows stand in a file of text.

    Parameters
    ----------
    delimiter: what separates cells.
    decimal: the sign in numbers with a fraction.
    comment: what lines begin with that are no rows; empty where there are none.
    skip_lines: lines before the header, or before the first row where there is no header.
    header: whether a line of names comes first; else columns go by their number, from 1.
    """

    delimiter: str = text(",", check=_check_delimiter)
    decimal: str = text(".", check=_check_decimal)
    comment: str = text("", check=_check_comment)
    skip_lines: int = whole(0, 0, _MOST_SKIPPED)
    header: bool = flag(True)


PLAIN_ROWS: Final = RowForm()
"""A plain .csv: commas, decimal points, a header."""
