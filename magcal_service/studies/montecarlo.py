"""Many runs of one method over one flight, and what they say together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from magcal_service.config.settings import CraftConfig
from magcal_service.estimators import find_method
from magcal_service.estimators.interface import Phase
from magcal_service.estimators.scalar_ukf import ScalarUkf
from magcal_service.estimators.spin import SpinFilter
from magcal_service.estimators.ukf import Ukf
from magcal_service.many.executor import Executor
from magcal_service.model import STATE_SIZE, Array
from magcal_service.studies.batched.spin import BatchedSpin
from magcal_service.studies.batched.ukf import BatchedScalarUkf, BatchedUkf
from magcal_service.studies.flights import FlightPlan, Flown, fly
from magcal_service.ticks.assembler import Tick

BATCH: Final = 250
"""Runs in one batched job: 110 MB of samples over three orbits, and the loop over ticks costs little beside them."""

ALONE: Final = 4
"""Runs in one job of a method that goes one run at a time."""


class Batch(Protocol):
    """An estimator for many runs at once; ``left`` says which have to be repeated alone."""

    left: NDArray[np.bool_]

    @property
    def running(self) -> NDArray[np.bool_]:
        """Runs with an estimate (runs,)."""

    @property
    def x(self) -> Array:
        """States (runs, 9)."""

    @property
    def covariance(self) -> Array:
        """Covariances (runs, 9, 9)."""

    def handle(self, tick: Tick, field_body_nt: Array) -> None:
        """Take one tick with the measured vectors (runs, 3) [nT]."""


_BATCHES: Final[dict[str, type[BatchedUkf] | type[BatchedSpin]]] = {
    Ukf.name: BatchedUkf,
    ScalarUkf.name: BatchedScalarUkf,
    SpinFilter.name: BatchedSpin,
}


@dataclass(frozen=True, slots=True)
class Job:
    """Some runs of a method over a flight.

    Parameters
    ----------
    plan, config: the flight, and the craft's configuration with the method's name.
    seeds: one per run.
    at_s: times whose estimates are wanted (k,) [s], rising.
    """

    plan: FlightPlan
    config: CraftConfig
    seeds: tuple[np.random.SeedSequence, ...]
    at_s: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Ensemble:
    """Estimates of many runs at the times asked for.

    Parameters
    ----------
    at_s: times (k,) [s].
    truth: true states (k, 9).
    x, covariance: estimates (runs, k, 9) and (runs, k, 9, 9) [nT, -].
    started: whether there was an estimate by then (runs, k).
    restarts: per run (runs,).
    """

    at_s: Array
    truth: Array
    x: Array
    covariance: Array
    started: NDArray[np.bool_]
    restarts: NDArray[np.int_]

    @property
    def error(self) -> Array:
        """Estimate less truth (runs, k, 9)."""
        return self.x - self.truth

    @property
    def sigma(self) -> Array:
        """1 sigma by the filters' covariances (runs, k, 9)."""
        return np.sqrt(np.diagonal(self.covariance, axis1=2, axis2=3))


@dataclass(frozen=True, slots=True)
class Statistics:
    """What an ensemble says at one time, over the runs that have started.

    Parameters
    ----------
    runs, started: all, and those with an estimate.
    mean, spread: mean estimate (9,) and its empirical 1 sigma over runs (9,).
    formal: 1 sigma by the filters' covariances, root mean square over runs (9,).
    mean_error_sigmas: mean error over ``spread`` (9,); it scatters by 1 / sqrt(runs); nan where nothing is estimated.
    nees: mean normalised estimation error squared; 9 where the covariance is consistent, +- sqrt(18 / runs).
    """

    runs: int
    started: int
    mean: Array
    spread: Array
    formal: Array
    mean_error_sigmas: Array
    nees: float


def seeds_of(seed: int, runs: int) -> tuple[np.random.SeedSequence, ...]:
    """One child seed per run; the first ones are the same however many there are."""
    return tuple(np.random.SeedSequence(seed).spawn(runs))


def simulate(
    plan: FlightPlan,
    config: CraftConfig,
    seeds: Sequence[np.random.SeedSequence],
    executor: Executor,
    at_s: Sequence[float] = (),
    label: str = "",
) -> Ensemble:
    """Run the configuration's method once per seed.

    Parameters
    ----------
    at_s: times whose estimates are kept [s]; empty: the end alone.
    label: what the progress bar says.
    """
    times = tuple(at_s) or (float(plan.duration_s - 1),)
    size = BATCH if in_batch(config) else ALONE
    jobs = [Job(plan, config, tuple(seeds[i : i + size]), times) for i in range(0, len(seeds), size)]
    parts = list(executor.map(run_job, jobs, label or config.filter.method, size=lambda job: len(job.seeds)))
    return Ensemble(
        at_s=parts[0].at_s,
        truth=parts[0].truth,
        x=np.concatenate([part.x for part in parts]),
        covariance=np.concatenate([part.covariance for part in parts]),
        started=np.concatenate([part.started for part in parts]),
        restarts=np.concatenate([part.restarts for part in parts]),
    )


def in_batch(config: CraftConfig) -> bool:
    """Whether the configuration's method has a batched twin that covers it."""
    batch = _BATCHES.get(config.filter.method)
    return batch is not None and batch.supports(config)


def run_job(job: Job) -> Ensemble:
    """All runs of one job; the work of a worker process."""
    flown = fly(job.plan)
    result = _empty(job, flown)
    rows: Sequence[int] = range(len(job.seeds))
    if in_batch(job.config):
        rows = _run_batch(job, flown, result)
    for row in rows:
        _run_alone(job, flown, result, row)
    return result


def _empty(job: Job, flown: Flown) -> Ensemble:
    runs, times = len(job.seeds), len(job.at_s)
    return Ensemble(
        at_s=np.array(job.at_s),
        truth=np.stack([flown.truth(time_s) for time_s in job.at_s]),
        x=np.zeros((runs, times, STATE_SIZE)),
        covariance=np.zeros((runs, times, STATE_SIZE, STATE_SIZE)),
        started=np.zeros((runs, times), dtype=bool),
        restarts=np.zeros(runs, dtype=int),
    )


def _run_batch(job: Job, flown: Flown, result: Ensemble) -> Sequence[int]:
    """All runs side by side; returns those that left the batch and have to be done alone."""
    wanted = _rows_of(job, flown)
    measured = np.empty((wanted[-1] + 1, 3, len(job.seeds)))  # the runs of a tick side by side
    for run, seed in enumerate(job.seeds):
        measured[:, :, run] = flown.measured(seed)[: len(measured)]
    batch: Batch = _BATCHES[job.config.filter.method](job.config, len(job.seeds))
    for index, fields in enumerate(measured):
        batch.handle(flown.tick(index, fields[:, 0]), fields.T)
        for column in np.flatnonzero(wanted == index).tolist():
            result.x[:, column], result.covariance[:, column] = batch.x, batch.covariance
            result.started[:, column] = batch.running
    return np.flatnonzero(batch.left).tolist()


def _run_alone(job: Job, flown: Flown, result: Ensemble, row: int) -> None:
    estimator = find_method(job.config.filter.method).build(job.config)
    wanted = _rows_of(job, flown)
    measured = flown.measured(job.seeds[row])
    for index, tick in enumerate(flown.ticks(measured[: wanted[-1] + 1])):
        estimator.handle(tick)
        for column in np.flatnonzero(wanted == index).tolist() if index in wanted else ():
            estimate = estimator.estimate()
            result.x[row, column], result.covariance[row, column] = estimate.x, estimate.covariance
            result.started[row, column] = estimate.phase is Phase.RUNNING
    result.restarts[row] = estimator.estimate().restarts


def _rows_of(job: Job, flown: Flown) -> NDArray[np.intp]:
    """Index of the last sample not later than each time asked for (k,)."""
    return np.maximum(np.searchsorted(flown.times_s, job.at_s, side="right") - 1, 0)


def statistics(ensemble: Ensemble, column: int = -1) -> Statistics:
    """What the runs say at one of the times; nan where fewer than two have started."""
    good = ensemble.started[:, column]
    count = int(good.sum())
    if count < 2:
        nothing = np.full(STATE_SIZE, np.nan)
        return Statistics(len(good), count, nothing, nothing, nothing, nothing, float("nan"))
    x, covariance = ensemble.x[good, column], ensemble.covariance[good, column]
    error = x - ensemble.truth[column]
    spread = x.std(axis=0, ddof=1)
    return Statistics(
        runs=len(good),
        started=count,
        mean=x.mean(axis=0),
        spread=spread,
        formal=np.sqrt(np.diagonal(covariance, axis1=1, axis2=2).mean(axis=0)),
        mean_error_sigmas=error.mean(axis=0) / np.where(spread > 0.0, spread, np.nan),
        nees=float(nees(error, covariance).mean()),
    )


def nees(error: Array, covariance: Array) -> Array:
    """Normalised estimation error squared e' P^-1 e (runs,) of errors (runs, 9) and covariances (runs, 9, 9)."""
    scale = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))  # nT and 1 side by side: solve in units of sigma
    correlation = covariance / (scale[:, :, None] * scale[:, None, :])
    scaled = error / scale
    value: Array = (scaled * np.linalg.solve(correlation, scaled[:, :, None])[:, :, 0]).sum(axis=1)
    return value
