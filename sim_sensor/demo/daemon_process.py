"""The daemon as a second process: started, watched, stopped."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from magcal_service.base.errors import MagcalError

__all__ = ["DaemonDiedError", "DaemonProcess"]

_LAST_LINES = 20  # of the log, enough for a whole traceback of the daemon


class DaemonDiedError(MagcalError):
    """The daemon ended before it was asked to; the text carries its exit code and its last log lines."""

    exit_code = 1


class DaemonProcess:
    """``magcal run --config FILE`` in a process of its own; leaving the context stops it.

    Parameters
    ----------
    config: its configuration file.
    log: file that takes its standard error and output.
    command: what to run instead of this Python's ``magcal run``; ``--config FILE`` is appended.

    It has a process group of its own: Ctrl-C in the terminal reaches its parent alone, which then stops it in order.
    """

    def __init__(self, config: Path, log: Path, command: Sequence[str] | None = None) -> None:
        self.log = log
        if command is None:
            command = (sys.executable, "-m", "magcal_service.cli", "run")
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                [*command, "--config", str(config)],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                process_group=0,
            )

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def check(self) -> None:
        """Raise DaemonDiedError where the process has ended."""
        code = self._process.poll()
        if code is not None:
            raise DaemonDiedError(f"the daemon ended early with exit code {code}; its last lines:\n{self.last_lines()}")

    def last_lines(self) -> str:
        """The end of its log."""
        lines = self.log.read_text(errors="replace").splitlines()[-_LAST_LINES:]
        return "\n".join(lines) if lines else "(it wrote nothing)"

    @property
    def running(self) -> bool:
        """Whether the process has not ended yet."""
        return self._process.poll() is None

    def ask_to_stop(self) -> None:
        """Send SIGTERM, and come back at once."""
        if self.running:
            self._process.send_signal(signal.SIGTERM)

    def stop(self, timeout_s: float = 10.0) -> int:
        """Ask it to end, kill it after ``timeout_s`` [s]; its exit code (negative: the signal)."""
        self.ask_to_stop()
        try:
            return self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.stop()
