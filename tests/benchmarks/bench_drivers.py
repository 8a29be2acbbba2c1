"""Channels that resemble the one that drives, and channels that drive nothing: who is named, how sure.

python -m tests.benchmarks.bench_drivers alike --seeds 20
python -m tests.benchmarks.bench_drivers unrelated --seeds 20
python -m tests.benchmarks.bench_drivers cost
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np

from magcal_service.diagnosis.diagnose import Diagnosis, diagnose
from magcal_service.diagnosis.entry import Entry
from magcal_service.diagnosis.result import entries
from tests.diagnosis.turntable import Bench, alike, course

CHANNELS = 20
UNITS = ("A", "counts", "")


def named(diagnosis: Diagnosis) -> list[Entry]:
    """Effects by name."""
    return [entry for entry in entries(diagnosis) if entry.effect != "unknown"]


def driven(seed: int) -> tuple[str, Diagnosis]:
    """The channel that drives a field of 150 to 400 nT, and the diagnosis with nineteen that resemble it."""
    rng = np.random.default_rng([seed, 2])
    bench = Bench(seed)
    courses = alike(rng, bench.time_s, CHANNELS)
    order = rng.permutation(CHANNELS)
    recorded = courses + rng.normal(0.0, 0.01, courses.shape)
    unit = UNITS[seed % len(UNITS)]
    bench.channels = {f"c{place:02d}": (2.0 + recorded[:, number], unit) for place, number in enumerate(order)}
    direction = rng.normal(size=3)
    size = rng.uniform(150.0, 400.0) * direction / np.linalg.norm(direction)
    bench.added_nt = np.outer(courses[:, 0], size)
    return f"channel:c{int(np.argmin(order)):02d}", diagnose(bench.recording())


def idle(seed: int) -> Diagnosis:
    """A clean recording beside twenty channels that have nothing to do with it."""
    rng = np.random.default_rng([seed, 3])
    bench = Bench(seed)
    bench.channels = {
        f"c{number:02d}": (2.0 + course(rng, bench.time_s), UNITS[number % len(UNITS)]) for number in range(CHANNELS)
    }
    return diagnose(bench.recording())


def cost() -> None:
    """20 000 rows and 300 channels of one kind or another."""
    rng = np.random.default_rng(4)
    bench = Bench(4, count=20_000)
    courses = [course(rng, bench.time_s) for _ in range(300)]
    units = ("A", "counts", "degC", "", "V", "W")
    bench.channels = {f"c{n:03d}": (20.0 + values, units[n % len(units)]) for n, values in enumerate(courses)}
    bench.added_nt = np.outer(courses[0], [200.0, -100.0, 50.0])
    recording, began = bench.recording(), time.process_time()
    found = diagnose(recording)
    print(f"{time.process_time() - began:.1f} s of processor:", [(e.effect, e.driver) for e in named(found)])


def main(argv: Sequence[str] | None = None) -> None:
    """Print one line a seed, and the sum."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("alike", "unrelated", "cost"))
    parser.add_argument("--seeds", type=int, default=20)
    options = parser.parse_args(argv)
    if options.what == "cost":
        cost()
        return
    right = 0
    for seed in range(options.seeds):
        if options.what == "alike":
            truth, diagnosis = driven(seed)
            said = named(diagnosis)
            drivers = said[0].drivers if said else ()
            right += any(name == truth for name, _ in drivers)
            print(
                seed,
                truth,
                diagnosis.verdict,
                [(e.effect, e.driver) for e in said],
                drivers,
                diagnosis.reasons,
                flush=True,
            )
        else:
            diagnosis = idle(seed)
            right += not named(diagnosis)
            print(seed, diagnosis.verdict, [(e.effect, e.driver) for e in named(diagnosis)], flush=True)
    print(f"{right} of {options.seeds}")


if __name__ == "__main__":
    main()
