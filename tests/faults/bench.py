"""The bench that the faults are tried on: a daemon and its node, and what lies between them."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from threading import Event, Thread
from types import TracebackType
from typing import Self

from magcal_service.ticks.rejection import Rejection
from magcal_service.wire.messages import CalibratedVector, Estimate, MagnetometerSample, Message
from sim_sensor.demo.daemon_process import DaemonProcess
from sim_sensor.demo.pty_pair import PtyPair
from tests.daemon.service_processes import PATIENCE_S, Node, wait_for

RECORD_FLUSH_S = 0.2
QUIET_S = 60.0  # what has not come by then is lost


class Witness(Node):
    """A node that knows when it was last answered, and whose own estimates it heard."""

    def __init__(self, address: str, crafts: Sequence[str] = ("paper",)) -> None:
        super().__init__(address, crafts)
        self.first_s: dict[tuple[str, int], float] = {}  # when each sample was first answered
        self.sent_s: dict[tuple[str, int], float] = {}
        self.marked_s: float | None = None
        self.recovered_s: list[float] = []
        self.estimate_s: dict[str, list[float]] = {craft: [] for craft in crafts}

    def _arrived(self, message: Message) -> None:
        super()._arrived(message)
        if isinstance(message, Estimate):
            self.estimate_s.setdefault(message.craft, []).append(time.monotonic())
        if isinstance(message, CalibratedVector):
            now_s = time.monotonic()
            self.first_s.setdefault((message.craft, message.sequence), now_s)
            if self.marked_s is not None:
                self.recovered_s.append(now_s - self.marked_s)
                self.marked_s = None

    def send(self, messages: Sequence[Message]) -> None:
        """Send, and note when."""
        for message in messages:
            if isinstance(message, MagnetometerSample):
                self.sent_s[message.craft, message.sequence] = time.monotonic()
            super().send([message])

    def mark(self) -> None:
        """The fault is over: the next vector says how long it took."""
        self.marked_s = time.monotonic()

    @property
    def on_the_books(self) -> int:
        """Samples that the daemon has accepted or refused, by its newest status."""
        return self.counters().get("accepted", 0) + self.refused

    @property
    def refused(self) -> int:
        """Samples that the daemon has refused, by its newest status."""
        return sum(self.counters().get(kind, 0) for kind in Rejection)


class Feeder(Thread):
    """Feeds a node's messages at a steady rate, in a thread that the link belongs to.

    Parameters
    ----------
    node: what sends; nobody else may touch it until the feeder has been joined.
    messages: in order.
    rate_hz: messages a second.
    """

    def __init__(self, node: Witness, messages: Sequence[Message], rate_hz: float) -> None:
        super().__init__(name="feeder")
        self.node, self.messages, self.rate_hz = node, messages, rate_hz
        self.position = 0
        self.over = Event()
        self.error: BaseException | None = None

    def run(self) -> None:
        """Send what is due, listen in between, and until told that it is over."""
        try:
            begun_s = time.monotonic()
            while not self.over.is_set():
                due = min(len(self.messages), int((time.monotonic() - begun_s) * self.rate_hz) + 1)
                if due > self.position:
                    self.node.send(self.messages[self.position : due])
                    self.position = due
                self.node.flow.receive(0.005)
        except BaseException as error:
            self.error = error

    def until(self, what: Callable[[], bool], told: str, patience_s: float = 2 * PATIENCE_S) -> None:
        """Wait while it feeds."""
        deadline_s = time.monotonic() + patience_s
        while not what():
            if self.error is not None:
                raise self.error
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"{told}: {self.node.counters()}")
            time.sleep(0.01)

    def reach(self, position: int) -> None:
        """Wait until so many messages have been sent."""
        self.until(lambda: self.position >= position, f"message {position} was not sent")

    def settle(self, lost: Callable[[], int] = lambda: 0) -> None:
        """Wait until everything is sent, and answered or on the daemon's books, or nothing has come for a while.

        ``lost`` is how many samples are lost by design.
        """
        self.reach(len(self.messages))
        self._come(lambda: max(len(self.node.first_s), self.node.on_the_books), lost)

    def close_books(self, lost: Callable[[], int] = lambda: 0) -> None:
        """Settle, and wait for a status of the newest daemon that has everything on its books.

        An answer does not tell that: a daemon that was killed may have given it, and the one after it, which works
        through the history in turns, sends a status between two of them.
        """
        self.settle(lost)
        self.fresh_status()
        self._come(lambda: self.node.on_the_books, lost)
        self.fresh_status()

    def _come(self, count: Callable[[], int], lost: Callable[[], int]) -> None:
        before, since_s = -1, time.monotonic()
        while (now := count()) < self.node.sent - lost():
            if now != before:
                before, since_s = now, time.monotonic()
            elif time.monotonic() - since_s > QUIET_S:
                return
            time.sleep(0.02)

    def fresh_status(self, count: int = 2) -> None:
        """Wait for statuses that were sent from now on."""
        for _ in range(count):
            self.node.status.clear()
            self.until(lambda: bool(self.node.status), "no status")

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.over.set()
        self.join()
        if self.error is not None and error is None:
            raise self.error


class Daemons:
    """One daemon after the other on the same configuration; leaving stops the one that runs."""

    def __init__(self, config: Path, command: Sequence[str] | None = None) -> None:
        self.config, self.command = config, command
        self.number = 0
        self.process = self.start()

    def start(self) -> DaemonProcess:
        """The next one, once it serves."""
        self.number += 1
        log = self.config.with_name(f"daemon-{self.number}.log")
        self.process = DaemonProcess(self.config, log, self.command)
        try:
            wait_for('"text": "serving', log)
        except BaseException:
            self.process.stop()
            raise
        return self.process

    def kill(self) -> None:
        """SIGKILL."""
        os.kill(self.process.pid, signal.SIGKILL)
        self.process.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.running:
            os.kill(self.process.pid, signal.SIGCONT)
        self.process.stop()


@contextlib.contextmanager
def stopped(pid: int) -> Iterator[None]:
    """A process that does nothing for a while."""
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


def with_recording(config: Path, folder: Path) -> Path:
    """The configuration with a recording that is flushed often and tried again soon."""
    settings = f"flush_s = {RECORD_FLUSH_S}\nretry_s = 0.5\nmin_free_mb = 0.0\n"
    config.write_text(f"{config.read_text()}[record]\ndirectory = {json.dumps(str(folder))}\n{settings}")
    return config


def estimates_by_time(node: Witness) -> dict[int, Estimate]:
    """The newest estimate that was heard for each tick."""
    return {estimate.time_ns: estimate for estimate in node.estimates}


class Proxy:
    """A TCP connection that can be cut: what is under way is gone, and nobody is let in until it is mended."""

    def __init__(self, port: int) -> None:
        self._target = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._pairs: dict[socket.socket, socket.socket] = {}
        self.cut, self._stop = Event(), Event()
        self._thread = Thread(target=self._work)
        self._thread.start()

    def _work(self) -> None:
        while not self._stop.is_set():
            if self.cut.is_set():
                self._drop(list(self._pairs))
            for end in select.select([self._listener, *self._pairs], [], [], 0.02)[0]:
                if end is self._listener:
                    self._accept(end.accept()[0])
                elif end in self._pairs:
                    self._carry(end)
        self._drop(list(self._pairs))
        self._listener.close()

    def _accept(self, near: socket.socket) -> None:
        if self.cut.is_set():
            near.close()
            return
        try:
            far = socket.create_connection(("127.0.0.1", self._target), timeout=1.0)
        except OSError:
            near.close()
            return
        self._pairs |= {near: far, far: near}

    def _carry(self, end: socket.socket) -> None:
        try:
            data = end.recv(65536)
            if data:
                self._pairs[end].sendall(data)
                return
        except OSError:
            pass
        self._drop([end])

    def _drop(self, ends: list[socket.socket]) -> None:
        for end in ends:
            other = self._pairs.pop(end, None)
            end.close()
            if other is not None:
                self._pairs.pop(other, None)
                other.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()


class Cable:
    """A serial cable on which what goes to the daemon can be altered; ``paths`` are the daemon's end and the node's.

    Parameters
    ----------
    alter: what becomes of the bytes on their way to the daemon.
    """

    def __init__(self, alter: Callable[[bytes], bytes]) -> None:
        self._pairs = (PtyPair(), PtyPair())
        self.paths = (self._pairs[0].paths[0], self._pairs[1].paths[1])
        inner = (self._pairs[0].paths[1], self._pairs[1].paths[0])
        self._service, self._node = (os.open(path, os.O_RDWR | os.O_NOCTTY) for path in inner)
        for file in (self._service, self._node):
            tty.setraw(file)
        self._alter = alter
        self._stop = Event()
        self._writing = threading.Lock()
        self._thread = Thread(target=self._carry)
        self._thread.start()

    def _carry(self) -> None:
        while not self._stop.is_set():
            for file in select.select([self._service, self._node], [], [], 0.05)[0]:
                data = os.read(file, 65536)
                if file == self._service:
                    write_all(self._node, data)
                else:
                    with self._writing:
                        write_all(self._service, self._alter(data))

    def inject(self, data: bytes) -> None:
        """Noise on the line, between what the node sends."""
        with self._writing:
            write_all(self._service, data)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        for file in (self._service, self._node):
            os.close(file)
        for pair in self._pairs:
            pair.close()


def write_all(file: int, data: bytes) -> None:
    """Every byte, in its order."""
    while data:
        data = data[os.write(file, data) :]
