"""Drive the daemon by the rules for long, every method in turn.

    python -m tests.fuzz.rules --steps 1000000 --seed 1
    python -m tests.fuzz.rules --method ekf --steps 20000
    python -m tests.fuzz.rules --steps 1000000 --write docs/fuzz.md

Prints a table; exit code 1 where a promise was broken, with the shortest steps to it.  ``--write`` puts the table into
a page, between its marks, each time that more is done.
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
from collections import Counter
from pathlib import Path
from typing import Final

from hypothesis import HealthCheck, Phase, seed, settings
from hypothesis.stateful import run_state_machine_as_test

from tests.fuzz.rules.crafts import LONG_S, METHODS
from tests.fuzz.rules.machine import Rules, rules_of

STEPS: Final = 100
"""Steps in one world, before another is opened."""

_WORLDS: Final = 5
"""Worlds of one method before the next one's turn."""

_COLUMNS: Final = ("worlds", "steps", "messages", "starts", "checkpoints", "contained", "escapes")
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


def table(done: dict[str, Counter[str]]) -> str:
    """What was done, a row for each method."""
    rows = [f"| method | {' | '.join(_COLUMNS)} |", f"|---|{'---:|' * len(_COLUMNS)}"]
    every: Counter[str] = sum(done.values(), Counter())
    for name, one in [*((f"`{name}`", one) for name, one in done.items()), ("all", every)]:
        rows.append(f"| {name} | {' | '.join(str(one[column]) for column in _COLUMNS)} |")
    return "\n".join(rows) + "\n"


def main() -> int:
    """Run, print, write."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.rules", description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000, help="in all")
    parser.add_argument("--minutes", type=float, default=1e9, help="end after so long, whatever is done by then")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--method", action="append", choices=METHODS, help="only this one")
    parser.add_argument("--write", type=Path, help="a page with the marks <!-- rules --> and <!-- end of rules -->")
    options = parser.parse_args()
    logging.getLogger("magcal").setLevel(logging.CRITICAL + 1)  # each planted defect is logged with its traceback
    warnings.simplefilter("error")  # as the suite does: an overflow is no answer
    done = {name: Counter[str]() for name in options.method or METHODS}
    began_s = time.monotonic()
    for number, name in zip(itertools.count(options.seed * 1_000_000), itertools.cycle(done), strict=False):
        machine = rules_of(name, LONG_S)
        error = drive(machine, number, _WORLDS)
        done[name].update(machine.total)
        done[name]["escapes"] += bool(error)
        if error:
            print(f"{name}, seed {number}:\n{error}", flush=True)
        steps, seconds = sum(one["steps"] for one in done.values()), time.monotonic() - began_s
        print(f"{steps} steps, {seconds:.0f} s", file=sys.stderr, flush=True)
        if options.write is not None:
            _write(options.write, options.steps, options.seed, done)
        if steps >= options.steps or seconds > 60.0 * options.minutes:
            break
    print(table(done))
    return 1 if any(one["escapes"] for one in done.values()) else 0


def _write(page: Path, steps: int, seed_number: int, done: dict[str, Counter[str]]) -> None:
    """Put the table so far into a page."""
    command = f"`python -m tests.fuzz.rules --steps {steps} --seed {seed_number}`"
    until = f"as far as it had come on {datetime.datetime.now(datetime.UTC):%Y-%m-%d}"
    text = f"{command}, {until}:\n\n{table(done)}"
    page.write_text(_BLOCK.sub(lambda block: f"{block[1]}{text}{block[3]}", page.read_text()))


if __name__ == "__main__":
    sys.exit(main())
