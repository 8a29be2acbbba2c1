"""What a serial link does with a line that takes a part of a frame, and with one that does not open."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from magcal_service.config.address import parse_address
from magcal_service.links import Role
from magcal_service.links import serial as module
from magcal_service.links.serial import SerialLink, SerialSettings
from magcal_service.links.states import LinkState
from magcal_service.wire.framing import FrameEncoder, StreamDecoder
from tests.links.link_messages import sample, settle

FRAME_BYTES = len(FrameEncoder().encode(sample(0)))


class Clock:
    """A monotonic clock that stands until it is set; sleeping moves it."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, pause_s: float) -> None:
        self.now_s += pause_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """The link's clock."""
    clock = Clock()
    monkeypatch.setattr(module, "time", clock)
    return clock


class ShortLine:
    """Takes what it has room for; ``written`` is what it took."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.room, self.written = 0, bytearray()
        monkeypatch.setattr(module.os, "write", self.write)

    def write(self, descriptor: int, data: bytes) -> int:
        taken = bytes(data[: self.room])
        if not taken:
            raise BlockingIOError
        self.room -= len(taken)
        self.written += taken
        return len(taken)


@pytest.fixture
def link(clock: Clock) -> Iterator[SerialLink]:
    """A node's end of a line at rest, whose frames last 5 s."""
    far, near = os.openpty()
    link = SerialLink(parse_address(f"serial:{os.ttyname(near)}?backlog_bytes=16384"), Role.NODE)
    assert link.counters["up"] == 1
    yield link
    link._backlog.clear()
    link.close()
    os.close(near)
    os.close(far)


def test_a_frame_that_is_begun_is_finished_however_old(
    link: SerialLink, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten bytes of the first frame are out when all frames grow too old: it alone is finished, and no receiver sees
    a broken one."""
    line = ShortLine(monkeypatch)
    line.room = 10
    for number in range(3):
        link.send(sample(number))
    clock.now_s += 6.0
    line.room = 10_000
    link.send(sample(3))
    decoder = StreamDecoder()
    assert decoder.feed(bytes(line.written)) == [sample(0), sample(3)]
    assert decoder.counters == {"frames": 2, "frames_lost": 2}
    assert (link.counters["sent"], link.counters["dropped"]) == (2, 2)


def test_a_frame_that_is_not_begun_gives_way_when_it_is_too_old(
    link: SerialLink, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    line = ShortLine(monkeypatch)
    link.send(sample(0))
    clock.now_s += 5.0
    link.send(sample(1))
    assert link.counters["dropped"] == 0
    clock.now_s += 0.1
    line.room = 10_000
    link.send(sample(2))
    assert StreamDecoder().feed(bytes(line.written)) == [sample(1), sample(2)]
    assert link.counters["dropped"] == 1


def test_the_backlog_holds_what_it_may_and_not_a_frame_more(link: SerialLink, monkeypatch: pytest.MonkeyPatch) -> None:
    line = ShortLine(monkeypatch)
    held = 20
    link._settings = replace(link._settings, backlog_bytes=held * FRAME_BYTES)
    for number in range(held + 5):
        link.send(sample(0))
        assert link.counters["dropped"] == max(0, number + 1 - held)
    line.room = 1 << 20
    link._write()
    assert len(StreamDecoder().feed(bytes(line.written))) == held
    assert (link.counters["sent"], link._backlog_bytes) == (held, 0)


def test_a_frame_is_sent_on_from_the_byte_where_the_line_stopped(
    link: SerialLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    line = ShortLine(monkeypatch)
    link.send(sample(0))
    for _ in range(FRAME_BYTES):
        line.room = 1
        link._write()
    assert bytes(line.written) == FrameEncoder().encode(sample(0))
    assert link.counters["sent"] == 1


def test_attempts_to_open_come_after_pauses_that_double_up_to_the_longest(
    clock: Clock, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Between attempts the device is left alone, and only the first failure is logged."""
    attempts: list[float] = []

    def broken(settings: SerialSettings) -> None:
        attempts.append(clock.now_s - 100.0)
        raise OSError(2, "No such file")

    monkeypatch.setattr(SerialSettings, "open", broken)
    with caplog.at_level(logging.INFO):
        link = SerialLink(parse_address("serial:/dev/none"), Role.NODE)
        while clock.now_s < 120.0:
            link._poll(0.05)
    assert attempts == pytest.approx([0.0, 0.2, 0.6, 1.4, 3.0, 6.2, 11.2, 16.2])
    assert len(caplog.records) == 1
    assert link.state is LinkState.RETRYING


def test_an_open_line_ends_the_pauses_and_begins_them_anew(
    clock: Clock, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    link = SerialLink(parse_address(f"serial:{tmp_path / 'tty'}"), Role.NODE)
    while clock.now_s < 103.0:
        link._poll(0.5)
    far, near = os.openpty()
    (tmp_path / "tty").symlink_to(os.ttyname(near))
    clock.now_s += 5.0
    link._poll(0.0)
    assert (link.state, link.counters["up"]) == (LinkState.OPEN, 1)
    os.close(near)
    os.close(far)
    (tmp_path / "tty").unlink()
    assert settle(lambda: not link.receive(0.0) and link.counters["down"] == 1)
    assert link.state is LinkState.LOST
    assert link._next_attempt_s == pytest.approx(clock.now_s + 0.2)
    link.close()


def test_a_closed_line_waits_and_does_not_open_again(clock: Clock, tmp_path: Path) -> None:
    link = SerialLink(parse_address(f"serial:{tmp_path / 'tty'}"), Role.NODE)
    link.close()
    far, near = os.openpty()
    (tmp_path / "tty").symlink_to(os.ttyname(near))
    assert link._poll(30.0) == []
    assert clock.now_s == pytest.approx(130.0)
    assert (link.counters["up"], link.counters["down"]) == (0, 0)
    os.close(near)
    os.close(far)


def test_a_line_that_died_within_a_frame_begins_the_next_one_whole(
    link: SerialLink, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was held for the dead line is dropped, and nothing of it is written on the new one."""
    line = ShortLine(monkeypatch)
    line.room = 10
    for number in range(3):
        link.send(sample(number))

    def broken(descriptor: int, data: bytes) -> int:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(module.os, "write", broken)
    link.send(sample(3))
    assert (link.state, link.counters["dropped"], link._backlog_bytes) == (LinkState.LOST, 4, 0)
    clock.now_s += 1.0
    again = ShortLine(monkeypatch)
    again.room = 10_000
    link.send(sample(4))
    assert StreamDecoder().feed(bytes(again.written)) == [sample(4)]
    assert (link.counters["sent"], link.counters["up"], link.counters["down"]) == (1, 2, 1)
