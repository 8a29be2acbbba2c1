"""Many craft at 1 Hz on one daemon, beside another checkout in turn: answered, how late, processor, and 10 s after.

    python -m tests.benchmarks.bench_load                                  # 100, 300, 1000 and 2000 craft
    python -m tests.benchmarks.bench_load --before DIR --craft 1000        # beside the checkout in DIR

On a machine with other work the absolute figures say little: compare the rows of one run.  The craft are in their first
minute, before a filter runs; after the load as many as any daemon carries go on for 15 s.  The first line says what a
message costs that comes into the link's queue, with room and full.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path
from typing import Any

from magcal_service.links.fair_inbox import FairInbox
from tests.benchmarks.load.craft import line, many_craft
from tests.benchmarks.load.served import ROOT
from tests.benchmarks.results import write

PLACES = 4096
SOURCES = 2000


def put_us() -> tuple[float, float]:
    """Processor time of one put into an inbox of ``SOURCES`` sources [us]: with room, and full; the least of five."""
    rounds = []
    for _ in range(5):
        inbox: FairInbox[int] = FairInbox(PLACES, lambda _: None)
        took_s = []
        for _ in range(2):  # the first round fills it
            begun_s = time.process_time()
            for number in range(PLACES):
                inbox.put(number, f"c{number % SOURCES}", "s")
            took_s.append(time.process_time() - begun_s)
        rounds.append(took_s)
    room, full = (1e6 * min(took_s) / PLACES for took_s in zip(*rounds, strict=True))
    return room, full


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--craft", type=int, nargs="+", default=[100, 300, 1000, 2000], metavar="N")
    parser.add_argument("--seconds", type=int, default=30, help="how long the load lasts (default 30)")
    parser.add_argument("--before", type=Path, metavar="DIR", help="another checkout, measured in turn")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    checkouts = {"now": ROOT} if options.before is None else {"before": options.before.resolve(), "now": ROOT}
    room, full = put_us()
    print(f"load average {os.getloadavg()[0]:.1f}; a put {room:.1f} us with room, {full:.1f} us full", flush=True)
    figures: dict[str, Any] = {"load_average": os.getloadavg()[0], "put_us": {"with_room": room, "full": full}}
    for count in options.craft:
        for name, checkout in checkouts.items():
            with tempfile.TemporaryDirectory(prefix="magcal-load-") as folder:
                told = figures[f"{name}_{count}"] = many_craft(checkout, Path(folder), count, options.seconds)
            print(line(count, name, told), flush=True)
    write(options.json, figures)


if __name__ == "__main__":
    main()
