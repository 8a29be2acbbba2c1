"""Rows of a recording in groups, such as ranges of a channel: columns that are zero outside of one group."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """Which of g groups each row is in.

    Parameters
    ----------
    number: (n,) of each row's group, 0 to g - 1; g itself stands for none.
    count: g.
    """

    number: NDArray[np.int16]
    count: int

    @classmethod
    def of(cls, number: NDArray[np.integer[Any]], among: NDArray[np.integer[Any]]) -> Groups:
        """Rows by a number (n,) each, one group for each of some numbers (g,), rising; rows of others are in none."""
        place = np.minimum(np.searchsorted(among, number), len(among) - 1)
        return cls(np.where(among[place] == number, place, len(among)).astype(np.int16), len(among))

    def columns(self, rows: Array, some: slice = slice(None)) -> Array:
        """(n, g a) each group's part of rows (n, a), zero elsewhere, one group's after another's, each in one piece.

        ``some``: of these groups only.
        """
        every = np.arange(self.count, dtype=np.int16)[some]
        found: Array = (self.number == every[:, None])[:, None] * np.ascontiguousarray(rows.T)
        return found.reshape(-1, len(rows)).T

    def sums(self, values: Array, among: NDArray[np.intp] | None = None, parts: int = 1) -> Array:
        """(g, parts) sums of values (n,) over each group's rows, for each part of the recording by number (n,)."""
        place = self.number if among is None else self.number.astype(np.intp) * parts + among
        found = np.asarray(np.bincount(place, values, minlength=(self.count + 1) * parts), dtype=np.float64)
        return found.reshape(-1, parts)[: self.count]

    def products(self, rows: Array) -> Array:
        """(g a, g a) products of each group's part of rows (n, a) with one another: zero between groups."""
        size, every = rows.shape[1], np.arange(self.count)
        found = np.zeros((self.count, size, self.count, size))
        for i in range(size):
            for j in range(i, size):
                sums = self.sums(rows[:, i] * rows[:, j])[:, 0]
                found[every, i, every, j] = found[every, j, every, i] = sums
        return found.reshape(self.count * size, -1)
