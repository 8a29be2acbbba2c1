"""Sums of columns over stretches of a recording, from which any choice of stretches is evaluated at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.physics.columns import Columns

_OFTEN: Final = 2.5
"""Cuts for each row of a table from which on a product with all of it is faster than taking rows; twice at 5."""

_FEW: Final = 100_000
"""Numbers up to which all rows are taken at once: 0.8 MB, which a core's cache holds; the calls are what costs then."""


@dataclass(frozen=True, slots=True, eq=False)
class Folds:
    """Running sums over stretches of time, from which those of any cycle's parts are had.

    Parameters
    ----------
    table: (g + 1, w) over the first 0, 1 ... g stretches; in each row the upper half of ``Segments.normal`` (k, k), its
        ``inside`` (p, k) and its ``right`` (k,).
    size, beside: k and p.
    squares, count: as of ``Segments``.
    """

    table: Array
    size: int
    beside: int
    squares: float
    count: int

    def folded(self, cuts: NDArray[np.intp]) -> Segments:
        """Sums over all stretches between ``cuts[:, i]`` and ``cuts[:, i + 1]``, one for each i.

        ``cuts`` (c, q + 1) are numbers of stretches, rising along each row.
        """
        rows, size = len(self.table), self.size
        if cuts.size > _OFTEN * rows:
            places = cuts + rows * np.arange(cuts.shape[1])
            times = np.bincount(places.reshape(-1), minlength=rows * cuts.shape[1]).reshape(-1, rows)
            found = np.diff(times, axis=0).astype(np.float64) @ self.table
        elif cuts.size * self.table.shape[1] < _FEW:
            found = np.diff(self.table.take(cuts.T, axis=0).sum(axis=1), axis=0)
        else:
            found = np.diff(np.stack([self.table.take(each, axis=0).sum(axis=0) for each in cuts.T]), axis=0)
        upper, lower = np.triu_indices(size)
        normal = np.empty((len(found), size, size))
        normal[:, upper, lower] = normal[:, lower, upper] = found[:, : len(upper)]
        inside = found[:, len(upper) : found.shape[1] - size].reshape(len(found), self.beside, size)
        return Segments(normal, inside, found[:, found.shape[1] - size :])


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Products of k columns in each of g stretches of time: sums from which any choice of stretches is evaluated.

    Parameters
    ----------
    normal: (g, k, k) products of the columns with one another, each column of unit rms over the recording.
    inside: (g, p, k) products of what is fitted anyway (orthonormal over the recording) with the columns.
    right: (g, k) products of the columns with the residual [nT].
    squares, count: sum of squares [nT^2] and number of rows of the residual whole.
    """

    normal: Array
    inside: Array
    right: Array
    squares: float = 0.0
    count: int = 0

    @property
    def running(self) -> Segments:
        """Sums (g + 1, ...) over the first 0, 1 ... g stretches."""

        def summed(part: Array) -> Array:
            found = np.zeros((len(part) + 1, *part.shape[1:]))
            np.cumsum(part, axis=0, out=found[1:])
            return found

        normal, inside, right = summed(self.normal), summed(self.inside), summed(self.right)
        return Segments(normal, inside, right, self.squares, self.count)

    @property
    def folds(self) -> Folds:
        """The same as running sums in one table, which any cycle is folded from."""
        size, beside = self.right.shape[1], self.inside.shape[1]
        upper = np.triu_indices(size)
        ends = np.cumsum([len(upper[0]), beside * size, size])
        table = np.zeros((len(self.right) + 1, ends[2]))
        table[1:, : ends[0]] = self.normal[(slice(None), *upper)]
        table[1:, ends[0] : ends[1]] = self.inside.reshape(len(self.inside), -1)
        table[1:, ends[1] :] = self.right
        np.cumsum(table[1:], axis=0, out=table[1:])
        return Folds(table, size, beside, self.squares, self.count)

    @property
    def alone(self) -> Segments:
        """The same as if nothing else were fitted: quicker, and no smaller a normal matrix."""
        return Segments(self.normal, self.inside[:, :0], self.right)

    @property
    def pairs(self) -> Segments:
        """Each stretch with the next one (g - 1, ...)."""
        normal, inside, right = (part[:-1] + part[1:] for part in (self.normal, self.inside, self.right))
        return Segments(normal, inside, right)

    def drop(self, chosen: Array) -> Array:
        """Drop in squares (m,) [nT^2] by the columns switched on in the stretches that (m, g) has as 1."""
        return self.weighted(chosen).drops

    def weighted(self, levels: Array) -> Segments:
        """Sums (m, ...) of the columns times signals (m, g) that are constant in each stretch."""
        return Segments(
            self._sum(levels**2, self.normal), self._sum(levels, self.inside), self._sum(levels, self.right)
        )

    @property
    def drops(self) -> Array:
        """Drop in squares (g,) [nT^2] by the columns switched on in each stretch alone."""
        left = self.normal - np.swapaxes(self.inside, 1, 2) @ self.inside
        trace = np.trace(self.normal, axis1=1, axis2=2) / self.normal.shape[1]
        diagonal = np.einsum("mii->mi", left)
        diagonal += (1e-6 * trace + 1e-9)[:, None]
        return np.asarray(np.einsum("mk,mk->m", self.right, np.linalg.solve(left, self.right[:, :, None])[:, :, 0]))

    @staticmethod
    def _sum(chosen: Array, part: Array) -> Array:
        return np.asarray((chosen @ part.reshape(len(part), -1)).reshape(len(chosen), *part.shape[1:]))


Sums = Callable[[Columns, NDArray[np.intp]], Segments]
"""From columns and the first rows of g stretches to their sums, for the residual that is being explained."""
