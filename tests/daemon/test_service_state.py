"""kill -9, restart: the daemon goes on from its checkpoint; commands over the link change its state and say so."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from magcal_service.base.errors import ConfigError
from magcal_service.config.reader import load_config
from magcal_service.daemon.checkpoints.files import decode
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.daemon.run import run_daemon
from magcal_service.links import Link, Role, open_link
from magcal_service.wire.messages import Command, CommandReply, Estimate, Message, Status
from sim_sensor.demo.pty_pair import PtyPair
from tests.daemon.service_processes import CRAFT, PATIENCE_S, Node, daemon, free_port, kill, stream

SECONDS = 900


def write_config(folder: Path, link: str, period_s: float = 10.0) -> Path:
    """A configuration with checkpoints, by default with the shortest period there is."""
    state = f"[state]\ndirectory = {json.dumps(str(folder / 'state'))}\nperiod_s = {period_s}\n"
    path = folder / "magcal.toml"
    text = f"version = 1\nlink = {json.dumps(link)}\n{CRAFT.format(name='paper')}{state}"
    path.write_text(f"{text}[output]\nstatus_period_s = 1.0\n")
    return path


def newest_samples(folder: Path) -> int:
    """Samples in the newest checkpoint, -1 where there is none.

    The file is read as it is: a ``StateStore`` of this process would sweep away what the daemon has half written.
    """
    newest = max((folder / "state" / "paper").glob("*.state"), default=None)
    return -1 if newest is None else decode(newest.read_bytes()).samples


def uninterrupted(config: Path, flight: Sequence[Message]) -> Estimate:
    """The estimate before the last of a craft that takes the whole flight."""
    pipeline = Pipeline(load_config(config).crafts[0])
    return [sent for message in flight for sent in pipeline.handle(message) if isinstance(sent, Estimate)][-1]


def test_after_kill_9_the_estimate_is_that_of_a_daemon_that_was_never_killed(tmp_path: Path) -> None:
    """700 s of samples and a checkpoint, 50 s that no checkpoint knows, SIGKILL, restart, and the rest.

    The node's cache sends the last 100 s again, so nothing is lost and nothing counts twice: bit for bit.
    """
    flight = stream(seconds=SECONDS)
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    config = write_config(tmp_path, address)
    with daemon(config) as first, Node(address) as node:
        node.until_heard()
        node.send(flight[:1400])
        node.settle()
        node.until("no checkpoint", lambda: newest_samples(tmp_path) == 700)
        node.send(flight[1400:1500])
        node.settle()
        kill(first)
        with daemon(config, 2) as second:
            node.until_heard()
            node.until_accepted(750)
            node.send(flight[1500:])
            node.until_accepted(SECONDS)
            node.until("no last tick", lambda: node.estimates[-1].tick == SECONDS - 1)
            counters = node.counters()
            assert second.stop() == 0
    assert (counters["state.restored"], counters["doubled"], counters.get("no_reference", 0)) == (1, 50, 0)
    restored, whole = node.estimates[-1], uninterrupted(config, flight)
    assert (restored.tick, restored.bias_nt, restored.D) == (whole.tick, whole.bias_nt, whole.D)
    assert restored.covariance == whole.covariance


def test_a_daemon_that_is_killed_before_every_period_is_over_keeps_all_samples(tmp_path: Path) -> None:
    """SIGKILL after each 120 s of samples, more than a node sends again, and long before the period is over."""
    flight = stream(seconds=480)
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    config = write_config(tmp_path, address, period_s=3600.0)
    with Node(address) as node:
        for part in range(4):
            with daemon(config, part) as process:
                node.until_heard()
                node.send(flight[240 * part : 240 * (part + 1)])
                node.settle()
                node.until("no checkpoint", lambda part=part: newest_samples(tmp_path) == 120 * (part + 1))
                kill(process)
    assert newest_samples(tmp_path) == 480


def test_a_second_daemon_on_the_same_folder_ends_and_touches_nothing(tmp_path: Path) -> None:
    """Its link is another, so nothing else would tell; rows and checkpoints stay the first one's."""
    config = write_config(tmp_path, f"zenoh:tcp/127.0.0.1:{free_port()}")
    rows = tmp_path / "rows.csv"
    second = tmp_path / "second.toml"
    text = config.read_text().replace("status_period_s", f"csv = {json.dumps(str(rows))}\nstatus_period_s")
    second.write_text(text.replace(load_config(config).link, f"zenoh:tcp/127.0.0.1:{free_port()}"))
    rows.write_text("torn")
    with daemon(config):
        command = [sys.executable, "-m", "magcal_service.cli", "run", "--config", str(second)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 2
    assert f"state.directory: '{tmp_path / 'state' / 'paper'}' is refused; a folder in which no other" in done.stderr
    assert rows.read_text() == "torn"


class Desk:
    """Someone who gives commands and waits for the answer, and hears the status."""

    def __init__(self, link: Link) -> None:
        self.link = link
        self.status: Status | None = None
        self._numbers = itertools.count()

    def ask(self, name: str, /, **arguments: str | float) -> CommandReply:
        """One command's answer; asked again while nobody hears it."""
        number = next(self._numbers)
        command = Command(craft="paper", source="desk", sequence=number, time_ns=0, name=name, arguments=arguments)
        deadline, asked = time.monotonic() + PATIENCE_S, 0.0
        while time.monotonic() < deadline:
            if time.monotonic() - asked > 2.0:
                asked = time.monotonic()
                self.link.send(command)
            for message in self.link.receive(0.1):
                if isinstance(message, Status):
                    self.status = message
                if isinstance(message, CommandReply) and message.command_sequence == number:
                    return message
        raise AssertionError(f"{name} was not answered within {PATIENCE_S} s")

    def told(self) -> str:
        """The text of the status that follows."""
        self.status, deadline = None, time.monotonic() + PATIENCE_S
        self.ask("status")
        while self.status is None and time.monotonic() < deadline:
            for message in self.link.receive(0.1):
                if isinstance(message, Status):
                    self.status = message
        return "" if self.status is None else self.status.text


@pytest.mark.parametrize("kind", ["zenoh", "serial"])
def test_commands_change_the_state_and_the_status_says_what_and_who(kind: str, tmp_path: Path) -> None:
    """Freeze, resume, process noise, a named checkpoint, back to it, reset, shutdown; with an answer each."""
    with PtyPair() as pair:
        zenoh = f"zenoh:tcp/127.0.0.1:{free_port()}"
        service, desk_end = (zenoh, zenoh) if kind == "zenoh" else tuple(f"serial:{path}" for path in pair.paths)
        config = write_config(tmp_path, service)
        with daemon(config) as process, open_link(desk_end, Role.VIEWER, crafts=["paper"]) as link:
            desk = Desk(link)
            assert desk.ask("freeze").text.startswith("frozen")
            assert "last event: frozen (command; by desk)" in desk.told()
            assert desk.ask("resume").accepted
            assert desk.ask("process_noise", bias_nt=0.5).accepted
            assert "bias 0.5 nT/sqrt(s)" in desk.told()
            assert desk.ask("checkpoint", name="before").accepted
            assert desk.ask("rollback", name="before").accepted
            assert "rolled_back (to checkpoint 'before'; by desk)" in desk.told()
            assert "there are: before" in desk.ask("rollback", name="after").text
            assert desk.ask("reset").accepted
            assert desk.ask("shutdown").accepted
            deadline = time.monotonic() + PATIENCE_S
            while process.running and time.monotonic() < deadline:
                link.receive(0.1)
            assert process.stop() == 0
    events = [json.loads(line)["event"]["what"] for line in process.log.read_text().splitlines() if '"event"' in line]
    assert list(dict.fromkeys(events)) == [
        "frozen",
        "resumed",
        "process_noise",
        "checkpoint",
        "rolled_back",
        "reset",
        "shutdown",
    ]


def test_a_history_that_the_state_cannot_know_again_is_refused(tmp_path: Path) -> None:
    """What a state does not remember would be taken twice, so the two together are refused by name."""
    config = load_config(write_config(tmp_path, f"zenoh:tcp/127.0.0.1:{free_port()}?history=129"))
    with pytest.raises(ConfigError, match=r"link: 'history=129' is refused; .*history=128 is accepted"):
        run_daemon(config, threading.Event())
