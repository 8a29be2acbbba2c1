"""What recording costs: disk, processor, memory, and how long one message holds the service.

    python -m tests.benchmarks.bench_recorder

A flight at 1 Hz (sample, reference, vector and estimate each second) is recorded as the recorder's thread does it,
with a chunk every 5 s of flight; Linux only (it reads /proc).
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from magcal_service.config.daemon_settings import RecordConfig
from magcal_service.config.settings import CraftConfig, SensorConfig, SpinConfig
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.recordings.recorder import Recorder
from magcal_service.recordings.session_file import SessionFile
from magcal_service.recordings.session_files import SessionFolder
from magcal_service.recordings.session_info import session_info
from magcal_service.wire.messages import Estimate, Message
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation

SECONDS = 3600
FLUSH_S = 5
CRAFT = CraftConfig("paper", sensor=SensorConfig(noise_nt=300.0), spin=SpinConfig(rate_rpm=7.5))

MEMORY = """
import pathlib, sys, magcal_service.daemon.service
from magcal_service.config.settings import CraftConfig, RecordConfig
from magcal_service.wire.messages import MagnetometerSample
samples = [MagnetometerSample(craft="a", source="b", sequence=n, time_ns=n, field_body_nt=(1.0 * n, 2.0, 3.0))
           for n in range(5000)]
if sys.argv[1] == "yes":
    from magcal_service.recordings.recorder import Recorder
    with Recorder(RecordConfig(pathlib.Path(sys.argv[2]), min_free_mb=0.0), [CraftConfig("a")]) as recorder:
        for sample in samples:
            recorder.add(sample)
print(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmRSS")))
"""


def flight() -> list[tuple[bool, Message]]:
    """Everything that goes through a service in an hour, and whether a tick ended with it."""
    pipeline, passed = Pipeline(CRAFT), []
    for message in Simulation(load_scenario("paper"), 1, float(SECONDS)).messages():
        passed += [message, *pipeline.handle(message)]
    return [(isinstance(message, Estimate), message) for message in passed]


def measure_file(folder: Path, messages: list[tuple[bool, Message]]) -> None:
    """Disk and processor time, chunk by chunk."""
    path, file = SessionFolder(folder).create(time.time_ns())
    session = SessionFile(path, file, {}, {CRAFT.name: CRAFT})
    begin, ticks = time.thread_time(), 0
    for closes, message in messages:
        session.add(time.time_ns(), message)
        ticks += closes
        if closes and ticks % FLUSH_S == 0:
            session.flush()
    session.close()
    spent, size = time.thread_time() - begin, path.stat().st_size
    count = sum(kind.count for kind in session_info(path).kinds)
    print(f"disk: {size / 1e6:.2f} MB for an hour at 1 Hz, {size / count:.0f} bytes a record ({count} records)")
    print(f"processor: {spent / count * 1e6:.0f} us a record, {spent / SECONDS * 100:.3f} % of a core at 1 Hz")


def measure_adding(folder: Path, messages: list[tuple[bool, Message]]) -> None:
    """The service's own share."""
    with Recorder(RecordConfig(folder, min_free_mb=0.0), [CRAFT]) as recorder:
        times = []
        for _, message in messages[:4000]:
            begin = time.perf_counter()
            recorder.add(message)
            times.append(time.perf_counter() - begin)
    times.sort()
    print(f"adding one message: p50 {times[2000] * 1e6:.1f} us, p99 {times[3960] * 1e6:.1f} us")


def measure_memory(folder: Path) -> None:
    """Resident memory with and without a recorder in the process."""
    kilobytes = []
    for mode in ("no", "yes"):
        command = [sys.executable, "-c", MEMORY, mode, str(folder)]
        kilobytes.append(int(subprocess.run(command, capture_output=True, text=True, check=True).stdout))
    print(f"memory: {(kilobytes[1] - kilobytes[0]) / 1000:.1f} MB more, after 5000 messages")


def main() -> None:
    """Measure and print."""
    messages = flight()
    with tempfile.TemporaryDirectory() as name:
        measure_file(Path(name) / "file", messages)
        measure_adding(Path(name) / "adding", messages)
        measure_memory(Path(name) / "memory")


if __name__ == "__main__":
    main()
