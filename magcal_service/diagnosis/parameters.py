"""The parameters of a fitted effect by name, each with 1 sigma, labels and the range that it may lie in."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from magcal_service.diagnosis.problem import Fit, Term, amplitude_columns, free_numbers
from magcal_service.model import Array
from magcal_service.physics.interface import Block, Effect, Nonlinear, Value, Values, by_name, value_of


def parameters_of(fit: Fit, index: int, effect: Effect) -> Values:
    """Amplitudes by block, nonlinear numbers, constants and what is derived, each with 1 sigma."""
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
    return {**found, **effect.derived(found)}


def _number_sigma(fit: Fit, term: Term, number: int, sigma: Array) -> float:
    """1 sigma of a nonlinear number of a term, from those of the numbers (m,) that its refit moves; NaN: none."""
    moving = free_numbers(term)
    if number in moving:
        return float(sigma[moving.index(number)])
    return _instant_sigma(fit, term, number) if term.hypothesis.nonlinear[number].role == "instant" else math.nan


def _instant_sigma(fit: Fit, term: Term, number: int) -> float:
    """1 sigma of a change time [s]: how far it may move, to either side, before that costs two noise variances.

    A change that shows in few directions cannot be told in time while the field points elsewhere.
    """
    changed = []
    for instant in (-np.inf, np.inf):
        theta = np.array(term.theta)
        theta[number] = instant
        rows = fit.problem.rows(term.hypothesis.columns(theta), fit.unit)
        assert rows is not None
        changed.append(rows @ term.amplitudes)
    times, at_s = fit.problem.row_time_s, float(term.theta[number])
    spent = np.cumsum((changed[0] - changed[1]) ** 2)
    row = int(np.searchsorted(times, at_s))
    before = float(spent[row - 1]) if row else 0.0
    allowed = 2.0 * fit.rms_nt**2
    first, last = np.searchsorted(spent, [before - allowed, before + allowed])
    last = min(int(last), len(times) - 1)
    return max(0.34 * fit.problem.scene.period_s, at_s - float(times[first]), float(times[last]) - at_s)


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
