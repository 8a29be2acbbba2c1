"""Time of one tick of the filter beside other filters on the same data, tick by tick in turn, in one run.

    python -m tests.benchmarks.bench_filter [--json docs/results/filter.json]

All take the paper's craft after it has converged: nine states, equation (3), and where said the two pseudo-measurements
(6).  filterpy takes all three at each tick; this project's filter takes (6) at the end of each spin window, so its mean
is given beside its median.  ``numpy`` is the unscented transform of Wan and van der Merwe (2000) written plainly in
numpy, equation (3) alone.  Ratios are theirs over ours: above 1 this project's tick is the faster one.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from magcal_service.config.settings import CraftConfig, SensorConfig, SpinConfig
from magcal_service.estimators.ukf import Ukf
from magcal_service.model import calibrate
from magcal_service.ticks.assembler import Tick
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.benchmarks.results import write

NOISE_NT: Final = 300.0
WINDOW: Final = 8  # samples of one turn at 7.5 rpm
SETTLED: Final = 3000  # ticks after which the filter has converged

Step = Callable[[int], None]


class Flight:
    """The paper's craft as arrays: measured field (n, 3), reference magnitude (n,) [nT], and ticks."""

    def __init__(self, count: int) -> None:
        block = Simulation(load_scenario("paper"), seed=1, duration_s=float(SETTLED + count)).arrays()
        self.measured, self.magnitude = block.measured_nt, np.linalg.norm(block.true_eci_nt, axis=1)
        rows = zip(self.measured, self.magnitude, block.true_eci_nt, strict=True)
        self.ticks = [Tick(i, np.array([float(i)]), b[None], h[None], v[None]) for i, (b, h, v) in enumerate(rows)]

    def noise(self, i: int) -> float:
        """Variance of |w|^2 - |H|^2 [nT^4]."""
        return float(4.0 * self.magnitude[i] ** 2 * NOISE_NT**2)


def main() -> None:
    """Print the medians, the means and their ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ticks", type=int, default=4000, help="ticks that are timed (default 4000)")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    flight = Flight(options.ticks)
    ours = Ukf(CraftConfig("bench", sensor=SensorConfig(noise_nt=NOISE_NT), spin=SpinConfig()))
    for tick in flight.ticks[:SETTLED]:
        ours.handle(tick)
    x, covariance = ours.estimate().x.copy(), ours.estimate().covariance.copy()
    steps: dict[str, Step] = {
        "magcal": lambda i: ours.handle(flight.ticks[i]) and None,
        "filterpy": filterpy_step(flight, x, covariance, spin=True),
        "filterpy_scalar": filterpy_step(flight, x, covariance, spin=False),
        "numpy_scalar": numpy_step(flight, x, covariance),
    }
    times = np.array([[timed(step, SETTLED + k) for step in steps.values()] for k in range(options.ticks)])
    figures = {}
    for kind, figure in (("median", np.median), ("mean", np.mean)):
        micros = dict(zip(steps, (1e6 * figure(times, axis=0)).tolist(), strict=True))
        figures |= {f"{kind}_us_{name}": value for name, value in micros.items()}
        for name, value in micros.items():
            print(f"{kind}: {name} {value:.0f} us a tick, {value / micros['magcal']:.2f} times magcal's")
    write(options.json, figures)


def timed(step: Step, i: int) -> float:
    """Wall time of one step [s]."""
    begin = time.perf_counter()
    step(i)
    return time.perf_counter() - begin


def filterpy_step(flight: Flight, x: np.ndarray, covariance: np.ndarray, *, spin: bool) -> Step:
    """filterpy's filter on equation (3), and with ``spin`` on the means over one turn as well."""
    now: dict[str, np.ndarray] = {}
    size = 3 if spin else 1

    def predicted(state: np.ndarray) -> np.ndarray:
        w = calibrate(state, now["field"])
        return np.array([w @ w, *calibrate(state, now["mean"])[:2]]) if spin else np.array([w @ w])

    points = MerweScaledSigmaPoints(9, 1.0, 2.0, 0.0)
    witness = UnscentedKalmanFilter(9, size, 1.0, predicted, lambda state, dt: state, points)
    witness.x, witness.P, witness.Q = x.copy(), covariance.copy(), np.zeros((9, 9))

    def step(i: int) -> None:
        now["field"] = flight.measured[i]
        if spin:
            now["mean"] = flight.measured[i - WINDOW + 1 : i + 1].mean(axis=0)
        witness.R = np.diag([flight.noise(i), NOISE_NT**2, NOISE_NT**2][:size])
        witness.predict()
        witness.update(np.array([flight.magnitude[i] ** 2 + 3.0 * NOISE_NT**2, 0.0, 0.0][:size]))

    return step


def numpy_step(flight: Flight, x: np.ndarray, covariance: np.ndarray) -> Step:
    """A scaled unscented update of equation (3), 19 points at once; alpha 1, beta 2, kappa 0."""
    state = {"x": x.copy(), "P": covariance.copy()}
    weights = np.full(19, 1.0 / 18.0)
    weights[0] = 0.0
    covariance_weights = weights.copy()
    covariance_weights[0] = 2.0

    def step(i: int) -> None:
        mean, P = state["x"], state["P"]
        root = np.linalg.cholesky(9.0 * P)
        points = np.concatenate([mean[None], mean + root.T, mean - root.T])
        b = flight.measured[i]
        d = points[:, [3, 6, 7, 6, 4, 8, 7, 8, 5]].reshape(-1, 3, 3)
        w = b + d @ b - points[:, :3]
        z = np.einsum("ij,ij->i", w, w)
        expected = weights @ z
        off, from_mean = z - expected, points - mean
        variance = covariance_weights @ off**2 + flight.noise(i)
        gain = from_mean.T @ (covariance_weights * off) / variance
        state["x"] = mean + gain * (flight.magnitude[i] ** 2 + 3.0 * NOISE_NT**2 - expected)
        P = P - variance * np.outer(gain, gain)
        state["P"] = 0.5 * (P + P.T)

    return step


if __name__ == "__main__":
    main()
