"""Whatever one craft's work raises, in any place, is that craft's alone: it begins anew, says so, and goes on."""

from __future__ import annotations

import itertools
import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from magcal_service.base.snapshot import SnapshotError
from magcal_service.config.daemon_settings import StateConfig
from magcal_service.config.settings import Config
from magcal_service.daemon.checkpoints.store import Checkpoints
from magcal_service.daemon.containment import contained
from magcal_service.daemon.craft_commands import CRAFT_COMMANDS
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.daemon.service import Service
from magcal_service.links import Link, Role, open_link
from magcal_service.trust.monitor import TrustMonitor
from magcal_service.wire.messages import CalibratedVector, Command, CommandReply, MagnetometerSample, Message, Status
from tests.daemon.pipeline_streams import handle_all, paper, quick_craft

FLIGHT = list(paper(5, 200.0).messages())
POISON = replace(FLIGHT[101], field_body_nt=(12_345.0, 1.0, 2.0), time_ns=FLIGHT[101].time_ns + 1)
CRAFTS = tuple(replace(quick_craft(), name=name) for name in ("sick", "well"))
_names = itertools.count()


def of(craft: str, messages: list[Message]) -> list[Message]:
    return [replace(message, craft=craft) for message in messages]


@contextmanager
def served(folder: Path) -> Iterator[tuple[Service, Link]]:
    """A service of two craft with checkpoints, and a node's end of its link."""
    address = f"loop:containment-{next(_names)}"
    state = StateConfig(folder)
    with open_link(address, Role.SERVICE) as link, open_link(address, Role.NODE) as node:
        service = Service(Config(address, CRAFTS, state=state), link, checkpoints=Checkpoints(state, CRAFTS))
        service.restore()
        yield service, node


def give(service: Service, node: Link, messages: list[Message]) -> list[Message]:
    """What is published for messages."""
    for message in messages:
        service.handle(message)
    return node.receive(0.0)


def poisonous(monkeypatch: pytest.MonkeyPatch) -> None:
    """A defect: the tick stage of any craft fails at one certain sample."""
    rejection = Pipeline.answer

    def answer(self: Pipeline, message: Message) -> list[Message]:
        if isinstance(message, MagnetometerSample) and message.field_body_nt == POISON.field_body_nt:
            raise KeyError("a defect\nof two lines")
        return rejection(self, message)

    monkeypatch.setattr(Pipeline, "answer", answer)


def test_a_craft_that_fails_begins_anew_and_the_other_does_not_notice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    poisonous(monkeypatch)
    alone = Pipeline(CRAFTS[1])
    with served(tmp_path) as (service, node), caplog.at_level(logging.ERROR, "magcal"):
        mixed = [one for pair in zip(of("sick", FLIGHT), of("well", FLIGHT), strict=True) for one in pair]
        mixed.insert(300, replace(POISON, craft="sick"))
        published = give(service, node, mixed)
        sick, well = service.pipelines["sick"], service.pipelines["well"]
    assert (sick.counters["failed"], well.counters["failed"]) == (1, 0)
    assert well.export_state() | {"_sequence": 0} == expected(alone)
    assert "KeyError: 'a defect" in sick.failure
    assert sick.failure.endswith("while taking a magnetometer message")
    (record,) = caplog.records
    assert record.exc_info is not None
    told = [one.text for one in published if isinstance(one, Status) and one.craft == "sick"]
    assert any("failed: KeyError" in text and "last event: failed" in text for text in told)
    vectors = [one for one in published if isinstance(one, CalibratedVector)]
    assert sum(one.craft == "sick" for one in vectors) == sum(one.craft == "well" for one in vectors) == 200


def expected(alone: Pipeline) -> dict[str, Any]:
    handle_all(alone, of("well", FLIGHT))
    return alone.export_state() | {"_sequence": 0}


def test_what_it_failed_at_is_left_out_where_it_comes_again_after_a_restart_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    poisonous(monkeypatch)
    history = of("sick", [*FLIGHT[:100], POISON, *FLIGHT[100:102]])
    with served(tmp_path) as (service, node):
        give(service, node, history)
        give(service, node, history)
        first = service.pipelines["sick"]
        assert (first.counters["failed"], first.counters["left_out"]) == (1, 1)
        assert first.ticks.counters["doubled"] == 51
        service.save()
    with served(tmp_path) as (service, node):
        published = give(service, node, [*history, *history])
        again = service.pipelines["sick"]
    assert (again.counters["failed"], again.counters["left_out"]) == (1, 3)
    events = [one.text for one in published if isinstance(one, Status)]
    told = "last event: left_out (a magnetometer message at which it failed before has come again"
    assert sum(told in event for event in events) == 1


def test_a_failure_that_goes_on_is_logged_the_first_time_and_at_powers_of_ten(caplog: pytest.LogCaptureFixture) -> None:
    pipeline = Pipeline(CRAFTS[0])
    with caplog.at_level(logging.ERROR, "magcal"):
        for error in [*(KeyError(number) for number in range(120)), ValueError("b\x1b[31m\n" + 300 * "c")]:
            with contained(pipeline, "trying"):
                raise error
    assert [bool(record.exc_info) for record in caplog.records] == [True, False, False, True]
    assert [" time;" in record.getMessage() for record in caplog.records] == [False, True, True, False]
    assert "KeyError: 99, while trying, for the 100th time; it begins anew" in caplog.text
    assert pipeline.counters["failed"] == 121
    assert pipeline.failure == f"ValueError: b[31m {142 * 'c'}, while trying"


def test_of_what_is_left_out_the_newest_are_known(tmp_path: Path) -> None:
    pipeline = Pipeline(CRAFTS[0])
    samples = [one for one in FLIGHT if isinstance(one, MagnetometerSample)][:65]
    for sample in samples:
        pipeline.begin_anew("planted", sample)
    assert [pipeline.leaves_out(sample) for sample in samples] == [False] + [True] * 64


@pytest.mark.parametrize("place", ["summary", "export_state", "flush"])
def test_a_failure_beside_the_messages_is_contained_as_well(
    tmp_path: Path, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with served(tmp_path) as (service, node):
        give(service, node, of("sick", FLIGHT[:300]) + of("well", FLIGHT[:300]))
        sick = service.pipelines["sick"]

        def fail(*_: object) -> None:
            monkeypatch.undo()
            raise OverflowError("int too big to convert")

        monkeypatch.setattr(sick, place, fail)
        work = {"summary": service.publish_status, "export_state": service.save}
        if place == "flush":
            service.shut_down()
            service.run(threading.Event())
        else:
            work[place]()
        assert (sick.counters["failed"], service.pipelines["well"].counters["failed"]) == (1, 0)
        assert sick.failure.startswith("OverflowError: int too big to convert, while ")
        service.save()
        service.publish_status()
        assert {one.craft for one in node.receive(0.0) if isinstance(one, Status)} == {"sick", "well"}
        assert list((tmp_path / "well").glob("*.state"))


def test_a_command_at_which_it_fails_is_answered_with_why_and_so_is_the_same_one_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(_craft: object, _command: Command) -> str:
        raise ZeroDivisionError("a defect")

    monkeypatch.setitem(CRAFT_COMMANDS, "freeze", failing)
    asked = Command(craft="sick", source="desk", sequence=3, time_ns=0, name="freeze")
    with served(tmp_path) as (service, node):
        give(service, node, of("sick", FLIGHT[:20]))
        replies = [one for one in give(service, node, [asked, asked]) if isinstance(one, CommandReply)]
    assert [(one.accepted, one.command_sequence) for one in replies] == [(False, 3)] * 2
    why = "the craft failed at it: ZeroDivisionError: a defect, while taking a command message"
    assert [one.text for one in replies] == [why] * 2


def test_commands_that_were_given_hold_and_numbers_go_on() -> None:
    pipeline = Pipeline(CRAFTS[0])
    handle_all(pipeline, FLIGHT[:200])
    pipeline.frozen = True
    pipeline.set_process_noise(0.5, 1e-6)
    number, accepted = pipeline.export_state()["_sequence"], pipeline.ticks.counters["accepted"]
    pipeline.begin_anew("planted")
    state = pipeline.export_state()
    assert (state["frozen"], state["_process_noise"], state["_sequence"]) == (True, [0.5, 1e-6], number)
    assert pipeline.ticks.counters["accepted"] == accepted
    assert pipeline.estimator.estimate().samples == 0
    assert handle_all(pipeline, FLIGHT[1:200:2]) == []  # all doubled


def test_a_checkpoint_that_raises_whatever_gives_way_to_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with served(tmp_path) as (service, node):
        for part in (FLIGHT[:100], FLIGHT[100:200]):
            give(service, node, of("sick", part))
            service.save()
    restore = TrustMonitor.restore_state
    calls = itertools.count()

    def restore_state(self: TrustMonitor, *given: Any) -> None:
        if next(calls) == 0:
            raise ZeroDivisionError("planted")
        restore(self, *given)

    monkeypatch.setattr(TrustMonitor, "restore_state", restore_state)
    with served(tmp_path) as (service, node):
        assert service.pipelines["sick"].ticks.counters["accepted"] == 50
        (event, *_) = [one.text for one in node.receive(0.0) if isinstance(one, Status)]
    assert "state_dropped (checkpoint 0000000002.state: ZeroDivisionError: planted" in event


def test_a_checkpoint_that_waits_for_the_start_of_no_physics_file_is_refused_by_name() -> None:
    saved = Pipeline(CRAFTS[0]).export_state()
    with pytest.raises(SnapshotError, match=r"state\.settling: there is no physics\.toml"):
        Pipeline(CRAFTS[0]).restore_state(saved | {"settling": {}})
