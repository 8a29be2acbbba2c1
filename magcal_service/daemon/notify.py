"""Notifies systemd of the daemon's state: the ``sd_notify`` protocol, a datagram on the socket it names."""

from __future__ import annotations

import math
import os
import socket
import time
from collections.abc import Iterable, Iterator
from typing import Final, TypeVar

Item = TypeVar("Item")

READY = "READY=1"
STOPPING = "STOPPING=1"
WATCHDOG = "WATCHDOG=1"

_MORE_TIME: Final = "EXTEND_TIMEOUT_USEC=10000000"
"""Ten seconds more, as many as the unit gives to begin with."""

_ASK_AGAIN_S: Final = 2.0
"""Pause between two requests; choice: a fifth of what is asked for, so that one slow write does not miss it."""


def notify(*assignments: str) -> bool:
    """Send ``assignments`` such as ``READY``, ``WATCHDOG``, ``STOPPING`` or ``status("...")`` in one datagram.

    Returns False, having done nothing, where there is no service manager (``NOTIFY_SOCKET`` unset); it never blocks,
    and a manager that is gone or too busy to receive is False as well: the daemon runs on without it.
    Send ``WATCHDOG`` only when the service has made progress, not from a timer: a stuck daemon is to be restarted.

    Source: sd_notify(3); a name that starts with ``@`` is an abstract socket, unix(7).
    """
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address.startswith(("/", "@")):
        return False
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK) as out:
        try:
            out.sendto("\n".join(assignments).encode(), "\0" + address[1:] if address.startswith("@") else address)
        except OSError:
            return False
    return True


def asking_for_time(items: Iterable[Item]) -> Iterator[Item]:
    """The items, while the service manager is asked again and again for the time that going through them takes.

    For what is done between a request to stop and the end: a manager that hears nothing kills.  One that hangs at an
    item asks no more, and is killed as it should be.

    Source: sd_notify(3), ``EXTEND_TIMEOUT_USEC``.
    """
    asked_s = -math.inf
    for item in items:
        if time.monotonic() - asked_s >= _ASK_AGAIN_S:
            notify(_MORE_TIME)
            asked_s = time.monotonic()
        yield item


def status(text: str) -> str:
    """The assignment that ``systemctl status`` shows as one line."""
    return "STATUS=" + " ".join(text.split())


def watchdog_period_s() -> float | None:
    """Half of the time within which ``WATCHDOG`` has to arrive [s]; None where this process is not watched.

    Source: sd_watchdog_enabled(3).
    """
    watched = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
    micros = os.environ.get("WATCHDOG_USEC", "")
    return int(micros) / 2e6 if watched and micros.isdecimal() and int(micros) > 0 else None
