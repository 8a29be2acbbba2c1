"""Log lines on stderr: JSON, one object a line, so that a journal can be searched by field; plain on a terminal."""

from __future__ import annotations

import contextlib
import fcntl
import json
import logging
import os
import select
import sys
from datetime import UTC, datetime
from typing import Any, Final

from magcal_service.base.errors import printable


class JsonLines(logging.Formatter):
    """Time (UTC), level, logger and text of a record as one JSON object, and the ``fields`` it brings."""

    def format(self, record: logging.LogRecord) -> str:
        """One line for one record."""
        entry: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "text": record.getMessage(),
        }
        entry |= getattr(record, "fields", {})
        if record.exc_info:
            entry["exception"] = self.formatException(record.exc_info)
        return json.dumps(entry, ensure_ascii=False)


_IN_COLOUR: Final = "\x1b[{}m{}\x1b[0m"


class PlainLines(logging.Formatter):
    """The same for people: time (UTC), level, text and fields; warnings in colour where ``colour`` says so.

    What a terminal might obey, control characters and the like, is shown as an escape.
    """

    _COLOURS: Final = {logging.WARNING: "33", logging.ERROR: "31", logging.CRITICAL: "31"}

    def __init__(self, *, colour: bool) -> None:
        super().__init__()
        self._colour = colour

    def format(self, record: logging.LogRecord) -> str:
        """One line for one record, and the lines of its exception."""
        when = datetime.fromtimestamp(record.created, UTC).strftime("%Y-%m-%d %H:%M:%SZ")
        level = f"{record.levelname.lower():<7}"
        code = self._COLOURS.get(record.levelno) if self._colour else None
        fields = json.dumps(found, ensure_ascii=False) if (found := getattr(record, "fields", {})) else ""
        text = printable(" ".join(filter(None, (record.getMessage(), fields))))
        line = f"{when} {level if code is None else _IN_COLOUR.format(code, level)} {text}"
        return f"{line}\n{self.formatException(record.exc_info)}" if record.exc_info else line


_WAIT_MS: Final = 100  # choice: a reader that is only slow comes in time, and a tick is a second


class UnheldLines(logging.Handler):
    """Writes log lines to a file and is not held up by whoever reads them: a pipe that nobody reads is full at once.

    What finds no room within ``_WAIT_MS`` is lost, and all after it until there is room again; then it is said how many
    lines that were.

    Parameters
    ----------
    file: descriptor; whether it waits is left as it is.
    """

    def __init__(self, file: int) -> None:
        super().__init__()
        self._file = file
        self._room = select.poll()
        self._room.register(file, select.POLLOUT)
        self._lost = 0
        self._torn = False  # a line that had begun found no more room

    def emit(self, record: logging.LogRecord) -> None:
        """Write one line, or count it as lost."""
        try:
            line = self.format(record)
            if self._lost and self._written(self.format(self._told(record))):
                self._lost = 0
            if self._lost or not self._written(line):
                self._lost += 1
        except Exception:
            self.handleError(record)

    def _told(self, record: logging.LogRecord) -> logging.LogRecord:
        told = {"name": "magcal.log", "levelno": logging.WARNING, "levelname": "WARNING", "created": record.created}
        return logging.makeLogRecord({**told, "msg": f"{self._lost} log lines are lost: nobody read them"})

    def _written(self, line: str) -> bool:
        """Whether all of a line found room; so much as fits for certain is written at once."""
        left = memoryview(f"{chr(10) if self._torn else ''}{line}\n".encode(errors="backslashreplace"))
        size = len(left)
        while left:
            try:
                written = os.write(self._file, left[: select.PIPE_BUF]) if self._has_room() else 0
            except OSError:  # nobody is at its other end any more, or its disk is full
                written = 0
            if not written:
                self._torn |= len(left) < size
                return False
            left = left[written:]
        self._torn = False
        return True

    def _has_room(self) -> bool:
        return bool(self._room.poll(0 if self._lost else _WAIT_MS))


_stdout_free = False
_PIPE_BYTES = 1 << 20  # the most that Linux gives a process without privileges (fs.pipe-max-size, its default)


def to_stderr(level: int = logging.INFO) -> None:
    """Send every log line of the process to stderr: plain on a terminal, JSON elsewhere.

    Its standard output is then free for ``stdout_as_pipe``.
    """
    global _stdout_free
    _stdout_free = True
    handler = _stderr_handler()
    at_terminal = sys.stderr.isatty()
    handler.setFormatter(PlainLines(colour=not os.environ.get("NO_COLOR")) if at_terminal else JsonLines())
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(level)


def _stderr_handler() -> logging.Handler:
    try:
        return UnheldLines(sys.stderr.fileno())
    except (OSError, ValueError):  # an object that only looks like a file
        return logging.StreamHandler(sys.stderr)


def stdout_as_pipe() -> int | None:
    """Put a pipe in the place of standard output and give its reading end, once.

    A library that logs to standard output and nowhere else can so be listened to.  Writing to it never waits: what does
    not fit is lost.  None where this process has not given its standard output away.
    """
    global _stdout_free
    if not _stdout_free:
        return None
    _stdout_free = False
    reading, writing = os.pipe()
    with contextlib.suppress(OSError):  # less room where the system's limit is lower
        fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
    os.set_blocking(writing, False)
    os.dup2(writing, 1)
    os.close(writing)
    return reading
