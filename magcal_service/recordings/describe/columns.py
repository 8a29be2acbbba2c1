"""A log's columns: their names taken apart, what is sampled of their cells, and groups of three."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.recordings.describe.layout import Layout
from magcal_service.recordings.describe.sample import Sample
from magcal_service.recordings.table import parse_numbers
from magcal_service.recordings.unit_words import split_unit, unit_of

FloatArray = npt.NDArray[np.float64]

_MOST_ROWS: Final = 12000  # of the sample: enough for every question, and quick
_WORD: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_AXES: Final = (("x", "y", "z"), ("n", "e", "d"), ("1", "2", "3"), ("0", "1", "2"))
_ABSURD: Final = 1e20  # beyond nanoseconds since 1970, the largest number that a log has a reason for
_MOSTLY: Final = 0.8  # share of cells that are numbers in a column of numbers


@dataclass(frozen=True, eq=False)
class Column:
    """One column.

    Parameters
    ----------
    number: its place, from 1.
    name: as the header has it, empty where there is none.
    stem: the name without its unit.
    unit: what name or line of units say, in the descriptor's words; empty where they say none.
    words: the stem's words in small letters.
    cells: (n,) sampled cells as text.
    values: (n,) as numbers, NaN where they are none.
    """

    number: int
    name: str
    stem: str
    unit: str
    words: tuple[str, ...]
    cells: list[str] = field(repr=False)
    values: FloatArray = field(repr=False)

    @cached_property
    def numeric(self) -> bool:
        """Whether most filled cells are numbers, and there are some."""
        filled = sum(1 for cell in self.cells if cell)
        return filled > 0 and int(np.isfinite(self.values).sum()) >= _MOSTLY * filled * 0.5

    @property
    def label(self) -> str:
        """How the column is called in a sentence."""
        return f"{self.name!r}" if self.name else f"column {self.number}"

    @cached_property
    def whole(self) -> bool:
        """Whether all numbers are whole ones."""
        good = self.values[np.isfinite(self.values)]
        return bool(good.size) and bool(np.all(good == np.round(good)))


@dataclass(frozen=True, slots=True, eq=False)
class Triple:
    """Three columns that are called the same but for the axis; ``stem`` is what they share."""

    columns: tuple[Column, Column, Column]
    stem: str
    words: tuple[str, ...]

    @property
    def values(self) -> FloatArray:
        """(n, 3) numbers."""
        return np.stack([column.values for column in self.columns], axis=-1)

    @property
    def unit(self) -> str:
        """The unit all three names agree on; empty where they say none."""
        units = {column.unit for column in self.columns}
        return units.pop() if len(units) == 1 else ""

    @property
    def label(self) -> str:
        """How they are called in a sentence."""
        return ", ".join(column.label for column in self.columns)

    @property
    def whole(self) -> bool:
        """Whether all numbers are whole ones."""
        return all(column.whole for column in self.columns)


@dataclass(frozen=True, slots=True)
class Log:
    """A log's form, columns, and the stretch of the sample that each row is from.

    Parameters
    ----------
    block: (n,) number of the stretch of each sampled row: neighbours in one stretch are neighbours in the log.
    """

    sample: Sample
    layout: Layout
    columns: tuple[Column, ...]
    block: npt.NDArray[np.int64]

    @property
    def rows(self) -> int:
        """Sampled rows."""
        return len(self.block)

    @property
    def numbered(self) -> bool:
        """Whether columns can be named by number only."""
        return not self.layout.header

    def neighbours(self) -> npt.NDArray[np.bool_]:
        """(n - 1,) whether a row and the next are neighbours in the log."""
        return np.asarray(np.diff(self.block) == 0, dtype=np.bool_)


def read_log(sample: Sample, layout: Layout) -> Log:
    """The sampled rows as columns."""
    share = max(_MOST_ROWS // len(sample.stretches), 50)
    rows: list[list[str]] = []
    block: list[int] = []
    for number, stretch in enumerate(sample.stretches):
        first = layout.skip_lines + int(layout.header) if number == 0 else 0
        lines = stretch.lines[first:]
        if len(lines) > share and sample.whole:  # of a small log both ends count
            parts = [lines[: share - share // 4], lines[-(share // 4) :]]
        else:
            parts = [lines[:share]]
        for part in parts:
            found = layout.rows(part)
            block += [2 * number + (part is not parts[0])] * len(found)
            rows += found
    columns = []
    for index, name in enumerate(layout.names):
        cells = [row[index] for row in rows]
        stem, unit = split_unit(name)
        if layout.units and unit_of(layout.units[index]):
            unit = unit_of(layout.units[index])
        values = parse_numbers(cells)[0] if cells else np.zeros(0)
        values[np.abs(values) > _ABSURD] = np.nan
        columns.append(Column(index + 1, name, stem, unit, words_of(stem), cells, values))
    return Log(sample, layout, tuple(columns), np.array(block, dtype=np.int64))


def words_of(name: str) -> tuple[str, ...]:
    """The words of a name in small letters: by blanks and signs, by capitals, and numbers apart."""
    return tuple(word.lower() for word in _WORD.findall(name))


def triples(log: Log) -> list[Triple]:
    """Groups of three numeric columns called the same but for their axis, in the log's order."""
    found: list[Triple] = []
    by_name = {_key(column): column for column in reversed(log.columns) if column.stem and column.numeric}
    taken: set[int] = set()
    for axes in _AXES:
        for column in by_name.values():
            for triple in _triples_of(column, axes, by_name):
                numbers = {one.number for one in triple.columns}
                if not numbers & taken:
                    taken |= numbers
                    found.append(triple)
    return sorted(found, key=lambda triple: triple.columns[0].number)


def _key(column: Column) -> str:
    """What tells columns apart: their name and unit, without regard to capitals."""
    return f"{column.stem.lower()}\n{column.unit}"


def _triples_of(column: Column, axes: tuple[str, str, str], by_name: dict[str, Column]) -> list[Triple]:
    """What begins with this column and goes on in the other two axes, at each place of its name."""
    name = _key(column)
    found = []
    for at in (i for i, sign in enumerate(column.stem.lower()) if sign == axes[0]):
        x, y, z = (by_name.get(name[:at] + axis + name[at + 1 :]) for axis in axes)
        if x is None or y is None or z is None or (axes[0].isdigit() and _continues(name, at, by_name)):
            continue
        stem = f"{column.stem[:at]} {column.stem[at + 1 :]}"
        found.append(Triple((x, y, z), stem.strip(" _-."), words_of(stem)))
    return found


def _continues(name: str, at: int, by_name: dict[str, Column]) -> bool:
    """Whether a count goes on before or beyond three, as a quaternion's does, or the digit is part of a number."""
    before, beyond = ("-", "3") if name[at] == "0" else ("0", "4")
    around = name[max(at - 1, 0) : at] + name[at + 1 : at + 2]
    more = (name[:at] + sign + name[at + 1 :] in by_name for sign in (before, beyond))
    return any(more) or any(sign.isdigit() for sign in around)
