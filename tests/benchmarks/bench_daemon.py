"""What the daemon costs: memory over a bare process with the same imports, CPU at 1 Hz, and the time of a replay.

    python -m tests.benchmarks.bench_daemon [--runs 3] [--json docs/results/daemon.json]

Each figure is measured beside its yardstick in the same run; Linux only (it reads /proc).  The JSON has every run.
"""

from __future__ import annotations

import argparse
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from pathlib import Path

from magcal_service.links import Role, open_link
from sim_sensor.node import run_node
from sim_sensor.recorder import record_simulation
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.benchmarks.results import write

FIGURES: defaultdict[str, list[float]] = defaultdict(list)

BARE = """
import msgpack, numpy, serial, zenoh, sys, time
with zenoh.open(zenoh.Config.from_json5('{{mode: "peer", scouting: {{multicast: {{enabled: false}}}}, '
                                        'listen: {{endpoints: ["tcp/127.0.0.1:{port}"]}}}}')):
    sys.stdin.read()
"""

CONFIG = """
version = 1
link = "zenoh:tcp/127.0.0.1:{port}"
[[craft]]
name = "{craft}"
[craft.sensor]
noise_nt = 300.0
[craft.spin]
rate_rpm = 7.5
"""


def resident_mb(pid: int) -> float:
    """Resident memory of a process [MB]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def cpu_s(pid: int) -> float:
    """User and system time of a process [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def free_port() -> int:
    """A port on 127.0.0.1 that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--idle-s", type=float, default=30.0, help="how long the 1 Hz load is watched (default 30)")
    parser.add_argument("--runs", type=int, default=1, help="how often everything is measured (default 1)")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    for _ in range(options.runs):
        with tempfile.TemporaryDirectory() as folder:
            measure_daemon(Path(folder), options.idle_s)
            measure_replay(Path(folder))
    write(options.json, FIGURES)


def measure_daemon(folder: Path, idle_s: float) -> None:
    """CPU and memory at 1 Hz, and memory after a burst, of a daemon with a zenoh session."""
    environment = dict(os.environ, OPENBLAS_NUM_THREADS="1", MALLOC_TRIM_THRESHOLD_="65536")  # as deployed
    bare = subprocess.Popen(
        [sys.executable, "-c", BARE.format(port=free_port())], stdin=subprocess.PIPE, env=environment
    )
    port = free_port()
    scenario = load_scenario("paper")
    config = folder / "bench.toml"
    config.write_text(CONFIG.format(port=port, craft=scenario.craft), encoding="utf-8")
    command = [sys.executable, "-m", "magcal_service.cli", "run", "--config", str(config)]
    daemon = subprocess.Popen(command, stderr=subprocess.DEVNULL, env=environment)
    try:
        time.sleep(3.0)
        with open_link(f"zenoh:tcp/127.0.0.1:{port}", Role.NODE, crafts=[scenario.craft]) as link:
            time.sleep(1.0)
            before, begin = cpu_s(daemon.pid), time.monotonic()
            run_node(Simulation(scenario, seed=2, duration_s=idle_s), link, 1.0, threading.Event())
            share = (cpu_s(daemon.pid) - before) / (time.monotonic() - begin)
            FIGURES["cpu_share_1hz"].append(share)
            print(f"CPU at 1 Hz: {100 * share:.2f} % of one core over {idle_s:.0f} s")
            print_memory("at_1hz", bare.pid, daemon.pid)
            run_node(Simulation(scenario, seed=1, duration_s=3000.0), link, 500.0, threading.Event())
            time.sleep(1.0)
            print_memory("after_3000_at_500hz", bare.pid, daemon.pid)
    finally:
        daemon.send_signal(signal.SIGTERM)
        daemon.wait(10)
        bare.communicate(timeout=10)


def print_memory(when: str, bare: int, daemon: int) -> None:
    """Both processes' resident memory."""
    bare_mb, daemon_mb = resident_mb(bare), resident_mb(daemon)
    FIGURES[f"memory_over_bare_mb_{when}"].append(daemon_mb - bare_mb)
    print(f"memory {when}: bare {bare_mb:.1f} MB, daemon {daemon_mb:.1f} MB, over it {daemon_mb - bare_mb:.1f} MB")


def measure_replay(folder: Path) -> None:
    """Wall time of ``magcal replay`` on 18000 s, process start and reading included."""
    path = record_simulation(Simulation(load_scenario("paper"), seed=1), folder / "recording")
    command = [sys.executable, "-m", "magcal_service.cli", "replay", str(path), "--out", str(folder / "out.csv")]
    begin = time.monotonic()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    wall = time.monotonic() - begin
    FIGURES["replay_18000_s"].append(wall)
    print(f"replay of 18000 s: {wall:.2f} s, {18000 / wall:.0f} times real time")


if __name__ == "__main__":
    main()
