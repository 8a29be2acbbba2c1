"""False alarms and time of the inspection, on clean logs of many kinds and on the recordings of a folder.

    python -m tests.benchmarks.bench_inspect [--logs 200] [--data ../shared/data] [--json FILE]

A false alarm is any finding on a clean log.  ``docs/results/inspect.json`` holds what docs/inspect.md says.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any, Final

import numpy as np

from magcal_service.recordings.inspect.inspection import inspect
from magcal_service.recordings.reader import read_recording
from tests.benchmarks.results import write
from tests.recordings.inspect.clean_logs import Kind, clean_log, kind_of

DATA: Final = Path(__file__).parents[2] / ".." / "shared" / "data"
FIRST_SEED: Final = 1000
"""Beyond those of the suite."""

ROWS: Final = 20_000


def main() -> None:
    """Print the false alarms, the findings on recordings, and the time of 20 000 rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    figures = {"logs": options.logs, **false_alarms(options.logs), "seconds": seconds(), **on_recordings(options.data)}
    print(figures)
    write(options.json, figures)


def false_alarms(logs: int) -> dict[str, Any]:
    """Clean logs with a finding, and the codes."""
    alarms: Counter[str] = Counter()
    wrong = 0
    for seed in range(FIRST_SEED, FIRST_SEED + logs):
        with tempfile.TemporaryDirectory() as folder:
            findings = clean_log(kind_of(seed), seed).inspected(Path(folder)).findings
        wrong += bool(findings)
        alarms.update(f"{one.code}{'' if one.certain else ' (likely)'}" for one in findings)
        if findings:
            print(seed, *map(str, findings), sep="\n  ", flush=True)
    return {"logs_with_a_finding": wrong, "alarms": dict(alarms)}


def seconds() -> float:
    """Median time of ten inspections of 20 000 rows with vector reference, places, gyro and attitude [s]."""
    with tempfile.TemporaryDirectory() as folder:
        recording = read_recording(clean_log(Kind(rows=ROWS, reference="vector")).write(Path(folder)))
    taken = []
    for _ in range(10):
        began = time.perf_counter()
        inspect(recording)
        taken.append(time.perf_counter() - began)
    return round(float(np.median(taken)), 3)


def on_recordings(data: Path) -> dict[str, Any]:
    """What is found on each recording of a folder."""
    found = {}
    for path in sorted(data.glob("*/*.toml")):
        findings = inspect(read_recording(path)).findings
        found[f"{path.parent.name}/{path.stem}"] = [f"{one.code}: {one.says}" for one in findings]
    return {"recordings": found}


if __name__ == "__main__":
    main()
