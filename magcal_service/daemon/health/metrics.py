"""Metrics as Prometheus text, on a separate loopback port.

The daemon's loop renders the text and hands it over whole; the server's one thread only sends the newest text.
It answers one request after the other, reads one packet of each and waits a second for it at most, so no client
can hold memory or block the daemon.

Format: Prometheus text exposition format 0.0.4.
"""

from __future__ import annotations

import logging
import socket
import threading
import time
from collections.abc import Iterable, Mapping
from typing import Final

from magcal_service.errors import Fault, InputRefusedError
from magcal_service.version import __version__

_log = logging.getLogger("magcal.metrics")

_PATIENCE_S: Final = 1.0  # for one request: one thread serves all, and a scraper on this machine sends at once
_REQUEST_BYTES: Final = 4096  # read of a request; its first line is all that matters
_BACKLOG: Final = 8  # connections that wait for the thread; a scraper has one

Labels = Mapping[str, str]
Sample = tuple[str, Labels, float]


class Metrics:
    """Collects families of samples and renders them."""

    def __init__(self) -> None:
        self._lines: list[str] = []

    def add(self, name: str, kind: str, text: str, samples: Iterable[tuple[Labels, float]]) -> None:
        """One family.

        Parameters
        ----------
        name: without the prefix ``magcal_``.
        kind: ``counter`` or ``gauge``.
        text: what it counts.
        samples: labels and value of each.
        """
        self._head(name, kind, text)
        self._lines += [_sample(f"magcal_{name}", labels, value) for labels, value in samples]

    def add_histogram(self, name: str, text: str, bounds: Iterable[float], counts: list[int], total: float) -> None:
        """A histogram: counts by bucket, the last one beyond the last bound, and the sum of all values."""
        self._head(name, "histogram", text)
        reached = 0
        for bound, count in zip(bounds, counts, strict=False):
            reached += count
            self._lines.append(_sample(f"magcal_{name}_bucket", {"le": repr(bound)}, reached))
        self._lines.append(_sample(f"magcal_{name}_bucket", {"le": "+Inf"}, sum(counts)))
        self._lines.append(_sample(f"magcal_{name}_sum", {}, total))
        self._lines.append(_sample(f"magcal_{name}_count", {}, sum(counts)))

    def _head(self, name: str, kind: str, text: str) -> None:
        self._lines += [f"# HELP magcal_{name} {text}", f"# TYPE magcal_{name} {kind}"]

    def render(self) -> str:
        """The whole text."""
        return "\n".join(self._lines) + "\n"


def _sample(name: str, labels: Labels, value: float) -> str:
    inner = ",".join(f'{key}="{_escaped(label)}"' for key, label in labels.items())
    number = repr(float(value)) if isinstance(value, float) else str(value)
    return f"{name}{{{inner}}} {number}" if inner else f"{name} {number}"


def _escaped(label: str) -> str:
    return label.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")


class MetricsServer:
    """Serves ``GET /metrics`` until it is closed.

    Parameters
    ----------
    address: ``HOST:PORT`` of the loopback, as the configuration has checked it; port 0 takes any that is free.

    Raises InputRefusedError where the port is taken.
    """

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        family = socket.AF_INET6 if host.startswith("[") else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.bind((host.strip("[]"), int(port)))
            self._socket.listen(_BACKLOG)
        except OSError as error:
            self._socket.close()
            fault = Fault("health.metrics", address, f"a free port of this machine is accepted ({error.strerror})")
            raise InputRefusedError([fault]) from None
        self.port: int = self._socket.getsockname()[1]
        self._text, self._rendered_s = "", time.monotonic()
        self._closed = False
        self._thread = threading.Thread(target=self._serve, name="magcal-metrics", daemon=True)
        self._thread.start()

    def publish(self, text: str) -> None:
        """Take the text that is served from now on."""
        self._text, self._rendered_s = text, time.monotonic()

    def _serve(self) -> None:
        while not self._closed:
            try:
                connection, _ = self._socket.accept()
            except OSError:
                return
            with connection:
                try:
                    connection.settimeout(_PATIENCE_S)
                    connection.sendall(self._answer(connection.recv(_REQUEST_BYTES)))
                except OSError as error:
                    _log.debug("a request for metrics was not answered: %s", error)

    def _answer(self, request: bytes) -> bytes:
        method, _, rest = request.partition(b" ")
        path = rest.partition(b" ")[0].partition(b"?")[0]
        if (method, path) != (b"GET", b"/metrics"):
            return _response("404 Not Found", "GET /metrics is accepted\n")
        age = Metrics()
        text = "Time since the daemon's loop last came by here."
        age.add("loop_age_seconds", "gauge", text, [({}, time.monotonic() - self._rendered_s)])
        return _response("200 OK", self._text + age.render())

    def close(self) -> None:
        """Stop serving."""
        self._closed = True
        try:
            self._socket.shutdown(socket.SHUT_RDWR)  # wakes the thread out of accept
        except OSError as error:
            _log.debug("closing the metrics' port: %s", error)
        self._socket.close()
        self._thread.join(2.0 * _PATIENCE_S)

    def __enter__(self) -> MetricsServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _response(status: str, body: str) -> bytes:
    content = body.encode()
    head = (
        f"HTTP/1.1 {status}\r\nContent-Type: text/plain; version=0.0.4; charset=utf-8\r\n"
        f"Content-Length: {len(content)}\r\nConnection: close\r\nServer: magcal/{__version__}\r\n\r\n"
    )
    return head.encode() + content
