"""Many recordings diagnosed at once: on a pool and on dask, with workers killed and a run cut, the same bits.

    python -m tests.benchmarks.bench_many                        # 12 recordings, two workers
    python -m tests.benchmarks.bench_many --recordings 200       # 600 diagnoses

Four runs of ``magcal diagnose --separately`` over the same simulated recordings: on the pool with a worker killed and
cut half way; that one resumed; on dask with a worker killed; on the pool, undisturbed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from sim_sensor.recorder import record_simulation
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.benchmarks.results import write

WORKERS = 2
SHORTEST_S, LONGEST_S = 600, 1000
RECORDING = "RECORDING.toml"


@dataclass(frozen=True)
class Run:
    """One command: exit code, seconds, pieces kept from before and done anew, processes killed, digest of all files."""

    name: str
    exit_code: int
    seconds: float
    kept: int
    anew: int
    killed: int
    digest: str


def main() -> None:
    """Make the recordings, do the runs, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=int, default=12)
    parser.add_argument("--folder", type=Path, metavar="DIR", help="of recordings and results, kept (default: neither)")
    parser.add_argument("--json", type=Path, default=None)
    options = parser.parse_args()
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # a shell's background job has it ignored, for children too
    with tempfile.TemporaryDirectory(prefix="magcal-many-") as folder:
        runs = list(Bench(options.folder or Path(folder), options.recordings).runs())
    same = len({run.digest for run in runs if run.exit_code != -signal.SIGINT and run.exit_code != 130}) == 1
    print(f"{options.recordings} recordings, every run that ended: {'the same bits' if same else 'DIFFERENT BITS'}")
    write(options.json, {"recordings": options.recordings, "same": same, "runs": [asdict(run) for run in runs]})
    sys.exit(not same)


class Bench:
    """The recordings, and commands over them."""

    def __init__(self, folder: Path, count: int) -> None:
        self.folder, self.count = folder, count
        for number in range(count):
            target = folder / "flights" / f"{number:03}"
            if (target / RECORDING).exists():
                continue
            seconds = SHORTEST_S + (LONGEST_S - SHORTEST_S) * number // count
            simulation = Simulation(load_scenario("random-errors"), 1 + number, float(seconds))
            record_simulation(simulation, target)

    def runs(self) -> Iterator[Run]:
        """Each run as it ends."""
        quarter, half = self.count // 4, self.count // 2
        pool = ["--workers", str(WORKERS)]
        yield self.run("pool, a worker killed, then cut", "cut", pool, {quarter: kill_child, half: interrupt})
        yield self.run("the same, resumed", "cut", [*pool, "--resume"])
        with scheduler() as (address, kill_worker):
            yield self.run("dask, a worker killed", "dask", ["--executor", address], {quarter: kill_worker})
        yield self.run("pool, undisturbed", "pool", pool)

    def run(
        self, name: str, out: str, options: list[str], events: dict[int, Callable[[int], int]] | None = None
    ) -> Run:
        """One command; ``events`` are done to its process when so many pieces are on the disk."""
        target = self.folder / out
        command = [
            sys.executable,
            "-m",
            "magcal_service.cli",
            "diagnose",
            "--separately",
            "--out",
            str(target),
            *options,
        ]
        command += sorted(str(path) for path in self.folder.glob(f"flights/*/{RECORDING}"))[: self.count]
        before = pieces(target)
        began = time.monotonic()
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
            killed = 0
            for count, event in sorted((events or {}).items()):
                while process.poll() is None and len(pieces(target)) < count:
                    time.sleep(0.1)
                killed += event(process.pid)
            code = process.wait()
        seconds = time.monotonic() - began
        after = pieces(target)
        kept = sum(after.get(path) == stamp for path, stamp in before.items())
        run = Run(name, code, round(seconds, 1), kept, len(after) - kept, killed, digest(target))
        print(
            f"{name:<32} exit {code:>3}, {seconds:6.1f} s, {run.kept:3} kept, {run.anew:3} done, {killed} killed, "
            f"files {run.digest[:16]}",
            flush=True,
        )
        return run


def pieces(out: Path) -> dict[Path, int]:
    """Finished pieces of a run, and when each was written."""
    return {path: path.stat().st_mtime_ns for path in out.glob("pieces/*.piece")}


def digest(out: Path) -> str:
    """Of every file that a run wrote, but for the seconds it took."""
    found = hashlib.sha256()
    for path in sorted(path for path in out.rglob("*") if path.is_file() and path.parent.name != "pieces"):
        content = path.read_bytes()
        if path.name == "summary.json":
            summary = json.loads(content)
            for row in summary["recordings"]:
                row.pop("seconds", None)
            content = json.dumps(summary).encode()
        found.update(f"{path.relative_to(out)} {len(content)}\0".encode() + content)
    return found.hexdigest()


def kill_child(pid: int) -> int:
    """Kill a worker of a command's pool; how many were."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
    workers = [child for child in children if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]
    os.kill(int(workers[0]), signal.SIGKILL)
    return 1


def interrupt(pid: int) -> int:
    """Ctrl-C."""
    os.kill(pid, signal.SIGINT)
    return 0


@contextmanager
def scheduler() -> Iterator[tuple[str, Callable[[int], int]]]:
    """The address of a dask scheduler with workers of its own, and what kills one of them."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=WORKERS,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        scheduler_kwargs={"dashboard": False},
        silence_logs=50,
    ) as cluster:

        def kill(_: int) -> int:
            os.kill(cluster.workers[0].pid, signal.SIGKILL)
            return 1

        yield cluster.scheduler_address.replace("tcp://", "dask://"), kill


if __name__ == "__main__":
    main()
