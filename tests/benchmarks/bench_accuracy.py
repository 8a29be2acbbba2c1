"""The paper's scenario over many seeds: mean error, scatter, the filter's own sigma, and NEES.

    python -m tests.benchmarks.bench_accuracy            # Table 1 errors
    python -m tests.benchmarks.bench_accuracy --random   # |b| up to 30 uT, |D| up to 0.2, from a zero guess

Samples come from the simulator, so the orbit, the field and the errors share no code with the filter.  Runs are spread
over processes; the figures do not depend on how many.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from magcal_service.config.settings import CraftConfig, SensorConfig, SpinConfig
from magcal_service.estimators.interface import Phase
from magcal_service.estimators.ukf import Ukf
from magcal_service.many.executor import Executor
from magcal_service.many.pool import Pool
from magcal_service.model import STATE_NAMES
from magcal_service.ticks.assembler import Tick
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.benchmarks.results import write

NOISE_NT = 300.0


@dataclass(frozen=True)
class Run:
    """One seed's final error (9,), the filter's sigma (9,), NEES, and whether the filter had started."""

    seed: int
    error: list[float]
    sigma: list[float]
    nees: float
    running: bool


def one(seed: int, scenario: str, seconds: float | None) -> Run:
    """Play one seed through the filter."""
    block = Simulation(load_scenario(scenario), seed=seed, duration_s=seconds).arrays()
    magnitude = np.linalg.norm(block.true_eci_nt, axis=1)
    config = CraftConfig("bench", sensor=SensorConfig(noise_nt=NOISE_NT), spin=SpinConfig(rate_rpm=7.5))
    estimator = Ukf(config)
    for i in range(len(magnitude)):
        rows = slice(i, i + 1)
        estimator.handle(
            Tick(i, np.array([float(i)]), block.measured_nt[rows], magnitude[rows], block.true_eci_nt[rows])
        )
    estimate = estimator.estimate()
    error = estimate.x - np.concatenate([block.bias_nt[-1], block.D[-1]])
    return Run(
        seed=seed,
        error=error.tolist(),
        sigma=np.sqrt(np.diagonal(estimate.covariance)).tolist(),
        nees=float(error @ np.linalg.solve(estimate.covariance, error)),
        running=estimate.phase is Phase.RUNNING,
    )


def main() -> None:
    """Run the seeds and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=None, help="default: the scenario's 18000")
    parser.add_argument("--random", action="store_true", help="random errors instead of the paper's Table 1")
    parser.add_argument("--json", type=Path, default=None)
    options = parser.parse_args()
    work = partial(one, scenario="random-errors" if options.random else "paper", seconds=options.seconds)
    seeds = range(options.first_seed, options.first_seed + options.runs)
    write(options.json, report(list(Executor(Pool()).map(work, seeds, "seeds"))))


def report(runs: list[Run]) -> dict[str, float]:
    """Print what the runs say together; the same as figures."""
    errors, sigmas = np.array([run.error for run in runs]), np.array([run.sigma for run in runs])
    nees = np.array([run.nees for run in runs])
    print(f"{'':>4} {'mean error':>11} {'in sigma':>9} {'3 sigma seen':>13} {'3 sigma own':>12}")
    for i, name in enumerate(STATE_NAMES):
        error, own = errors[:, i], sigmas[:, i].mean()
        print(f"{name:>4} {error.mean():11.3g} {error.mean() / own:9.2f} {3 * error.std():13.4g} {3 * own:12.4g}")
    inside = np.abs(errors / sigmas).max(axis=1)
    print(f"runs {len(runs)}; started {sum(run.running for run in runs)}; largest error {inside.max():.1f} sigma")
    print(f"NEES: mean {nees.mean():.2f} (9 expected), largest {nees.max():.1f}")
    print(f"converged (every error inside 5 sigma): {int((inside < 5.0).sum())} of {len(runs)}")
    return {
        "runs": len(runs),
        "converged": int((inside < 5.0).sum()),
        "worst_mean_error_sigma": float(np.abs(errors.mean(axis=0) / sigmas.mean(axis=0)).max()),
        "nees_mean": float(nees.mean()),
        "nees_10_percent": float(np.percentile(nees, 10)),
        "nees_90_percent": float(np.percentile(nees, 90)),
        "nees_largest": float(nees.max()),
        "largest_error_sigma": float(inside.max()),
    }


if __name__ == "__main__":
    main()
