"""How seldom the watch over the model is wrong, how soon it is right, and what it costs.

    python -m tests.benchmarks.bench_watch false-alarms --windows 1000
    python -m tests.benchmarks.bench_watch delays
    python -m tests.benchmarks.bench_watch cost

The first plays windows of right models with new noise (four spins, three noises, a drawn direction of the spin; every
driver of the catalogue on board) and puts the tail of all tests beside the e^-s that the threshold is computed from.
The second flies an orbit and a half with each effect through the whole pipeline.  The third times the watch's part of a
tick and the filter's, tick by tick in turn.
"""

from __future__ import annotations

import argparse
import math
import time
from collections import defaultdict

import numpy as np

from magcal_service.daemon.pipeline import Pipeline
from magcal_service.estimators.interface import Phase, StateEstimate
from magcal_service.estimators.ukf import Ukf
from magcal_service.watch.evidence import FALSE_PER_YEAR
from magcal_service.watch.residual_watch import ALARM_NATS, BLOCK, FIRST_EVALUATION, TICKS, ModelWatch
from tests.watch.watch_runs import Clean, Known, craft, flight, fly, stream

SPINS_RPM = (0.5, 2.0, 7.5, 15.0)
NOISES_NT = (20.0, 100.0, 300.0)
PER_FLIGHT = 25
LEVELS = (2.0, 4.0, 6.0, 8.0, 10.0)
FLIGHT_S = 9000.0
PANELS_TOWARDS = (1.0, -1.0, 1.0)
STRENGTHS = {
    "thermal_bias": [(f"{k:g} nT/K", flight(thermal_nt_per_k=k)) for k in (1.0, 2.0, 4.0, 8.0)],
    "thermal_scale": [(f"{k:g} /K", flight(scale_per_k=k)) for k in (5e-5, 1e-4, 2e-4, 4e-4)],
    "current_loop": [(f"{k:g} nT/A", flight(panel_nt_per_a=k, towards=PANELS_TOWARDS)) for k in (100.0, 200.0, 400.0)],
    "torquer": [(f"{k:g} nT", flight(torquer_nt=k)) for k in (50.0, 100.0, 200.0)],
    "bias_step": [(f"{k:g} nT", flight(step_nt=k)) for k in (50.0, 100.0, 200.0, 400.0)],
    "saturation": [(f"at {k:g} nT", flight(full_scale_nt=k)) for k in (44_000.0, 42_000.0, 38_000.0)],
}


def settled(x: np.ndarray, noise_nt: float, rng: np.random.Generator) -> StateEstimate:
    """An estimate as a filter has it once it is trusted: tens of nanotesla and some 1e-4 off."""
    sigma = np.array([20.0] * 3 + [3e-4] * 6)
    x = x + sigma * rng.standard_normal(9)
    return StateEstimate(x, np.diag(sigma**2), Phase.RUNNING, noise_nt, 1000, 0, 0, None, False)


def drawn(number: int, rng: np.random.Generator) -> Clean:
    """A flight in which nothing is left out."""
    direction = rng.standard_normal(3)
    x, y, z = (direction / np.linalg.norm(direction)).tolist()
    rate_rpm, noise_nt = SPINS_RPM[number % len(SPINS_RPM)], NOISES_NT[number % len(NOISES_NT)]
    return Clean.of(flight(rate_rpm=rate_rpm, noise_nt=noise_nt, towards=(x, y, z)), number, TICKS)


def false_alarms(windows: int, seed: int) -> None:
    """Print the tail of the significance on right models beside the one that the threshold assumes."""
    tested: dict[str, list[float]] = defaultdict(list)
    worst, told, most_tests = [], 0, 0
    for number, child in enumerate(np.random.SeedSequence(seed).spawn(math.ceil(windows / PER_FLIGHT))):
        rng = np.random.default_rng(child)
        clean = drawn(number, rng)
        estimate = settled(clean.x, clean.scenario.sensor.noise_nt[0], rng)
        known = Known(clean)
        for _ in range(min(PER_FLIGHT, windows - number * PER_FLIGHT)):
            watch, largest = ModelWatch(5.0), 0.0
            watch.drivers = known
            for count, tick in enumerate(clean.ticks(clean.noise(rng), None), 1):
                if count == TICKS:  # the window would end, and with it what can be asked
                    break
                told += watch.push(tick, estimate, walks=False)
                if count % BLOCK or count < FIRST_EVALUATION:
                    continue
                explanations = watch.explanations(walks=False)
                tries = [1 if one.driver.startswith(("channel", "inferred")) else one.tries for one in explanations]
                most_tests = max(most_tests, sum(tries))
                for one, among in zip(explanations, tries, strict=True):
                    single = one.significance() - math.log(among)  # the best of so many tests
                    tested[f"{one.effects[0]} {one.driver} {one.columns}"].append(single)
                    largest = max(largest, single)
            worst.append(largest)
    every = np.concatenate([np.array(values) for values in tested.values()])
    print(
        f"{len(worst)} windows, {len(every)} explanations, at most {most_tests} tests in a look; findings told: {told}"
    )
    print(f"largest of a window: median {np.median(worst):.1f}, largest {max(worst):.1f}; alarm from {ALARM_NATS:.1f}")
    for level in LEVELS:
        print(f"share beyond {level:2.0f}: {np.mean(every > level):.2e}; chi-squared at most {math.exp(-level):.2e}")
    for name, values in sorted(tested.items(), key=lambda item: -float(np.mean(np.array(item[1]) > 4.0)))[:6]:
        print(f"  {name}: beyond 4 {np.mean(np.array(values) > 4.0):.2e}, largest {max(values):.1f}")
    print(f"false alarms a year by the threshold: at most {FALSE_PER_YEAR:g}")


def delays() -> None:
    """Print when each effect is told first, and as what, from the start of the flight; for a step from the step."""
    for effect, flights in STRENGTHS.items():
        for strength, scenario in flights:
            flown = fly(Pipeline(craft()), stream(scenario, FLIGHT_S))
            start_ns = scenario.start_ns + round(1e9 * sum(step.at_s for step in scenario.effects.steps))
            told = [event for event in flown.findings if event.what == "model_doubtful"]
            first = f"{(told[0].time_ns - start_ns) / 6e10:.0f} min: {told[0].cause}" if told else "not told"
            right = next((event for event in told if f"like {effect}" in event.cause), None)
            named = "-" if right is None else f"{(right.time_ns - start_ns) / 6e10:.0f} min"
            print(f"{effect:14} {strength:12} first {first}; named rightly: {named}")


def cost() -> None:
    """Print the processor time of a tick in the filter and in the watch, in turn, all drivers on board."""
    clean = drawn(1, np.random.default_rng(1))
    ukf, watch = Ukf(craft(clean.scenario.sensor.noise_nt[0], SPINS_RPM[1])), ModelWatch(5.0)
    times = []
    for tick in clean.ticks(clean.noise(np.random.default_rng(2)), watch.drivers):
        begin = time.thread_time()
        ukf.handle(tick)
        between = time.thread_time()
        watch.push(tick, ukf.estimate(), walks=False)
        times.append((between - begin, time.thread_time() - between))
    own, watched = 1e6 * np.array(times[1000:]).T
    for name, figure in (("median", np.median), ("mean", np.mean)):
        first, second = float(figure(own)), float(figure(watched))
        print(f"{name}: filter {first:.0f} us, watch {second:.0f} us a tick, ratio {second / first:.2f}")
    looks = np.sort(watched)[-len(watched) // BLOCK :]
    print(f"a look, every {BLOCK} ticks: median {1e-3 * float(np.median(looks)):.1f} ms")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("false-alarms", "delays", "cost"))
    parser.add_argument("--windows", type=int, default=1000, help="windows for the false alarms (default 1000)")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    if options.what == "false-alarms":
        false_alarms(options.windows, options.seed)
    else:
        {"delays": delays, "cost": cost}[options.what]()
