"""The peers, and the changes of the errors: the figures of docs/peers.md, each on the same data in one run.

    python -m tests.benchmarks.bench_peers estimators      # ukf, filterpy, batches: accuracy and time, as ratios
    python -m tests.benchmarks.bench_peers step            # a jump of the errors: time to be back within 3 sigma
    python -m tests.benchmarks.bench_peers quiet           # what looking for jumps costs where there is none

Runs are spread over processes; times are the medians of each run's own, and only their ratios are to be compared.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from scipy.optimize import least_squares

from magcal_service.config.settings import FilterConfig
from magcal_service.estimators import find_method
from magcal_service.estimators.interface import InformationSet, Phase
from magcal_service.estimators.parts.magnitude_sums import MagnitudeSums
from magcal_service.estimators.parts.noise_level import NoiseLevel
from magcal_service.estimators.parts.start import prior_sigma
from magcal_service.estimators.two_step import Solution, two_step
from magcal_service.estimators.ukf import Ukf
from magcal_service.many.executor import Executor
from magcal_service.many.pool import Pool
from magcal_service.model import STATE_NAMES, Array, calibrate, field_jacobian, measure
from magcal_service.studies.bounds import bound_sigma
from magcal_service.studies.flights import FlightPlan, Flown, fly

AXES = {"(1, 1, 1)": (1.0, 1.0, 1.0), "near the orbit normal": (0.64, -0.73, 0.25)}
"""The second is 2 degrees from the normal."""

HOLD_S = 300
"""Back within 3 sigma: and for so long after."""


def nees(error: Array, covariance: Array) -> float:
    """Normalised estimation error squared; 9 expected."""
    return float(error @ np.linalg.solve(covariance, error))


# Changes of the errors
STEPS = {"bx": (0, 200.0), "by": (1, 200.0), "bz": (2, 200.0), "D11": (3, 2e-3), "D33": (5, 2e-3), "D12": (6, 2e-3)}

_WALK = (1.0, 1.0, 1.0)
FOLLOWERS: dict[str, FilterConfig] = {
    "ukf": FilterConfig(),
    "ukf, 1 nT/sqrt(s)": FilterConfig(process_noise_bias_nt=_WALK, process_noise_D=(1e-9,) * 6),
    "sliding-batch": FilterConfig(method="sliding-batch"),
    "ukf, adaptive": FilterConfig(adaptive=True),
}


def step_run(seed: np.random.SeedSequence, plan: FlightPlan, settings: FilterConfig, what: str) -> tuple[float, ...]:
    """Seconds until the state is back within 3 sigma, its sigma before, its error, sigma and NEES at the end."""
    flown, (state, size) = fly(plan), STEPS[what]
    at = plan.duration_s // 2
    before, after = np.array(plan.x), np.array(plan.x)
    after[state] += size
    field = flown.field_body_nt + plan.noise_nt * np.random.default_rng(seed).standard_normal(flown.field_body_nt.shape)
    measured = np.concatenate([measure(before, field[:at]), measure(after, field[at:])])
    estimator = find_method(settings.method).build(plan.craft(settings))
    error, sigma = np.empty((2, plan.duration_s))
    for i, tick in enumerate(flown.ticks(measured)):
        estimator.handle(tick)
        estimate = estimator.estimate()
        error[i] = estimate.x[state] - after[state]
        sigma[i] = estimate.covariance[state, state] ** 0.5
    inside = (np.abs(error) <= 3.0 * sigma)[at:].astype(int)
    held = np.flatnonzero(np.convolve(inside, np.ones(HOLD_S), mode="valid") > HOLD_S - 0.5)
    back = float(held[0]) if len(held) else np.inf
    return back, sigma[at - 1], error[-1], sigma[-1], nees(estimate.x - after, estimate.covariance)


def step_figures(pool: Executor, options: argparse.Namespace) -> Iterable[str]:
    seeds = np.random.SeedSequence(options.seed).spawn(options.runs)
    plan = FlightPlan(noise_nt=options.noise, spin_eci=AXES[options.axis])
    yield f"spin axis {options.axis}, noise {options.noise:g} nT, {options.runs} runs of {plan.duration_s} s"
    for what in options.states or STEPS:
        for name, settings in FOLLOWERS.items():
            results = list(pool.map(partial(step_run, plan=plan, settings=settings, what=what), seeds))
            back, before, error, sigma, value = np.array(results).T
            found = np.isfinite(back)
            median = f"{np.median(back):5.0f} s" if found.mean() > 0.5 else "    - "
            slowest = f"{back.max():5.0f} s" if found.all() else "    - "
            yield (
                f"{what:<4}{name:<18} back {median} (slowest {slowest}, {found.sum()} of {len(back)}); sigma before "
                f"{before.mean():.3g}, at the end {sigma.mean():.3g}, rms error {np.sqrt(np.mean(error**2)):.3g}, "
                f"NEES {value.mean():.1f}"
            )


def quiet_run(seed: np.random.SeedSequence, plan: FlightPlan) -> tuple[int, int, float, float, float, float]:
    """False alarms, ticks asked, NEES with and without, the largest ratio of the sigmas, and the ratio of the times."""
    flown = fly(plan)
    filters = [Ukf(plan.craft(FilterConfig(adaptive=adaptive))) for adaptive in (True, False)]
    spent, asked = np.zeros(2), 0
    for tick in flown.ticks(flown.measured(seed)):
        for i, each in enumerate(filters):
            begin = time.perf_counter()
            each.handle(tick)
            spent[i] += time.perf_counter() - begin
        asked += filters[0].estimate().phase is Phase.RUNNING
    on, off = (each.estimate() for each in filters)
    ratio = np.sqrt(np.diagonal(on.covariance) / np.diagonal(off.covariance)).max()
    values = [nees(each.x - np.array(plan.x), each.covariance) for each in (on, off)]
    return filters[0].changes, asked, values[0], values[1], float(ratio), float(spent[0] / spent[1])


def quiet_figures(pool: Executor, options: argparse.Namespace) -> Iterable[str]:
    seeds = np.random.SeedSequence(options.seed).spawn(options.runs)
    plan = FlightPlan(noise_nt=options.noise, spin_eci=AXES[options.axis])
    alarms, asked, on, off, ratio, spent = np.array(list(pool.map(partial(quiet_run, plan=plan), seeds))).T
    yield (
        f"spin axis {options.axis}, noise {options.noise:g} nT, {options.runs} runs: {alarms.sum():.0f} false alarms "
        f"in {asked.sum():.0f} ticks; NEES {on.mean():.2f} (without {off.mean():.2f}); sigma at most {ratio.max():.4f} "
        f"times that without; time {np.median(spent):.2f} times"
    )


# The same data, four estimators
WINDOW = 8


@dataclass(frozen=True)
class Answer:
    """Error (9,), covariance (9, 9) and the time it took [s]."""

    error: Array
    covariance: Array
    seconds: float


def with_ukf(plan: FlightPlan, flown: Flown, measured: Array) -> Answer:
    ticks, estimator = list(flown.ticks(measured)), Ukf(plan.craft(FilterConfig()))
    begin = time.perf_counter()
    for tick in ticks:
        estimator.handle(tick)
    seconds = time.perf_counter() - begin
    return Answer(estimator.estimate().x - np.array(plan.x), estimator.estimate().covariance, seconds)


def with_filterpy(plan: FlightPlan, flown: Flown, measured: Array) -> Answer:
    """Equations (3) and (6) at each tick, as in the paper, from the start that ``ukf`` makes for itself."""
    own, settled = Ukf(plan.craft(FilterConfig())), 0
    while own.estimate().phase is not Phase.RUNNING:
        own.handle(flown.tick(settled, measured[settled]))
        settled += 1
    now: dict[str, Array] = {}

    def predicted(x: Array) -> Array:
        w, mean = calibrate(x, now["field"]), calibrate(x, now["mean"])
        return np.array([w @ w, mean[0], mean[1]])

    witness = UnscentedKalmanFilter(9, 3, 1.0, predicted, lambda x, dt: x, MerweScaledSigmaPoints(9, 1.0, 2.0, 0.0))
    start, variance = own.estimate(), plan.noise_nt**2
    witness.x, witness.P, witness.Q = start.x.copy(), start.covariance.copy(), np.zeros((9, 9))
    begin = time.perf_counter()
    for i in range(settled, len(measured)):
        magnitude = flown.magnitude_nt[i]
        now["field"], now["mean"] = measured[i], measured[i - WINDOW + 1 : i + 1].mean(axis=0)
        witness.R = np.diag([4.0 * magnitude**2 * variance, variance, variance])
        witness.predict()
        witness.update(np.array([magnitude**2 + 3.0 * variance, 0.0, 0.0]))
    seconds = (time.perf_counter() - begin) * len(measured) / (len(measured) - settled)
    return Answer(witness.x - np.array(plan.x), witness.P, seconds)


def with_maximum_likelihood(plan: FlightPlan, flown: Flown, measured: Array) -> Answer:
    """Least squares of e = |w| - |H| less its mean s^2 / |H|, within bounds, from zero; units 30 uT and 1."""
    units = np.array([30_000.0] * 3 + [1.0] * 6)
    mean = plan.noise_nt**2 / flown.magnitude_nt

    def residual(y: Array) -> Array:
        w = calibrate(y * units, measured)
        rest: Array = (np.linalg.norm(w, axis=1) - flown.magnitude_nt - mean) / plan.noise_nt
        return rest

    def jacobian(y: Array) -> Array:
        w = calibrate(y * units, measured)
        unit = w / np.linalg.norm(w, axis=1)[:, None]
        rows: Array = np.einsum("ni,nij->nj", unit, field_jacobian(measured)) * units / plan.noise_nt
        return rows

    limits = np.array([1.0] * 3 + [0.5] * 6)
    begin = time.perf_counter()
    result = least_squares(residual, np.zeros(9), jacobian, bounds=(-limits, limits), x_scale="jac")
    covariance = np.linalg.inv(result.jac.T @ result.jac) * np.outer(units, units)
    return Answer(result.x * units - np.array(plan.x), covariance, time.perf_counter() - begin)


def with_two_step(plan: FlightPlan, flown: Flown, measured: Array) -> Answer:
    begin, sums = time.perf_counter(), MagnitudeSums()
    sums.add(measured, flown.magnitude_nt)
    solution = two_step(sums, NoiseLevel(plan.noise_nt), prior_sigma(FilterConfig()))
    if not isinstance(solution, Solution):
        raise ValueError(f"TWO-STEP found no solution: {solution}")
    return Answer(solution.x - np.array(plan.x), solution.covariance, time.perf_counter() - begin)


ESTIMATORS = {
    "magcal ukf": with_ukf,
    "filterpy UKF, same model": with_filterpy,
    "batch maximum likelihood (scipy)": with_maximum_likelihood,
    "magcal TWO-STEP": with_two_step,
}


def estimator_run(seed: np.random.SeedSequence, plan: FlightPlan) -> list[Answer]:
    """All estimators on one run's samples, one after the other."""
    flown = fly(plan)
    measured = flown.measured(seed)
    return [answer(plan, flown, measured) for answer in ESTIMATORS.values()]


def estimator_figures(pool: Executor, options: argparse.Namespace) -> Iterable[str]:
    plan = FlightPlan(noise_nt=options.noise, spin_eci=AXES[options.axis])
    bound = bound_sigma(fly(plan).for_bounds(), InformationSet.SCALAR_SPIN)
    runs = list(pool.map(partial(estimator_run, plan=plan), np.random.SeedSequence(options.seed).spawn(options.runs)))
    own = np.median([answers[0].seconds for answers in runs])
    yield f"spin axis {options.axis}, noise {options.noise:g} nT, {options.runs} runs; bound: scalar and spin windows"
    for i, name in enumerate(ESTIMATORS):
        answers = [run[i] for run in runs]
        ratio = np.sqrt(np.mean([answer.error**2 for answer in answers], axis=0)) / bound
        value = np.mean([nees(answer.error, answer.covariance) for answer in answers])
        seconds = float(np.median([answer.seconds for answer in answers]))
        states = ", ".join(f"{state} {each:.2f}" for state, each in zip(STATE_NAMES, ratio, strict=True))
        yield (
            f"{name}: rms over bound {np.sqrt(np.mean(ratio**2)):.2f} ({states}); NEES {value:.1f}; "
            f"{seconds:.3f} s for {plan.duration_s} samples, {seconds / own:.3f} times magcal ukf"
        )


FIGURES: dict[str, Callable[[Executor, argparse.Namespace], Iterable[str]]] = {
    "estimators": estimator_figures,
    "step": step_figures,
    "quiet": quiet_figures,
}


def main() -> None:
    """Print the figures that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=FIGURES)
    parser.add_argument("--runs", type=int, default=6)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--noise", type=float, default=300.0, help="[nT]")
    parser.add_argument("--axis", choices=AXES, default="(1, 1, 1)", help="of the spin, ECI")
    parser.add_argument("--states", nargs="*", choices=STEPS, help="step: which states jump (default: all)")
    options = parser.parse_args()
    os.nice(5)
    for line in FIGURES[options.name](Executor(Pool()), options):
        print(line, flush=True)


if __name__ == "__main__":
    main()
