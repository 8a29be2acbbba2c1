"""Time of one tick of the filter beside filterpy's UKF on the same model, in one run.

    python -m tests.benchmarks.bench_filter

Both take the paper's craft after it has converged, tick by tick in turn: nine states, equation (3) and the two
pseudo-measurements (6).  filterpy takes all three at each tick; this project's filter takes (6) at the end of each spin
window, so its mean is given beside its median.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from magcal_service.config.settings import CraftConfig, SensorConfig, SpinConfig
from magcal_service.estimators.ukf import Ukf
from magcal_service.model import calibrate
from magcal_service.ticks.assembler import Tick
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation

NOISE_NT = 300.0
WINDOW = 8


def main() -> None:
    """Print the medians, the means and their ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ticks", type=int, default=4000, help="ticks that are timed (default 4000)")
    count = parser.parse_args().ticks
    settled = 3000
    block = Simulation(load_scenario("paper"), seed=1, duration_s=float(settled + count)).arrays()
    measured, magnitude = block.measured_nt, np.linalg.norm(block.true_eci_nt, axis=1)
    ticks = [
        Tick(i, np.array([float(i)]), measured[i : i + 1], magnitude[i : i + 1], block.true_eci_nt[i : i + 1])
        for i in range(len(measured))
    ]
    ours = Ukf(CraftConfig("bench", sensor=SensorConfig(noise_nt=NOISE_NT), spin=SpinConfig()))
    for tick in ticks[:settled]:
        ours.handle(tick)

    now: dict[str, np.ndarray] = {}

    def predicted(x: np.ndarray) -> np.ndarray:
        w, mean = calibrate(x, now["field"]), calibrate(x, now["mean"])
        return np.array([w @ w, mean[0], mean[1]])

    start = ours.estimate()
    witness = UnscentedKalmanFilter(9, 3, 1.0, predicted, lambda x, dt: x, MerweScaledSigmaPoints(9, 1.0, 2.0, 0.0))
    witness.x, witness.P, witness.Q = start.x.copy(), start.covariance.copy(), np.zeros((9, 9))
    times = np.empty((2, count))
    for k, tick in enumerate(ticks[settled:]):
        i = settled + k
        now["field"], now["mean"] = measured[i], measured[i - WINDOW + 1 : i + 1].mean(axis=0)
        witness.R = np.diag([4.0 * magnitude[i] ** 2 * NOISE_NT**2, NOISE_NT**2, NOISE_NT**2])
        begin = time.perf_counter()
        witness.predict()
        witness.update(np.array([magnitude[i] ** 2 + 3.0 * NOISE_NT**2, 0.0, 0.0]))
        between = time.perf_counter()
        ours.handle(tick)
        times[:, k] = between - begin, time.perf_counter() - between
    for name, figure in (("median", np.median), ("mean", np.mean)):
        theirs, own = (1e6 * float(figure(row)) for row in times)
        print(f"{name}: filterpy {theirs:.0f} us, magcal {own:.0f} us a tick, ratio {theirs / own:.1f}")


if __name__ == "__main__":
    main()
