"""``magcal watch``: one picture of a daemon or a recording, and a terminal that is left as it was found."""

from __future__ import annotations

import fcntl
import os
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from magcal_service.cli import screen
from magcal_service.cli.watch import Watch, _shown
from magcal_service.links import Role, open_link
from magcal_service.views.picture import HEIGHT, WIDTH
from magcal_service.views.sources import LiveSource
from magcal_service.wire.messages import Command, Message, Status, Verdict
from sim_sensor.demo.pty_pair import PtyPair
from sim_sensor.recorder import record_simulation
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.cli.cli_inputs import run
from tests.links.link_messages import RESULTS, estimate, free_port, vector
from tests.recordings.inspect.clean_logs import Kind, clean_log


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """450 s of the paper's scenario: started, not trusted yet."""
    return record_simulation(Simulation(load_scenario("paper"), 4, 450.0), tmp_path_factory.mktemp("paper"))


RESULTS_NOW: list[Message] = [
    vector(1),
    replace(estimate(2), verdict=Verdict.TRUSTED),
    next(one for one in RESULTS if isinstance(one, Status)),
]


def test_a_recording_is_shown_at_its_end_and_the_exit_code_is_the_verdicts(recording: Path) -> None:
    done = run("watch", recording, "--once")
    lines = done.out.splitlines()
    assert (done.code, done.err, len(lines) <= HEIGHT) == (3, "", True)
    assert lines[0].endswith("end of the recording")
    assert lines[1].startswith("verdict   CONVERGING, ")
    assert any(line.startswith("after ") and line.endswith("nT rms off |H|") for line in lines)
    assert "accepted 450, ticks 450, " in done.out
    assert "started (the start passed every gate" in done.out


def test_a_recording_in_doubt_is_not_trusted(tmp_path: Path) -> None:
    place = '[position]\ncolumns = ["lat", "lon"]\naltitude = { column = "alt", unit = "m" }'  # it is in km
    path = clean_log(Kind(reference="igrf", channels=False, rows=400)).described(position=place).write(tmp_path)
    done = run("watch", path, "--once")
    assert done.code == 3
    assert "why       recording_doubtful" in done.out
    assert "(magcal inspect shows it)" in done.out


def test_a_daemon_over_zenoh_is_shown_when_it_is_known_whole() -> None:
    link = f"zenoh:tcp/127.0.0.1:{free_port()}"
    with open_link(link, Role.SERVICE, crafts=["alpha"]) as service:
        for message in RESULTS_NOW:
            service.send(message)
        done = run("watch", "--link", link, "--once", "--timeout", "60")
    assert (done.code, done.err) == (0, "")
    assert "verdict   TRUSTED, no protection level, ukf, tick 2" in done.out
    assert "received 7, refused.too_large 1" in done.out


def test_a_daemon_that_has_no_result_yet_is_asked_for_its_status_and_what_is_awaited_is_said() -> None:
    link = f"zenoh:tcp/127.0.0.1:{free_port()}"
    waiting = next(one for one in RESULTS if isinstance(one, Status))
    with open_link(link, Role.SERVICE, crafts=["alpha"]) as service:
        stop = threading.Event()

        def answer() -> None:
            while not stop.is_set():
                for message in service.receive(0.05):
                    if isinstance(message, Command) and message.name == "status":
                        service.send(waiting)

        answering = threading.Thread(target=answer)
        answering.start()
        began_s = time.monotonic()
        done = run("watch", "--link", link, "--once", "--timeout", "30")
        stop.set()
        answering.join()
    assert (done.code, done.err) == (3, "")
    assert f"status    {waiting.text}" in done.out
    assert time.monotonic() - began_s < 15.0, "no estimate is awaited that the status does not count"
    assert "errors    awaited: " in done.out


def test_a_daemon_at_a_serial_line_is_shown_by_its_results_alone() -> None:
    with PtyPair() as pair, open_link(f"serial:{pair.paths[0]}", Role.SERVICE) as service:
        stop = threading.Event()
        sending = threading.Thread(target=repeat, args=(service.send, stop))
        sending.start()
        done = run("watch", "--link", f"serial:{pair.paths[1]}", "--craft", "alpha", "--once", "--timeout", "60")
        stop.set()
        sending.join()
    assert (done.code, done.err) == (0, "")
    assert re.search(r"^\|H\|       no reference heard in \d+\.\d s$", done.out, re.MULTILINE)


def repeat(send: Callable[[Message], None], stop: threading.Event) -> None:
    """Send messages ten times a second: a line holds nothing for one who comes later."""
    while not stop.wait(0.1):
        for message in RESULTS_NOW:
            send(message)


def test_where_nobody_is_the_reason_is_said_and_nothing_is_shown() -> None:
    link = f"zenoh:tcp/127.0.0.1:{free_port()}"
    done = run("watch", "--link", link, "--once", "--timeout", "0.3")
    assert (done.code, done.out) == (2, "")
    assert "is the daemon running?" in done.err


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--speed", "2", "--once"], "--speed: 2.0 is refused; it goes with a recording"),
        (["{recording}", "--link", "loop:x"], "--link: 'loop:x' is refused; a recording or a link is accepted"),
        (["{recording}", "--craft", "x", "--config", "none.toml"], "none.toml"),
        (["{recording}", "--speed", "-1"], "0 (as fast as it goes) to 1e6 is accepted"),
    ],
)
def test_arguments_that_do_not_go_together_are_refused(arguments: list[str], told: str, recording: Path) -> None:
    done = run("watch", *(one.format(recording=recording) for one in arguments))
    assert (done.code, done.out) == (2, "")
    assert told in done.err


class FakeScreen:
    """A screen of 80 by 24 at which these keys are pressed, one after each picture; ``heads`` are their first lines."""

    is_ended, colour, size = False, False, (WIDTH, HEIGHT)

    def __init__(self, keys: str) -> None:
        self._keys, self.heads = iter(keys), list[str]()

    def draw(self, lines: list[str]) -> None:
        self.heads.append(lines[0].split("  ")[0])

    def keys(self, wait_s: float) -> str:
        return next(self._keys)


def test_keys_go_round_the_magnetometers_and_what_has_not_told_its_status_is_asked() -> None:
    with open_link("loop:watch", Role.VIEWER) as link:
        source = LiveSource(link)
        for name in ("a", "b", "c"):
            source.take(replace(estimate(2), craft=name))
        asked = list[tuple[str, str]]()
        source.give = lambda craft, name: asked.append((craft, name)) or True  # type: ignore[method-assign, func-returns-value]
        watch, looked = Watch(source, crafts=("d",)), FakeScreen("nnnpq")
        watch.ask_s = 0.0
        _shown(watch, looked)  # type: ignore[arg-type]
    assert looked.heads == [f"{name} ({place} of 3)" for name, place in zip("abcac", (1, 2, 3, 1, 3), strict=True)]
    assert sorted(asked) == [(name, "status") for name in "abcd"]


def test_colours_are_for_terminals_and_for_those_who_want_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(screen, "is_terminal", lambda: True)
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert screen.has_colour()
    monkeypatch.setenv("NO_COLOR", "1")
    assert not screen.has_colour()
    monkeypatch.undo()
    assert not screen.has_colour()


def test_a_terminal_shows_the_picture_until_q_and_is_left_as_it_was(recording: Path) -> None:
    ours, theirs = os.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", HEIGHT, WIDTH, 0, 0))
    before = termios.tcgetattr(theirs)
    environment = {**os.environ, "TERM": "xterm", "PYTHONUTF8": "1", "NO_COLOR": ""}
    command = [sys.executable, "-m", "magcal_service.cli", "watch", str(recording), "--speed", "0"]
    with subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, env=environment) as process:
        try:
            seen = read_until(ours, "end of the recording")
            os.write(ours, b"q")
            seen += read_until(ours, "\x1b[?1049l")
            assert process.wait(120) == 0
        finally:
            process.kill()
    assert termios.tcgetattr(theirs) == before
    os.close(ours)
    os.close(theirs)
    assert seen.startswith("\x1b[?1049h")
    assert "\x1b[?25h" in seen
    assert "q quit" in seen
    assert "\x1b[33mCONVERGING\x1b[0m" in seen


@pytest.mark.parametrize("hangs_up", [True, False], ids=["with a signal", "without one"])
def test_a_terminal_that_goes_away_ends_it_without_a_word(recording: Path, hangs_up: bool) -> None:
    """A window that is closed, an ssh session that is cut; ``nohup`` and other sessions send no signal."""
    ours, theirs = os.openpty()
    environment = os.environ | {"TERM": "xterm", "PYTHONUTF8": "1"}
    command = [sys.executable, "-m", "magcal_service.cli", "watch", str(recording), "--speed", "60"]
    started = subprocess.Popen(
        command,
        stdin=theirs,
        stdout=theirs,
        stderr=subprocess.PIPE,
        env=environment,
        preexec_fn=(lambda: _with_terminal(theirs)) if hangs_up else None,
    )
    os.close(theirs)
    read_until(ours, "q quit")
    os.close(ours)
    assert started.communicate(timeout=20.0)[1] == b""
    assert started.returncode in ((0, -signal.SIGHUP) if hangs_up else (0,))


def _with_terminal(terminal: int) -> None:
    """A session whose terminal that is: it is told by a signal when the terminal is gone."""
    os.setsid()
    fcntl.ioctl(terminal, termios.TIOCSCTTY, 0)


def read_until(file: int, told: str) -> str:
    """What comes out of a terminal, up to a text."""
    seen, deadline_s = b"", time.monotonic() + 120.0
    while told.encode() not in seen and time.monotonic() < deadline_s:
        if select.select([file], [], [], 0.2)[0]:
            seen += os.read(file, 65536)
    text = seen.decode()
    assert told in text
    return text
