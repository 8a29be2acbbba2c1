"""What a link says where nobody answers: who is missing, and what there is instead."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable

import pytest

from magcal_service.cli.asking import Desk
from magcal_service.config.settings import Config, CraftConfig
from magcal_service.daemon.service import Service
from magcal_service.links import Role, open_link
from magcal_service.links.base import Link
from magcal_service.links.line_text import TextWatch
from magcal_service.links.silence import why_silent
from magcal_service.wire.framing import pack_frame
from magcal_service.wire.messages import Status
from sim_sensor.demo.pty_pair import PtyPair
from tests.daemon.service_processes import free_port, stream

NMEA = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n"


def until(done: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 120.0
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.parametrize("line", [NMEA, b"12345.6\t-2345.1\t40012.0\n", b"[boot] sensor ready\r", b"a,b,c\n"])
def test_text_is_recognised_and_quoted_once(line: bytes) -> None:
    watch, told = TextWatch(), 0
    for byte in line * (800 // len(line)):
        told += watch.feed(bytes([byte]), 0)
    assert told == 1
    assert f"text comes instead of frames, such as {line.strip().decode()[:60]!r}: " in watch.warning


def test_frames_noise_and_a_few_letters_are_no_text() -> None:
    """Frames of printable payloads, whose counter goes up; bytes of a wrong rate; less than some lines."""
    watch = TextWatch()
    frames = [pack_frame(0, b"all of it printable, and a line\n" * 20, number) for number in range(3)]
    for number, frame in enumerate(frames, 1):
        assert not watch.feed(frame, number)
    assert not TextWatch().feed(bytes(range(256)) * 8, 0)
    assert not TextWatch().feed(NMEA, 0)
    assert not TextWatch().feed(b"x" * 4000, 0)  # a line without end


def test_a_frame_ends_what_was_said_of_text() -> None:
    watch = TextWatch()
    assert watch.feed(NMEA * 10, 0)
    assert not watch.feed(b"\0", 1)
    assert watch.warning == ""
    assert watch.feed(NMEA * 10, 1)


def test_text_on_a_serial_line_is_said_in_the_log_and_in_the_status(caplog: pytest.LogCaptureFixture) -> None:
    pair = PtyPair()
    try:
        with open_link(f"serial:{pair.paths[0]}", Role.SERVICE, crafts=["demo"]) as link:
            other = os.open(pair.paths[1], os.O_RDWR | os.O_NOCTTY)
            service = Service(Config(link.address, (CraftConfig("demo"),)), link)
            for _ in range(10):
                os.write(other, NMEA)
                link.receive(0.05)
            until(lambda: bool(link.receive(0.01) or link.warnings))
            status = service.statuses.of(service.pipelines["demo"])
            os.close(other)
    finally:
        pair.close()
    assert "text comes instead of frames, such as '$GPGGA,123519," in status.text
    assert sum("text comes instead of frames" in record.message for record in caplog.records) == 1


def test_a_line_that_cannot_be_opened_is_a_trouble() -> None:
    with open_link("serial:/dev/absent", Role.SERVICE, crafts=["demo"]) as link:
        service = Service(Config(link.address, (CraftConfig("demo"),)), link)
        assert "/dev/absent cannot be opened" in service.statuses.of(service.pipelines["demo"]).text
        assert why_silent(link).startswith(
            "/dev/absent cannot be opened: there is no such file or folder; give the device "
        )


def test_a_line_that_another_process_has_is_said_to_be_taken(caplog: pytest.LogCaptureFixture) -> None:
    with PtyPair() as pair, open_link(f"serial:{pair.paths[0]}", Role.SERVICE, crafts=["demo"]) as own:
        assert own.alone == ""
        with open_link(own.address, Role.VIEWER, crafts=["demo"]) as second:
            assert why_silent(second).startswith(
                f"{pair.paths[0]} cannot be opened: another process has it; give the device "
            )
    told = f"{own.address}: cannot be opened (another process has it); it is tried again"
    assert [record.message for record in caplog.records] == [told]


def test_an_end_that_connects_to_nobody_says_so_and_that_somebody_came(caplog: pytest.LogCaptureFixture) -> None:
    """A daemon that connects, as a client of a router or as a peer: in its log, once, and in its status."""
    place = f"tcp/127.0.0.1:{free_port()}"
    caplog.set_level(logging.INFO)
    with open_link(f"zenoh:{place}?mode=client&listen=no", Role.SERVICE, crafts=["demo"]) as link:
        service = Service(Config(link.address, (CraftConfig("demo"),)), link)
        for _ in range(3):
            service.publish_status()
        assert f"nobody is at {place}" in service.statuses.of(service.pipelines["demo"]).text
        with open_link(f"zenoh:{place}?mode=router&listen=yes", Role.VIEWER):
            until(lambda: not link.alone)
            service.publish_status()
            assert "nobody is" not in service.statuses.of(service.pipelines["demo"]).text
    told = [record.message for record in caplog.records if record.name == "magcal"]
    assert [message for message in told if "it is tried again" in message] == [
        f"{link.address}: nobody is at {place}, or it refuses this end (certificate, password); it is tried again"
    ]
    assert f"{link.address}: connected: somebody is at the other end" in told


def test_the_craft_that_are_served_are_named_at_the_other_end() -> None:
    """A node of another name learns what there is; so does the daemon, of whom it is."""
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    with open_link(address, Role.NODE, crafts=["wrong"]) as node:
        assert why_silent(node, ["wrong"]).endswith("; is the daemon running?")
        with open_link(address, Role.SERVICE, crafts=["demo", "other"]) as link:
            until(lambda: node.served() == {"demo", "other"})
            assert why_silent(node, ["wrong"]) == "no daemon there serves craft wrong; served: demo, other"
            assert why_silent(node, ["demo"]).startswith("a daemon there serves demo, other and does not answer: ")
            assert "demo, other and has sent nothing new: " in why_silent(node, ["demo"], heard=True)
            service = Service(Config(address, (CraftConfig("demo"), CraftConfig("other"))), link)
            node.send(stream(craft="wrong", seconds=1)[0])
            until(lambda: bool(link.receive(0.05) or link.strangers))
            told = service.statuses.of(service.pipelines["demo"])
            assert isinstance(told, Status)
            assert "messages of craft wrong are refused; served: demo, other" in told.text


def test_somebody_who_serves_nothing_is_no_daemon() -> None:
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    with open_link(f"{address}?listen=yes&mode=peer", Role.VIEWER), open_link(address, Role.NODE, crafts=["a"]) as node:
        until(lambda: not node.alone)
        assert why_silent(node, ["a"]).startswith("no daemon is seen there; ")


def test_names_of_strangers_are_bounded_and_told_for_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    with (
        open_link("loop:strangers", Role.SERVICE, crafts=["demo"]) as link,
        open_link("loop:strangers", Role.NODE) as node,
    ):
        for number in range(20):
            node.send(stream(craft=f"craft{number}", seconds=1)[0])
        received(link)
        assert link.strangers == ("craft0", "craft1", "craft2", "craft3")
        assert link.counters["refused.unknown_craft"] == 20
        assert [link.counters[f"refused.unknown_craft.craft{number}"] for number in (0, 3, 4)] == [1, 1, 0]
        monotonic = time.monotonic
        monkeypatch.setattr(time, "monotonic", lambda: monotonic() + 61.0)
        node.send(stream(craft="craft2", seconds=1)[0])
        received(link)
        assert link.strangers == ("craft2",)


def test_a_command_for_a_mistyped_craft_is_counted_and_told_to_nobody_else(caplog: pytest.LogCaptureFixture) -> None:
    """Its sender hears which craft are served; a status, and the four names that it may tell, are for nodes."""
    with (
        open_link("loop:mistyped", Role.SERVICE, crafts=["demo"]) as link,
        open_link("loop:mistyped", Role.NODE) as node,
        open_link("loop:mistyped", Role.VIEWER, crafts=["dmeo"]) as viewer,
    ):
        Desk(viewer, "send").give("dmeo", "freeze")
        received(link)
        assert (link.counters["refused.unknown_craft"], link.counters["refused.unknown_craft.dmeo"]) == (1, 0)
        assert (link.strangers, caplog.text) == ((), "")
        node.send(stream(craft="dmeo", seconds=1)[0])
        received(link)
        assert (link.counters["refused.unknown_craft"], link.strangers) == (2, ("dmeo",))


def received(link: Link) -> None:
    for _ in range(3):
        assert link.receive(0.05) == []
