"""The nonlinear numbers of a hypothesis moved from the best of their grids to the optimum."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from magcal_service.diagnosis.linear import Gain
from magcal_service.diagnosis.problem import Problem
from magcal_service.model import Array
from magcal_service.physics.interface import Hypothesis, Nonlinear

_LINE_STEP: Final = 0.25  # of 1 / duration, the width of a line in the spectrum: the first step within it
_LINE_END: Final = 0.005  # of the same: a phase of two degrees over the recording
_INSTANT_END: Final = 0.4  # of a sample period: instants between two samples are indistinguishable
_RELATIVE_END: Final = 0.02  # of a number itself: a time constant is seldom known better
_PASSES: Final = 2  # over the numbers where there are several: the second sees the others moved
_NEAR: Final = 0.25  # of the first step from a grid: the first one from where a number was at its best before
_FINEST: Final = 1.0 / 64.0  # of the first step, the last one: a number at zero has no relative precision


def refined(
    hypothesis: Hypothesis,
    gain: Callable[[Array], Gain | None],
    theta: Array,
    best: Gain,
    grids: Sequence[Array],
    problem: Problem,
    near: bool = False,
) -> tuple[Array, Gain]:
    """The nonlinear numbers moved one after another by shrinking steps while the evidence grows.

    ``near``: they were at their best for another residual, not on a grid; so the steps begin small.
    """
    theta, tried = np.array(theta), {np.asarray(theta, dtype=np.float64).tobytes()}
    for _ in range(_PASSES if len(grids) > 1 and not near else 1):
        for index, number in enumerate(hypothesis.nonlinear):
            step = _first_step(number, float(theta[index]), grids[index], problem)
            finest = _FINEST * step
            step *= _NEAR if near else 1.0
            while step > max(_last_step(number, float(theta[index]), problem), finest):
                for sign in (1.0, -1.0):
                    trial = np.array(theta)
                    trial[index] += sign * step
                    if not _allowed(number, float(trial[index])) or trial.tobytes() in tried:
                        continue  # what was tried before was no better
                    tried.add(trial.tobytes())
                    other = gain(trial)
                    if other is not None and other.nats > best.nats:
                        theta, best = trial, other
                        break
                else:
                    step *= 0.5
    return theta, best


def _allowed(number: Nonlinear, value: float) -> bool:
    """Whether a number is within the range that is searched; lines and periods only have to be positive."""
    if number.role in ("frequency", "period"):
        return value > 0.0
    return bool(number.grid.min() <= value <= number.grid.max())


def _first_step(number: Nonlinear, value: float, grid: Array, problem: Problem) -> float:
    span = max(float(np.ptp(problem.scene.time_s)), 1.0)
    if number.role == "frequency":
        return _LINE_STEP / span
    if number.role == "period":
        return _LINE_STEP * value**2 / span
    if len(grid) < 2:
        return 0.0
    nearest = int(np.argmin(np.abs(grid - value)))
    gaps = np.diff(np.sort(grid))
    return 0.5 * float(gaps[min(max(nearest - 1, 0), len(gaps) - 1)])


def _last_step(number: Nonlinear, value: float, problem: Problem) -> float:
    span = max(float(np.ptp(problem.scene.time_s)), 1.0)
    if number.role == "frequency":
        return _LINE_END / span
    if number.role == "period":
        return _LINE_END * value**2 / span
    if number.role == "instant":
        return _INSTANT_END * problem.scene.period_s
    return _RELATIVE_END * max(abs(value), 1e-3)
