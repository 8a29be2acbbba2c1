"""The rules for a short while on every method, and proof that they see what they look for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from magcal_service.daemon import service
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.links import Role
from magcal_service.links.loop import LoopLink
from magcal_service.ticks import assembler
from magcal_service.wire.kinds import MAX_TELEMETRY
from magcal_service.wire.messages import Message, TelemetrySample
from tests.fuzz.rules import __main__ as rules
from tests.fuzz.rules import lines
from tests.fuzz.rules.__main__ import drive, run
from tests.fuzz.rules.crafts import CALM, METHODS, OTHER, WILD
from tests.fuzz.rules.machine import Rules, rules_of
from tests.fuzz.rules.progress import Progress, table


@pytest.mark.parametrize("method", METHODS)
def test_no_order_of_messages_times_and_restarts_breaks_a_promise(method: str) -> None:
    machine = rules_of(method)
    assert drive(machine, 1, 2) == ""
    assert machine.total["steps"] >= 200
    assert machine.total["messages"] > machine.total["steps"]


def is_found(what: str, worlds: int) -> bool:
    """Whether an error comes out of so many worlds, ten from each seed: how soon one seed's come to it is chance."""
    seeds = range(1, worlds // 10 + 1)
    return any(what in drive(rules_of("plkf"), number, 10, shrink=False) for number in seeds)


def test_a_craft_that_fails_by_itself_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    answer = Pipeline.answer

    def raising(self: Pipeline, message: Message) -> list[Message]:
        if isinstance(message, TelemetrySample) and max(message.values) == MAX_TELEMETRY:
            raise OverflowError("planted")
        return answer(self, message)

    monkeypatch.setattr(Pipeline, "answer", raising)
    assert is_found("a craft failed by itself", 60)


def test_a_failure_that_is_not_contained_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def uncontained(*_: object) -> Iterator[None]:
        yield

    monkeypatch.setattr(service, "contained", uncontained)
    assert is_found("PlantedError", 60)


def test_times_that_are_not_held_to_the_window_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tick stage as it was: every time is believed, and elapsed time grows without end."""
    monkeypatch.setattr(assembler, "is_usable", lambda time_ns: True)
    monkeypatch.setattr(assembler, "FURTHEST_NS", 1 << 80)
    monkeypatch.setattr(assembler, "LONGEST_NS", 1 << 80)
    assert is_found("a craft failed by itself", 200)


@pytest.mark.parametrize("line", ["zenoh", "serial"])
def test_the_promises_hold_over_real_links(line: str) -> None:
    """All that a node sends arrives, before and after a daemon is killed; what a history brings again is known."""
    machine = rules_of("plkf", line=line)()
    machine.begin(number=0, flown_s=0, writes=0)
    for how in ("kill", "save"):
        machine.fly(CALM, 5)
        machine.fly(WILD, 5)
        machine.garbage(b"no message")
        machine.plant(WILD, "ticks")
        machine.fly(WILD, 3)
        machine.restart(OTHER, how, 0)
    machine.fly(CALM, 5)
    done = machine.world.done
    machine.teardown()
    assert (done["starts"], done["contained"], done["checkpoints"]) == (3, 2, 1)


def test_a_message_that_does_not_arrive_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lines, "WAIT_S", 0.05)
    listeners = LoopLink._listeners

    def deaf(self: LoopLink, message: Message) -> list[LoopLink]:
        return [] if self.role is Role.NODE else listeners(self, message)

    monkeypatch.setattr(LoopLink, "_listeners", deaf)
    assert "what was sent has not arrived" in drive(rules_of("plkf"), 1, 5, shrink=False)


def test_a_run_that_ended_goes_on_where_it_stood(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seeds = []

    def one_batch(machine: type[Rules], number: int, worlds: int, *, shrink: bool) -> str:
        seeds.append((machine.method, number))
        machine.total.update(steps=100, worlds=worlds)
        return "AssertionError: planted" if len(seeds) == 2 else ""

    monkeypatch.setattr(rules, "drive", one_batch)
    kept = tmp_path / "kept.json"
    for steps in (200, 300):
        progress = Progress.load(kept) if kept.exists() else Progress("loop", 5)
        run(progress, steps, 1e9, ("ukf", "plkf"), kept)
    assert seeds == [("ukf", 5_000_000), ("plkf", 5_000_001), ("ukf", 5_000_002)]
    assert [row.split(" | ")[2] for row in table([Progress.load(kept)]).splitlines()[2:]] == [
        "200",
        "100",
        "300",
        "300",
    ]
    assert "plkf over loop, seed 5000001" in Progress.load(kept).escapes[0]
