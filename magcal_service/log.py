"""Log lines as JSON on stderr: one object a line, so that a journal can be searched by field."""

from __future__ import annotations

import contextlib
import fcntl
import json
import logging
import os
import sys
from datetime import UTC, datetime
from typing import Any


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


_stdout_free = False
_PIPE_BYTES = 1 << 20  # the most that Linux gives a process without privileges (fs.pipe-max-size, its default)


def to_stderr(level: int = logging.INFO) -> None:
    """Send every log line of the process to stderr; its standard output is then free for ``stdout_as_pipe``."""
    global _stdout_free
    _stdout_free = True
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines())
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(level)


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
