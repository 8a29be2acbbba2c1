"""The serial link keeps the contract over real pseudo-terminals, and what is its own."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from magcal_service.base.errors import LinkAddressError
from magcal_service.links import Link, Role, open_link
from magcal_service.wire.framing import FrameEncoder, StreamDecoder
from sim_sensor.demo.pty_pair import PtyPair
from tests.links.link_contract import Ends, LinkContract
from tests.links.link_messages import SOON_S, WAIT_S, flows, gather, sample, settle, vector


class SerialEnds(Ends):
    """Two ends of a cable that can be pulled out and put back: the devices are names for the pair now plugged in."""

    def __init__(self, directory: Path) -> None:
        self._devices = {Role.SERVICE: directory / "ttyService", Role.NODE: directory / "ttyNode"}
        self._cable: PtyPair | None = None
        self.plug()
        super().__init__()

    def address(self, role: Role) -> str:
        return f"serial:{self._devices[role]}"

    def garbage(self) -> str:
        frame = bytearray(FrameEncoder().encode(sample(0)))
        frame[9] ^= 0x40
        self.raw(bytes(frame))
        return "refused.bad_crc"

    def raw(self, data: bytes) -> None:
        """Write bytes on the node's device beside its link."""
        with open(self._devices[Role.NODE], "wb", buffering=0) as device:
            device.write(data)

    def plug(self) -> None:
        """Put a cable in."""
        self._cable = PtyPair()
        for device, path in zip(self._devices.values(), self._cable.paths, strict=True):
            device.unlink(missing_ok=True)
            device.symlink_to(path)

    def pull(self) -> None:
        """Pull the cable out: both devices vanish."""
        if self._cable is not None:
            self._cable.close()
            self._cable = None
        for device in self._devices.values():
            device.unlink(missing_ok=True)

    def close(self) -> None:
        super().close()
        self.pull()


@pytest.fixture
def ends(tmp_path: Path) -> Iterator[SerialEnds]:
    pair = SerialEnds(tmp_path)
    yield pair
    pair.close()


class TestSerialLink(LinkContract):
    """The contract, over a pair of pseudo-terminals."""

    known_option = "baud"


def died(link: Link) -> bool:
    return settle(lambda: not link.receive(0.0) and link.counters["down"] == 1)


def test_a_cable_pulled_and_put_back_flows_again_both_ways(ends: SerialEnds) -> None:
    flows(ends.node, ends.service, sample)
    ends.pull()
    assert died(ends.service)
    assert died(ends.node)
    ends.plug()
    flows(ends.node, ends.service, sample, first=1000)
    flows(ends.service, ends.node, vector)
    assert (ends.service.counters["up"], ends.node.counters["up"]) == (2, 2)


def test_what_is_sent_while_the_cable_is_out_is_counted_as_dropped_and_seen_as_lost(ends: SerialEnds) -> None:
    ends.node.send(sample(0))
    gather(ends.service, 1)
    ends.pull()
    assert died(ends.node)
    for number in range(1, 11):
        ends.node.send(sample(number))
    assert ends.node.counters["dropped"] == 10
    ends.plug()
    assert settle(lambda: not ends.node.receive(0.01) and ends.node.counters["up"] == 2)
    assert settle(lambda: not ends.service.receive(0.01) and ends.service.counters["up"] == 2)
    ends.node.send(sample(11))
    assert gather(ends.service, 1) == [sample(11)]
    assert ends.service.counters["lost"] == 10


def test_a_device_that_is_not_there_yet_is_no_error(tmp_path: Path) -> None:
    with open_link(f"serial:{tmp_path / 'ttyNowhere'}", Role.SERVICE) as link:
        link.send(vector(1))
        begun_s, used_s = time.monotonic(), time.process_time()
        assert link.receive(0.5) == []
        assert 0.5 <= time.monotonic() - begun_s < SOON_S
        assert time.process_time() - used_s < 0.05
        assert (link.counters["up"], link.counters["dropped"]) == (0, 1)


def test_a_device_in_use_is_not_shared(ends: SerialEnds) -> None:
    with open_link(ends.address(Role.NODE), Role.NODE) as second:
        assert second.counters["up"] == 0


@pytest.fixture
def stuck() -> Iterator[tuple[int, str]]:
    """A line that nobody reads: its far end's file and its device."""
    far, near = os.openpty()
    yield far, os.ttyname(near)
    os.close(near)
    os.close(far)


def test_sending_on_a_stuck_line_does_not_block_and_the_oldest_are_dropped(stuck: tuple[int, str]) -> None:
    far, device = stuck
    with open_link(f"serial:{device}?backlog_bytes=16384", Role.NODE) as link:
        begun_s = time.monotonic()
        for number in range(2000):
            link.send(sample(number))
        assert time.monotonic() - begun_s < SOON_S
        assert link.counters["dropped"] > 1000
        os.set_blocking(far, False)
        written = bytearray()
        while not link.receive(0.02):
            try:
                written += os.read(far, 65536)
            except BlockingIOError:
                break
        assert StreamDecoder().feed(bytes(written))[-1] == sample(1999)


def test_frames_older_than_the_backlogs_age_are_dropped(stuck: tuple[int, str]) -> None:
    with open_link(f"serial:{stuck[1]}?backlog_s=0.05", Role.NODE) as link:
        for number in range(2000):
            link.send(sample(number))
        time.sleep(0.06)
        link.send(sample(2000))
        assert link.counters["dropped"] > 500
        assert link.counters["sent"] + link.counters["dropped"] >= 1999  # one is partly written, one is new


def test_a_frame_split_into_single_bytes_arrives_whole(ends: SerialEnds) -> None:
    for byte in FrameEncoder().encode(sample(3)):
        ends.raw(bytes([byte]))
    assert gather(ends.service, 1) == [sample(3)]


def test_the_echo_of_own_results_is_counted_and_not_received(ends: SerialEnds) -> None:
    ends.raw(FrameEncoder().encode(vector(1)))
    assert settle(lambda: not ends.service.receive(0.0) and ends.service.counters["refused.wrong_direction"] == 1)


def test_closing_lets_the_line_take_what_is_queued(ends: SerialEnds) -> None:
    for number in range(300):
        ends.node.send(sample(number))
    ends.node.close()
    assert len(gather(ends.service, 300, timeout_s=WAIT_S)) == 300


@pytest.mark.parametrize(
    ("address", "named"),
    [
        ("serial:", "device"),
        ("serial:/dev/ttyS0?baud=fast", "'fast'"),
        ("serial:/dev/ttyS0?parity=evn", "did you mean 'even'"),
        ("serial:/dev/ttyS0?stop_bits=3", "'3'"),
        ("serial:/dev/ttyS0?dtr=maybe", "'maybe'"),
        ("serial:/dev/ttyS0?backlog_s=nan", "'nan'"),
    ],
)
def test_a_wrong_serial_address_is_refused_by_name(address: str, named: str) -> None:
    with pytest.raises(LinkAddressError, match=named):
        open_link(address, Role.SERVICE)
