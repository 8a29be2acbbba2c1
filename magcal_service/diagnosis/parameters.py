"""The parameters of a fitted effect by name, each with 1 sigma, labels and the range that it may lie in."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from magcal_service.diagnosis.problem import Fit, Term, amplitude_columns, free_numbers
from magcal_service.physics.interface import Block, Effect, Nonlinear, Value, Values, value_of


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
    free = fit.linear_size + sum(len(free_numbers(t)) for t in fit.terms[:index])
    moving = free_numbers(term)
    for number, nonlinear in enumerate(term.hypothesis.nonlinear):
        if number in moving:
            error = float(sigma[free + moving.index(number)])
        elif nonlinear.role == "instant":
            error = _instant_sigma(fit, term)
        else:
            error = math.nan
        value = value_of(float(term.theta[number]), error, nonlinear.unit)
        found[nonlinear.name] = replace(value, bounds=_searched(nonlinear))
    for name, constant in term.hypothesis.constants.items():
        found.setdefault(name, value_of(constant, math.nan, effect.units.get(name, "1")))
    return {**found, **effect.derived(found)}


def _instant_sigma(fit: Fit, term: Term) -> float:
    """1 sigma of a change time [s]: how far it may move, to either side, before that costs two noise variances.

    A change that shows in few directions cannot be told in time while the field points elsewhere.
    """
    rows = fit.problem.rows(term.hypothesis.columns(np.array([-np.inf])), fit.unit)
    assert rows is not None
    times, at_s = fit.problem.row_time_s, float(term.theta[0])
    spent = np.cumsum((rows @ term.amplitudes) ** 2)
    row = int(np.searchsorted(times, at_s))
    before = float(spent[row - 1]) if row else 0.0
    allowed = 2.0 * fit.rms_nt**2
    first, last = np.searchsorted(spent, [before - allowed, before + allowed])
    last = min(int(last), len(times) - 1)
    return max(0.34 * fit.problem.scene.period_s, at_s - float(times[first]), float(times[last]) - at_s)


def _most(block: Block) -> tuple[float, float] | None:
    """What its physics allows each number of a block; None where no limit is known."""
    return (-block.most, block.most) if math.isfinite(block.most) else None


def _searched(number: Nonlinear) -> tuple[float, float] | None:
    """What a refit keeps a number within; None where its grid is no range."""
    if number.role or len(number.grid) < 2:
        return None
    return float(number.grid.min()), float(number.grid.max())
