"""Recordings in passes: a few stretches, far apart, as a ground station gets them.

What goes slowly is nearly constant within a pass, so that few passes are few data for it, however many samples they
have; and blocks within passes, held out, are foretold from the rest of their own pass.  So a name has to foretell
whole passes from the others.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.linear import fold_solutions, held_out
from magcal_service.diagnosis.problem import Fit
from magcal_service.diagnosis.term_columns import amplitude_columns, columns_of
from magcal_service.model import Array

_ACTS: Final = 0.25  # of what a term adds in the pass that it adds most to, and it acts there

_FORETOLD: Final = 0.3
"""Of the squares that a name takes from all rows, what it has to take from passes that took no part; as for blocks."""


def foretells(fit: Fit, index: int) -> bool:
    """Whether a term foretells passes that took no part from the others; so does any where there are no passes.

    Asked of the passes that it acts in most: in the others it helps by what it spares the nine errors.  Passes foretold
    with it have to be left with less than those that nine errors alone were fitted to: both are foretold poorly.
    """
    numbers = fit.problem.passes
    if numbers is None:
        return True
    fold = np.repeat(numbers, fit.problem.rows_per_sample)
    linear = amplitude_columns(fit, index)
    added = fit.white_columns[:, linear] * fit.terms[index].amplitudes
    begun = np.isin(np.arange(linear.start, linear.stop), fit.starts)  # what begins a recording stays as it is
    others = np.setdiff1d(np.arange(fit.columns.shape[1]), columns_of(fit, index))
    bare, without, tie = fit.white_residual + added.sum(axis=1), fit.white_columns[:, others], fit.held_tie
    held = np.bincount(fold, added.sum(axis=1) ** 2)
    acts = held[fold] > _ACTS * held.max()

    def squares(left: Array) -> float:
        return float((left[acts] ** 2).sum())

    alone = squares(_refitted(bare, without, tie[others]))
    beside = squares(_held_out(bare - added[:, begun].sum(axis=1), fit.white_columns, fold, tie))
    foretold = squares(_held_out(bare, without, fold, tie[others])) - beside
    return beside < alone and foretold > _FORETOLD * max(alone - squares(fit.white_residual), 0.0)


def _refitted(residual: Array, columns: Array, tie: Array) -> Array:
    """What is left of a residual (m,) after a fit of columns (m, p)."""
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    scaled = columns / scale
    solution = np.linalg.lstsq(scaled.T @ scaled + np.diag(tie / scale**2), scaled.T @ residual, rcond=1e-12)[0]
    return np.asarray(residual - scaled @ solution)


def _held_out(residual: Array, columns: Array, fold: NDArray[np.intp], tie: Array) -> Array:
    """The same, of each fold under the fit to the others."""
    return held_out(residual, columns, fold, fold_solutions(residual, columns, fold, tie))
