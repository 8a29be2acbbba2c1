"""Does the covariance stay symmetric and positive definite?  Ten million ticks of the filter, four months at 1 Hz.

    python -m tests.benchmarks.bench_covariance [--ticks N] [--walk NT]

The paper's five hours over and over, with fresh noise.  Without process noise, the harder case, the covariance shrinks
for ever; ``--walk`` gives it some.  Every hundredth covariance is looked at: the largest difference from its
transpose, and the smallest eigenvalue in units that give it a diagonal of ones.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator

import numpy as np

from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig, SpinConfig
from magcal_service.estimators.ukf import Ukf
from magcal_service.model import measure
from magcal_service.ticks.assembler import Tick
from magcal_service.wire.messages import ReferenceSample
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation

NOISE_NT = 300.0
PAPER_X = np.array([5000.0, 3000.0, 4000.0, 0.05, 0.10, 0.05, 0.05, 0.05, 0.05])
SECONDS = 18_000
EVERY = 100
REPORT_EVERY = 500_000


def ticks(count: int, seed: int) -> Iterator[Tick]:
    """One-sample ticks of the paper's flight, again and again with fresh noise, a gap between the rounds."""
    flight = Simulation(load_scenario("paper"), seed, float(min(SECONDS, count)))
    ambient = flight.arrays().ambient_body_nt
    reference = np.array([m.field_nt for m in flight.messages() if isinstance(m, ReferenceSample)])[: len(ambient)]
    magnitude = np.linalg.norm(reference, axis=1)
    rng = np.random.default_rng(seed)
    field = ambient
    for i in range(count):
        k = i % len(ambient)
        if k == 0:
            field = measure(PAPER_X, ambient + rng.normal(0.0, NOISE_NT, ambient.shape))
        yield Tick(
            index=i,
            times_s=np.array([float(i)]),
            field_body_nt=field[k : k + 1],
            reference_magnitude_nt=magnitude[k : k + 1],
            reference_eci_nt=reference[k : k + 1],
            after_gap=k == 0,
        )


def check(covariance: np.ndarray) -> tuple[float, float]:
    """Largest relative difference from the transpose, and smallest eigenvalue of the correlation."""
    sigma = np.sqrt(np.diagonal(covariance))
    correlation = covariance / np.outer(sigma, sigma)
    return float(np.abs(correlation - correlation.T).max()), float(np.linalg.eigvalsh(correlation)[0])


def run(count: int, walk_nt: float, seed: int = 1) -> Iterator[dict[str, float]]:
    """The worst of everything that was looked at so far, every ``REPORT_EVERY`` ticks and at the end."""
    settings = FilterConfig(process_noise_bias_nt=(walk_nt,) * 3)
    estimator = Ukf(CraftConfig("paper", SensorConfig(noise_nt=NOISE_NT), SpinConfig(rate_rpm=7.5), settings))
    asymmetry, smallest, begun_s = 0.0, 1.0, time.process_time()
    for tick in ticks(count, seed):
        estimator.handle(tick)
        if tick.index % EVERY == 0:
            difference, eigenvalue = check(estimator.estimate().covariance)
            asymmetry, smallest = max(asymmetry, difference), min(smallest, eigenvalue)
        done = tick.index + 1
        if done % REPORT_EVERY == 0 or done == count:
            state = estimator.estimate()
            sigma = np.sqrt(np.diagonal(state.covariance))
            yield {
                "ticks": done,
                "asymmetry": asymmetry,
                "smallest_eigenvalue": smallest,
                "restarts": state.restarts,
                "sigma_bx_nt": float(sigma[0]),
                "worst_error_in_sigma": float((np.abs(state.x - PAPER_X) / sigma).max()),
                "us_per_tick": 1e6 * (time.process_time() - begun_s) / done,
            }


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ticks", type=int, default=10_000_000)
    parser.add_argument("--walk", type=float, default=0.0, help="process noise of the bias [nT/sqrt(s)]")
    options = parser.parse_args()
    for figures in run(options.ticks, options.walk):
        print("  ".join(f"{name} {value:.6g}" for name, value in figures.items()), flush=True)


if __name__ == "__main__":
    main()
