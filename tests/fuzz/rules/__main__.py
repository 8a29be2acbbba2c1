"""Drive the daemon by the rules for long, every method in turn.

    python -m tests.fuzz.rules --steps 1000000 --keep output/rules-loop.json       # once more: it goes on from there
    python -m tests.fuzz.rules --steps 10000 --line zenoh --keep output/rules-zenoh.json
    python -m tests.fuzz.rules --method ekf --steps 20000
    python -m tests.fuzz.rules --table docs/fuzz.md output/rules-*.json

Prints a table; exit code 1 where a promise was broken, with the steps to it, over memory the shortest.  ``--table``
puts the table of runs that were kept into a page, between its marks.
"""

from __future__ import annotations

import argparse
import datetime
import itertools
import logging
import re
import sys
import time
import traceback
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from hypothesis import HealthCheck, Phase, seed, settings
from hypothesis.stateful import run_state_machine_as_test

from tests.fuzz.rules.crafts import LONG_S, METHODS
from tests.fuzz.rules.lines import LINES
from tests.fuzz.rules.machine import Rules, rules_of
from tests.fuzz.rules.progress import Progress, table

STEPS: Final = 100
"""Steps in one world, before another is opened."""

_WORLDS: Final = 30
"""Worlds of one method before the next one's turn: the first that a seed gives is the simplest one, of any seed."""

_BLOCK: Final = re.compile(r"(<!-- rules -->\n)(.*?)(<!-- end of rules -->)", re.DOTALL)


def drive(machine: type[Rules], number: int, worlds: int, *, shrink: bool = True) -> str:
    """Open so many worlds of a machine by a seed; the error that came out of one, with its steps, empty if none did."""
    phases = [Phase.generate, Phase.shrink] if shrink else [Phase.generate]
    chosen = settings(
        max_examples=worlds,
        stateful_step_count=STEPS,
        deadline=None,
        database=None,
        derandomize=False,
        phases=phases,
        suppress_health_check=list(HealthCheck),
    )
    try:
        run_state_machine_as_test(seed(number)(machine), settings=chosen)
    except Exception:
        return traceback.format_exc()
    return ""


def run(progress: Progress, steps: int, minutes: float, methods: Sequence[str], keep: Path | None) -> None:
    """Drive on until so many steps are done, or so long of the processor is over [min]."""
    for batch in itertools.count(progress.batches):
        if progress.steps >= steps or progress.processor_s > 60.0 * minutes:
            return
        method, number = methods[batch % len(methods)], progress.seed * 1_000_000 + batch
        machine = rules_of(method, LONG_S, progress.line)
        began_s = time.process_time()
        error = drive(machine, number, _WORLDS, shrink=progress.line == "loop")  # the others take minutes for it
        escape = f"{method} over {progress.line}, seed {number}:\n{error}" if error else ""
        progress.add(method, machine.total, time.process_time() - began_s, escape)
        print(escape, end="", flush=True)
        print(progress.told(steps), file=sys.stderr, flush=True)
        if keep is not None:
            progress.save(keep)


def main() -> int:
    """Run, print, write."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz.rules", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=20_000, help="in all")
    parser.add_argument("--minutes", type=float, default=1e9, help="of the processor, whatever is done by then")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--line", choices=LINES, default="loop", help="the link")
    parser.add_argument("--method", action="append", choices=METHODS, help="only this one")
    parser.add_argument(
        "--keep", type=Path, metavar="FILE", help="what was done; where it is there, it is gone on from"
    )
    parser.add_argument("--table", type=Path, nargs="+", metavar=("PAGE", "FILE"), help="write kept runs into a page")
    options = parser.parse_args()
    if options.table:
        page, *files = options.table
        _write(page, [Progress.load(file) for file in files])
        return 0
    logging.getLogger("magcal").setLevel(logging.CRITICAL + 1)  # each planted defect is logged with its traceback
    warnings.simplefilter("error")  # as the suite does: an overflow is no answer
    kept = options.keep is not None and options.keep.exists()
    progress = Progress.load(options.keep) if kept else Progress(options.line, options.seed)
    run(progress, options.steps, options.minutes, options.method or METHODS, options.keep)
    print(table([progress]))
    return 1 if progress.escapes else 0


def _write(page: Path, runs: Sequence[Progress]) -> None:
    """Put the table of these runs into a page."""
    speeds = ", ".join(
        f"over {one.line} with `--seed {one.seed}` {one.steps / max(one.processor_s, 1e-9):.0f} steps a second"
        for one in runs
    )
    text = f"Recorded until {datetime.datetime.now(datetime.UTC):%Y-%m-%d}, {speeds} of processor:\n\n{table(runs)}"
    page.write_text(_BLOCK.sub(lambda block: f"{block[1]}{text}{block[3]}", page.read_text()))


if __name__ == "__main__":
    sys.exit(main())
