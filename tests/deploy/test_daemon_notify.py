"""The daemon as systemd sees it: a real process with a shipped configuration, ready, stopping, exit code."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MAGCAL = [sys.executable, "-c", "import sys; from magcal_service.cli.__main__ import main; sys.exit(main())"]


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    """A service manager's socket, at ``tmp_path / "notify"``."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.settimeout(60.0)
        yield listener


@pytest.fixture
def daemon(tmp_path: Path, manager: socket.socket) -> Iterator[subprocess.Popen[bytes]]:
    """``magcal run`` with the shipped peer configuration on a port of its own."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    config = tmp_path / "magcal.toml"
    config.write_text((ROOT / "deploy/config/zenoh-peer.toml").read_text().replace(":7447", f":{port}"))
    environment = os.environ | {"NOTIFY_SOCKET": str(tmp_path / "notify"), "PYTHONPATH": str(ROOT)}
    command = [*MAGCAL, "run", "--config", str(config)]
    with subprocess.Popen(command, env=environment, cwd=tmp_path, stderr=subprocess.DEVNULL) as process:
        yield process
        process.kill()


def told(manager: socket.socket, assignment: str) -> bool:
    """Whether the daemon says ``assignment`` within 20 s."""
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        if assignment in manager.recv(65536).decode().splitlines():
            return True
    return False


def test_the_daemon_says_when_it_is_ready(manager: socket.socket, daemon: subprocess.Popen[bytes]) -> None:
    assert told(manager, "READY=1")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_daemon_says_that_it_stops_and_ends_with_zero(
    manager: socket.socket, daemon: subprocess.Popen[bytes], number: int
) -> None:
    told(manager, "READY=1")
    daemon.send_signal(number)
    assert told(manager, "STOPPING=1")
    assert daemon.wait(10) == 0


def test_a_refused_configuration_ends_with_two_and_a_line_for_each_fault(tmp_path: Path) -> None:
    config = tmp_path / "magcal.toml"
    config.write_text('version = 1\nlnk = "loop:"\n[[craft]]\nname = "a b"\n')
    command = [*MAGCAL, "run", "--config", str(config)]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, [line.split(":")[1] for line in done.stderr.splitlines()]) == (
        2,
        [" craft[0].name", " lnk"],
    )
