"""Values at a few rows, carried on along straight lines to all rows between, and their transpose; of one number a row,
or of three components in axes of their own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.groups import Groups
from magcal_service.model import Array

_TOGETHER: Final = 16  # columns that lines are carried on to, or gathered from, at a time: a core's cache holds them


@dataclass(frozen=True, eq=False)
class Lines:
    """Straight lines between rows: values at ``at`` (q,), rising from the first row to the last, carried on to all n.

    Parameters
    ----------
    at: numbers of the rows that have values (q,).
    count: n.
    """

    at: NDArray[np.intp]
    count: int

    @cached_property
    def _lengths(self) -> NDArray[np.intp]:
        """Rows (q - 1,) of each line, of which the last has both of its ends."""
        return np.diff(np.append(self.at[:-1], self.count))

    @cached_property
    def _share(self) -> Array:
        """How far (n,) along its line a row is."""
        first, last = (np.repeat(ends, self._lengths) for ends in (self.at[:-1], self.at[1:]))
        return np.asarray((np.arange(self.count) - first) / (last - first))

    def _carry(self, values: Array, out: Array) -> None:
        """Values (k, q) at all rows (k, n)."""
        for some in _together(len(values)):
            out[some] = np.repeat(np.diff(values[some], axis=1), self._lengths, axis=1)
            out[some] *= self._share
            out[some] += np.repeat(values[some, :-1], self._lengths, axis=1)

    def carried_on(self, values: Array) -> Array:
        """Values (q, k) at all rows (n, k), each column in one piece."""
        result = np.empty((values.shape[1], self.count))
        self._carry(np.ascontiguousarray(values.T), result)
        return result.T

    def less(self, rows: Array, values: Array) -> Array:
        """Rows (n, k) less values (q, k) carried on, each column in one piece."""
        result = self.carried_on(values).T
        return np.subtract(rows.T, result, out=result).T

    def gathered(self, rows: Array) -> Array:
        """The transpose: rows (n, k) to (q, k)."""
        found = np.zeros((rows.shape[1], len(self.at)))
        for some in _together(len(found)):
            columns = np.ascontiguousarray(rows.T[some])
            found[some, :-1] = np.add.reduceat(columns, self.at[:-1], axis=1)
            at_ends = np.add.reduceat(columns * self._share, self.at[:-1], axis=1)
            found[some, :-1] -= at_ends
            found[some, 1:] += at_ends
        return found.T

    def gathered_groups(self, rows: Array, groups: Groups) -> Array:
        """What ``gathered`` makes of each group's part of rows (n, a): (q, g a), of the first group first.

        A row counts for its own group only, so each is added once, not once for every group.
        """
        lines = len(self.at) - 1
        among = np.repeat(np.arange(lines), self._lengths)
        found = np.zeros((groups.count, rows.shape[1], lines + 1))
        for number, column in enumerate(rows.T):
            at_ends = column * self._share
            found[:, number, :-1] += groups.sums(column - at_ends, among, lines)
            found[:, number, 1:] += groups.sums(at_ends, among, lines)
        return found.reshape(-1, lines + 1).T

    def weighed(self, values: Array) -> Array:
        """What ``gathered`` makes of values (q, k) carried on (q, k): a line overlaps with its neighbours only."""
        own, beside = self._overlaps
        found = own[:, None] * values
        found[:-1] += beside[:, None] * values[1:]
        found[1:] += beside[:, None] * values[:-1]
        return np.asarray(found)

    @cached_property
    def _overlaps(self) -> tuple[Array, Array]:
        """Products of each line's weights with themselves (q,), and with those of the next (q - 1,)."""
        first, both, last = self.sums_of_products(np.ones((self.count, 1)))
        return np.append(first, 0.0) + np.append(0.0, last), both[:, 0]

    def sums_of_products(self, rows: Array) -> tuple[Array, Array, Array]:
        """Sums (q - 1, k) over each line of rows (n, k) by the products of its weights: of its start with itself, of
        both, of its end with itself."""
        at_start, at_end = 1.0 - self._share, self._share
        first, both, last = (
            np.add.reduceat(product[:, None] * rows, self.at[:-1])
            for product in (at_start * at_start, at_start * at_end, at_end * at_end)
        )
        return first, both, last


def _together(count: int) -> Iterator[slice]:
    """So many columns, a few at a time."""
    return (slice(first, first + _TOGETHER) for first in range(0, count, _TOGETHER))


@dataclass(frozen=True, eq=False)
class TurnedLines:
    """Lines of three components in axes of their own, carried on to three rows a sample.

    Parameters
    ----------
    lines: of each component; of q knots and n samples.
    onto: (n, 3, 3) from these axes to a sample's rows.
    """

    lines: Lines
    onto: Array

    @property
    def count(self) -> int:
        """Rows, 3 n."""
        return 3 * self.lines.count

    def carried_on(self, values: Array) -> Array:
        """Values (3 q, k), of one knot's components after another's, at all rows (3 n, k)."""
        table = values.reshape(-1, 3, values.shape[1])
        parts = np.stack([self.lines.carried_on(table[:, axis]) for axis in range(3)], axis=1)
        return np.asarray((self.onto @ parts).reshape(-1, values.shape[1]))

    def less(self, rows: Array, values: Array) -> Array:
        """Rows (3 n, k) less values (3 q, k) carried on."""
        return rows - self.carried_on(values)

    def gathered(self, rows: Array) -> Array:
        """The transpose of ``carried_on``: rows (3 n, k) to (3 q, k)."""
        parts = np.swapaxes(self.onto, 1, 2) @ rows.reshape(-1, 3, rows.shape[1])
        return np.stack([self.lines.gathered(parts[:, axis]) for axis in range(3)], axis=1).reshape(-1, rows.shape[1])

    def gathered_groups(self, rows: Array, groups: Groups) -> Array:
        """As of ``Lines``."""
        return self.gathered(groups.columns(rows))

    def weighed(self, values: Array) -> Array:
        """What ``gathered`` makes of values (3 q, k) carried on."""
        own, beside = self._overlaps
        table = values.reshape(-1, 3, values.shape[1])
        found = own @ table
        found[:-1] += beside @ table[1:]
        found[1:] += beside @ table[:-1]
        return np.asarray(found.reshape(values.shape))

    @cached_property
    def _overlaps(self) -> tuple[Array, Array]:
        """Products (q, 3, 3) of each line's weights with themselves, and with those of the next (q - 1, 3, 3)."""
        squares = (np.swapaxes(self.onto, 1, 2) @ self.onto).reshape(-1, 9)
        first, both, last = self.lines.sums_of_products(squares)
        none = np.zeros((1, 9))
        own = np.concatenate([first, none]) + np.concatenate([none, last])
        return own.reshape(-1, 3, 3), both.reshape(-1, 3, 3)
