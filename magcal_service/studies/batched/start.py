"""The batch start of ``start``, for many runs at once: same samples times, same reference, one stack of problems.

What differs between runs is the measured field alone, so all attempts fall into the same ticks, and Gauss-Newton goes
on for all runs together until each has settled.  Only the plain case is here: a run in which a sample or a spin window
would be left out, or that no solution fits, is reported as irregular and has to be flown alone.

Source: as ``start``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.config.settings import CraftConfig
from magcal_service.estimators.interface import StartGate
from magcal_service.estimators.parts.spin_window import Window
from magcal_service.estimators.parts.start import (
    BatchSolution,
    StartBuffer,
    fits_all,
    gated,
    lowest,
    prior_sigma,
    without_outliers,
)
from magcal_service.estimators.parts.start_problem import (
    FIRST_DAMPING,
    ITERATIONS,
    LARGEST_D,
    LEAST_DAMPING,
    SETTLED,
    WORSE,
    BatchProblem,
    WindowMeans,
    linear_states,
)
from magcal_service.model import D_ALL, STATE_SIZE, Array
from magcal_service.ticks.assembler import Tick

_ELEMENTS: Final = 16_384
"""Runs times samples in one stack: its working arrays of 128 kB stay in the cache."""


@dataclass(frozen=True, slots=True)
class Starts:
    """What an attempt gave: solutions by run, and the irregular runs."""

    solutions: dict[int, BatchSolution]
    irregular: list[int]


class BatchedStart:
    """Collects ticks of many runs until their batch solutions pass every gate.

    Parameters
    ----------
    config: the craft's configuration, with a known noise.
    """

    def __init__(self, config: CraftConfig) -> None:
        self.config = config
        self._noise_nt = config.sensor.noise_nt or 0.0
        self._ticks: StartBuffer[tuple[Array, float]] = StartBuffer(config.filter.start_s)
        self._windows: list[tuple[Window, Array]] = []

    def push(self, tick: Tick, field_nt: Array, window: Window | None, window_field_nt: Array | None) -> None:
        """Add a tick.

        Parameters
        ----------
        tick: one sample; its measured vector is not used.
        field_nt: measured vectors B (runs, 3) [nT].
        window, window_field_nt: the spin window that ended in the tick, if one did, and its B (runs, k, 3) [nT].
        """
        self._ticks.add(tick, (field_nt, float(tick.reference_magnitude_nt[-1])))
        if window is not None and window_field_nt is not None:
            mean = np.einsum("k,rki->ri", window.weights, window_field_nt)
            self._windows.append((window, mean))

    def attempt(self, waiting: NDArray[np.intp]) -> Starts:
        """Try a start for the runs that wait for one, when it is time to; nothing otherwise."""
        result = Starts({}, [])
        if not len(waiting) or not self._ticks.due():
            return result
        chunk = max(1, _ELEMENTS // self._ticks.samples)
        for first in range(0, len(waiting), chunk):
            runs = waiting[first : first + chunk]
            for run, found in zip(runs.tolist(), self._solve(self._problem(runs)), strict=True):
                if isinstance(found, BatchSolution):
                    result.solutions[run] = found
                elif found is StartGate.BAD_FIT:
                    result.irregular.append(run)
        return result

    def _problem(self, runs: NDArray[np.intp]) -> BatchProblem:
        entries = self._ticks.entries
        field = np.empty((3, len(runs), len(entries)))
        for i, (measured, _) in enumerate(entries):
            field[:, :, i] = measured[runs].T
        shared = WindowMeans.of([window for window, _ in self._windows])
        means = np.array([mean[runs] for _, mean in self._windows]).reshape(-1, len(runs), 3)
        windows = WindowMeans(means.transpose(1, 0, 2), shared.across, shared.weight, shared.leak_nt)
        return BatchProblem(
            field_nt=np.moveaxis(field, 0, 2),
            magnitude_nt=np.array([magnitude for _, magnitude in entries]),
            windows=windows,
            prior=prior_sigma(self.config.filter),
            sigma_nt=self._noise_nt,
            noise_nt=self._noise_nt,
        )

    def _solve(self, problem: BatchProblem) -> Iterator[BatchSolution | StartGate]:
        """``start._solve`` and the gates for a stack; BAD_FIT for an irregular run."""
        linear, positive = linear_states(problem)
        linear[~positive] = 0.0
        roads = [_Road(problem, linear), _Road(problem, np.zeros_like(linear))]
        plain = without_outliers(problem)
        for run, sound in enumerate(plain.tolist()):
            found = [road.result(run) for road in roads if road.arrived[run]]
            if not sound:
                yield StartGate.BAD_FIT
            elif not found:
                yield StartGate.NO_CONVERGENCE
            else:
                yield self._gated(problem.run(run), found)

    def _gated(self, problem: BatchProblem, found: list[tuple[Array, Array]]) -> BatchSolution | StartGate:
        solution = lowest(problem, found)
        if isinstance(solution, StartGate):
            return solution
        if not fits_all(problem, solution.x):
            return StartGate.BAD_FIT
        return gated(solution, problem.field_nt, problem.magnitude_nt, self._noise_nt, self._ticks.stride)


class _Road:
    """``gauss_newton`` for a stack of problems, each from its start.

    Parameters
    ----------
    problem: a stack of r.
    start: states (r, 9).
    """

    def __init__(self, problem: BatchProblem, start: Array) -> None:
        runs = len(start)
        self.x = np.zeros((runs, STATE_SIZE))
        self.covariance = np.zeros((runs, STATE_SIZE, STATE_SIZE))
        self.arrived: NDArray[np.bool_] = np.zeros(runs, dtype=bool)
        self._go(problem, start)

    def result(self, run: int) -> tuple[Array, Array]:
        """State (9,) and covariance (9, 9) of a run that has arrived."""
        return self.x[run], self.covariance[run]

    def _go(self, problem: BatchProblem, x: Array) -> None:
        rows, damping = np.arange(len(x)), np.zeros(len(x))
        normal, gradient, cost = problem.normal_equations(x)
        for _ in range(ITERATIONS):
            damped = normal + damping[:, None, None] * (normal * np.eye(STATE_SIZE))
            step = np.linalg.solve(damped, gradient[:, :, None])[:, :, 0]
            settled = (step * (normal @ step[:, :, None])[:, :, 0]).sum(axis=1) < SETTLED
            if settled.any():
                self._arrive(rows[settled], x[settled], normal[settled])
                if settled.all():
                    return
                on = ~settled
                problem, rows, x, damping = problem.runs(on), rows[on], x[on], damping[on]
                normal, gradient, cost, step = normal[on], gradient[on], cost[on], step[on]
            trial = x - step
            trials = problem.normal_equations(trial)
            better = (trials[2] <= cost * WORSE) & (np.abs(trial[:, D_ALL]).max(axis=1) <= LARGEST_D)
            x = np.where(better[:, None], trial, x)
            normal = np.where(better[:, None, None], trials[0], normal)
            gradient = np.where(better[:, None], trials[1], gradient)
            cost = np.where(better, trials[2], cost)
            relaxed = np.where(damping > LEAST_DAMPING, 0.1 * damping, 0.0)
            damping = np.where(better, relaxed, np.maximum(10.0 * damping, FIRST_DAMPING))

    def _arrive(self, rows: NDArray[np.intp], x: Array, normal: Array) -> None:
        self.x[rows], self.arrived[rows] = x, True
        self.covariance[rows] = np.linalg.inv(normal)
