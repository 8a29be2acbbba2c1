"""The small parts of the links: who is present, who waits, what is logged once, and what an address leaves open."""

from __future__ import annotations

import logging
import os
import threading
import time
from pathlib import Path

import pytest

from magcal_service.base.errors import DecodeError
from magcal_service.config.address import parse_address
from magcal_service.links import Role, open_link, presence
from magcal_service.links.fair_inbox import FairInbox
from magcal_service.links.presence import Presence, PresenceBoard
from magcal_service.links.serial import SerialLink, SerialSettings
from magcal_service.wire.messages import CommandReply, Message
from tests.links.link_messages import SOON_S, command, sample, vector

NODE = Presence("alpha", Role.NODE, "one")


def test_an_end_is_present_from_its_token_to_the_end_of_it() -> None:
    counted: list[str] = []
    board = PresenceBoard(counted.append)
    assert [board.change(NODE.key, alive=True) for _ in range(2)] == [NODE, None]
    assert (board.present(), counted) == (frozenset({NODE}), ["joined"])
    assert [board.change(NODE.key, alive=False) for _ in range(2)] == [None, None]
    assert (board.present(), counted) == (frozenset(), ["joined", "left"])


def test_a_session_that_is_gone_leaves_nobody_present() -> None:
    counted: list[str] = []
    board = PresenceBoard(counted.append)
    board.change(NODE.key, alive=True)
    board.clear()
    assert (board.present(), counted) == (frozenset(), ["joined", "left"])


@pytest.mark.parametrize("key", [f"{NODE.key}/more", "magcal/v1/alpha/alive/node-", "magcal/v1/alpha/alive/king-one"])
def test_other_tokens_are_ignored(key: str) -> None:
    board = PresenceBoard(pytest.fail)
    assert board.change(key, alive=True) is None
    assert board.present() == frozenset()


def test_an_empty_inbox_waits_for_as_long_as_it_may() -> None:
    inbox: FairInbox[int] = FairInbox(10, lambda _: None)
    begun_s = time.monotonic()
    assert inbox.drain(0.1) == []
    assert 0.1 <= time.monotonic() - begun_s < SOON_S


def test_an_inbox_that_waits_wakes_with_the_first_item() -> None:
    inbox: FairInbox[int] = FairInbox(10, lambda _: None)
    timer = threading.Timer(0.05, inbox.put, (1,))
    timer.start()
    begun_s = time.monotonic()
    assert inbox.drain(60.0) == [1]
    assert time.monotonic() - begun_s < SOON_S
    timer.join()


def test_an_inbox_that_was_flooded_and_drained_has_all_its_room_again() -> None:
    gone: list[None] = []
    inbox: FairInbox[int] = FairInbox(3, lambda _: gone.append(None))
    for item in range(8):
        inbox.put(item)
    assert inbox.drain(0.0) == [5, 6, 7]
    for item in range(3):
        inbox.put(item)
    assert (inbox.drain(0.0), len(gone)) == ([0, 1, 2], 5)


def test_messages_of_a_craft_that_is_not_served_are_counted_and_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    with (
        open_link("loop:served", Role.SERVICE, crafts=["alpha"]) as service,
        open_link("loop:served", Role.NODE) as node,
    ):
        for number in range(3):
            node.send(sample(number, craft="stranger"))
        with caplog.at_level(logging.WARNING):
            assert service.receive(0.05) == []
        assert service.counters["refused.unknown_craft"] == 3
    assert ["stranger" in record.getMessage() for record in caplog.records] == [True]


def test_a_viewer_of_a_loop_hears_a_nodes_samples_and_not_its_results() -> None:
    with open_link("loop:seen", Role.NODE) as node, open_link("loop:seen", Role.VIEWER) as viewer:
        node.send(vector(0))
        node.send(sample(1))
        assert viewer.receive(0.0) == [sample(1)]


def test_a_loop_holds_4096_messages_unless_its_address_says_otherwise() -> None:
    with open_link("loop:held", Role.SERVICE) as service, open_link("loop:held", Role.NODE) as node:
        for number in range(4097):
            node.send(sample(number % 8))
        assert service.counters["overflow"] == 1


def test_a_serial_address_leaves_the_documented_settings() -> None:
    assert SerialSettings.read(parse_address("serial:/dev/ttyUSB0")) == SerialSettings(
        device="/dev/ttyUSB0",
        baud=115200,
        parity="none",
        stop_bits=1,
        flow_control=False,
        dtr=True,
        backlog_bytes=262_144,
        backlog_s=5.0,
        key=None,
        counter=Path(),
    )


def test_closing_a_stuck_line_waits_a_second_without_work() -> None:
    far, near = os.openpty()
    link = open_link(f"serial:{os.ttyname(near)}", Role.NODE)
    for number in range(1500):
        link.send(sample(number))
    begun_s, used_s = time.monotonic(), time.process_time()
    link.close()
    assert 0.9 < time.monotonic() - begun_s < SOON_S
    assert time.process_time() - used_s < 0.3
    os.close(near)
    os.close(far)


def test_the_lines_own_answers_are_numbered_from_nought_and_wrap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = SerialLink(parse_address(f"serial:{tmp_path / 'tty'}"), Role.SERVICE)
    sent: list[Message] = []
    monkeypatch.setattr(link, "send", sent.append)
    for answered in (0, 1, (1 << 32) - 1, 1 << 32):
        link._answers = answered
        link._refuse_command(command(7), DecodeError("unsealed", "seal it"))
    assert [message.sequence for message in sent] == [0, 1, (1 << 32) - 1, 0]
    assert all(isinstance(message, CommandReply) and not message.accepted for message in sent)


def test_invented_tokens_take_bounded_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(presence, "MAX_PRESENT", 2)
    counted: list[str] = []
    board = PresenceBoard(counted.append)
    for number in range(4):
        board.change(NODE._replace(name=f"n{number}").key, alive=True)
    assert (len(board.present()), counted) == (2, ["joined", "joined"])


def test_refused_commands_are_all_answered_and_the_first_is_logged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    link = SerialLink(parse_address(f"serial:{tmp_path / 'tty'}"), Role.SERVICE)
    sent: list[Message] = []
    monkeypatch.setattr(link, "send", sent.append)
    caplog.clear()
    for number in range(3):
        link._refuse_command(command(number), DecodeError("unsealed", "seal it"))
    assert ["is refused" in record.getMessage() for record in caplog.records] == [True]
    assert len(sent) == 3
