"""How seldom the watch over the model is wrong, and how soon it is right; and what it costs.

    python -m tests.benchmarks.bench_watch false-alarms --windows 1000
    python -m tests.benchmarks.bench_watch delays
    python -m tests.benchmarks.bench_watch cost

The first plays windows of right models with new noise (spins, noises and attitudes drawn; every driver of the catalogue
on board) and compares the tail of every test's significance with the e^-s that its threshold is computed from.
"""

from __future__ import annotations

import argparse
import math
import time
from collections import defaultdict
from dataclasses import replace

import numpy as np

from magcal_service.estimators.interface import Phase, StateEstimate
from magcal_service.model_watch import ALARM_NATS, BLOCK, TICKS, ModelWatch
from magcal_service.pipeline import Pipeline
from magcal_service.watch_evidence import FALSE_PER_YEAR
from tests.watch.watch_runs import Clean, craft, flight, fly, stream

SPINS_RPM = (0.5, 2.0, 7.5, 15.0)
NOISES_NT = (20.0, 100.0, 300.0)
PER_FLIGHT = 25
LEVELS = (2.0, 4.0, 6.0, 8.0, 10.0)


def settled(x: np.ndarray, noise_nt: float, rng: np.random.Generator) -> StateEstimate:
    """An estimate as a filter has it once it is trusted: tens of nanotesla and some 1e-4 off."""
    sigma = np.array([20.0] * 3 + [3e-4] * 6)
    return StateEstimate(
        x + sigma * rng.standard_normal(9), np.diag(sigma**2), Phase.RUNNING, noise_nt, 1000, 0, 0, None, False
    )


def false_alarms(windows: int, seed: int) -> None:
    """Print the tail of the significance on right models beside the one that the threshold assumes."""
    tested: dict[str, list[float]] = defaultdict(list)
    worst, looks, told = [], 0, 0
    root = np.random.SeedSequence(seed)
    for number, child in enumerate(root.spawn(math.ceil(windows / PER_FLIGHT))):
        rng = np.random.default_rng(child)
        noise_nt = NOISES_NT[number % len(NOISES_NT)]
        scenario = flight(rate_rpm=SPINS_RPM[number % len(SPINS_RPM)], noise_nt=noise_nt)
        direction = rng.standard_normal(3)
        x, y, z = (direction / np.linalg.norm(direction)).tolist()
        scenario = replace(scenario, spin=replace(scenario.spin, direction_eci=(x, y, z)))
        clean = Clean.of(scenario, number, TICKS)
        for _ in range(min(PER_FLIGHT, windows - number * PER_FLIGHT)):
            watch, most = ModelWatch(5.0), 0.0
            estimate = settled(clean.x, noise_nt, rng)
            for count, tick in enumerate(clean.ticks(clean.noise(rng), watch.drivers), 1):
                if count == TICKS:
                    break
                if watch.push(tick, estimate, walks=False):
                    told += 1
                if count % BLOCK == 0 and count >= 3 * BLOCK:
                    looks += 1
                    for one in watch.explanations(walks=False):
                        single = one.significance() - math.log(one.tries)
                        tested[f"{one.effects[0]} {one.driver} {one.columns}"].append(single)
                        most = max(most, single)
            worst.append(most)
    tests = sum(map(len, tested.values()))
    print(f"{len(worst)} windows, {looks} looks, {tests} tests; findings: {told}")
    print(
        f"threshold {ALARM_NATS:.1f}; largest significance in a window (corrected for tries within a test): "
        f"median {np.median(worst):.1f}, largest {max(worst):.1f}"
    )
    every = np.concatenate([np.array(values) for values in tested.values()])
    for level in LEVELS:
        print(
            f"share of tests beyond {level:.0f}: {np.mean(every > level):.2e}, e^-{level:.0f} = {math.exp(-level):.2e}"
        )
    for name, values in sorted(tested.items(), key=lambda item: -float(np.mean(np.array(item[1]) > 4.0)))[:8]:
        print(f"  {name}: beyond 4: {np.mean(np.array(values) > 4.0):.2e}, largest {max(values):.1f}")
    print(f"expected a year by the threshold: at most {FALSE_PER_YEAR:g}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--windows", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    o = parser.parse_args()
    false_alarms(o.windows, o.seed)
