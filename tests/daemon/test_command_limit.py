"""Commands beyond a craft's allowance cost nothing but a counted, limited answer; recorded ones are never limited."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from magcal_service.config.daemon_settings import CommandsConfig
from magcal_service.config.settings import Config, CraftConfig
from magcal_service.daemon import run as run_module
from magcal_service.daemon.command_limit import CommandLimit
from magcal_service.daemon.run import run_daemon
from magcal_service.daemon.service import Service
from magcal_service.links import Link, Role, open_link
from magcal_service.links.rate_limit import RateLimit
from magcal_service.trust.modes import MODES, Mode
from magcal_service.wire.messages import Clock, Command, CommandReply, Message

CRAFTS = (CraftConfig("one"), CraftConfig("two"))


def command(number: int, craft: str = "one", name: str = "freeze") -> Command:
    """Each from a source that nobody has seen before."""
    return Command(craft=craft, source=f"s{number}", sequence=number, time_ns=0, clock=Clock.UTC, name=name)


class Session:
    """A service with a limit of 3 at once and 30 a minute, by a clock that the test sets [s]."""

    def __init__(self, link: Link, node: Link) -> None:
        self.now_s, self.recorded = 100.0, list[Message]()
        recorder: Any = SimpleNamespace(add=self.recorded.append, trouble="", path=None, counters=Counter())
        self.service, self.node = Service(Config(link.address, CRAFTS), link, recorder=recorder), node
        self.service.limit = CommandLimit(CommandsConfig(30.0, 3), self.service.counters, lambda: self.now_s)

    def give(self, *commands: Command) -> list[CommandReply]:
        for one in commands:
            self.service.handle(one)
        return [message for message in self.node.receive(0.0) if isinstance(message, CommandReply)]


@pytest.fixture
def session() -> Iterator[Session]:
    with open_link("loop:limit", Role.SERVICE) as link, open_link("loop:limit", Role.NODE) as node:
        yield Session(link, node)


def test_a_burst_passes_and_the_rest_is_refused_with_the_limit_and_when_to_try_again(session: Session) -> None:
    """Invented sources do not help; as many refusals are answered as commands are taken."""
    replies = session.give(*(command(number) for number in range(20)))
    assert [(one.command_sequence, one.accepted) for one in replies] == [(n, n < 3) for n in range(6)]
    told = "too many commands: 3 at once and 30 a minute are accepted for craft one; try again in 2 s"
    assert {one.text for one in replies[3:]} == {told}
    assert session.service.counters[MODES[Mode.COMMANDS_LIMITED].counter] == 17
    assert session.service.pipelines["one"].counters["commands"] == 3


def test_it_is_taken_again_when_the_refusal_says(session: Session) -> None:
    session.give(*(command(number) for number in range(20)))
    session.now_s += 1.9
    assert session.give(command(20)) == []  # neither taken nor, as yet, answered
    session.now_s += 0.1
    assert [one.accepted for one in session.give(command(21))] == [True]


def test_another_craft_has_an_allowance_of_its_own(session: Session) -> None:
    session.give(*(command(number) for number in range(20)))
    assert [one.accepted for one in session.give(command(20, "two"))] == [True]


def test_what_is_refused_costs_no_record_no_event_and_one_line(
    session: Session, caplog: pytest.LogCaptureFixture
) -> None:
    session.give(*(command(number) for number in range(3)))
    before = (len(session.recorded), session.service.counters["events"])
    with caplog.at_level(logging.INFO, "magcal"):
        session.give(*(command(number, name="reset") for number in range(3, 1000)))
    assert (len(session.recorded), session.service.counters["events"]) == before
    (line,) = caplog.messages
    assert "command reset of s3 is refused: too many commands: " in line
    assert line.endswith("; the next ones are counted (commands_limited), not logged")


def test_when_the_next_may_pass() -> None:
    limit = RateLimit(0.5, 1.0)
    assert limit.wait_s("a", 0.0) == 0.0
    assert limit.allows("a", 0.0)
    assert (limit.wait_s("a", 0.0), limit.wait_s("a", 1.5), limit.wait_s("a", 9.0)) == (2.0, 0.5, 0.0)


@pytest.mark.parametrize("live", [True, False])
def test_the_daemon_limits_what_is_live_and_not_what_was_recorded(
    live: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    found: list[bool] = []

    @contextmanager
    def opened(*_: object, **__: object) -> Iterator[Link]:
        with open_link("loop:limited", Role.SERVICE) as link:
            link.live = live
            yield link

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run_module, "open_link", opened)
    monkeypatch.setattr(Service, "run", lambda self, _stop: found.append(self.limit is not None))
    run_daemon(Config("loop:limited", CRAFTS), None)  # type: ignore[arg-type]
    assert found == [live]
