"""A daemon in a process of its own, and a sensor node in the test that keeps the books."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import time
import tty
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from threading import Event, Thread

from magcal_service.links import Role, open_link
from magcal_service.links.zenoh import ZenohLink
from magcal_service.wire.messages import CalibratedVector, Estimate, MagnetometerSample, Message, Status
from sim_sensor.demo.daemon_process import DaemonProcess
from sim_sensor.demo.flow import WindowedLink
from sim_sensor.demo.pty_pair import PtyPair
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation

PATIENCE_S = 120.0  # a daemon takes 30 s to start where 20 processes want one core
CRAFT = """
[[craft]]
name = "{name}"
[craft.sensor]
noise_nt = 300.0
[craft.spin]
rate_rpm = 7.5
"""


def free_port() -> int:
    """A TCP port of 127.0.0.1 that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


def write_config(folder: Path, link: str, crafts: Sequence[str] = ("paper",), csv: Path | None = None) -> Path:
    """A configuration file for these crafts."""
    rows = "" if csv is None else f"csv = {json.dumps(str(csv))}\n"
    text = f"version = 1\nlink = {json.dumps(link)}\n{''.join(CRAFT.format(name=name) for name in crafts)}"
    path = folder / "magcal.toml"
    path.write_text(f"{text}[output]\nstatus_period_s = 1.0\n{rows}")
    return path


def wait_for(told: str, log: Path) -> None:
    """Return once a log contains a text."""
    deadline = time.monotonic() + PATIENCE_S
    while told not in log.read_text(errors="replace"):
        assert time.monotonic() < deadline, f"{told!r} was not said within {PATIENCE_S} s: {log.read_text()}"
        time.sleep(0.02)


@contextlib.contextmanager
def daemon(config: Path, number: int = 1) -> Iterator[DaemonProcess]:
    """``magcal run`` on a configuration, once it serves."""
    with DaemonProcess(config, config.with_name(f"daemon-{number}.log")) as process:
        wait_for('"text": "serving', process.log)
        yield process


def kill(process: DaemonProcess) -> None:
    """SIGKILL: no chance to say goodbye."""
    os.kill(process.pid, signal.SIGKILL)
    assert process.stop() == -signal.SIGKILL


@cache
def stream(craft: str = "paper", seconds: int = 600, seed: int = 1) -> tuple[Message, ...]:
    """The paper's scenario under a craft's name: a reference and a sample a second."""
    messages = Simulation(load_scenario("paper"), seed, float(seconds)).messages()
    return tuple(replace(message, craft=craft) for message in messages)


class Node:
    """A sensor node on a real link; every sample sent is on its books until an answer names it.

    Parameters
    ----------
    address: its end of the link.
    crafts: whose messages it sends.
    """

    def __init__(self, address: str, crafts: Sequence[str] = ("paper",)) -> None:
        self.link = open_link(address, Role.NODE, crafts=crafts)
        self.flow = WindowedLink(self.link, 1000, self._arrived, patience_s=PATIENCE_S)
        self.sent = 0
        self.answers: Counter[tuple[str, int]] = Counter()
        self.estimates: list[Estimate] = []
        self.status: dict[str, Status] = {}

    def _arrived(self, message: Message) -> None:
        if isinstance(message, CalibratedVector):
            self.answers[message.craft, message.sequence] += 1
        elif isinstance(message, Estimate):
            self.estimates.append(message)
        elif isinstance(message, Status):
            self.status[message.craft] = message

    def send(self, messages: Sequence[Message]) -> None:
        """Send, without waiting for answers."""
        for message in messages:
            self.flow.send(message)
            self.sent += isinstance(message, MagnetometerSample)

    def settle(self) -> None:
        """Return once every sample that is on the way has been answered."""
        self.flow.wait_for_room()
        assert self.flow.counters["unanswered"] == 0

    def listen(self, seconds: float) -> None:
        """Take in what arrives for a while."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self.flow.receive(0.02)

    def until(self, told: str, what: object) -> None:
        """Listen until the daemon is heard again, or told so much; ``what`` is a call that says whether it is so."""
        assert callable(what)
        deadline = time.monotonic() + PATIENCE_S
        while not what():
            assert time.monotonic() < deadline, f"{told}: { {craft: self.counters(craft) for craft in self.status} }"
            self.flow.receive(0.02)

    @property
    def connected(self) -> bool:
        """Whether the node's zenoh session has the daemon at its other end."""
        assert isinstance(self.link, ZenohLink)
        return self.link.connected

    def until_heard(self) -> None:
        """Listen until a status arrives that was sent from now on."""
        self.status.clear()
        self.until("no status", lambda: self.status)
        if isinstance(self.link, ZenohLink):  # a status that came proves one direction only
            link = self.link
            self.until("nobody serves", lambda: any(one.role is Role.SERVICE for one in link.alive()))
            self.listen(0.5)

    def until_accepted(self, count: int, craft: str = "paper") -> None:
        """Listen until the daemon says that it has accepted so many samples."""
        self.until(f"{count} samples were not accepted", lambda: self.counters(craft).get("accepted", 0) >= count)

    def counters(self, craft: str = "paper") -> dict[str, int]:
        """The daemon's newest counters."""
        return dict(self.status[craft].counters) if craft in self.status else {}

    def __enter__(self) -> Node:
        return self

    def __exit__(self, *_: object) -> None:
        self.link.close()


class CutCable:
    """A serial cable between two devices that can be cut and joined again; what is sent meanwhile is gone.

    ``paths`` are its ends.
    """

    def __init__(self) -> None:
        self._pairs = (PtyPair(), PtyPair())
        self.paths = (self._pairs[0].paths[0], self._pairs[1].paths[1])
        self._inner = [
            os.open(path, os.O_RDWR | os.O_NOCTTY) for path in (self._pairs[0].paths[1], self._pairs[1].paths[0])
        ]
        for file in self._inner:
            tty.setraw(file)
        self.cut = Event()
        self.lost_bytes = 0
        self._stop = Event()
        self._thread = Thread(target=self._carry)
        self._thread.start()

    def _carry(self) -> None:
        first, second = self._inner
        other = {first: second, second: first}
        while not self._stop.is_set():
            for file in select.select(self._inner, [], [], 0.05)[0]:
                data = os.read(file, 65536)
                if self.cut.is_set():
                    self.lost_bytes += len(data)
                else:
                    os.write(other[file], data)

    def __enter__(self) -> CutCable:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        for file in self._inner:
            os.close(file)
        for pair in self._pairs:
            pair.close()
