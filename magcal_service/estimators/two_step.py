"""TWO-STEP: the batch solution for bias, scale and non-orthogonality, kept up to date as samples come.

Step 1 solves for (E, c) linearly after centring, which removes |b|^2; step 2 goes on from (b, D) by Gauss-Newton with
the centre measurement |b|^2 = s put back.  Both use the observations (2)-(4) with the mean and variance of v, and both
need the samples in sums only (``magnitude_sums``), so a solution costs the same however long the recording is.

``corrected`` (the default) also subtracts what the noise inside B adds to the gradient and to the normal matrix: the
published form leaves it in, is biased by about 1e-4 in D at 300 nT, and is off by a sigma or more.  With it the
estimate attains the Cramer-Rao bound of the scalar measurement.  Added besides: a weak tie to the prior, so that a
short batch stays regular, and the gates of ``start`` against collapsed solutions.  ``published`` has the form as it
stands in the paper.

Source: Alonso & Shuster 2002, "Complete linear attitude-independent magnetometer calibration": the centred estimate
(step 1), the Gauss-Newton correction (step 2), E = 2D + D^2 and c = (I + D) b; Cetin, Soken & Tekinalp 2020, (2)-(4).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.config.settings import CraftConfig
from magcal_service.estimators.interface import Method, Phase, StartGate, StateEstimate, TickOutcome
from magcal_service.estimators.parts.magnitude_sums import (
    SCALE_NT,
    MagnitudeSums,
    coefficients,
    scaled,
    unscaled,
    unscaled_covariance,
)
from magcal_service.estimators.parts.noise_level import NoiseLevel, is_sound, squared_innovations
from magcal_service.estimators.parts.start import prior_sigma
from magcal_service.estimators.parts.start_gates import (
    HANDOVER_SHARE,
    LARGEST_EIGENVALUE,
    SMALLEST_EIGENVALUE,
    Proposal,
    stopped_by,
)
from magcal_service.model import STATE_SIZE, Array, mean_of_v, scalar_residual, state_of
from magcal_service.ticks.assembler import Tick

_ITERATIONS: Final = 60
"""Most steps of either part; None after that.

Choice: solutions in the tests mostly settle in 2 to 5 steps, the slowest in 56; a batch that needs more is tried again
with 5 % more sample time.
"""

_CONVERGED: Final = 1e-6
"""Square of a step, in sigmas, below which it is the last."""

_WARM_STEPS: Final = 4
"""Steps from the last solution on; in the tests one or two do, and what needs more is solved from the beginning."""

_WARM_LIMIT: Final = 25.0
"""A tick that would move the solution by more than this (in sigmas, squared) is solved from the beginning."""

_RETRY: Final = 1.05
"""While there is no start, the next attempt waits for this many times as much sample time."""

_NEW_SHARE: Final = 0.005
"""A running batch is solved again when this share of it is new: its sigmas are at most a quarter of a percent old."""

_NOISE_PASSES: Final = 4
"""Solutions by which an unknown noise level is found, each weighted by the residual of the one before.

Choice: the level only weighs the prior, which is weak, and the mean of v; each pass costs a solution.
"""

_BAD_FIT: Final = 3.0
"""Residual level, in units of the given noise, from which on the samples do not fit together."""


@dataclass(frozen=True, slots=True)
class Solution:
    """A state (9,), its covariance (9, 9) [nT, -], the residual level that it leaves [nT], and the samples' count."""

    x: Array
    covariance: Array
    residual_nt: float
    count: float


def two_step(
    sums: MagnitudeSums, noise: NoiseLevel, prior: Array, *, corrected: bool = True, start: Array | None = None
) -> Solution | StartGate:
    """Solve a batch.

    Parameters
    ----------
    sums: the batch.
    noise: sigma of the residual for the covariance, and its white part for the means.
    prior: 1 sigma of the nine states, a weak tie (9,) [nT, -].
    corrected: take the noise inside B into account; False: as published.
    start: a state (9,) close to the solution, from which step 2 goes on; None: step 1 finds one.
    """
    try:
        return _solved(_Problem(sums, noise, scaled(prior), corrected), sums, start)
    except np.linalg.LinAlgError:  # singular to rounding: the samples say nothing of some state, and too much of others
        return StartGate.POOR_COVERAGE


def _solved(problem: _Problem, sums: MagnitudeSums, start: Array | None) -> Solution | StartGate:
    y = problem.polished(scaled(start), _WARM_STEPS, _WARM_LIMIT) if start is not None else None
    if y is None:
        first = problem.linear()
        if isinstance(first, StartGate):
            return first
        descended = problem.descended(first)
        y = problem.polished(descended, _ITERATIONS, np.inf) if descended is not None else None
    if y is None:
        return StartGate.NO_CONVERGENCE
    if not is_sound(unscaled(y), (SMALLEST_EIGENVALUE, LARGEST_EIGENVALUE)):
        return StartGate.COLLAPSED
    covariance = problem.covariance(y)
    np.linalg.cholesky(correlation_of(covariance))
    return Solution(unscaled(y), covariance, sums.mean_square_nt(y) ** 0.5, sums.count)


def correlation_of(covariance: Array) -> Array:
    """Correlations (9, 9); LinAlgError where a variance is not a positive number."""
    variance = np.diagonal(covariance)
    if not (np.isfinite(covariance).all() and np.all(variance > 0.0)):
        raise np.linalg.LinAlgError(f"variances {variance.tolist()} are not all positive")
    sigma = np.sqrt(variance)
    correlation: Array = covariance / np.outer(sigma, sigma)
    return correlation


class _Problem:
    """One batch's equations in scaled states; the unit of cost is (sigma / SCALE_NT)^2."""

    def __init__(self, sums: MagnitudeSums, noise: NoiseLevel, prior: Array, corrected: bool) -> None:
        self._sums, self._prior, self._corrected = sums, prior, corrected
        self._noise_nt, self._white_nt = noise.total_nt, noise.white_nt
        self._variance = (noise.total_nt / SCALE_NT) ** 2
        self._tie = self._variance * prior**-2.0

    def linear(self) -> Array | StartGate:
        """Step 1: (E, c) by centred least squares, as a state."""
        q = self._sums.linear_solution(self._noise_nt, self._prior)
        square = np.diag(q[:3])
        square[[0, 0, 1], [1, 2, 2]] = square[[1, 2, 2], [0, 0, 1]] = 0.5 * q[3:6]
        values, vectors = np.linalg.eigh(square)
        if values[0] <= 0.0:
            return StartGate.NOT_POSITIVE
        root = (vectors * np.sqrt(values)) @ vectors.T
        return state_of(np.linalg.solve(root, -0.5 * q[6:9]), root - np.eye(3))

    def _cost(self, y: Array) -> float:
        """The published cost less a constant: what the gradient with the mean of v alone belongs to."""
        q = coefficients(y)
        mean = mean_of_v((self._white_nt / SCALE_NT) ** 2) * self._sums.normal[9]
        return float(q @ self._sums.normal @ q - 2.0 * (q @ (self._sums.target + mean)) + self._tie @ y**2)

    def descended(self, y: Array) -> Array | None:
        """Step 2: damped Gauss-Newton on the published cost; None if it runs away."""
        cost, damping = self._cost(y), 0.0
        for _ in range(_ITERATIONS):
            gradient = self._sums.gradient(y, self._white_nt, corrected=False) + self._tie * y
            normal = self._sums.information(y, 0.0, corrected=False) + np.diag(self._tie)
            step = np.linalg.solve(normal + damping * np.diag(np.diagonal(normal)), gradient)
            if float(step @ normal @ step) < _CONVERGED * self._variance:
                return y
            trial = y - step
            trial_cost = self._cost(trial)
            if not trial_cost <= cost + 1e-12 * abs(cost):
                damping = max(10.0 * damping, 1e-3)
                if damping > 1e9:
                    return y
                continue
            y, cost, damping = trial, trial_cost, 0.1 * damping if damping > 1e-6 else 0.0
        return None

    def polished(self, y: Array, steps: int, limit: float) -> Array | None:
        """The root of the gradient near y by Gauss-Newton steps; None if a step is too long or too many are needed."""
        for _ in range(steps):
            normal = self._normal(y)
            gradient = self._sums.gradient(y, self._white_nt, corrected=self._corrected) + self._tie * y
            step = np.linalg.solve(normal, gradient)
            length = float(step @ normal @ step) / self._variance
            if not length < limit:
                return None
            y = y - step
            if length < _CONVERGED:
                return y
        return y if limit < np.inf else None

    def _normal(self, y: Array) -> Array:
        """Normal matrix with the tie; the noise's share is left in where subtracting it would leave too little."""
        information, tie = self._sums.information(y, self._white_nt, corrected=False), np.diag(self._tie)
        full = information + tie
        if not self._corrected:
            return full
        corrected = information - self._sums.noise_information(y, self._white_nt) + tie
        root = np.linalg.inv(np.linalg.cholesky(full))
        enough = np.linalg.eigvalsh(root @ corrected @ root.T)[0] > 0.2
        return corrected if enough else full

    def covariance(self, y: Array) -> Array:
        """Covariance of the state (9, 9) [nT, -]."""
        return unscaled_covariance(self._variance * np.linalg.inv(self._normal(y)))


@dataclass(init=False, repr=False, eq=False)
class TwoStepMemory:
    """What of ``TwoStep`` outlives a restart, saved and restored whole."""

    _x: Array
    _covariance: Array
    _noise: NoiseLevel
    _phase: Phase
    _gate: StartGate | None
    _samples: int
    _restarts: int
    _first_s: float | None
    _attempt_at_s: float
    _fresh: int
    _solved_count: float
    _all: MagnitudeSums


class TwoStep(Stateful, TwoStepMemory):
    """One craft's batch.

    Parameters
    ----------
    config: the craft's configuration (sensor, filter's prior and ``start_s``).
    corrected: as ``two_step``.
    """

    name = "two-step"

    def __init__(self, config: CraftConfig, *, corrected: bool = True) -> None:
        self.config = config
        self._corrected = corrected
        self._prior = prior_sigma(config.filter)
        self.reset()

    def reset(self) -> None:
        """Back to the prior, before any sample."""
        self._x = np.zeros(STATE_SIZE)
        self._covariance = np.diag(self._prior**2)
        self._noise = NoiseLevel(self.config.sensor.noise_nt)
        self._phase = Phase.STARTING
        self._gate = None
        self._samples = self._restarts = 0
        self._first_s = None
        self._attempt_at_s = self.config.filter.start_s
        self._fresh = 0
        self._solved_count = 0.0
        self._clear()

    def _clear(self) -> None:
        self._all = MagnitudeSums()

    def _take(self, tick: Tick) -> None:
        self._all.add(tick.field_body_nt, tick.reference_magnitude_nt)

    def _sums(self) -> MagnitudeSums:
        """The batch that is solved."""
        return self._all

    def estimate(self) -> StateEstimate:
        """The estimate from every sample but the newest half percent."""
        return StateEstimate(
            x=self._x,
            covariance=self._covariance,
            phase=self._phase,
            noise_nt=self._noise.total_nt,
            samples=self._samples,
            rejected=0,
            restarts=self._restarts,
            waiting_for=self._gate if self._phase is Phase.STARTING else None,
            spin_given_up=False,
        )

    def handle(self, tick: Tick) -> TickOutcome:
        """Take one tick; solve the batch again where it has grown, from the last solution where there is one."""
        residual = scalar_residual(self._x, tick.field_body_nt, tick.reference_magnitude_nt)
        running = self._phase is Phase.RUNNING
        squared = self._squared(tick, residual) if running else 0.0
        self._take(tick)
        self._samples += len(residual)
        self._fresh += len(residual)
        if running:
            self._noise.observe(residual, after_gap=tick.after_gap)
            if self._fresh >= _NEW_SHARE * self._solved_count:
                self._go_on()
        else:
            self._try_start(tick)
        return TickOutcome(
            self._phase,
            residual,
            used=len(residual),
            squared_innovation=squared,
            degrees=len(residual) if running else 0,
        )

    def _squared(self, tick: Tick, residual_nt: Array) -> float:
        noise = self._noise
        squares = squared_innovations(
            self._x, self._covariance, tick.field_body_nt, residual_nt, noise.total_nt, noise.white_nt
        )
        return float(squares.sum())

    def _go_on(self) -> None:
        solution = self._solve(self._x)
        if isinstance(solution, Solution):
            self._accept(solution)
            return
        self._phase, self._gate = Phase.STARTING, solution  # what was collected contradicts itself
        self._restarts += 1
        self._first_s, self._attempt_at_s = None, self.config.filter.start_s

    def _accept(self, solution: Solution) -> None:
        self._x, self._covariance = solution.x, solution.covariance
        self._fresh, self._solved_count = 0, solution.count

    def _try_start(self, tick: Tick) -> None:
        """Solve from the beginning when there is enough, and again whenever there is so much more."""
        if self._first_s is None:
            self._first_s = float(tick.times_s[0])
        seconds = float(tick.times_s[-1]) - self._first_s
        if seconds < self._attempt_at_s or self._samples <= 2 * STATE_SIZE:
            return
        self._attempt_at_s = _RETRY * seconds
        solution = self._solve(None)
        self._gate = solution if isinstance(solution, StartGate) else self._gate_of(solution)
        if isinstance(solution, Solution) and self._gate is None:
            self._accept(solution)
            self._phase = Phase.RUNNING

    def _gate_of(self, solution: Solution) -> StartGate | None:
        given, sums = self.config.sensor.noise_nt, self._sums()
        magnitude_nt = SCALE_NT * float(sums.square / max(sums.normal[9, 9], 1e-300)) ** 0.25
        return stopped_by(
            Proposal(
                solution.x,
                solution.covariance,
                residual_rms_nt=solution.residual_nt,
                largest_rms_nt=np.inf if given is None else _BAD_FIT * given,
                is_unsure=lambda: sums.vector_sigma_nt(solution.covariance) > HANDOVER_SHARE[1] * magnitude_nt,
            )
        )

    def _solve(self, start: Array | None) -> Solution | StartGate:
        """Solve the batch; an unknown noise level is taken from what the solution leaves."""
        sums, prior = self._sums(), self._prior
        if self._noise.given_nt is not None:
            return two_step(sums, self._noise, prior, corrected=self._corrected, start=start)
        if start is not None:
            self._noise.set(self._level(sums, scaled(start)))
            return two_step(sums, self._noise, prior, corrected=self._corrected, start=start)
        solution: Solution | StartGate = StartGate.NO_CONVERGENCE
        self._noise.set(0.01 * SCALE_NT)
        for _ in range(_NOISE_PASSES):
            solution = two_step(sums, self._noise, prior, corrected=self._corrected)
            if isinstance(solution, StartGate):
                break
            self._noise.set(self._level(sums, scaled(solution.x)))
        return solution

    @staticmethod
    def _level(sums: MagnitudeSums, y: Array) -> float:
        """Residual level [nT], with the nine fitted parameters counted."""
        return float((sums.mean_square_nt(y) * sums.count / max(sums.count - STATE_SIZE, 1.0)) ** 0.5)


def published(config: CraftConfig) -> TwoStep:
    """The batch with the mean of v only, as published; for comparison."""
    return TwoStep(config, corrected=False)


METHOD = Method(
    "two-step",
    "TWO-STEP batch of all samples: centred linear start, then Gauss-Newton",
    TwoStep,
    has_process_noise=False,
)
