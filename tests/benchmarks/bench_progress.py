"""When ``magcal diagnose`` said it would end, and when it did: ``python -m tests.benchmarks.bench_progress DIR ...``.

Every ``RECORDING.toml`` and the like below the folders is diagnosed.  The first table is what ``USUAL`` in
``magcal_service/diagnosis/forecast.py`` holds, measured on these recordings; then what was told at a third of the way
over what was left, by the table in that file.  Times are of the processor, so that a busy machine does not count.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from magcal_service.base.errors import MagcalError
from magcal_service.diagnosis.command import Request, make
from magcal_service.diagnosis.forecast import WRITING_S, Course, Place
from magcal_service.diagnosis.stages import READING

Run = list[tuple[str, float]]
"""Each step and when it began [s]; last the end, with an empty name."""

AT = 1.0 / 3.0
LEAST_S = 2.0  # what ends sooner shows nothing


def timed(recording: Path) -> Run:
    """One diagnosis."""
    began_s = time.process_time()
    run = [(READING, 0.0)]
    make(Request(recording, Path("unused"), None, None), lambda step: run.append((step, time.process_time() - began_s)))
    return [*run, ("", time.process_time() - began_s)]


def walked(run: Run) -> Iterator[tuple[Course, float, float]]:
    """The course at the beginning of each step, and when that begins and ends [s]."""
    course = Course()
    for (step, begins_s), (_, ends_s) in pairwise(run):
        course.begin(step, begins_s)
        yield course, begins_s, ends_s


def table(runs: Sequence[Run]) -> None:
    """The rows of ``USUAL``."""
    found: defaultdict[Place, list[tuple[float, float]]] = defaultdict(list)
    for run in runs:
        for course, begins_s, ends_s in walked(run):
            if course.unit_s:
                left_s = max(run[-1][1] - begins_s - WRITING_S, 0.0)
                found[course.place].append((left_s / course.unit_s, (ends_s - begins_s) / course.unit_s))
    for place, each in sorted(found.items()):
        left, own = np.mean(each, axis=0)
        print(f"{place}: Usual({left:.2f}, {own:.2f}),  # of {len(each)}")


def told(run: Run, at_s: float) -> float | None:
    """What was told at a time [s]."""
    left_s = None
    for course, begins_s, ends_s in walked(run):
        if begins_s <= at_s < ends_s:
            left_s = course.left_s(at_s)
            break
    return left_s


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.bench_progress", description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+", metavar="DIR")
    parser.add_argument("--times", type=Path, metavar="FILE", help="keep times here, and take what is there")
    options = parser.parse_args()
    kept: dict[str, Run] = {}
    if options.times is not None and options.times.exists():
        kept = {name: [tuple(pair) for pair in run] for name, run in json.loads(options.times.read_text()).items()}
    for path in sorted(path for folder in options.folders for path in folder.rglob("*.toml")):
        if str(path) not in kept:
            try:
                kept[str(path)] = timed(path)
            except MagcalError:
                continue
            if options.times is not None:
                options.times.write_text(json.dumps(kept))
        run = kept[str(path)]
        print(f"{path}: {run[-1][1]:.1f} s")
    runs = [run for run in kept.values() if run[-1][1] > LEAST_S]
    table(runs)
    pairs = [(told(run, AT * run[-1][1]), (1.0 - AT) * run[-1][1]) for run in runs]
    ratios = np.array([said / left for said, left in pairs if said is not None])
    if len(ratios):
        low, middle, high = np.percentile(ratios, [25, 50, 75])
        print(
            f"told at a third of the way, over what was left, {len(ratios)} of {len(runs)} diagnoses: "
            f"median {middle:.2f}, half of them {low:.2f} to {high:.2f}, all {ratios.min():.2f} to {ratios.max():.2f}"
        )


if __name__ == "__main__":
    main()
