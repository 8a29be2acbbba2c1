"""Thirty days of ticks through the daemon's service, as fast as it goes: memory, files and threads stay flat.

    python -m tests.faults.soak [--days 30] [--json FILE]

The paper's flight of five hours is flown over and over, a gap of a minute in between; the service works on an open
zenoh link, publishes vectors, estimates and a status a minute, and keeps checkpoints.  Exit code 1: something grew.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

from magcal_service.config.daemon_settings import StateConfig
from magcal_service.config.settings import Config, CraftConfig, SensorConfig, SpinConfig
from magcal_service.daemon.checkpoints.store import Checkpoints
from magcal_service.daemon.service import Service
from magcal_service.links import Role, open_link
from magcal_service.wire.messages import Message
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.daemon.service_processes import free_port

FLIGHT_S, GAP_S, SECOND_NS = 18_000, 61, 1_000_000_000
HOUR_TICKS, MINUTE_TICKS = 3600, 60
MOST_GROWTH_MB = 1.0


@dataclass(frozen=True)
class Figures:
    """What the process holds at one time."""

    ticks: int
    memory_mb: float
    files: int
    threads: int

    @classmethod
    def now(cls, ticks: int) -> Figures:
        """Of this process; Linux only."""
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        memory_mb = pages * os.sysconf("SC_PAGE_SIZE") / 1e6
        threads = len(os.listdir("/proc/self/task"))
        return cls(ticks, memory_mb, len(os.listdir("/proc/self/fd")), threads)


def flight(ticks: int) -> Iterator[list[Message]]:
    """The messages of each second, the five hours again and again in a time and with numbers that go on."""
    base: list[list[Message]] = []
    for message in Simulation(load_scenario("paper"), 1, float(min(FLIGHT_S, ticks))).messages():
        second = message.sequence
        base.extend([] for _ in range(len(base), second + 1))
        base[second].append(replace(message, craft="paper"))
    for tick in range(ticks):
        turn, second = divmod(tick, len(base))
        later_ns = turn * (FLIGHT_S + GAP_S) * SECOND_NS
        yield [replace(one, sequence=tick % (1 << 32), time_ns=one.time_ns + later_ns) for one in base[second]]


def soak(ticks: int, folder: Path, told: Callable[[list[Figures]], None]) -> list[Figures]:
    """Work through so many seconds; the figures after the first hour's worth and each flight, told as they come."""
    craft = CraftConfig("paper", SensorConfig(noise_nt=300.0), SpinConfig(rate_rpm=7.5))
    state = StateConfig(folder)
    config = Config(f"zenoh:tcp/127.0.0.1:{free_port()}", (craft,), state=state)
    figures = []
    with open_link(config.link, Role.SERVICE, crafts=["paper"]) as link:
        service = Service(config, link, checkpoints=Checkpoints(state, config.crafts))
        for tick, messages in enumerate(flight(ticks), 1):
            for message in messages:
                service.handle(message)
            if tick % MINUTE_TICKS == 0:
                service.publish_status()
                link.receive(0.0)
            if tick % HOUR_TICKS == 0:
                service.save()
            if tick in (HOUR_TICKS, ticks) or tick % FLIGHT_S == 0:
                figures.append(Figures.now(tick))
                told(figures)
        assert service.pipelines["paper"].ticks.closed >= ticks - 2
    return figures


def keep(path: Path | None, figures: list[Figures]) -> None:
    """Write the figures so far, so that a run that is cut short is not for nothing."""
    if path is not None:
        path.write_text(json.dumps([asdict(one) for one in figures], indent=1) + "\n", encoding="utf-8")


def main() -> int:
    """Soak and print."""
    parser = argparse.ArgumentParser(prog="python -m tests.faults.soak", description="Thirty days of ticks.")
    parser.add_argument("--days", type=float, default=30.0, help="of flight, a tick a second (default: 30)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures here")
    options = parser.parse_args()
    begun_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        figures = soak(max(2 * HOUR_TICKS, int(options.days * 86_400)), Path(folder), partial(keep, options.json))
    first, last = figures[0], figures[-1]
    growth_mb = max(one.memory_mb for one in figures) - first.memory_mb
    grown = max(one.files for one in figures) - first.files, max(one.threads for one in figures) - first.threads
    print("| after ticks | resident memory | files open | threads |\n|---|---|---|---|")
    for one in (first, figures[len(figures) // 2], last):
        print(f"| {one.ticks} | {one.memory_mb:.2f} MB | {one.files} | {one.threads} |")
    print(f"\nlargest growth after the first hour's worth: {growth_mb:.2f} MB, {grown[0]} files, {grown[1]} threads")
    print(f"{last.ticks} ticks in {time.monotonic() - begun_s:.0f} s")
    return int(growth_mb >= MOST_GROWTH_MB or max(grown) > 0)


if __name__ == "__main__":
    sys.exit(main())
