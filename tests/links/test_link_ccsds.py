"""``ccsds:``: results go out as packets, nothing comes in, and the daemon sends them beside its main link."""

from __future__ import annotations

import errno
import logging
import socket
import threading
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from magcal_service.base.errors import ConfigError, LinkAddressError, LinkError
from magcal_service.config.daemon_settings import OutputConfig
from magcal_service.config.reader import load_config
from magcal_service.config.settings import Config, CraftConfig
from magcal_service.daemon.outputs import Outputs
from magcal_service.daemon.service import Service
from magcal_service.links import Role, open_link
from magcal_service.links.ccsds import CcsdsLink
from magcal_service.wire.messages import Status
from magcal_service.wire.packets import pack
from tests.links.link_messages import RESULTS, SOON_S, command, estimate, sample, vector

Ear = tuple[socket.socket, str]


@pytest.fixture
def ear() -> Iterator[Ear]:
    """A socket of mission control, and the address that sends to it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as heard:
        heard.bind(("127.0.0.1", 0))
        heard.settimeout(SOON_S)
        yield heard, f"ccsds:udp/127.0.0.1:{heard.getsockname()[1]}"


def apid_and_count(packet: bytes) -> tuple[int, int]:
    first, second = int.from_bytes(packet[:2], "big"), int.from_bytes(packet[2:4], "big")
    return first & 0x7FF, second & 0x3FFF


def test_each_kind_goes_out_under_its_apid_with_counts_of_its_own(ear: Ear) -> None:
    heard, address = ear
    with open_link(address, Role.SERVICE) as link:
        for message in (*RESULTS, vector(2)):
            link.send(message)
        packets = [heard.recv(65_507) for _ in range(5)]
        assert link.counters["sent"] == 5
    assert [apid_and_count(packet) for packet in packets] == [(256, 0), (257, 0), (258, 0), (259, 0), (256, 1)]
    assert packets[1][14:] == pack(RESULTS[1])


def test_options_choose_apids_craft_and_kinds(ear: Ear) -> None:
    heard, address = ear
    with open_link(f"{address}?apid=100&apid_status=7&craft=alpha&vectors=no", Role.SERVICE) as link:
        for message in (*RESULTS, estimate(0, craft="beta")):
            link.send(message)
        assert [apid_and_count(heard.recv(65_507))[0] for _ in range(3)] == [101, 7, 103]
        assert link.counters["sent"] == 3


def test_what_is_no_result_is_not_sent(ear: Ear) -> None:
    with open_link(ear[1], Role.SERVICE) as link:
        link.send(sample(0))
        link.send(command(0))
        assert (link.counters["sent"], link.counters["dropped"]) == (0, 0)


def test_it_says_that_it_only_sends_when_asked_for_input(ear: Ear) -> None:
    with open_link(ear[1], Role.SERVICE) as link, pytest.raises(LinkError, match="only sends"):
        link.receive(0.0)
    for role in (Role.NODE, Role.VIEWER):
        with pytest.raises(LinkAddressError, match="only sends the daemon's results"):
            open_link(ear[1], role)


@pytest.mark.parametrize(
    ("rest", "words"),
    [
        ("tcp/127.0.0.1:1", "udp/ADDRESS:PORT"),
        ("udp/127.0.0.1", "udp/ADDRESS:PORT"),
        ("udp/1.2.3:99", "IP address"),
        ("udp/[::zz]:99", "udp/ADDRESS:PORT"),
        ("udp/127.0.0.1:0", "1 to 65535"),
        ("udp/127.0.0.1:9?apid=2044", "0 to 2043"),
        ("udp/127.0.0.1:9?apid_reply=256", "an APID of its own"),
        ("udp/127.0.0.1:9?craft=beta", "one of alpha"),
        ("udp/127.0.0.1:9?aipd=3", "did you mean 'apid'"),
    ],
)
def test_a_wrong_address_is_refused_by_what_is_wrong_with_it(rest: str, words: str) -> None:
    with pytest.raises(LinkAddressError, match=words):
        open_link(f"ccsds:{rest}", Role.SERVICE, crafts=["alpha"])


def test_a_port_that_nobody_listens_at_is_told_and_costs_nothing_once_somebody_does(ear: Ear) -> None:
    heard, address = ear
    place = heard.getsockname()
    heard.close()
    with open_link(address, Role.SERVICE) as link:
        link.send(vector(0))
        until_s = time.monotonic() + SOON_S
        while not link.alone and time.monotonic() < until_s:
            link.send(vector(1))
        assert link.alone == f"nobody listens at 127.0.0.1:{place[1]}"
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as later:
            later.bind(place)
            later.settimeout(SOON_S)
            link.send(estimate(2))
            assert apid_and_count(later.recv(65_507)) == (257, 0)


def test_a_network_that_is_not_there_drops_and_counts(caplog: pytest.LogCaptureFixture) -> None:
    """255.255.255.255 may not be reached by a socket that has not asked to."""
    with caplog.at_level(logging.WARNING), open_link("ccsds:udp/255.255.255.255:9", Role.SERVICE) as link:
        link.send(vector(0))
        link.send(vector(1))
        assert (link.counters["dropped"], link.counters["sent"]) == (2, 0)
        assert link.alone == "there is no way to 255.255.255.255:9 (permission is denied to this user)"
    assert len(caplog.records) == 1
    link.send(vector(2))
    assert link.counters["dropped"] == 3


def test_a_network_that_goes_and_comes_back_is_told_and_taken_up_again(
    ear: Ear, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where a cable is pulled: what is sent meanwhile is dropped, and said; then packets arrive again."""
    heard, address = ear

    def refuse(*_: object) -> int:
        raise OSError(errno.ENETUNREACH, "Network is unreachable")

    with open_link(address, Role.SERVICE) as link:
        link.send(vector(0))
        with monkeypatch.context() as pulled:
            pulled.setattr(socket.socket, "send", refuse)
            link.send(vector(1))
            link.send(vector(2))
        assert link.alone == f"there is no way to {address[10:]} (the system says network is unreachable)"
        link.send(vector(3))
        assert [apid_and_count(heard.recv(65_507))[1] for _ in range(2)] == [0, 3]
        assert (link.counters["sent"], link.counters["dropped"]) == (2, 2)


def test_a_queue_of_this_machine_that_is_full_drops_and_waits_for_nothing(
    ear: Ear, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That is no lack of a way."""

    def full(*_: object) -> int:
        raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")

    with open_link(ear[1], Role.SERVICE) as link:
        monkeypatch.setattr(socket.socket, "send", full)
        link.send(vector(0))
        assert (link.alone, link.counters["dropped"]) == ("", 1)


def test_what_is_sent_to_it_is_never_read_and_stops_nothing(ear: Ear) -> None:
    """A receiver that floods the sender with datagrams is heard by nobody."""
    heard, address = ear
    with open_link(address, Role.SERVICE) as link:
        link.send(vector(0))
        _, sender = heard.recvfrom(65_507)
        for size in (0, 1, 6, 1400, 60_000):
            for _ in range(50):
                heard.sendto(b"\xff" * size, sender)
        link.send(vector(1))
        assert apid_and_count(heard.recv(65_507)) == (256, 1)
        assert link.counters["dropped"] == 0


def test_what_the_daemon_publishes_goes_there_too(ear: Ear) -> None:
    heard, address = ear
    config = Config(link="loop:mission", crafts=(CraftConfig("alpha"),), output=OutputConfig(links=(address,)))
    stop = threading.Event()
    stop.set()
    with (
        open_link(config.link, Role.SERVICE, crafts=["alpha"]) as link,
        open_link(config.link, Role.NODE) as node,
        Outputs(config.output.links, ["alpha"]) as outputs,
    ):
        service = Service(config, link, outputs=outputs)
        service.handle(sample(0))
        service.run(stop)
        published = node.receive(SOON_S)
        packets = [heard.recv(65_507)[14:] for _ in published]
        assert packets == [pack(message) for message in published]
        status = published[-1]
        assert isinstance(status, Status)
        assert status.counters["output.sent"] == len(published) - 1


def test_an_output_that_nobody_hears_is_a_trouble_of_the_status() -> None:
    with Outputs(["ccsds:udp/255.255.255.255:9"], ["alpha"]) as outputs:
        config = Config(link="loop:unheard", crafts=(CraftConfig("alpha"),))
        with open_link(config.link, Role.SERVICE) as link, open_link(config.link, Role.VIEWER) as viewer:
            Service(config, link, outputs=outputs).publish_status()
            (status,) = viewer.receive(SOON_S)
    assert isinstance(status, Status)
    assert "ccsds:udp/255.255.255.255:9: there is no way to 255.255.255.255:9" in status.text
    assert outputs.counters == Counter({**outputs.counters, "output.dropped": 1})


def test_a_defect_of_a_further_link_costs_what_it_was_to_send_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CcsdsLink, "send", lambda *_: {}["defect"])
    config = Config(link="loop:defect", crafts=(CraftConfig("alpha"),))
    with (
        open_link(config.link, Role.SERVICE) as link,
        open_link(config.link, Role.NODE) as node,
        Outputs(["ccsds:udp/127.0.0.1:9"], ["alpha"]) as outputs,
    ):
        service = Service(config, link, outputs=outputs)
        service.handle(sample(0))
        assert [type(message).__name__ for message in node.receive(SOON_S)] == ["CalibratedVector"]
    assert service.counters["untold"] == 1


def test_an_address_of_ipv6_stands_in_brackets() -> None:
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as heard:
        try:
            heard.bind(("::1", 0))
        except OSError:
            pytest.skip("no IPv6 on this machine")
        heard.settimeout(SOON_S)
        with open_link(f"ccsds:udp/[::1]:{heard.getsockname()[1]}", Role.SERVICE) as link:
            link.send(vector(0))
            assert heard.recv(65_507)[14:] == pack(vector(0))


@pytest.mark.parametrize(
    ("top", "output", "words"),
    [
        ('link = "ccsds:udp/127.0.0.1:9"', "", "ccsds: only sends"),
        ("", 'links = ["zenoh:tcp/127.0.0.1:7447"]', "ccsds: addresses are accepted"),
        ("", 'links = "ccsds:udp/127.0.0.1:9"', "an array of at most 8 addresses"),
        ("", 'links = ["ccsds:udp/127.0.0.1:9", "ccsds:udp/127.0.0.1:9"]', "each once"),
        ("", 'links = ["cssds:udp/127.0.0.1:9"]', "did you mean 'ccsds'"),
    ],
)
def test_a_configuration_tells_links_that_send_from_the_main_one(
    tmp_path: Path, top: str, output: str, words: str
) -> None:
    path = tmp_path / "magcal.toml"
    path.write_text(f'version = 1\n{top}\n[[craft]]\nname = "a"\n[output]\n{output}\n', encoding="utf-8")
    with pytest.raises(ConfigError, match=words):
        load_config(path)


def test_a_configuration_with_further_links() -> None:
    assert OutputConfig().links == ()
