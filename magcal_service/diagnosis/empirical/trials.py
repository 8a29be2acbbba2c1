"""Which curve over which driver: all of them screened on the residual, the likeliest ones tried on held-out blocks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.diagnosis.empirical.curves import ELAPSED, Form, form_of
from magcal_service.diagnosis.explain import Search
from magcal_service.diagnosis.linear import fold_solutions, held_out
from magcal_service.diagnosis.problem import Fit, Term, amplitude_tie
from magcal_service.diagnosis.screen import ACCEPTED_NATS
from magcal_service.model import Array
from magcal_service.physics.apply.empirical import Kind
from magcal_service.physics.drivers.computed import COMPUTED
from magcal_service.physics.interface import Hypothesis

_KNOTS: Final = (3, 6, 11)
"""Knots that are tried: a bend, a curve, a course with several turns; the second one when drivers are screened."""

_KNOTS_OF_TIME: Final = (6, 12, 24)
"""The same of a course over time: 24 knots are two held-out blocks apart, with fewer between them nothing is known."""

_TRIED: Final = 5
"""Curves whose number of knots is tried, the likeliest first; choice: more have not come first on any recording."""


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A curve that was tried.

    Parameters
    ----------
    form: what it lies over, and how it acts.
    hypothesis: it as a form of an effect without a name.
    residual: (m,) white, on held-out blocks, to first order [nT].
    """

    form: Form
    hypothesis: Hypothesis
    residual: Array

    @property
    def left(self) -> float:
        """Sum of its squares [nT^2]."""
        return float(self.residual @ self.residual)


def trials_of(
    search: Search, fit: Fit, drivers: Sequence[tuple[str, int, str]], largest_nt: float, floor_nt: float
) -> list[Trial]:
    """The likeliest curves by what they leave on held-out blocks, least first; each with its best number of knots."""
    problem = fit.problem
    search.look_at(problem, search.hypotheses)
    space = search.workspace(fit)
    sigma = max(math.sqrt(space.squares / space.count), floor_nt)
    ranked: list[tuple[float, tuple[str, int, str], Kind]] = []
    for driver in drivers:
        for kind in Kind:
            rows = _rows(fit, driver, kind, 6 if driver[0] != ELAPSED else 12, largest_nt)
            if rows is not None:
                ranked.append((search.products(space, rows[1]).gain(sigma).nats, driver, kind))
    cost = math.log(max(len(ranked), 1)) + ACCEPTED_NATS
    ranked = sorted((one for one in ranked if one[0] > cost), key=lambda one: -one[0])[:_TRIED]
    found = []
    for _, driver, kind in ranked:
        tried = []
        for count in _KNOTS_OF_TIME if driver[0] == ELAPSED else _KNOTS:
            rows = _rows(fit, driver, kind, count, largest_nt)
            if rows is not None:
                tried.append(Trial(rows[0], rows[2], _held_out(fit, rows[1], rows[2])))
        found.append(min(tried, key=lambda one: one.left))
    return sorted(found, key=lambda one: one.left)


def _rows(
    fit: Fit, driver: tuple[str, int, str], kind: Kind, count: int, largest_nt: float
) -> tuple[Form, Array, Hypothesis] | None:
    """A form with its rows (m, k a) of the residual; None where this residual does not see it, or no reference can."""
    scene = fit.problem.scene
    name = driver[0].partition(":")[2]
    if kind is Kind.MAGNITUDE and (fit.problem.is_vector or (name in COMPUTED and COMPUTED[name].of_sensor)):
        return None
    form = form_of(scene, *driver, kind, count)
    if form is None:
        return None
    hypothesis = form.hypothesis(scene, largest_nt)
    rows = fit.problem.rows(hypothesis.columns(np.zeros(0)), fit.unit)
    assert rows is not None
    return form, rows, hypothesis


def _held_out(fit: Fit, rows: Array, hypothesis: Hypothesis) -> Array:
    """White residual (m,) on held-out blocks [nT], with rows (m, k) beside what is fitted, to first order."""
    problem = fit.problem
    term = Term(hypothesis, np.zeros(0), np.zeros(hypothesis.size))
    columns = np.concatenate([fit.white_columns, problem.white(rows)], axis=1)
    own = amplitude_tie(problem, term, hypothesis.columns(term.theta)) * fit.white_rms_nt**2
    solutions = fold_solutions(fit.white_residual, columns, problem.fold, np.concatenate([fit.held_tie, own]))
    return held_out(fit.white_residual, columns, problem.fold, solutions)
