"""The figures of docs/methods.md: ``python tests/estimators/method_figures.py NAME [--runs N]``, on the paper's orbit.

``two-step`` against its bound; ``ekf``, the share of runs that do not converge; ``fourth``, equation (8) at each noise;
``step``, how long a 200 nT step takes to be followed; ``suchai``, SUCHAI-3's spin by ``spin`` beside its gyro.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig, SpinConfig
from magcal_service.estimators.ekf import Ekf
from magcal_service.estimators.interface import InformationSet
from magcal_service.estimators.parts.magnitude_sums import MagnitudeSums
from magcal_service.estimators.parts.noise_level import NoiseLevel
from magcal_service.estimators.parts.start import prior_sigma
from magcal_service.estimators.scalar_ukf import ScalarUkf
from magcal_service.estimators.sliding_batch import SlidingBatch
from magcal_service.estimators.spin import SpinFilter
from magcal_service.estimators.two_step import Solution, TwoStep, two_step
from magcal_service.estimators.ukf import Ukf
from magcal_service.many.executor import Executor
from magcal_service.many.pool import Pool
from magcal_service.model import STATE_NAMES, d_matrix
from magcal_service.recordings.reader import read_recording
from magcal_service.studies.bounds import bound_sigma
from magcal_service.ticks.assembler import Tick
from tests.estimators.method_data import NEAR_NORMAL, PAPER_NOISE_NT, PAPER_X, nees, paper_field, play

Seeds = list[np.random.SeedSequence]
STEP_AT_S = 6000.0
SUCHAI = Path(__file__).resolve().parents[3] / "shared" / "data" / "suchai3" / "2023-08-24.toml"
GYRO_S = 300.0


def each(pool: Executor, work: Callable[[np.random.SeedSequence], Any], seeds: Seeds) -> list[Any]:
    return list(pool.map(work, seeds))


def batch_run(
    seed: np.random.SeedSequence, direction: tuple[float, float, float], corrected: bool
) -> tuple[np.ndarray, float]:
    """Error (9,) and NEES of one batch."""
    field, sums = paper_field(direction), MagnitudeSums()
    sums.add(field.measured(np.random.default_rng(seed)), np.linalg.norm(field.reference_eci_nt, axis=1))
    solution = two_step(sums, NoiseLevel(PAPER_NOISE_NT), prior_sigma(FilterConfig()), corrected=corrected)
    if not isinstance(solution, Solution):
        raise ValueError(f"no solution: {solution}")
    return solution.x - PAPER_X, nees(solution.x - PAPER_X, solution.covariance)


def two_step_figures(pool: Executor, seeds: Seeds) -> Iterable[str]:
    for direction in ((1.0, 1.0, 1.0), NEAR_NORMAL):
        bound = bound_sigma(paper_field(direction).flight(), InformationSet.SCALAR)
        for corrected in (True, False):
            results = each(pool, partial(batch_run, direction=direction, corrected=corrected), seeds)
            errors = np.array([error for error, _ in results])
            yield f"axis {direction}, {'corrected' if corrected else 'as published'}: NEES {mean(results):.2f}"
            rows = zip(STATE_NAMES, 3 * bound, errors.std(axis=0) / bound, errors.mean(axis=0) / bound, strict=True)
            yield from (f"  {n:<4} bound {b:9.3g}  scatter/bound {s:.3f}  mean/sigma {m:+.2f}" for n, b, s, m in rows)


def mean(results: list[Any]) -> float:
    return float(np.mean([value for _, value in results]))


def cold_run(
    seed: np.random.SeedSequence, method: type[Ekf] | type[ScalarUkf], bias_nt: float, d: float
) -> tuple[bool, bool, float]:
    """Whether the bias ends beyond five sigma and 50 nT, whether I + D collapsed, and the worst error [nT]."""
    rng, field = np.random.default_rng(seed), paper_field().until(5400.0)
    direction = rng.standard_normal(3)
    x = np.concatenate([bias_nt * direction / np.linalg.norm(direction), rng.uniform(-d, d, 6)])
    sensor, prior = SensorConfig(noise_nt=PAPER_NOISE_NT), FilterConfig(prior_bias_nt=bias_nt, prior_D=d)
    estimator = method(CraftConfig("craft", sensor=sensor, filter=prior))
    play(estimator, field.ticks(field.measured(rng, x)))
    state = estimator.estimate()
    error, sigma = np.abs(state.x - x)[:3], np.sqrt(np.diagonal(state.covariance)[:3])
    collapsed = bool(np.linalg.eigvalsh(np.eye(3) + d_matrix(state.x))[0] < 0.4)
    return bool(np.any(error > np.maximum(5.0 * sigma, 50.0))), collapsed, float(error.max())


def ekf_figures(pool: Executor, seeds: Seeds) -> Iterable[str]:
    for bias_nt, d in ((1000.0, 0.01), (5000.0, 0.05), (10_000.0, 0.1), (30_000.0, 0.2)):
        for method in (Ekf, ScalarUkf):
            failed, collapsed, errors = zip(
                *each(pool, partial(cold_run, method=method, bias_nt=bias_nt, d=d), seeds), strict=True
            )
            yield (
                f"|b| {bias_nt:6.0f} nT, D {d:.2f}: {method.name:<10} not converged {np.mean(failed):5.0%}, "
                f"collapsed {np.mean(collapsed):4.0%}, median worst bias error {np.median(errors):8.1f} nT"
            )


def fourth_run(seed: np.random.SeedSequence, noise_nt: float, fourth: bool) -> tuple[float, float, float, int]:
    """Error and sigma of bz [nT], NEES, restarts."""
    field = paper_field().until(5400.0)
    sensor, spin = SensorConfig(noise_nt=noise_nt), SpinConfig(fourth=fourth)
    estimator = Ukf(CraftConfig("craft", sensor=sensor, spin=spin))
    play(estimator, field.ticks(field.measured(np.random.default_rng(seed), noise_nt=noise_nt)))
    state = estimator.estimate()
    error = state.x - PAPER_X
    return float(error[2]), float(state.covariance[2, 2] ** 0.5), nees(error, state.covariance), state.restarts


def fourth_figures(pool: Executor, seeds: Seeds) -> Iterable[str]:
    for noise_nt in (1.0, 10.0, 50.0, 300.0, 1000.0):
        for fourth in (False, True):
            results = each(pool, partial(fourth_run, noise_nt=noise_nt, fourth=fourth), seeds)
            error, sigma, value, restarts = (np.array(column) for column in zip(*results, strict=True))
            which = "with" if fourth else "without"
            yield (
                f"{noise_nt:5.0f} nT, {which:<7} (8): bz {np.sqrt(np.mean(error**2)):7.2f} nT rms, "
                f"sigma {np.median(sigma):6.2f} nT, NEES median {np.median(value):6.1f}, restarts {restarts.sum()}"
            )


def step_run(seed: np.random.SeedSequence, name: str) -> tuple[float, float, float]:
    """Time [s] from a step of 200 nT in bx until it is within 3 sigma (and 60 nT) for good; sigma before; end error."""
    walk = FilterConfig(process_noise_bias_nt=(1.0, 1.0, 1.0))
    plain = CraftConfig("craft", sensor=SensorConfig(noise_nt=PAPER_NOISE_NT), spin=SpinConfig())
    walking = CraftConfig("craft", sensor=plain.sensor, spin=plain.spin, filter=walk)
    estimator = {
        "sliding-batch": lambda: SlidingBatch(plain),
        "sliding-batch, no re-weighting": lambda: SlidingBatch(plain, decay_s=np.inf),
        "two-step": lambda: TwoStep(plain),
        "ukf": lambda: Ukf(plain),
        "ukf, 1 nT/sqrt(s)": lambda: Ukf(walking),
    }[name]()
    field = paper_field()
    measured = field.measured(np.random.default_rng(seed))
    late = field.times_s >= STEP_AT_S
    measured[late] += np.linalg.solve(np.eye(3) + d_matrix(PAPER_X), [200.0, 0.0, 0.0])
    back_s, before = np.inf, 0.0
    for tick in field.ticks(measured, per_tick=5):
        estimator.handle(tick)
        state, now_s = estimator.estimate(), float(tick.times_s[-1])
        sigma = float(state.covariance[0, 0] ** 0.5)
        if now_s < STEP_AT_S:
            before = sigma
            continue
        error = abs(float(state.x[0]) - PAPER_X[0] - 200.0)
        if error > max(3.0 * sigma, 60.0):
            back_s = np.inf
        elif np.isinf(back_s):
            back_s = now_s - STEP_AT_S
    return back_s, before, error


def step_figures(pool: Executor, seeds: Seeds) -> Iterable[str]:
    for name in ("two-step", "ukf", "ukf, 1 nT/sqrt(s)", "sliding-batch, no re-weighting", "sliding-batch"):
        back, before, error = (
            np.array(column) for column in zip(*each(pool, partial(step_run, name=name), seeds), strict=True)
        )
        yield (
            f"{name:<31} back after {np.median(back):6.0f} s (median), "
            f"3 sigma of bx before {3 * np.median(before):5.1f} nT, "
            f"error at the end {np.sqrt(np.mean(error**2)):6.1f} nT rms"
        )


def suchai_figures(pool: Executor, seeds: Seeds) -> Iterable[str]:
    """Every attempt of ``spin`` at SUCHAI-3's spin, without its gyro and with nothing configured, beside the gyro."""
    recording = read_recording(SUCHAI).sorted_unique()
    times_s = (recording.time_ns - recording.time_ns[0]) * 1e-9
    reference, gyro = recording.reference.vector_nt, np.radians(recording.channels["gyro"].values)
    if reference is None:
        raise ValueError("the recording has no reference vector")
    estimator, seen, before_s = SpinFilter(CraftConfig("suchai3")), np.zeros(3), 0.0
    rates, angles = [], []
    for i, now_s in enumerate(times_s.tolist()):
        rows = slice(i, i + 1)
        magnitude = recording.reference.magnitude_nt[rows]
        gap = now_s - before_s > 5.0
        estimator.handle(Tick(i, times_s[rows], recording.field_body_nt[rows], magnitude, reference[rows], gap))
        before_s, spin = now_s, estimator.spin
        if spin is None or estimator.fallback is None or (spin.axis_body == seen).all():
            continue
        seen = spin.axis_body
        measured = np.nanmean(gyro[(times_s > now_s - GYRO_S) & (times_s <= now_s)], axis=0)
        speed = float(np.linalg.norm(measured))
        rates.append(spin.rate_rad_s / speed - 1.0)
        angles.append(math.degrees(math.acos(min(1.0, float(measured @ seen) / speed))))
        yield (
            f"{now_s:5.0f} s: {math.degrees(spin.rate_rad_s):.2f} deg/s about {np.round(seen, 2)}, gyro "
            f"{math.degrees(speed):.2f} about {np.round(measured / speed, 2)}: {angles[-1]:.1f} deg apart"
        )
    yield (
        f"{len(rates)} attempts: rate within {100 * max(map(abs, rates)):.2f} % of the gyro's, "
        f"axis {min(angles):.1f} to {max(angles):.1f} deg off, median {np.median(angles):.1f}"
    )


FIGURES = {
    "two-step": two_step_figures,
    "ekf": ekf_figures,
    "fourth": fourth_figures,
    "step": step_figures,
    "suchai": suchai_figures,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("name", choices=FIGURES)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    seeds = np.random.SeedSequence(options.seed).spawn(options.runs)
    os.nice(10)
    for line in FIGURES[options.name](Executor(Pool()), seeds):
        print(line, flush=True)


if __name__ == "__main__":
    main()
