"""How a log's text is laid out: delimiter, decimal sign, comments, lines before the header, header, line of units."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Final

from magcal_service.base.errors import Fault, RecordingError
from magcal_service.recordings.describe.cells import COMMA_NUMBER, NUMBER, WHITESPACE, is_value, split
from magcal_service.recordings.describe.foreign import of_marked_up, of_text, of_unequal
from magcal_service.recordings.describe.header import Header, find_header
from magcal_service.recordings.describe.sample import Sample
from magcal_service.recordings.unit_words import unit_of

_DELIMITERS: Final = ("\t", ";", "|", ",", WHITESPACE)
"""In the order of preference: where two cut a line equally well, the rarer one was meant."""

_COMMENTS: Final = ("#", "%", "//", "!", "*", "'")
_OTHER_DELIMITERS: Final = ("^", "~", "&", ":", "/", "\\", "_")
_SURELY: Final = 0.8  # of the lines have the same number of cells, and of these most are values
_LOOKED_AT: Final = 400  # lines of the head: enough to know a log's form
_WORTH_OF_LABEL: Final = 0.7  # of a value: that rows have labels in them is possible, and seldom
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
    labels: a column's text where it is the same in every row, such as ``X:``; empty for columns of values.
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
    labels: tuple[str, ...]
    preamble: tuple[str, ...]
    remarks: tuple[str, ...]

    def rows(self, lines: Sequence[str], first: int = 0) -> list[list[str]]:
        """Cells of the lines from ``first`` on that have the form of a row."""
        rows = []
        for line in lines[first:]:
            cells = None if not line.strip() or self.is_comment(line) else split(line, self.delimiter)
            if cells is None or len(cells) < len(self.names):
                continue
            known = zip(cells, self.labels, strict=False)
            if sum(is_value(cell) or (bool(label) and cell == label) for cell, label in known) * 2 < len(self.names):
                continue
            rows.append([self._plain(cell) for cell in cells[: len(self.names)]])
        return rows

    def is_comment(self, line: str) -> bool:
        """Whether a line is a comment."""
        return bool(self.comment) and line.lstrip().startswith(self.comment)

    def _plain(self, cell: str) -> str:
        """A cell with the decimal sign that numbers are read by."""
        if self.decimal == "," and COMMA_NUMBER.fullmatch(cell):
            return cell.replace(",", ".")
        return cell


def find_layout(sample: Sample, delimiter: str | None = None, decimal: str | None = None) -> Layout:
    """The layout of a log, with delimiter and decimal sign where they are known; raises ``RecordingError``."""
    head = sample.head
    comment = _comment(head)
    body = [line for line in head if line.strip() and not (comment and line.lstrip().startswith(comment))]
    body = body[len(body) // 3 :][:_LOOKED_AT] if len(body) > 6 else body
    _refuse_marked_up(sample, body)
    if delimiter is None and (foreign := of_text(sample.path, body)):
        raise RecordingError([Fault(str(sample.path), (body or [""])[0][:80], foreign)])
    found = [_cut(body, one) for one in ((delimiter,) if delimiter else _DELIMITERS)]
    best = max(found, key=lambda cut: round(cut.score, 2))
    if best.width < 2 or best.share < _LEAST_SHARE or best.score < 0.3:
        accepted = (
            of_unequal(sample.path, body)
            or _cut_otherwise(sample.path, body)
            or (
                "rows of the same number of cells, most of them numbers, are accepted, cut by comma, semicolon, tab, "
                "| or blanks; --answer samples.delimiter=... says which"
            )
        )
        raise RecordingError([Fault(str(sample.path), (body or [""])[0][:80], accepted)])
    sign = decimal or ("," if best.comma > best.point else ".")
    return _layout(head, comment, best, sign, find_header(head, comment, best.delimiter, best.labels))


def _refuse_marked_up(sample: Sample, body: Sequence[str]) -> None:
    """Refuse JSON, XML and the like, whose lines a delimiter would cut into anything."""
    marked = [line for line in body if line.lstrip()[:1] in {"{", "<"} or line.strip() in {"[", "]"}]
    if body and len(marked) * 2 > len(body):
        raise RecordingError([Fault(str(sample.path), marked[0][:80], of_marked_up(sample.path, marked[-1]))])
    first = next((line.strip() for line in sample.head if line.strip()), "")
    if first in {"{", "[", "[{", "[["} or first.startswith(('{"', "<?xml")):  # over many lines
        raise RecordingError([Fault(str(sample.path), first[:80], of_marked_up(sample.path, ""))])


def _cut_otherwise(path: Path, body: Sequence[str]) -> str:
    """What cuts rows evenly and is no delimiter here, with the command that exchanges it; empty where nothing does."""
    found = [cut for cut in (_cut(body, sign) for sign in _OTHER_DELIMITERS) if cut.width > 1]
    best = max(found, key=lambda cut: cut.score, default=None)
    if best is None or best.score < _SURELY:
        return ""
    log = quote(str(path))
    return f"rows are cut by {best.delimiter!r}: tr {quote(best.delimiter)} ',' < {log} > log.csv makes commas of them"


@dataclass(frozen=True, slots=True)
class _Cut:
    """How well a delimiter cuts lines.

    Parameters
    ----------
    width, share: the usual number of cells, and the share of lines that have it.
    score: that share times the share of cells that are values, or the label of their column.
    comma, point: cells that are numbers with such a decimal sign.
    labels: the text of each column that has the same one in every line; empty for the others.
    """

    delimiter: str
    width: int
    share: float
    score: float
    comma: int
    point: int
    labels: tuple[str, ...] = ()


def _cut(lines: Sequence[str], delimiter: str) -> _Cut:
    rows = [split(line, delimiter) for line in lines]
    widths = Counter(len(row) for row in rows if row is not None)
    if not widths:
        return _Cut(delimiter, 0, 0.0, 0.0, 0, 0)
    width, times = widths.most_common(1)[0]
    cells = [cell for row in rows if row is not None and len(row) == width for cell in row]
    comma = sum(bool(COMMA_NUMBER.fullmatch(cell)) for cell in cells) if delimiter != "," else 0
    point = sum("." in cell and bool(NUMBER.fullmatch(cell)) for cell in cells)
    labels = _labels([row for row in rows if row is not None and len(row) == width])
    values = sum(is_value(cell) for cell in cells) / max(len(cells), 1)
    if values > 0:
        values += _WORTH_OF_LABEL * sum(bool(label) for label in labels) / width
    share = times / len(lines)
    return _Cut(delimiter, width, share, share * values if width > 1 else 0.0, comma, point, labels)


def _labels(rows: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Of each column the text that is the same in every row, where that is no value; else empty."""
    columns = [set(column) for column in zip(*rows, strict=True)]
    steady = [column.pop() if len(column) == 1 and len(rows) > 2 else "" for column in columns]
    return tuple("" if is_value(text) else text for text in steady)


def _comment(lines: Sequence[str]) -> str:
    """What comment lines begin with, where there are any."""
    for mark in _COMMENTS:
        marked = [line for line in lines[:_LOOKED_AT] if line.lstrip().startswith(mark)]
        if marked and len(marked) * 2 < len(lines):
            return mark
    return ""


def _from_labels(labels: tuple[str, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of columns of values by the labels in front of them, and units by those behind; a last unit is for all."""
    before, behind = ("", *labels[:-1]), (*labels[1:], "")
    called = ["" if label else text.strip(":= ") for label, text in zip(labels, before, strict=True)]
    round_of = [called[:at].count(name) for at, name in enumerate(called)]  # raw readings, then the same in a unit
    names = tuple(f"{name} {at + 1}" if name and at else name for name, at in zip(called, round_of, strict=True))
    units = tuple("" if label or not unit_of(text) else text for label, text in zip(labels, behind, strict=True))
    if unit_of(labels[-1]) and sum(map(bool, units)) == 1:
        last = max(at for name, at in zip(called, round_of, strict=True) if name)
        units = tuple(labels[-1] if name and at == last else "" for name, at in zip(called, round_of, strict=True))
    return names, units


def _layout(head: Sequence[str], comment: str, cut: _Cut, decimal: str, header: Header) -> Layout:
    """The layout with its header, where there is one that the rows go by."""
    width = cut.width if not header.by_name else max(cut.width, len(header.names))
    names, units = header.names, header.units
    if not names and any(cut.labels):
        names, units = _from_labels(cut.labels)
    return Layout(
        delimiter=cut.delimiter,
        decimal=decimal,
        comment=comment,
        skip_lines=header.skip_lines,
        header=header.by_name,
        names=names + ("",) * (width - len(names)),
        units=units + ("",) * (width - len(units)) if units else (),
        labels=cut.labels + ("",) * (width - len(cut.labels)),
        preamble=tuple(head[: header.first_row]),
        remarks=header.remarks,
    )
