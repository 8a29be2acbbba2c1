"""Cells of a log's columns as few long texts: a text of its own takes 50 bytes more than its characters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Final

_BLOCK_CELLS: Final = 1 << 16  # choice: 4 MB of cells that are not packed yet
_BETWEEN: Final = "\n"
"""Between two cells: no cell of a log in lines holds one."""


@dataclass(slots=True)
class PackedCells:
    """One column: blocks of cells, each as one text."""

    blocks: list[str] = field(default_factory=list)

    def cells(self) -> list[str]:
        """All of them, in order."""
        return _BETWEEN.join(self.blocks).split(_BETWEEN) if self.blocks else []


class CellPacker:
    """Takes rows, gives columns; ``width`` is how many there are, and what a row has beyond them is dropped."""

    def __init__(self, width: int) -> None:
        self._columns = tuple(PackedCells() for _ in range(width))
        self._open: list[Sequence[str]] = []
        self._most = max(_BLOCK_CELLS // max(width, 1), 1)  # rows

    def add(self, row: Sequence[str]) -> None:
        """One row, of at least as many cells as there are columns, none with a line break."""
        self._open.append(row)
        if len(self._open) >= self._most:
            self._pack()

    def columns(self) -> tuple[PackedCells, ...]:
        """The columns of all rows so far."""
        self._pack()
        return self._columns

    def _pack(self) -> None:
        if self._open:
            cells = islice(zip(*self._open, strict=False), len(self._columns))
            for column, block in zip(self._columns, cells, strict=True):
                column.blocks.append(_BETWEEN.join(block))
            self._open = []
