"""One linear-algebra pass over rival explanations: projections, evidence, and blocks that took no part in a fit.

Evidence is that of a linear Gaussian model whose amplitudes have one common prior spread s, chosen by the data
(empirical Bayes, type II likelihood).  For amplitudes c with projected normal matrix G = V diag(l) V', right side V'r:

    2 ln E(s) = sum_i (V'r)_i^2 / sigma^2 / (l_i + sigma^2 / s^2) - ln(1 + l_i s^2 / sigma^2)

so a form with more amplitudes pays for each by what the data could determine of it, whatever the sample's size.
Source: MacKay 1992, Bayesian interpolation, Neural Computation 4, equations 4.9 and 4.13.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.physics.segments import Segments

FOLDS: Final = 5
"""Parts that the held-out blocks are dealt out to: each fit sees four fifths of the data; more cost more fits."""

BLOCKS: Final = 50
"""Held-out data are contiguous blocks, a fiftieth of the recording each.

Choice: contiguous, because neighbours share what is slow and would not be independent; fifty leave each fold ten
places spread over the recording.
"""

_ROUNDING: Final = 1e-9
"""Share of a column's square below which what a projection leaves of it is rounding."""

_MANY: Final = 40
"""Stretches for each column from which on products are summed column by column: as fast for 3 columns in 100 stretches,
and four times as fast in 4000."""

_SMALL: Final = 1_000_000
"""Multiplications up to which OpenBLAS does not copy matrices before it multiplies them: by parts of so many, products
of a few columns of 20 000 rows with some more take a third of the time."""

_SPREADS: Final = np.geomspace(1e-6, 1e6, 61)


@dataclass(frozen=True, slots=True, eq=False)
class Gain:
    """What a set of columns explains.

    Parameters
    ----------
    nats: evidence over the model without them.
    squares: drop of the sum of squares [nT^2].
    effective: how many amplitudes the data really set, at most k.
    amplitudes: least-squares amplitudes (k,), with the prior as a tie, in units of the columns.
    """

    nats: float
    squares: float
    effective: float
    amplitudes: Array


@dataclass(frozen=True, slots=True, eq=False)
class Products:
    """All that evidence needs of k columns: how they were counted does not depend on the noise.

    Parameters
    ----------
    normal: (k, k) of the columns less their part in the model's, each divided by ``scale``.
    right: (k,) products with the residual [nT], divided by the same.
    scale: rms of each column (k,).
    smallest: eigenvalue below which a direction is rounding.
    """

    normal: Array
    right: Array
    scale: Array
    smallest: float

    def gain(self, sigma_nt: float) -> Gain:
        """Evidence at a noise of ``sigma_nt``."""
        return evidence(self.normal, self.right, self.scale, sigma_nt, self.smallest)


class Whitening(Protocol):
    """What makes rows (m, k) white, by a symmetric matrix, or gives the products (k, k) of what it would make."""

    def white(self, rows: Array) -> Array:
        """Rows in which the noise is white."""

    def white_products(self, rows: Array) -> Array:
        """Their products with one another."""


class Workspace:
    """A residual with the model's columns projected out.

    Parameters
    ----------
    residual: (m,) [nT].
    model: (m, p) columns that are fitted in any case.
    """

    def __init__(self, residual: Array, model: Array) -> None:
        scale = np.linalg.norm(model, axis=0)
        q, r = np.linalg.qr(model / np.where(scale > 0.0, scale, 1.0))
        keep = np.abs(np.diagonal(r)) > 1e-9
        self._basis = np.ascontiguousarray(q[:, keep])
        self.residual: Array = residual - self._basis @ (self._basis.T @ residual)
        self.count = len(residual)
        self.squares = float(self.residual @ self.residual)
        self._before: Array | None = None

    def clipped(self, limit: float) -> Workspace:
        """The same with no sample of the residual beyond a limit [nT]."""
        result = copy(self)
        result._before = None
        result.__dict__.pop("_fixed", None)
        held = np.clip(self.residual, -limit, limit)
        result.residual = held - self._basis @ (self._basis.T @ held)
        result.squares = float(result.residual @ result.residual)
        return result

    def projected(self, columns: Array) -> Array:
        """Columns (m, k) less their part in the model's."""
        result: Array = columns - self._basis @ (self._basis.T @ columns)
        return result

    def gain(self, columns: Array, sigma_nt: float) -> Gain:
        """Evidence for columns (m, k) at a noise of ``sigma_nt``."""
        return self.products(columns).gain(sigma_nt)

    def products(self, columns: Array) -> Products:
        """Of columns (m, k), for their evidence at any noise."""
        return self._products(columns.T @ columns, _between(self._basis, columns), columns.T @ self.residual)

    def products_before(self, rows: Array, problem: Whitening, whole: Array | None = None) -> Products:
        """Of columns that a problem would still have to make white from rows (m, k), without making them.

        Its whitening is a symmetric matrix: that of what they are multiplied by will do.  ``whole``: their white
        products (k, k) where they are known.
        """
        beside = self.beside(rows, problem)
        return self.products_of(problem.white_products(rows) if whole is None else whole, beside)

    def sums_before(self, rows: Array, problem: Whitening) -> Segments:
        """As ``segments`` of one stretch that is the whole recording, of columns as in ``products_before``."""
        whole, beside = problem.white_products(rows), self.beside(rows, problem)
        scale = _rms(np.diagonal(whole) / self.count)
        normal, beside = whole / np.outer(scale, scale), beside / scale
        return Segments(normal[None], beside[None, :-1], beside[None, -1], self.squares, self.count)

    def beside(self, rows: Array, problem: Whitening) -> Array:
        """(p + 1, k) products of the basis and the residual with what a problem makes of rows (m, k)."""
        if self._before is None:
            self._before = problem.white(self._fixed)
        return _between(self._before, rows)

    def products_of(self, whole: Array, beside: Array) -> Products:
        """Of columns whose white products with one another (k, k), and what ``beside`` says (p + 1, k), are known."""
        return self._products(whole, beside[:-1], beside[-1])

    def _products(self, whole: Array, inside: Array, right: Array) -> Products:
        """Of columns Z, from Z'Z (k, k), Q'Z (p, k) and Z'r (k,), Q being the model's basis."""
        # Q'Z is small: G = Z'Z - (Q'Z)'(Q'Z), and Z'r needs no projection because r is projected
        scale = _rms(np.diagonal(whole) / self.count)
        normal = (whole - inside.T @ inside) / np.outer(scale, scale)
        return Products(normal, right / scale, scale, _ROUNDING * self.count)

    def segments(self, columns: Array, first_rows: NDArray[np.intp]) -> Segments:
        """Sums over the stretches that begin at each of the rows (g,), rising; what comes before the first is left out.

        Columns (m, k) count in units of their rms.
        """
        scaled = columns / _scale(columns)
        if len(first_rows) > _MANY * scaled.shape[1] and (np.diff(first_rows) > 0).all():
            normal, beside = (_by_sums(left, scaled, first_rows) for left in (scaled, self._fixed))
        else:
            ends = np.append(first_rows[1:], len(columns))
            each = [slice(first, end) for first, end in zip(first_rows.tolist(), ends.tolist(), strict=True)]
            normal = np.stack([scaled[rows].T @ scaled[rows] for rows in each])
            beside = np.stack([_between(self._fixed[rows], scaled[rows]) for rows in each])
        return Segments(normal, beside[:, :-1], beside[:, -1], self.squares, self.count)

    @cached_property
    def _fixed(self) -> Array:
        """(m, p + 1) the model's basis, and the residual, each column in one piece."""
        return np.concatenate([self._basis.T, self.residual[None]]).T

    def gated(self, columns: Array, first_rows: NDArray[np.intp], sigma_nt: float) -> list[Gain]:
        """Gains of columns (m, k) that are zero before each of the rows (g,), rising; at the cost of about one."""
        parts = self.segments(columns, first_rows)
        normal, inside, right = (
            np.cumsum(part[::-1], axis=0)[::-1] for part in (parts.normal, parts.inside, parts.right)
        )
        left = normal - np.swapaxes(inside, 1, 2) @ inside
        return evidences(left, right, _scale(columns), sigma_nt, _ROUNDING * len(columns))


def _between(left: Array, right: Array) -> Array:
    """(p, k) products of columns (m, p) with columns (m, k), summed over parts of the rows."""
    step = max(_SMALL // (left.shape[1] * right.shape[1] or 1), 1)
    found: Array = left[:step].T @ right[:step]
    for first in range(step, len(left), step):
        found += left[first : first + step].T @ right[first : first + step]
    return found


def _by_sums(left: Array, right: Array, first_rows: NDArray[np.intp]) -> Array:
    """(g, p, k) products of columns (m, p) and (m, k) in stretches that begin at each of the rows (g,), rising."""
    found = np.empty((len(first_rows), left.shape[1], right.shape[1]))
    columns = np.ascontiguousarray(left.T)
    for number, column in enumerate(np.ascontiguousarray(right.T)):
        found[:, :, number] = np.add.reduceat(columns * column, first_rows, axis=1).T
    return found


def _scale(columns: Array) -> Array:
    return _rms(np.einsum("mk,mk->k", columns, columns) / len(columns))


def _rms(mean_squares: Array) -> Array:
    """Roots of mean squares (k,), 1 for zeros."""
    return np.sqrt(np.where(mean_squares > 0.0, mean_squares, 1.0))


def evidence(normal: Array, right: Array, scale: Array, sigma_nt: float, smallest: float = 0.0) -> Gain:
    """``Gain`` from a normal matrix (k, k), a right side (k,), both of columns divided by ``scale`` (k,).

    Directions with an eigenvalue below ``smallest`` lie in the model's columns up to rounding and hold no information.
    """
    return evidences(normal[None], right[None], scale, sigma_nt, smallest)[0]


def evidences(normal: Array, right: Array, scale: Array, sigma_nt: float, smallest: float) -> list[Gain]:
    """As ``evidence``, of each of normal matrices (g, k, k) and right sides (g, k)."""
    values, vectors = np.linalg.eigh(normal)
    useful = values > np.maximum(smallest, 1e-10 * values[:, -1:])
    values = np.where(useful, values, 0.0)
    turned = np.where(useful, (right[:, None] @ vectors)[:, 0], 0.0)
    variance = sigma_nt**2
    size2 = (np.divide(turned, values, out=np.zeros_like(turned), where=useful) ** 2).sum(axis=1)
    added = variance / (_SPREADS * (size2[:, None] + 1e-12) / right.shape[1])
    terms = (turned**2 / variance)[:, None] / (values[:, None] + added[:, :, None])
    total = 0.5 * (terms - np.log1p(values[:, None] / added[:, :, None])).sum(axis=2)
    best = np.argmax(total, axis=1)
    rows = np.arange(len(best))
    ridge = values + added[rows, best][:, None]
    solutions = (vectors @ (turned / ridge)[:, :, None])[:, :, 0]
    squares = (solutions * (2.0 * right - (solutions[:, None] @ normal)[:, 0])).sum(axis=1)
    effective = (values / ridge).sum(axis=1)
    each = zip(total[rows, best].tolist(), squares.tolist(), effective.tolist(), solutions / scale, strict=True)
    return [Gain(*one) for one in each]


def folds(time_s: Array) -> NDArray[np.intp]:
    """Fold number (n,) of each sample: contiguous blocks of time dealt out in turn."""
    rank = np.arange(len(time_s)) * BLOCKS // max(len(time_s), 1)
    return (rank % FOLDS).astype(np.intp)


def fold_solutions(residual: Array, columns: Array, fold: NDArray[np.intp], tie: Array) -> list[Array]:
    """For each fold the solution (p,) of the rows outside of it: what their fit would take off the residual.

    Parameters
    ----------
    residual: (m,) at the point where the columns were taken.
    columns: (m, p) derivatives of the model.
    fold: (m,) fold numbers, from 0 without a gap.
    tie: (p,) weak diagonal added to the normal matrix.
    """
    scale = np.linalg.norm(columns, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    scaled = columns / scale
    count = int(fold.max()) + 1
    parts = [scaled[fold == number] for number in range(count)]
    normals = np.stack([part.T @ part for part in parts])
    rights = np.stack([part.T @ residual[fold == number] for number, part in enumerate(parts)])
    weak = np.diag(tie / scale**2)
    found = []
    for number in range(count):
        normal = normals.sum(axis=0) - normals[number] + weak
        found.append(np.linalg.lstsq(normal, rights.sum(axis=0) - rights[number], rcond=1e-12)[0] / scale)
    return found


def held_out(residual: Array, columns: Array, fold: NDArray[np.intp], solutions: Sequence[Array]) -> Array:
    """A residual (m,), each fold of it under the solution (p,) of the others, by columns (m, p)."""
    left = np.array(residual)
    for number, solution in enumerate(solutions):
        inside = fold == number
        left[inside] -= columns[inside] @ solution
    return left
