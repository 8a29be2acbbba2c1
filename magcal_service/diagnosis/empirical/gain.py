"""What curves gain: on held-out blocks, and forward in time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.empirical.curves import Form, values_of
from magcal_service.diagnosis.linear import fold_solutions
from magcal_service.diagnosis.problem import Fit, Problem
from magcal_service.model import Array

_EARLIER: Final = 2.0 / 3.0
"""Share of the recording that the rest is foretold from."""

_COVERED: Final = 0.2
"""Of the rest, the samples at least whose drivers have values that were there before: else nothing is foretold."""


def gain_of(before: Fit, after: Fit) -> tuple[float, int, int]:
    """``gain_in_blocks`` of a fit over the one before."""
    return gain_in_blocks(before.sensor_held_out, after.sensor_held_out, after.problem)


def gain_in_blocks(before: Array, after: Array, problem: Problem) -> tuple[float, int, int]:
    """By how many of its errors over blocks the held-out gain stands out; in how many blocks it is one, of how many.

    A block gains q = 1/2 ln(mean before^2 / mean after^2), in nats a sample, as in ``trust.harm``: a few blocks in
    which much is wrong do not count for all.
    """
    number = problem.blocks(after)
    gained = 0.5 * np.log(np.bincount(number, before**2) / np.bincount(number, after**2))
    error = float(np.std(gained, ddof=1)) / math.sqrt(len(gained))
    return float(np.mean(gained)) / max(error, 1e-300), int(np.count_nonzero(gained > 0.0)), len(gained)


def forward_rms_nt(before: Fit, after: Fit, forms: Sequence[Form]) -> tuple[float, float] | None:
    """rms [nT] of the last third of the recording foretold from the rest, without and with the curves.

    Of its samples those at which every driver has a value that was there before: a curve is for use inside its range.
    None where they are few.
    """
    scene = after.problem.scene
    later = np.arange(len(scene)) >= _EARLIER * len(scene)
    covered = np.array(later)
    for form in forms:
        x = values_of(scene, form.driver, form.column, form.quantity)
        assert x is not None
        known = x[~later]
        covered &= (x >= known.min()) & (x <= known.max())
    if np.count_nonzero(covered) < _COVERED * np.count_nonzero(later):
        return None
    rows, fold = (np.repeat(part, after.problem.rows_per_sample) for part in (covered, np.where(later, 0, 1)))
    return _foretold_nt(before, fold, rows), _foretold_nt(after, fold, rows)


def _foretold_nt(fit: Fit, fold: NDArray[np.intp], rows: NDArray[np.bool_]) -> float:
    """rms of rows [nT] under the fit to those whose fold (m,) is not 0."""
    solution = fold_solutions(fit.white_residual, fit.white_columns, fold, fit.held_tie)[0]
    return float(np.sqrt(np.mean((fit.residual[rows] - fit.columns[rows] @ solution) ** 2)))
