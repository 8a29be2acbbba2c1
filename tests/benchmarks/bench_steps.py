"""What the joint fit saves by learning from its steps what the normal matrix leaves out.

    python -m tests.benchmarks.bench_steps            # four blind cases, a few minutes

Blind cases with a hysteresis, which bends with its numbers, are diagnosed twice in turn: as is, and with the normal
matrix alone.  What is compared is processor time; the answers are printed beside it.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from magcal_service.diagnosis import solution
from magcal_service.diagnosis.diagnose import diagnose
from magcal_service.diagnosis.result import entries
from magcal_service.recordings.reader import read_recording
from tests.benchmarks.results import write
from tests.blind.draw import draw_case
from tests.blind.recording import write_case

EFFECT = "hysteresis"
SEED = 8991


def diagnosed(folder: Path, bends: float) -> tuple[float, list[str]]:
    """Processor time [s] of a recording's diagnosis and the names it gives, with steps learned below ``bends``."""
    as_is = solution._BENDS
    solution._BENDS = bends  # type: ignore[misc]
    try:
        began = time.process_time()
        found = diagnose(read_recording(folder / "RECORDING.toml"))
        return time.process_time() - began, [entry.effect for entry in entries(found)]
    finally:
        solution._BENDS = as_is  # type: ignore[misc]


def main() -> None:
    """Draw the cases, diagnose each twice, print the ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=4)
    parser.add_argument("--json", type=Path, default=None)
    options = parser.parse_args()
    rows = []
    for index in range(options.cases):
        with tempfile.TemporaryDirectory(prefix="magcal-steps-") as folder:
            case = draw_case(SEED * 100_000 + index, EFFECT, driver_recorded=True)
            write_case(case, Path(folder))
            bends = (solution._BENDS, 0.0)
            order = bends if index % 2 == 0 else bends[::-1]  # what is warm after the first helps either as often
            by = {one: diagnosed(Path(folder), one) for one in order}
        (learned_s, names), (normal_s, others) = by[bends[0]], by[bends[1]]
        rows.append({"case": index, "learned_s": learned_s, "normal_s": normal_s, "names": names, "others": others})
        same = "the same names" if names == others else f"{others} by the normal matrix alone"
        print(
            f"case {index}: {learned_s:.1f} s with what steps tell, {normal_s:.1f} s by the normal matrix alone: "
            f"{learned_s / normal_s:.2f} times; {names}, {same}",
            flush=True,
        )
    learned, normal = (sum(float(row[key]) for row in rows) for key in ("learned_s", "normal_s"))  # type: ignore[arg-type]
    print(f"all: {learned:.1f} of {normal:.1f} s, {learned / normal:.2f} times")
    write(options.json, {"rows": rows, "ratio": learned / normal})


if __name__ == "__main__":
    main()
