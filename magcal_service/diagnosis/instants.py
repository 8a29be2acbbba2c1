"""The instant of a change by joint solutions: to first order it is sought where the last one has led.

Where the field points in few directions, the nine errors move far with the instant, and columns made at one are wrong
at another.  On a craft that looks down a step was found 1270 s late so, and every round came back there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from magcal_service.diagnosis.problem import Fit, Term
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array

if TYPE_CHECKING:
    from magcal_service.diagnosis.screen import Screen

_FIRST: Final = 0.05
"""Share of the recording by which an instant is first moved to either side; a choice."""

_LAST: Final = 0.01  # of the same: nearer the linear search tells instants apart by itself
_MOST_STEPS: Final = 12  # solutions, from where one of the first steps was better


def timed(search: Screen, fit: Fit, index: int) -> Fit:
    """A fit with a term's instants and lines, which no solution moves, where joint solutions leave least.

    They are sought to first order where the fit has led; one single instant also a way off to either side.

    Parameters
    ----------
    search: whose forms and noise they are.
    fit: with the term; ``index``: its number.
    """
    own = fit.terms[index].hypothesis
    if not any(number.role for number in own.nonlinear):
        return fit
    found = search.screen(search.workspace(fit, index), fit, fit.white_rms_nt, among=[own])
    if found:
        fit = _better(fit, [_at(fit, index, found[0].theta, found[0].gain.amplitudes)])
    if any(number.role == "edge" for number in own.nonlinear):
        return _better(fit, [_at(fit, index, _moved(fit, index), fit.terms[index].amplitudes)])
    if len(own.nonlinear) != 1 or own.nonlinear[0].role != "instant":
        return fit
    span_s = float(np.ptp(fit.problem.scene.time_s))
    low, high = float(own.nonlinear[0].grid.min()), float(own.nonlinear[0].grid.max())
    step_s, steps = _FIRST * span_s, 0
    while step_s > _LAST * span_s and steps < _MOST_STEPS:
        term = fit.terms[index]
        sides = [np.array([float(term.theta[0]) + side]) for side in (-step_s, step_s)]
        trials = [_at(fit, index, side, term.amplitudes) for side in sides if low <= side[0] <= high]
        steps += len(trials)
        best = _better(fit, trials)
        step_s *= 0.5 if best is fit else 1.0
        fit = best
    return fit


def _moved(fit: Fit, index: int) -> Array:
    """A term's edges (k,) where a joint solution leaves them that moves them along."""
    term = fit.terms[index]
    terms: list[Term] = list(fit.terms)
    terms[index] = replace(term, hypothesis=term.hypothesis.loosened())
    time_s = fit.problem.scene.course_at(float(term.theta[0]))
    moved = solve(fit.problem, fit.x, terms).terms[index].theta
    return np.sort(np.clip(moved, time_s[0], time_s[-1]))


def _better(fit: Fit, trials: Sequence[Fit]) -> Fit:
    """The one of all that leaves least; those that do not converge are none."""
    return min((fit, *(trial for trial in trials if trial.converged)), key=_squares)


def _squares(fit: Fit) -> float:
    """Of what is left, as noise of the sensor's own [nT^2]."""
    return float(fit.sensor_residual @ fit.sensor_residual)


def _at(fit: Fit, index: int, theta: Array, amplitudes: Array) -> Fit:
    """The joint solution with a term's nonlinear numbers there."""
    terms: list[Term] = list(fit.terms)
    terms[index] = replace(terms[index], theta=theta, amplitudes=amplitudes)
    return solve(fit.problem, fit.x, terms)
