"""How well the tests bite: single changes of the core, and whether the tests of the room notice.

    python -m tests.mutation --sample 10               # ten of each room, in minutes
    python -m tests.mutation --room wire --sample 0    # all of one room, in hours
    python -m tests.mutation --sample 40 --out docs    # writes docs/mutation.md and docs/results/mutation.json

Ends with 1 where a survivor is not explained in ``explained.toml``.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.mutation.mutants import Bench, Mutant, Outcome, drawn
from tests.mutation.report import explanation, recorded, summary, write
from tests.mutation.rooms import ROOMS, Room, room_named


def main() -> int:
    """Draw, try, report."""
    options = _options()
    if options.results is not None:
        return _report(recorded(options.results), options.seed, options.out)
    rooms = [room_named(name) for name in options.room] or list(ROOMS)
    work = [(room, mutant) for room in rooms for mutant in drawn(room, options.sample or sys.maxsize, options.seed)]
    print(f"{len(work)} mutants in {len(rooms)} rooms, seed {options.seed}", flush=True)
    return _report(_tried(work, options.workers, options.log), options.seed, options.out)


def _report(outcomes: list[Outcome], seed: int, out: Path | None) -> int:
    print(summary(outcomes))
    if out is not None:
        write(outcomes, seed, out)
    return int(any(not outcome.killed_by and not explanation(outcome.mutant) for outcome in outcomes))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__.splitlines()[0])
    parser.add_argument("--room", action="append", default=[], choices=[room.name for room in ROOMS])
    parser.add_argument("--sample", type=int, default=10, metavar="N", help="mutants of each room; 0: all")
    parser.add_argument("--seed", type=int, default=1, metavar="S")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="copies of the checkout worked on at once")
    parser.add_argument("--out", type=Path, metavar="DOCS", help="write mutation.md and results/mutation.json there")
    parser.add_argument("--log", type=Path, metavar="FILE", help="append every outcome as a JSON line")
    parser.add_argument("--results", type=Path, metavar="FILE", help="report what --log has written, try nothing")
    return parser.parse_args()


def _tried(work: list[tuple[Room, Mutant]], workers: int, log: Path | None) -> list[Outcome]:
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(workers) as pool:
        benches = [Bench(Path(folder) / str(number)) for number in range(workers)]
        processor_s = {name: benches[0].processor_time(room_named(name)) for name in {room.name for room, _ in work}}
        print("processor time without a mutant [s]:", {name: round(s) for name, s in processor_s.items()}, flush=True)

        def try_one(room: Room, mutant: Mutant) -> Outcome:
            bench = benches.pop()  # each worker has one at a time
            try:
                outcome = bench.try_out(room, mutant, processor_s[room.name])
            finally:
                benches.append(bench)
            print(f"{room.name}: {outcome.killed_by or 'SURVIVED'}: {mutant.text}", flush=True)
            if log is not None:
                with log.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(outcome.as_dict()) + "\n")
            return outcome

        return list(pool.map(lambda item: try_one(*item), work))


if __name__ == "__main__":
    sys.exit(main())
