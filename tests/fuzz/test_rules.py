"""The rules for a short while on every method, and proof that they see what they look for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from magcal_service.daemon import service
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.ticks import assembler
from magcal_service.wire.kinds import MAX_TELEMETRY
from magcal_service.wire.messages import Message, TelemetrySample
from tests.fuzz.rules.__main__ import drive, table
from tests.fuzz.rules.crafts import METHODS
from tests.fuzz.rules.machine import rules_of


@pytest.mark.parametrize("method", METHODS)
def test_no_order_of_messages_times_and_restarts_breaks_a_promise(method: str) -> None:
    machine = rules_of(method)
    assert drive(machine, 1, 2) == ""
    assert machine.total["steps"] >= 200
    assert machine.total["messages"] > machine.total["steps"]


def test_a_craft_that_fails_by_itself_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    answer = Pipeline.answer

    def raising(self: Pipeline, message: Message) -> list[Message]:
        if isinstance(message, TelemetrySample) and max(message.values) == MAX_TELEMETRY:
            raise OverflowError("planted")
        return answer(self, message)

    monkeypatch.setattr(Pipeline, "answer", raising)
    assert "a craft failed by itself" in drive(rules_of("plkf"), 1, 60, shrink=False)


def test_a_failure_that_is_not_contained_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def uncontained(*_: object) -> Iterator[None]:
        yield

    monkeypatch.setattr(service, "contained", uncontained)
    assert "PlantedError" in drive(rules_of("plkf"), 1, 60, shrink=False)


def test_times_that_are_not_held_to_the_window_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tick stage as it was: every time is believed, and elapsed time grows without end."""
    monkeypatch.setattr(assembler, "is_usable", lambda time_ns: True)
    monkeypatch.setattr(assembler, "FURTHEST_NS", 1 << 80)
    monkeypatch.setattr(assembler, "LONGEST_NS", 1 << 80)
    assert "a craft failed by itself" in drive(rules_of("plkf"), 1, 200, shrink=False)


def test_the_table_has_a_row_for_each_method_and_their_sum() -> None:
    machine = rules_of("plkf")
    assert drive(machine, 2, 1) == ""
    rows = table({"plkf": machine.total, "ukf": machine.total}).splitlines()
    steps = machine.total["steps"]
    assert [row.split(" | ")[2] for row in rows[2:]] == [str(steps), str(steps), str(2 * steps)]
