"""A .csv or .csv.gz file as columns of text; rows that cannot be split into cells are counted, never guessed."""

from __future__ import annotations

import csv
import gzip
import io
import re
import zlib
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np
import numpy.typing as npt

from magcal_service.errors import Fault, RecordingError
from magcal_service.recordings.report import RowCount, RowFault
from magcal_service.recordings.row_limits import RowLimits

_Stream = io.BufferedReader | gzip.GzipFile

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Codes = npt.NDArray[np.uint8]

FAULTS = tuple(RowFault)
"""Fault k + 1 of a code array is ``FAULTS[k]``; code 0 is a good cell."""

CODE = {fault: code for code, fault in enumerate(FAULTS, start=1)}

_ANY_END = re.compile("\r*\n|\r")

_SHOWN = 80  # characters of a header in a fault: one line of a terminal
_CHUNK_BYTES = 1 << 13  # small, because what a broken gzip stream would have given within one chunk is lost


@dataclass(frozen=True, slots=True)
class TextTable:
    """A log's rows, all with as many cells as the header.

    Parameters
    ----------
    header: the column names, blanks stripped.
    rows: cells as text.
    lines: (n,) line in the file of each row, from 1.
    seen: rows of the file, those that were not split included.
    entries: what was counted on the way.
    """

    header: tuple[str, ...]
    rows: list[list[str]]
    lines: IntArray
    seen: int
    entries: tuple[RowCount, ...]

    def column(self, name: str) -> list[str]:
        """All cells of one column."""
        index = self.header.index(name)
        return [row[index] for row in self.rows]

    def numbers(self, name: str) -> tuple[FloatArray, Codes]:
        """One column as numbers (n,), NaN where faulty, and the fault codes (n,)."""
        return parse_numbers(self.column(name))


def read_table(path: Path, delimiter: str = ",", limits: RowLimits | None = None) -> TextTable:
    """Read a log; raises ``RecordingError`` where the file cannot be read at all, or is beyond ``limits``.

    Each line is one row (a quoted cell may hold the delimiter, not a line break), so that one broken quote spoils
    one row and no more.  A gzip file that ends early gives the rows before its end; the one that was cut is counted
    as ``truncated_file``.
    """
    limits = limits or RowLimits()
    raw, truncated = _read_bytes(path, limits)
    text = raw.decode("utf-8-sig", errors="replace")
    del raw  # as large as the text
    lines = _lines(path, text, limits)
    del text
    limits.check_line(path, max(map(len, lines)))
    if truncated:
        lines = lines[:-1] or [""]  # the last line is cut somewhere within
    header = tuple(name.strip() for name in _split(lines[0].rstrip("\r"), delimiter) or ())
    if not any(header):
        raise RecordingError(
            [Fault(str(path), lines[0][:_SHOWN], "a header line with the column names must come first")]
        )
    rows = len(lines) - 1 if lines[-1].strip() else len(lines) - 2
    limits.check_rows(path, rows)
    limits.check_cells(path, len(header), rows)
    splitter = _Splitter(delimiter, len(header))
    for number, line in enumerate(islice(lines, 1, None), start=2):
        splitter.add(number, line, at_end=number == len(lines))
    if truncated:
        splitter.seen += 1
        splitter.note(RowFault.TRUNCATED_FILE, len(lines) + 1)
    return splitter.table(header)


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
        raise RecordingError([Fault(str(path), exc.strerror or str(exc), "give a readable log")]) from None


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


def _split(line: str, delimiter: str) -> list[str] | None:
    """The cells of one line; None where its quotes make no sense."""
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter, strict=True))
    except csv.Error:
        return None


@dataclass(slots=True)
class _Splitter:
    delimiter: str
    width: int
    rows: list[list[str]] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    seen: int = 0
    faults: dict[RowFault, list[int]] = field(default_factory=dict)

    def note(self, fault: RowFault, number: int) -> None:
        """Count a fault on a line."""
        self.faults.setdefault(fault, []).append(number)

    def add(self, number: int, line: str, *, at_end: bool) -> None:
        """Split one line; the empty rest after the last line break is no line."""
        if at_end and not line.strip():
            return
        self.seen += 1
        if not line.strip():
            self.note(RowFault.BLANK_LINE, number)
            return
        cells = _split(line, self.delimiter)
        if cells is None:
            self.note(RowFault.UNPARSABLE, number)
        elif len(cells) < self.width:
            self.note(RowFault.SHORT_ROW, number)
        elif len(cells) > self.width and any(cell.strip() for cell in cells[self.width :]):
            self.note(RowFault.LONG_ROW, number)
        else:
            self.rows.append(cells)
            self.numbers.append(number)

    def table(self, header: tuple[str, ...]) -> TextTable:
        """The finished table."""
        entries = tuple(RowCount("row", kind, len(at), at[0], kept=False) for kind, at in self.faults.items())
        return TextTable(header, self.rows, np.array(self.numbers, dtype=np.int64), self.seen, entries)


def parse_numbers(cells: list[str]) -> tuple[FloatArray, Codes]:
    """Cells as numbers (n,), NaN where faulty, and the fault codes (n,)."""
    codes = np.zeros(len(cells), dtype=np.uint8)
    try:
        values = np.array([float(cell) for cell in cells], dtype=np.float64)
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
