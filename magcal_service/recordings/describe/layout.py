"""How a log's text is laid out: delimiter, decimal sign, comments, lines before the header, header, line of units."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from magcal_service.errors import Fault, RecordingError
from magcal_service.recordings.describe.sample import Sample
from magcal_service.recordings.describe.units import is_unit

WHITESPACE: Final = "whitespace"
_DELIMITERS: Final = ("\t", ";", "|", ",", WHITESPACE)
"""In the order of preference: where two cut a line equally well, the rarer one was meant."""

_COMMENTS: Final = ("#", "%", "//", "!", "*", "'")
_NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?", re.ASCII)
_COMMA_NUMBER: Final = re.compile(r"[+-]?(?:\d+,\d*|,\d+)(?:[eE][+-]?\d{1,3})?", re.ASCII)
_NOT_A_VALUE: Final = {"", "nan", "-nan", "+nan", "null", "none", "na", "n/a", "inf", "-inf", "--", "?"}
_DATE: Final = re.compile(
    r"\d{1,4}[-/.]\d{1,3}([-/.]\d{1,4})?([T ].*)?|\d{1,2}[- ][A-Za-z]{3}[- ]\d{2,4}.*|[A-Za-z]{3} \d.*"
)
_CLOCK: Final = re.compile(r"\d{1,2}:\d\d(:\d\d)?([.,:]\d+)?\s*([AaPp][Mm]|Z|UTC)?")
_LOOKED_AT: Final = 400  # lines of the head: enough to know a log's form
_LEAST_SHARE: Final = 0.6  # of the lines looked at that have the same number of cells


@dataclass(frozen=True, slots=True)
class Layout:
    """A log's form.

    Parameters
    ----------
    delimiter: ``","`` ``";"`` ``"\\t"`` ``"|"`` or ``"whitespace"``.
    decimal: ``"."`` or ``","``.
    comment: what comment lines begin with; empty where there are none.
    skip_lines: lines before the header, or before the first row where there is no header.
    header: whether a line of names stands at the head of the rows and is read as such.
    names: a name for each column, empty where none is known.
    units: what a line of units says of each column; empty where there is none.
    preamble: the lines before the rows, as written.
    remarks: what was noticed on the way, in sentences.
    """

    delimiter: str
    decimal: str
    comment: str
    skip_lines: int
    header: bool
    names: tuple[str, ...]
    units: tuple[str, ...]
    preamble: tuple[str, ...]
    remarks: tuple[str, ...]

    def rows(self, lines: Sequence[str], first: int = 0) -> list[list[str]]:
        """Cells of the lines from ``first`` on that have the form of a row."""
        rows = []
        for line in lines[first:]:
            cells = None if not line.strip() or self.is_comment(line) else split(line, self.delimiter)
            if cells is None or len(cells) < len(self.names):
                continue
            if sum(_is_value(cell) for cell in cells) * 2 < len(cells):
                continue
            rows.append([self._plain(cell) for cell in cells[: len(self.names)]])
        return rows

    def is_comment(self, line: str) -> bool:
        """Whether a line is a comment."""
        return bool(self.comment) and line.lstrip().startswith(self.comment)

    def _plain(self, cell: str) -> str:
        """A cell with the decimal sign that numbers are read by."""
        if self.decimal == "," and _COMMA_NUMBER.fullmatch(cell):
            return cell.replace(",", ".")
        return cell


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


def find_layout(sample: Sample, delimiter: str | None = None, decimal: str | None = None) -> Layout:
    """The layout of a log, with delimiter and decimal sign where they are known; raises ``RecordingError``."""
    head = sample.head
    comment = _comment(head)
    body = [line for line in head if line.strip() and not (comment and line.lstrip().startswith(comment))]
    body = body[len(body) // 3 :][:_LOOKED_AT] if len(body) > 6 else body
    found = [_cut(body, one) for one in ((delimiter,) if delimiter else _DELIMITERS)]
    best = max(found, key=lambda cut: round(cut.score, 2))
    if best.width < 2 or best.share < _LEAST_SHARE or best.score < 0.3:
        accepted = (
            "rows of the same number of cells, most of them numbers, are accepted, cut by comma, semicolon, tab, "
            "| or blanks; --answer samples.delimiter=... says which"
        )
        raise RecordingError([Fault(str(sample.path), (body or [""])[0][:80], accepted)])
    sign = decimal or ("," if best.comma > best.point else ".")
    return _with_header(head, comment, best, sign)


@dataclass(frozen=True, slots=True)
class _Cut:
    """How well a delimiter cuts lines: the usual width, the share of lines that have it, how many cells are values."""

    delimiter: str
    width: int
    share: float
    score: float
    comma: int
    point: int


def _cut(lines: Sequence[str], delimiter: str) -> _Cut:
    rows = [split(line, delimiter) for line in lines]
    widths = Counter(len(row) for row in rows if row is not None)
    if not widths:
        return _Cut(delimiter, 0, 0.0, 0.0, 0, 0)
    width, times = widths.most_common(1)[0]
    cells = [cell for row in rows if row is not None and len(row) == width for cell in row]
    comma = sum(bool(_COMMA_NUMBER.fullmatch(cell)) for cell in cells) if delimiter != "," else 0
    point = sum("." in cell and bool(_NUMBER.fullmatch(cell)) for cell in cells)
    values = sum(_is_value(cell) for cell in cells) / max(len(cells), 1)
    share = times / len(lines)
    return _Cut(delimiter, width, share, share * values if width > 1 else 0.0, comma, point)


def _is_value(cell: str) -> bool:
    """Whether a cell is what stands in a row: a number, a date, a time of day, or a way to say that there is none."""
    return bool(
        _NUMBER.fullmatch(cell)
        or _COMMA_NUMBER.fullmatch(cell)
        or cell.lower() in _NOT_A_VALUE
        or _CLOCK.fullmatch(cell)
        or _DATE.fullmatch(cell)
    )


def _comment(lines: Sequence[str]) -> str:
    """What comment lines begin with, where there are any."""
    for mark in _COMMENTS:
        marked = [line for line in lines[:_LOOKED_AT] if line.lstrip().startswith(mark)]
        if marked and len(marked) * 2 < len(lines):
            return mark
    return ""


def _with_header(head: Sequence[str], comment: str, cut: _Cut, decimal: str) -> Layout:
    first = next(
        (i for i, line in enumerate(head) if _is_row(line, comment, cut)),
        len(head),
    )
    remarks: list[str] = []
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    at: int | None = None
    for i in range(first - 1, -1, -1):
        if not head[i].strip():
            continue
        marked = bool(comment) and head[i].lstrip().startswith(comment)
        cells = _names(head[i].lstrip()[len(comment) :] if marked else head[i], cut)
        if cells is None:
            if marked:
                continue
            break
        if not units and not marked and sum(is_unit(cell) for cell in cells) * 2 >= sum(bool(c) for c in cells):
            units = cells
            remarks.append(f"line {i + 1} holds units, no row")
            continue
        names, at = cells, i
        break
    marked = at is not None and bool(comment) and head[at].lstrip().startswith(comment)
    if units and not names:  # one line that only looks like units is a line of names
        names, units, at = units, (), next(i for i in range(first) if _names(head[i], cut) == units)
        remarks.clear()
    width = max(cut.width, len(names))
    if at is None:
        remarks.append("no line of names: columns go by their number")
        return Layout(
            cut.delimiter, decimal, comment, first, False, ("",) * width, (), tuple(head[:first]), tuple(remarks)
        )
    if marked:
        remarks.append(f"the names stand in the comment of line {at + 1}: columns go by their number")
    names = names + ("",) * (width - len(names))
    units = units + ("",) * (width - len(units)) if units else ()
    skip = first if marked else at
    before = tuple(head[: first if marked else at])
    return Layout(cut.delimiter, decimal, comment, skip, not marked, names, units, before, tuple(remarks))


def _is_row(line: str, comment: str, cut: _Cut) -> bool:
    if not line.strip() or (comment and line.lstrip().startswith(comment)):
        return False
    cells = split(line, cut.delimiter)
    if cells is None or len(cells) != cut.width:
        return False
    filled = [cell for cell in cells if cell]
    return sum(_is_value(cell) for cell in filled) * 2 >= len(filled) > 0 and any(_NUMBER.match(c) for c in filled)


def _names(line: str, cut: _Cut) -> tuple[str, ...] | None:
    """The cells of a line that could hold the names, or the units, of the columns."""
    cells = split(line.strip() if cut.delimiter == WHITESPACE else line.rstrip("\r"), cut.delimiter)
    if cells is None or not cut.width - 1 <= len(cells) <= cut.width + 40:
        return None
    if len(cells) != cut.width and len([c for c in cells if c]) > cut.width:
        return None
    filled = [cell for cell in cells if cell]
    if len(filled) < 2 or sum(bool(_NUMBER.fullmatch(cell)) for cell in filled) * 2 >= len(filled):
        return None
    return tuple(cells)
