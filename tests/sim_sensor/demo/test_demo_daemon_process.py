"""Starting, watching and stopping the daemon's process."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path

import pytest

from sim_sensor.demo.daemon_process import DaemonDiedError, DaemonProcess

POLITE = """
import signal, sys, time
signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
print("ready", flush=True)
time.sleep(60)
"""
STUBBORN = POLITE.replace("lambda *_: sys.exit(0)", "signal.SIG_IGN")


def start(tmp_path: Path, code: str) -> DaemonProcess:
    return DaemonProcess(tmp_path / "magcal.toml", tmp_path / "log", command=(sys.executable, "-c", code))


def wait_until_ready(daemon: DaemonProcess) -> None:
    for _ in range(500):
        if "ready" in daemon.last_lines():
            return
        time.sleep(0.01)
    raise AssertionError(daemon.last_lines())


def watch(daemon: DaemonProcess) -> None:
    for _ in range(500):
        daemon.check()
        time.sleep(0.01)


def test_a_polite_process_ends_with_its_own_code(tmp_path: Path) -> None:
    with start(tmp_path, POLITE) as daemon:
        wait_until_ready(daemon)
        daemon.check()
        assert daemon.stop() == 0


def test_a_process_that_ignores_sigterm_is_killed(tmp_path: Path) -> None:
    with start(tmp_path, STUBBORN) as daemon:
        wait_until_ready(daemon)
        assert daemon.stop(timeout_s=0.1) == -signal.SIGKILL


def test_leaving_the_context_leaves_no_process(tmp_path: Path) -> None:
    with start(tmp_path, POLITE) as daemon:
        wait_until_ready(daemon)
    with pytest.raises(DaemonDiedError, match="exit code 0"):
        daemon.check()


def test_an_early_end_is_told_with_exit_code_and_last_lines(tmp_path: Path) -> None:
    with start(tmp_path, "import sys; print('ready: no such thing', file=sys.stderr); sys.exit(7)") as daemon:
        wait_until_ready(daemon)
        with pytest.raises(DaemonDiedError, match=r"(?s)exit code 7;.*no such thing"):
            watch(daemon)


def test_the_configuration_is_passed_on(tmp_path: Path) -> None:
    code = "import sys; print(sys.argv[1:], 'ready', flush=True); import time; time.sleep(60)"
    with start(tmp_path, code) as daemon:
        wait_until_ready(daemon)
        assert daemon.last_lines().startswith(str(["--config", str(tmp_path / "magcal.toml")]))
