"""How well the tests bite: single changes of the core, and whether the tests of the room notice.

    python -m tests.mutation --sample 10               # ten of each room, in minutes
    python -m tests.mutation --room wire --sample 0    # all of one room, in hours
    python -m tests.mutation --sample 40 --out docs    # writes docs/mutation.md and docs/results/mutation.json
    python -m tests.mutation --again FILE --log FILE   # tests were added: the survivors of a log once more

Ends with 1 where a survivor is not explained in ``explained.toml``.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.mutation.mutants import Bench, Mutant, Outcome, drawn, located
from tests.mutation.report import explanation, recorded, summary, write
from tests.mutation.rooms import ROOMS, Room, room_named

Work = tuple[Room, Mutant, int]
"""A mutant of a room and the seed that drew it."""


def main() -> int:
    """Draw, try, report."""
    options = _options()
    if options.results is not None:
        return _report(recorded(options.results), options.out)
    work = _survivors(options.again) if options.again else _drawn(options.room, options.sample, options.seed)
    print(f"{len(work)} mutants in {len({room for room, _, _ in work})} rooms", flush=True)
    return _report(_tried(work, options.workers, options.log), options.out)


def _drawn(rooms: list[str], sample: int, seed: int) -> list[Work]:
    named = [room_named(name) for name in rooms] or list(ROOMS)
    return [(room, mutant, seed) for room in named for mutant in drawn(room, sample or sys.maxsize, seed)]


def _survivors(log: Path) -> list[Work]:
    """Those that nobody has explained, where they stand in the code now."""
    left = [one for one in recorded(log) if not one.killed_by and not explanation(one.mutant)]
    found = [(room_named(one.room), located(one.mutant), one.seed) for one in left]
    return [(room, mutant, seed) for room, mutant, seed in found if mutant is not None]


def _report(outcomes: list[Outcome], out: Path | None) -> int:
    print(summary(outcomes))
    if out is not None:
        write(outcomes, out)
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
    parser.add_argument("--again", type=Path, metavar="FILE", help="the unexplained survivors that --log has written")
    return parser.parse_args()


def _tried(work: list[Work], workers: int, log: Path | None) -> list[Outcome]:
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(workers) as pool:
        benches = [Bench(Path(folder) / str(number)) for number in range(workers)]
        processor_s = {name: benches[0].processor_time(room_named(name)) for name in {room.name for room, _, _ in work}}
        print("processor time without a mutant [s]:", {name: round(s) for name, s in processor_s.items()}, flush=True)

        def try_one(room: Room, mutant: Mutant, seed: int) -> Outcome:
            bench = benches.pop()  # each worker has one at a time
            try:
                killed_by = bench.try_out(room, mutant, processor_s[room.name])
            finally:
                benches.append(bench)
            outcome = Outcome(room.name, mutant, killed_by, seed, at_first=bool(killed_by))
            print(f"{room.name}: {killed_by or 'SURVIVED'}: {mutant.text}", flush=True)
            if log is not None:
                with log.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(outcome.as_dict()) + "\n")
            return outcome

        return list(pool.map(lambda item: try_one(*item), work))


if __name__ == "__main__":
    sys.exit(main())
