"""Directions of the field in the body: which have occurred, and the newest vector of each before and after."""

from __future__ import annotations

import math
from typing import Final

from magcal_service.wire.messages import Vector

BANDS: Final = 12
"""Cells from pole to pole, equal in the sine of the latitude, so equal in area."""

AROUND: Final = 24
"""Cells around each band."""

CELLS: Final = BANDS * AROUND

Cell = tuple[float | None, ...]
"""Raw vector and calibrated one over the reference's magnitude: six numbers, three of them None where unknown."""


def cell_of(vector: Vector) -> int | None:
    """The number of the cell that a vector (any length above zero) points at; None for a vector without length."""
    x, y, z = vector
    length = math.sqrt(x * x + y * y + z * z)
    if not 0.0 < length < math.inf:
        return None
    band = min(int((z / length + 1.0) * 0.5 * BANDS), BANDS - 1)
    around = min(int((math.atan2(y, x) / math.tau + 0.5) * AROUND), AROUND - 1)
    return band * AROUND + around


class Sphere:
    """The newest pair of vectors of each cell."""

    def __init__(self) -> None:
        self._cells: dict[int, tuple[int, Cell]] = {}
        self.count = 0

    def add(self, before: Vector | None, after: Vector | None, scale_nt: float) -> None:
        """Take a sample over its reference ``scale_nt`` [nT].

        ``before`` is None where the raw one was not heard, ``after`` where there is no estimate yet.
        """
        seen = after or before
        cell = None if seen is None else cell_of(seen)
        if cell is None or not scale_nt > 0.0:
            return
        self.count += 1
        self._cells[cell] = self.count, (*_scaled(before, scale_nt), *_scaled(after, scale_nt))

    @property
    def seen(self) -> frozenset[int]:
        """The cells in which the field has pointed."""
        return frozenset(self._cells)

    @property
    def coverage(self) -> float:
        """Share of the sphere's cells in which the field has pointed."""
        return len(self._cells) / CELLS

    def since(self, count: int) -> dict[int, Cell]:
        """The cells that have changed since ``count`` was the number of vectors taken."""
        return {cell: vectors for cell, (when, vectors) in self._cells.items() if when > count}


def _scaled(vector: Vector | None, scale_nt: float) -> Cell:
    return (None, None, None) if vector is None else tuple(round(one / scale_nt, 4) for one in vector)
