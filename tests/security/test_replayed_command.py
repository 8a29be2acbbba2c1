"""A command recorded on a real daemon's serial line and played again: refused, counted, answered, after kill -9 too."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

from magcal_service.links import Link, Role, open_link
from magcal_service.wire.framing import FrameEncoder
from magcal_service.wire.messages import Command, CommandReply, Message, Status
from magcal_service.wire.seal import seal
from sim_sensor.demo.daemon_process import DaemonProcess
from sim_sensor.demo.pty_pair import PtyPair

KEY = bytes(range(32))
PATIENCE_S = 120.0  # where forty processes want two cores a daemon takes 60 s to start


class Operator:
    """Listens on the line and writes recorded bytes on it."""

    def __init__(self, link: Link, device: str) -> None:
        self.link, self.device = link, device
        self.replies: list[CommandReply] = []
        self.counters: dict[str, int] = {}

    def play(self, data: bytes) -> None:
        """Write bytes as they were recorded."""
        with open(self.device, "wb", buffering=0) as line:
            line.write(data)

    def until(self, what: Callable[[], object]) -> None:
        """Listen until it is so."""
        deadline = time.monotonic() + PATIENCE_S
        while not what():
            assert time.monotonic() < deadline, (self.replies, self.counters)
            for message in self.link.receive(0.05):
                self._heard(message)

    def _heard(self, message: Message) -> None:
        if isinstance(message, CommandReply):
            self.replies.append(message)
        elif isinstance(message, Status):
            self.counters = dict(message.counters)


def configured(folder: Path, device: str) -> Path:
    """The daemon's configuration."""
    key = folder / "line.key"
    key.write_text(KEY.hex())
    key.chmod(0o600)
    link = f"serial:{device}?key={key}&counter={folder / 'line.counter'}"
    config = folder / "magcal.toml"
    text = f'version = 1\nlink = {json.dumps(link)}\n[[craft]]\nname = "demo"\n[output]\nstatus_period_s = 1.0\n'
    config.write_text(text)
    return config


def test_a_replayed_command_is_refused_for_good(tmp_path: Path) -> None:
    """Carried out once; played again, and again to the next daemon after SIGKILL, it is refused each time."""
    command = Command(craft="demo", source="ops", sequence=1, time_ns=0, name="freeze")
    recorded = FrameEncoder(lambda payload: seal(KEY, 1000, payload)).encode(command)
    with PtyPair() as pair:
        config = configured(tmp_path, pair.paths[0])
        with open_link(f"serial:{pair.paths[1]}", Role.VIEWER, crafts=["demo"]) as link:
            operator = Operator(link, pair.paths[1])
            with DaemonProcess(config, tmp_path / "first.log") as first:
                operator.until(lambda: operator.counters)
                operator.play(recorded)
                operator.until(lambda: operator.replies)
                operator.play(recorded)
                operator.until(lambda: len(operator.replies) == 2 and "link.refused.replayed" in operator.counters)
                assert [reply.accepted for reply in operator.replies] == [True, False]
                assert operator.counters["link.refused.replayed"] == 1
                assert operator.counters["commands"] == 1
                os.kill(first.pid, signal.SIGKILL)
                first.stop()
            operator.counters = {}
            with DaemonProcess(config, tmp_path / "second.log"):
                operator.until(lambda: operator.counters)
                operator.play(recorded)
                operator.until(lambda: len(operator.replies) == 3 and "link.refused.replayed" in operator.counters)
                assert (operator.replies[2].accepted, operator.counters.get("commands", 0)) == (False, 0)
                assert operator.replies[2].text.startswith("replayed: counter 1000 was used")
