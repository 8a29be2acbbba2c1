"""A log in rows, packed or not, as columns of text; rows that cannot be split into cells are counted, never guessed."""

from __future__ import annotations

import csv
import gzip
import io
import math
import re
import zlib
from array import array
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.base.errors import Fault, FileFault, Lacking, RecordingError
from magcal_service.base.progress import Work, counted
from magcal_service.recordings.log_text import log_text
from magcal_service.recordings.packed_cells import CellPacker, PackedCells
from magcal_service.recordings.report import RowCount, RowFault, shown
from magcal_service.recordings.row_form import PLAIN_ROWS, WHITESPACE, RowForm
from magcal_service.recordings.row_limits import RowLimits
from magcal_service.recordings.unit_words import are_units, unit_of

_Stream = io.BufferedReader | gzip.GzipFile

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Codes = npt.NDArray[np.uint8]

FAULTS = tuple(RowFault)
"""Fault k + 1 of a code array is ``FAULTS[k]``; code 0 is a good cell."""

CODE = {fault: code for code, fault in enumerate(FAULTS, start=1)}

POINT: Final = str.maketrans(",.", ".,")
"""Makes a number with a decimal comma one with a point; one with a point is then none, as it may part thousands."""

_ANY_END = re.compile("\r*\n|\r")

_SHOWN = 80  # characters of a header in a fault: one line of a terminal
_LOOKED_AT = 2000  # rows: enough to know how wide they are
_CHUNK_BYTES = 1 << 13  # small, because what a broken gzip stream would have given within one chunk is lost


@dataclass(frozen=True, slots=True)
class TextTable:
    """A log's rows, all with as many cells as the header.

    Parameters
    ----------
    header: the column names, blanks stripped; the columns' numbers from 1 where the log has none.
    cells: of each column, as text.
    lines: (n,) line in the file of each row, from 1.
    seen: rows of the file, those that were not split included.
    entries: what was counted on the way.
    decimal: the sign in numbers with a fraction.
    comments: lines in the file that are comments, rising.
    units: what a line of units right below the header says of each column; empty where there is none.
    joined: further columns by name, each made when it is asked for, with a cell for every row.
    """

    header: tuple[str, ...]
    cells: Sequence[list[str] | PackedCells]
    lines: IntArray
    seen: int
    entries: tuple[RowCount, ...]
    decimal: str = "."
    comments: Sequence[int] = ()
    units: tuple[str, ...] = ()
    joined: Mapping[str, Callable[[], list[str]]] = field(default_factory=dict)

    def column(self, name: str) -> list[str]:
        """All cells of one column."""
        if name in self.joined:
            return self.joined[name]()
        cells = self.cells[self.header.index(name)]
        return cells if isinstance(cells, list) else cells.cells()

    def numbers(self, name: str) -> tuple[FloatArray, Codes]:
        """One column as numbers (n,), NaN where faulty, and the fault codes (n,)."""
        cells = self.column(name)
        return parse_numbers(cells if self.decimal == "." else [self.plain(cell) for cell in cells])

    def plain(self, cell: str) -> str:
        """A cell with a point where it has the log's decimal sign."""
        return cell if self.decimal == "." else cell.translate(POINT)

    def rows_before(self) -> IntArray:
        """How many rows stand before each one (n,), those that were refused for their cells counted too."""
        if not len(self.lines):
            return self.lines
        passed = np.searchsorted(np.asarray(self.comments, dtype=np.int64), self.lines)
        numbers = self.lines - passed
        return np.asarray(numbers - numbers[0], dtype=np.int64)


def read_table(path: Path, form: RowForm = PLAIN_ROWS, limits: RowLimits | None = None) -> TextTable:
    """Read a log; raises ``RecordingError`` where the file cannot be read at all, or is beyond ``limits``.

    Each line is one row (a quoted cell may hold the delimiter, not a line break), so that one broken quote spoils
    one row and no more.  A gzip file that ends early gives the rows before its end; the one that was cut is counted
    as ``truncated_file``.
    """
    limits = limits or RowLimits()
    raw, truncated = _read_bytes(path, limits)
    text = log_text(raw)
    del raw  # as large as the text
    lines = _lines(path, text, limits)
    del text
    limits.check_line(path, max(map(len, lines)))
    if truncated:
        lines = lines[:-1] or [""]  # the last line is cut somewhere within
    header, first = _header(path, lines, form)
    rows = len(lines) - first if lines[-1].strip() else len(lines) - first - 1
    limits.check_rows(path, rows)
    limits.check_cells(path, len(header), rows)
    split, width = _splitting(form.delimiter), len(header)
    splitter = _Splitter(split, width, form.comment, form.decimal, form.header, CellPacker(width))
    with counted(Work(f"reading {path.name}", rows, "rows")) as work:
        for number, line in enumerate(islice(lines, first, None), start=first + 1):
            splitter.add(number, line, at_end=number == len(lines))
            work.done = number - first
    if truncated:
        splitter.seen += 1
        splitter.note(RowFault.TRUNCATED_FILE, len(lines) + 1)
    return splitter.table(header)


def _header(path: Path, lines: list[str], form: RowForm) -> tuple[tuple[str, ...], int]:
    """The columns' names, or their numbers, and the index of the first line below."""
    first = form.skip_lines
    while form.comment and first < len(lines) and (not lines[first].strip() or _is_comment(lines[first], form)):
        first += 1
    if not any(line.strip() for line in lines):
        raise RecordingError([Lacking(str(path), "this file is empty", "a header line and rows below it are accepted")])
    if first >= len(lines):
        accepted = "a file with rows below the lines that are skipped is accepted; check skip_lines under [samples]"
        raise RecordingError([Fault(str(path), f"{len(lines)} lines", accepted)])
    if "\0" in lines[first]:
        accepted = "a text in UTF-8 is accepted; iconv -f UTF-16 -t UTF-8 converts one in UTF-16"
        raise RecordingError([Fault(f"{path}: line {first + 1}", lines[first][:_SHOWN], accepted)])
    split = _splitting(form.delimiter)
    if not form.header:
        return tuple(map(str, range(1, _usual_width(lines[first:], form, split) + 1))), first
    header = tuple(name.strip() for name in split(lines[first].rstrip("\r")) or ())
    if not any(header):
        accepted = "a header line with the column names must come first; skip_lines, comment and header = false "
        accepted += "under [samples] say where there is another, or none"
        raise RecordingError([Fault(f"{path}: line {first + 1}", lines[first][:_SHOWN], accepted)])
    return header, first + 1


def _is_comment(line: str, form: RowForm) -> bool:
    return bool(form.comment) and line.lstrip().startswith(form.comment)


def _usual_width(lines: list[str], form: RowForm, split: Callable[[str], list[str] | None]) -> int:
    """How many cells most rows have."""
    rows = (line for line in lines if line.strip() and not _is_comment(line, form))
    widths = Counter(len(split(line) or ()) for line in islice(rows, _LOOKED_AT))
    return widths.most_common(1)[0][0] if widths else 0


def _lines(path: Path, text: str, limits: RowLimits) -> list[str]:
    """The lines of a file; a CR within a line that LF ends is left where it stands."""
    if text.count("\r") <= 2 * text.count("\n"):
        return text.split("\n")
    limits.check_rows(path, sum(1 for _ in _ANY_END.finditer(text)) - 1)
    return _ANY_END.split(text)


def _read_bytes(path: Path, limits: RowLimits) -> tuple[bytearray, bool]:
    """The file's content, unpacked, and whether a packed one ends early."""
    try:
        with _open(path) as stream:
            return _read_to_the_end(path, stream, limits)
    except OSError as exc:
        raise RecordingError([FileFault(str(path), exc, "give a readable log")]) from None
    except ValueError:  # a name that no file can have
        raise RecordingError([Fault("samples.file", str(path), "give a readable log")]) from None


def _open(path: Path) -> _Stream:
    return gzip.GzipFile(path) if path.suffix.lower() == ".gz" else path.open("rb")


def _read_to_the_end(path: Path, stream: _Stream, limits: RowLimits) -> tuple[bytearray, bool]:
    content = bytearray()
    ends = line = 0
    while True:
        try:
            chunk = stream.read1(_CHUNK_BYTES)
        except (EOFError, zlib.error, gzip.BadGzipFile):
            if not content:
                raise OSError(None, "no row can be unpacked from this gzip file") from None
            return content, True
        if not chunk:
            return content, False
        ends += chunk.count(b"\n")
        limits.check_rows(path, ends - 1)  # without the header's
        last = max(chunk.rfind(b"\n"), chunk.rfind(b"\r"))
        line = line + len(chunk) if last < 0 else len(chunk) - last - 1
        limits.check_line(path, line)
        content += chunk
        limits.check_bytes(path, len(content))


def _splitting(delimiter: str) -> Callable[[str], list[str] | None]:
    """What makes cells of a line; gives None where the line's quotes make no sense."""
    if delimiter == WHITESPACE:
        return _split_blanks
    return lambda line: line.split(delimiter) if '"' not in line else _split_quoted(line, delimiter)


def _split_quoted(line: str, delimiter: str) -> list[str] | None:
    try:
        return next(csv.reader([line], delimiter=delimiter, strict=True))
    except csv.Error:
        return None


def _split_blanks(line: str) -> list[str] | None:
    return line.split() if '"' not in line else _split_quoted(" ".join(line.split()), " ")


@dataclass(slots=True)
class _Splitter:
    split: Callable[[str], list[str] | None]
    width: int
    comment: str
    decimal: str
    header: bool
    packer: CellPacker
    units: tuple[str, ...] = ()
    numbers: array[int] = field(default_factory=lambda: array("q"))
    comments: list[int] = field(default_factory=list)
    seen: int = 0
    faults: dict[RowFault, list[int]] = field(default_factory=dict)
    shows: dict[RowFault, str] = field(default_factory=dict)

    def note(self, fault: RowFault, number: int, shows: str = "") -> None:
        """Count a fault on a line, and keep what the first such line shows."""
        self.faults.setdefault(fault, []).append(number)
        self.shows.setdefault(fault, shows)

    def add(self, number: int, line: str, *, at_end: bool) -> None:
        """Split one line; the empty rest after the last line break is no line."""
        if at_end and not line.strip():
            return
        if self.comment and line.lstrip().startswith(self.comment):
            self.comments.append(number)
            return
        if self.header and not self.seen and not self.units and (units := self._line_of_units(line)):
            self.units = units
            self.comments.append(number)
            return
        self.seen += 1
        if not line.strip():
            self.note(RowFault.BLANK_LINE, number)
            return
        cells = self.split(line)
        if cells is None:
            self.note(RowFault.UNPARSABLE, number, f"{shown(line)}: its quotes do not close")
        elif len(cells) < self.width:
            self.note(RowFault.SHORT_ROW, number, f"{len(cells)} cells where {self.width} are expected")
        elif len(cells) > self.width and any(cell.strip() for cell in cells[self.width :]):
            self.note(RowFault.LONG_ROW, number, f"{len(cells)} cells where {self.width} are expected")
        else:
            self.packer.add(cells)
            self.numbers.append(number)

    def _line_of_units(self, line: str) -> tuple[str, ...]:
        """The cells of a line that has units in place of numbers; empty for any other."""
        cells = tuple(cell.strip() for cell in self.split(line.rstrip("\r")) or ())
        if len(cells) != self.width or not any(map(unit_of, cells)) or not are_units(cells):
            return ()
        written = [form for cell in cells if cell != "1" for form in (cell, cell.translate(POINT))]
        return () if any(math.isfinite(_number_or_nan(form)) for form in written) else cells

    def table(self, header: tuple[str, ...]) -> TextTable:
        """The finished table."""
        entries = tuple(
            RowCount("row", kind, len(at), at[0], kept=False, shows=self.shows[kind])
            for kind, at in self.faults.items()
        )
        numbers = np.array(self.numbers, dtype=np.int64)
        cells = self.packer.columns()
        return TextTable(header, cells, numbers, self.seen, entries, self.decimal, self.comments, self.units)


def parse_numbers(cells: list[str]) -> tuple[FloatArray, Codes]:
    """Cells as numbers (n,), NaN where faulty, and the fault codes (n,)."""
    codes = np.zeros(len(cells), dtype=np.uint8)
    try:
        values = np.array(list(map(float, cells)), dtype=np.float64)
        plain = "_" not in "".join(cells)
    except ValueError:
        plain = False
    if not plain:
        values = np.array([_number_or_nan(cell) for cell in cells], dtype=np.float64)
    for index in np.flatnonzero(~np.isfinite(values)):
        codes[index] = CODE[why(cells[index])]
        values[index] = np.nan
    return values, codes


def _number_or_nan(cell: str) -> float:
    try:
        return float("nan" if "_" in cell else cell)
    except ValueError:
        return float("nan")


def why(cell: str) -> RowFault:
    """What is wrong with a cell that is no finite number."""
    text = cell.strip().lower().lstrip("+-")
    if not text:
        return RowFault.MISSING
    if text == "nan":
        return RowFault.NOT_A_NUMBER
    if text in {"inf", "infinity"} or (_number_or_nan(text) == float("inf")):
        return RowFault.INFINITE
    return RowFault.UNPARSABLE
