"""The parameters of a fitted effect by name, each with 1 sigma, labels and the range that it may lie in."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from magcal_service.diagnosis.problem import Fit, Term, free_numbers
from magcal_service.diagnosis.solution import exchanged
from magcal_service.diagnosis.term_columns import amplitude_columns
from magcal_service.model import Array
from magcal_service.physics.interface import Block, Effect, Nonlinear, Value, Values, by_name, value_of

_OF_A_BEND: Final = 8.0
"""Samples within which a change's begin and end are not told from one another's: a quarter of the shortest change."""


def parameters_of(fit: Fit, index: int, effect: Effect) -> Values:
    """Amplitudes by block, nonlinear numbers, constants and what is derived, each with 1 sigma."""
    found = fitted_numbers(fit, index, effect)
    return {**found, **effect.derived(found)}


def fitted_numbers(fit: Fit, index: int, effect: Effect) -> Values:
    """The same without what is derived."""
    term = fit.terms[index]
    sigma = np.sqrt(np.maximum(np.diagonal(fit.covariance), 0.0))
    at = amplitude_columns(fit, index).start
    found: dict[str, Value] = {}
    used = 0
    for block in term.hypothesis.blocks:
        part = slice(at + used, at + used + block.size)
        values = term.amplitudes[used : used + block.size].reshape(block.shape)
        found[block.name] = Value(values, sigma[part].reshape(block.shape), block.unit, block.labels, _most(block))
        used += block.size
    numbers = term.hypothesis.nonlinear
    free = fit.linear_size + sum(len(free_numbers(t)) for t in fit.terms[:index])
    errors = by_name(numbers, [_number_sigma(fit, term, number, sigma[free:]) for number in range(len(numbers))])
    of = {number.name: number for number in numbers}
    for name, value in by_name(numbers, term.theta).items():
        each = value_of(value, errors[name], of[name].unit)
        names = () if np.ndim(value) == 0 else (tuple(f"instant {i + 1}" for i in range(np.size(value))),)
        found[name] = replace(each, labels=names, bounds=_searched(of[name]))
    for name, constant in term.hypothesis.constants.items():
        found.setdefault(name, value_of(constant, math.nan, effect.units.get(name, "1")))
    return found


def of_each_axis(fit: Fit, index: int, effect: Effect) -> Values:
    """What each axis has by itself, where a form has one number for all: that one's sigma says nothing of a single
    axis.  Empty where a form has no such number, or where the axes cannot be told apart."""
    term = fit.terms[index]
    mine = term.hypothesis
    names = [block.each for block in mine.blocks]
    for form in effect.hypotheses(fit.problem.scene) if all(names) else ():
        is_like = (form.driver, form.constants) == (mine.driver, mine.constants)
        numbers = [number.name for number in form.nonlinear]
        if not is_like or [b.name for b in form.blocks] != names or numbers != [n.name for n in mine.nonlinear]:
            continue
        apart = exchanged(fit.problem, fit, index, Term(form, term.theta, np.repeat(term.amplitudes, 3)))
        found = parameters_of(apart, index, effect) if apart.converged else {}
        return {name: found[name] for name in names if name in found}
    return {}


def _number_sigma(fit: Fit, term: Term, number: int, sigma: Array) -> float:
    """1 sigma of a nonlinear number of a term, from those of the numbers (m,) that its refit moves; NaN: none.

    What a number is searched between is the most that it may be off by.
    """
    moving = free_numbers(term)
    if number in moving:
        between = _searched(term.hypothesis.nonlinear[number])
        return min(float(sigma[moving.index(number)]), math.inf if between is None else between[1] - between[0])
    role = term.hypothesis.nonlinear[number].role
    if role == "edge":
        return _edge_sigma(fit, term, number)
    return _instant_sigma(fit, term, number) if role == "instant" else math.nan


def _added_at(fit: Fit, term: Term, number: int, value: float) -> Array:
    """(m,) what a term adds to the residual with one of its nonlinear numbers at another value [nT]."""
    theta = np.array(term.theta)
    theta[number] = value
    rows = fit.problem.rows(term.hypothesis.columns(theta), fit.unit)
    assert rows is not None
    return np.asarray(rows @ term.amplitudes)


def _edge_sigma(fit: Fit, term: Term, number: int) -> float:
    """1 sigma of where a change that takes a while begins or ends [s], beside all that was fitted."""
    at_s = float(term.theta[number])
    time_s = fit.problem.scene.course_at(at_s)
    step_s = float(np.median(np.diff(time_s)))
    later, earlier = (_added_at(fit, term, number, at_s + side) for side in (step_s, -step_s))
    slope = fit.problem.white((later - earlier) / (2.0 * step_s))
    scale, products, _ = fit.normal_equations
    columns = fit.white_columns / scale
    left = slope - columns @ np.linalg.lstsq(products, columns.T @ slope, rcond=1e-13)[0]
    sigma_s = fit.white_rms_nt / max(float(np.linalg.norm(left)), 1e-300)
    if sigma_s > float(np.ptp(time_s)):
        return math.nan
    # a bend is a matter of many samples, and of none while there are none
    after = int(np.clip(np.searchsorted(time_s, at_s), 1, len(time_s) - 1))
    return math.hypot(sigma_s, _OF_A_BEND * step_s, 0.5 * float(time_s[after] - time_s[after - 1]))


def _instant_sigma(fit: Fit, term: Term, number: int) -> float:
    """1 sigma of a change time [s] about the one that was found: of its likelihood over all times, all else as fitted.

    A change is known to a sample where it stands out of the noise at once, to seconds where it does not, and not at all
    while the field points where it does not show; two such times, far apart, may be as likely.
    """
    always, never = (_added_at(fit, term, number, instant) for instant in (-np.inf, np.inf))
    each = fit.problem.rows_per_sample
    times, at_s = fit.problem.scene.time_s, float(term.theta[number])
    jump = (always - never).reshape(len(times), each)
    residual, row = fit.residual.reshape(len(times), each), int(np.searchsorted(times, at_s))
    # costs [nats] of taking the jump from the rows after it, one after another, and of giving it to those before
    later = ((residual + 0.5 * jump) * jump).sum(axis=1)[row:] / fit.rms_nt**2
    earlier = ((0.5 * jump - residual) * jump).sum(axis=1)[:row][::-1] / fit.rms_nt**2
    cost = np.concatenate([np.cumsum(earlier)[::-1], [0.0], np.cumsum(later)])[1:-1]  # before the first row, ..., after
    middle, width = 0.5 * (times[1:] + times[:-1]), np.diff(times)
    weight = width * np.exp(cost.min() - cost)
    square = (middle - at_s) ** 2 + width**2 / 12.0
    return math.sqrt(float(weight @ square) / float(weight.sum()))


def _most(block: Block) -> tuple[float, float] | None:
    """What its physics allows each number of a block; None where no limit is known."""
    if not math.isfinite(block.most):
        return None
    return max(-block.most, block.least), block.most


def _searched(number: Nonlinear) -> tuple[float, float] | None:
    """What a refit keeps a number within; None where its grid is no range."""
    if number.role or len(number.grid) < 2:
        return None
    return float(number.grid.min()), float(number.grid.max())
