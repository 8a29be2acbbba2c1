"""What nodes that join and leave cost the vectors of a craft: ``python -m tests.benchmarks.bench_joins [SECONDS]``.

A daemon of its own over zenoh, a craft at 10 Hz, and a node of the same craft that sends nothing, joining and leaving
every second in the second half.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread

from magcal_service.links import Role, open_link
from tests.benchmarks.load.served import percentile
from tests.daemon.service_processes import free_port, stream, write_config
from tests.faults.bench import Daemons, Feeder, Witness

RATE_HZ = 10


@contextmanager
def coming_and_going(address: str) -> Iterator[list[int]]:
    """An empty node that is there for half of every second; gives how often it has been."""
    over, count = Event(), [0]

    def work() -> None:
        while not over.is_set():
            with open_link(address, Role.NODE, crafts=["paper"]):
                count[0] += 1
                over.wait(0.5)
            over.wait(0.5)

    thread = Thread(target=work)
    thread.start()
    try:
        yield count
    finally:
        over.set()
        thread.join()


def late_ms(node: Witness, begin: int) -> list[float]:
    """How late the vector of each sample came, from one on [ms]."""
    return [1e3 * (node.first_s[key] - sent_s) for key, sent_s in list(node.sent_s.items())[begin:]]


def main(seconds: int = 30) -> None:
    """Print the quantiles with and without."""
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    half = 2 * RATE_HZ * seconds
    flight = stream(seconds=2 * RATE_HZ * seconds)[: 2 * half]
    messages = [replace(one, time_ns=one.time_ns // RATE_HZ) for one in flight]  # ten a second of sample time as well
    with (
        tempfile.TemporaryDirectory() as folder,
        Daemons(write_config(Path(folder), address)),
        Witness(address) as node,
    ):
        node.until_heard()
        with Feeder(node, messages[:half], 2.0 * RATE_HZ) as feeder:
            feeder.settle()
        calm = late_ms(node, RATE_HZ)  # without the first second, of the start
        with coming_and_going(address) as count, Feeder(node, messages[half:], 2.0 * RATE_HZ) as feeder:
            feeder.settle()
        busy = late_ms(node, half // 2)
    for name, values in (("alone", calm), (f"{count[0]} joins and leaves of an empty node", busy)):
        figures = ", ".join(f"{share:.0%} {percentile(values, share):.1f} ms" for share in (0.5, 0.99, 1.0))
        print(f"{name}: {len(values)} vectors, late by {figures}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
