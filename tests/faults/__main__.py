"""Try the faults on real processes and print what came of them.

    python -m tests.faults [--only NAME ...] [--quick] [--json FILE]

Exit code 0: everything is as promised; 1: something is not.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import traceback
from pathlib import Path

from tests.faults.faults import Fault, Outcome, as_json, table
from tests.faults.runs import RUNS


def attempt(fault: Fault, quick: bool) -> Outcome:
    """One fault in a folder of its own; what goes wrong with the trial itself is a broken promise too."""
    with tempfile.TemporaryDirectory(prefix=f"{fault.label}-") as folder:
        try:
            return RUNS[fault](Path(folder), quick)
        except Exception as error:
            traceback.print_exc()
            outcome = Outcome(fault, "-")
            outcome.broken.append(f"{type(error).__name__}: {str(error)[:500]}")
            return outcome


def main() -> int:
    """Run what is asked for."""
    names = [fault.label for fault in Fault]
    parser = argparse.ArgumentParser(
        prog="python -m tests.faults", description="Faults on real processes, with figures."
    )
    parser.add_argument("--only", action="append", choices=names, help="this fault; may be given several times")
    parser.add_argument("--quick", action="store_true", help="fewer repetitions")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write everything here")
    options = parser.parse_args()
    outcomes = []
    for fault in Fault:
        if options.only and fault.label not in options.only:
            continue
        begun_s = time.monotonic()
        outcomes.append(attempt(fault, options.quick))
        print(f"{fault.label}: {time.monotonic() - begun_s:.0f} s", file=sys.stderr, flush=True)
    print(table(outcomes), end="")
    if options.json is not None:
        options.json.write_text(as_json(outcomes), encoding="utf-8")
    return int(any(outcome.broken for outcome in outcomes))


if __name__ == "__main__":
    sys.exit(main())
