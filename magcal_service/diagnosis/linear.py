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
from typing import Final

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

    def clipped(self, limit: float) -> Workspace:
        """The same with no sample of the residual beyond a limit [nT]."""
        result = copy(self)
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
        scale = self._scale(columns)
        # Q'Z is small: G = Z'Z - (Q'Z)'(Q'Z), and Z'r needs no projection because r is projected
        inside = self._basis.T @ columns
        normal = (columns.T @ columns - inside.T @ inside) / np.outer(scale, scale)
        return Products(normal, columns.T @ self.residual / scale, scale, _ROUNDING * len(columns))

    def segments(self, columns: Array, first_rows: NDArray[np.intp]) -> Segments:
        """Sums over the stretches that begin at each of the rows (g,), rising; what comes before the first is left out.

        Columns (m, k) count in units of their rms.
        """
        scaled = columns / self._scale(columns)
        parts = np.concatenate([self._basis, scaled, self.residual[:, None]], axis=1)
        ends = np.append(first_rows[1:], len(columns))
        sums = np.stack([parts[i:j].T @ scaled[i:j] for i, j in zip(first_rows.tolist(), ends.tolist(), strict=True)])
        width, size = self._basis.shape[1], scaled.shape[1]
        normal, inside, right = sums[:, width : width + size], sums[:, :width], sums[:, width + size]
        return Segments(normal, inside, right, self.squares, self.count)

    def gated(self, columns: Array, first_rows: NDArray[np.intp], sigma_nt: float) -> list[Gain]:
        """Gains of columns (m, k) that are zero before each of the rows (g,), rising; at the cost of about one."""
        parts = self.segments(columns, first_rows)
        normal, inside, right = (
            np.cumsum(part[::-1], axis=0)[::-1] for part in (parts.normal, parts.inside, parts.right)
        )
        left = normal - np.swapaxes(inside, 1, 2) @ inside
        scale, smallest = self._scale(columns), _ROUNDING * len(columns)
        return [evidence(left[at], right[at], scale, sigma_nt, smallest) for at in range(len(first_rows))]

    @staticmethod
    def _scale(columns: Array) -> Array:
        scale = np.sqrt(np.einsum("mk,mk->k", columns, columns) / len(columns))
        return np.where(scale > 0.0, scale, 1.0)


def evidence(normal: Array, right: Array, scale: Array, sigma_nt: float, smallest: float = 0.0) -> Gain:
    """``Gain`` from a normal matrix (k, k), a right side (k,), both of columns divided by ``scale`` (k,).

    Directions with an eigenvalue below ``smallest`` lie in the model's columns up to rounding and hold no information.
    """
    values, vectors = np.linalg.eigh(normal)
    useful = values > max(smallest, 1e-10 * float(values[-1]))
    values = np.where(useful, values, 0.0)
    turned = np.where(useful, vectors.T @ right, 0.0)
    variance = sigma_nt**2
    ratio = _SPREADS * float((turned[useful] ** 2 / values[useful] ** 2).sum() + 1e-12) / len(right)
    added = variance / ratio[:, None]
    terms = turned**2 / variance / (values + added) - np.log1p(values / added)
    total = 0.5 * terms.sum(axis=1)
    best = int(np.argmax(total))
    solution = vectors @ (turned / (values + added[best]))
    squares = float(2.0 * solution @ right - solution @ normal @ solution)
    effective = float((values / (values + added[best])).sum())
    return Gain(float(total[best]), squares, effective, solution / scale)


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
