"""A daemon of a checkout, in a process of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from tests.daemon.service_processes import CRAFT, free_port, wait_for

ROOT = Path(__file__).resolve().parents[3]
TICKS_S = os.sysconf("SC_CLK_TCK")


class Served:
    """``magcal run`` of a checkout, from its start until the block ends.

    Parameters
    ----------
    checkout: folder of the packages that are run.
    folder: of its configuration and log.
    craft: names of the craft that it serves.
    extra: tables of its configuration after the craft.
    """

    def __init__(self, checkout: Path, folder: Path, craft: list[str], extra: str = "") -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.port = free_port()
        self.endpoint = f"tcp/127.0.0.1:{self.port}"
        self.address = f"zenoh:{self.endpoint}"
        config, self.log = folder / "magcal.toml", folder / "daemon.log"
        tables = "".join(CRAFT.format(name=name) for name in craft)
        config.write_text(f'version = 1\nlink = "{self.address}"\n{tables}{extra}', encoding="utf-8")
        environment = dict(os.environ, PYTHONPATH=str(checkout), OPENBLAS_NUM_THREADS="1")
        command = [sys.executable, "-m", "magcal_service.cli", "run", "--config", str(config)]
        with self.log.open("w") as log:
            self._process = subprocess.Popen(command, cwd=checkout, stderr=log, env=environment)

    def cpu_s(self) -> float:
        """User and system time so far [s]."""
        fields = Path(f"/proc/{self._process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / TICKS_S

    def __enter__(self) -> Served:
        wait_for('"text": "serving', self.log)
        return self

    def __exit__(self, *_: object) -> None:
        self._process.send_signal(signal.SIGTERM)
        try:
            self._process.wait(30.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def percentile(values: list[float], share: float) -> float:
    """The value that this share of all does not exceed; not a number where there is none."""
    return sorted(values)[min(len(values) - 1, int(share * len(values)))] if values else float("nan")


def now_s() -> float:
    """The clock of all processes of this machine [s]."""
    return time.clock_gettime(time.CLOCK_MONOTONIC)
