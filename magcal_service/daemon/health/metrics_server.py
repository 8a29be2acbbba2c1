"""The metrics' port: serves the newest text to any number of clients at once, from one thread.

The daemon's loop renders the text and hands it over whole; the thread only sends the newest one.  It waits for all
connections together, so one that says nothing or reads nothing holds up no other, and it ends after ``PATIENCE_S``.
"""

from __future__ import annotations

import logging
import selectors
import socket
import threading
import time
from typing import Final

from magcal_service.base.errors import Fault, InputRefusedError, why_not
from magcal_service.base.version import __version__
from magcal_service.daemon.health.metrics import Metrics

_log = logging.getLogger("magcal.metrics")

PATIENCE_S: Final = 1.0
"""How long a connection may take for its request, and again for reading the answer [s]."""

MOST_CONNECTIONS: Final = 64
"""Connections at once; one more ends the oldest of those that have asked nothing yet, or the oldest of all."""

_REQUEST_BYTES: Final = 4096  # read of a request; its first line is all that matters
_NO_ROOM_S: Final = 0.1  # until the next try where the process has no descriptor left for a connection


class _Client:
    """One connection: what is left to send, None before its request, and until when it has time."""

    def __init__(self, connection: socket.socket, now_s: float) -> None:
        self.connection = connection
        self.left: memoryview | None = None
        self.until_s = now_s + PATIENCE_S


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
            self._socket.listen(MOST_CONNECTIONS)
            self._socket.setblocking(False)
        except OSError as error:
            self._socket.close()
            fault = Fault("health.metrics", address, f"a free port of this machine is accepted ({why_not(error)})")
            raise InputRefusedError([fault]) from None
        self.port: int = self._socket.getsockname()[1]
        self._text, self._rendered_s = "", time.monotonic()
        self._clients: dict[socket.socket, _Client] = {}
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._socket, selectors.EVENT_READ)
        self._closed = False
        self._thread = threading.Thread(target=self._serve, name="magcal-metrics", daemon=True)
        self._thread.start()

    def publish(self, text: str) -> None:
        """Take the text that is served from now on."""
        self._text, self._rendered_s = text, time.monotonic()

    def _serve(self) -> None:
        while not self._closed:
            for key, _ in self._selector.select(self._wait_s()):
                if key.fileobj is self._socket:
                    self._accept()
                elif isinstance(key.fileobj, socket.socket) and key.fileobj in self._clients:
                    self._move(self._clients[key.fileobj])
            now_s = time.monotonic()
            for client in [one for one in self._clients.values() if one.until_s <= now_s]:
                self._end(client)
        for client in list(self._clients.values()):
            self._end(client)

    def _wait_s(self) -> float | None:
        """Until the first connection's time is over [s]; None where there is none."""
        if not self._clients:
            return None
        return max(0.0, min(one.until_s for one in self._clients.values()) - time.monotonic())

    def _accept(self) -> None:
        try:
            connection, _ = self._socket.accept()
        except OSError as error:
            _log.debug("a connection for metrics was not taken: %s", error)
            if not self._closed:
                time.sleep(_NO_ROOM_S)
            return
        connection.setblocking(False)
        if len(self._clients) >= MOST_CONNECTIONS:
            self._end(min(self._clients.values(), key=lambda one: (one.left is not None, one.until_s)))
        self._clients[connection] = _Client(connection, time.monotonic())
        self._selector.register(connection, selectors.EVENT_READ)

    def _move(self, client: _Client) -> None:
        """Take the request of a connection, or send it more of its answer."""
        try:
            if client.left is None:
                client.left = memoryview(self._answer(client.connection.recv(_REQUEST_BYTES)))
                client.until_s = time.monotonic() + PATIENCE_S
                self._selector.modify(client.connection, selectors.EVENT_WRITE)
            client.left = client.left[client.connection.send(client.left) :]
            ended = not client.left
        except BlockingIOError:
            return
        except OSError as error:
            _log.debug("a request for metrics was not answered: %s", error)
            ended = True
        if ended:
            self._end(client)

    def _end(self, client: _Client) -> None:
        del self._clients[client.connection]
        self._selector.unregister(client.connection)
        client.connection.close()

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
            self._socket.shutdown(socket.SHUT_RDWR)  # wakes the thread
        except OSError as error:
            _log.debug("closing the metrics' port: %s", error)
        self._thread.join(2.0 * PATIENCE_S)
        self._socket.close()
        self._selector.close()

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
