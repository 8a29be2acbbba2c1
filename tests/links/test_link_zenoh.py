"""The zenoh link keeps the contract over real sessions on 127.0.0.1, and what is its own."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import cast

import pytest
import zenoh

from magcal_service.base.errors import LinkAddressError, LinkError
from magcal_service.links import Link, Role, open_link
from magcal_service.links.zenoh import ZenohLink
from magcal_service.wire.codec import encode
from magcal_service.wire.messages import Message
from tests.links.link_contract import Ends, LinkContract
from tests.links.link_messages import (
    SOON_S,
    WAIT_S,
    command,
    estimate,
    flows,
    free_port,
    gather,
    sample,
    settle,
    vector,
)

ROOT = Path(__file__).resolve().parents[2]


class ZenohEnds(Ends):
    """A service that listens and a node that connects."""

    def __init__(self) -> None:
        self.port = free_port()
        super().__init__()

    def address(self, role: Role) -> str:
        return f"zenoh:tcp/127.0.0.1:{self.port}"

    def connected(self) -> bool:
        return settle(lambda: sees(self.service, Role.NODE) and sees(self.node, Role.SERVICE))

    def garbage(self) -> str:
        self.put("magcal/v1/alpha/sample/magnetometer/mag", b"\xc1 no msgpack")
        return "refused.not_msgpack"

    def put(self, key: str, payload: bytes) -> None:
        """Put bytes as a program that isn't ours would, and see that they have arrived."""
        with zenoh.open(session_config("client", self.port)) as session, session.declare_publisher(key) as publisher:
            assert settle(lambda: publisher.matching_status.matching)  # else it may be dropped
            publisher.put(payload)

    def viewer(self, crafts: tuple[str, ...] = ("alpha",), options: str = "") -> ZenohLink:
        """One more listener."""
        return cast(ZenohLink, open_link(self.address(Role.VIEWER) + options, Role.VIEWER, crafts=crafts))


def sees(link: Link, role: Role) -> bool:
    """Whether an end of this role is alive for the link, so that it hears what the link sends."""
    return any(presence.role is role for presence in cast(ZenohLink, link).alive())


def session_config(mode: str, port: int) -> zenoh.Config:
    """The configuration of a bare session: a router that listens, or a client that connects."""
    config = zenoh.Config()
    endpoints = json.dumps([f"tcp/127.0.0.1:{port}"])
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("listen/endpoints", endpoints if mode == "router" else "[]")
    config.insert_json5("connect/endpoints", "[]" if mode == "router" else endpoints)
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("timestamping/enabled", "true")
    return config


@pytest.fixture
def ends() -> Iterator[ZenohEnds]:
    pair = ZenohEnds()
    yield pair
    pair.close()


class TestZenohLink(LinkContract):
    """The contract, over zenoh."""


def test_a_late_joiner_has_the_newest_estimate_at_once_and_once(ends: ZenohEnds) -> None:
    for number in range(5):
        ends.service.send(estimate(number))
    time.sleep(0.8)  # past the publisher's heartbeat, which would bring the newest to a joiner as well
    with ends.viewer() as viewer:
        begun_s = time.monotonic()
        assert viewer.receive(WAIT_S) == [estimate(4)]
        assert time.monotonic() - begun_s < SOON_S
        assert viewer.receive(0.3) == []


def test_a_late_joiner_does_not_get_old_vectors(ends: ZenohEnds) -> None:
    ends.service.send(vector(1))
    with ends.viewer() as viewer:
        assert viewer.receive(0.3) == []


def test_a_viewer_sees_samples_and_results_and_its_command_reaches_the_service(ends: ZenohEnds) -> None:
    with ends.viewer() as viewer:
        assert settle(lambda: sees(viewer, Role.SERVICE) and sees(ends.node, Role.VIEWER))
        ends.node.send(sample(1))
        ends.service.send(vector(1))
        viewer.send(command(1))
        assert sorted(type(message).__name__ for message in gather(viewer, 2)) == [
            "CalibratedVector",
            "MagnetometerSample",
        ]
        assert {type(message).__name__ for message in gather(ends.service, 2)} == {"Command", "MagnetometerSample"}


def test_a_viewer_without_samples_gets_results_only(ends: ZenohEnds) -> None:
    with ends.viewer(options="?samples=no") as viewer:
        assert settle(lambda: sees(ends.service, Role.VIEWER))
        ends.node.send(sample(1))
        gather(ends.service, 1)
        ends.service.send(estimate(1))
        assert gather(viewer, 1) == [estimate(1)]
        assert viewer.receive(0.2) == []


def test_two_crafts_on_one_session_are_told_apart() -> None:
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    with (
        open_link(address, Role.SERVICE, crafts=["alpha", "beta"]) as service,
        open_link(address, Role.NODE, crafts=["alpha"]) as alpha,
        open_link(address, Role.NODE, crafts=["beta"]) as beta,
    ):
        assert settle(lambda: len(cast(ZenohLink, service).alive()) == 2)
        for number in range(10):
            alpha.send(sample(number, craft="alpha"))
            beta.send(sample(number, craft="beta"))
        assert len(gather(service, 20)) == 20
        assert {record.craft: record.received for record in service.sources()} == {"alpha": 10, "beta": 10}
        service.send(estimate(1, craft="beta"))
        assert gather(beta, 1) == [estimate(1, craft="beta")]
        assert alpha.receive(0.1) == []


def test_a_router_that_restarts_loses_none_of_100_samples() -> None:
    port = free_port()
    address = f"zenoh:tcp/127.0.0.1:{port}?mode=client"
    router = zenoh.open(session_config("router", port))
    with (
        open_link(address, Role.SERVICE, crafts=["alpha"]) as service,
        open_link(address, Role.NODE, crafts=["alpha"]) as node,
    ):
        arrived: list[Message] = []
        for number in range(100):
            node.send(sample(number))
            arrived += service.receive(0.005)
            if number == 30:
                router.close()  # type: ignore[no-untyped-call]
            if number == 70:
                router = zenoh.open(session_config("router", port))
        arrived += gather(service, 100 - len(arrived))
        assert arrived == [sample(number) for number in range(100)]
        assert (service.counters["lost"], node.counters["dropped"]) == (0, 0)
        assert node.counters["deferred"] > 0
        assert (service.counters["up"], service.counters["down"]) == (2, 1)
    router.close()  # type: ignore[no-untyped-call]


def test_a_service_that_restarts_asks_for_the_samples_it_missed(ends: ZenohEnds) -> None:
    ends.node.send(sample(0))
    gather(ends.service, 1)
    ends.service.close()
    for number in range(1, 21):
        ends.node.send(sample(number))
    ends.service = ends.open(Role.SERVICE)
    assert gather(ends.service, 21) == [sample(number) for number in range(21)]


def test_a_service_with_no_history_starts_with_the_next_sample(ends: ZenohEnds) -> None:
    """But for the newest: a heartbeat that follows on it once brought all that the node keeps."""
    for number in range(20):
        ends.node.send(sample(number))
    gather(ends.service, 20)
    ends.service.close()
    ends.node.send(sample(20))
    ends.service = ends.open(Role.SERVICE, "?history=0")
    assert ends.connected()
    assert {one.sequence for one in gather(ends.service, 20, 0.8)} <= {20}
    ends.node.send(sample(21))
    assert gather(ends.service, 1) == [sample(21)]


def test_a_command_is_not_repeated_to_the_next_service(ends: ZenohEnds) -> None:
    with ends.viewer() as viewer:
        assert settle(lambda: sees(viewer, Role.SERVICE))
        viewer.send(command(1))
        assert gather(ends.service, 1) == [command(1)]
        ends.service.close()
        ends.service = ends.open(Role.SERVICE)
        assert settle(lambda: viewer.counters["up"] == 2)
        assert ends.service.receive(0.5) == []


def test_a_vector_sent_while_the_router_is_away_is_counted_as_dropped() -> None:
    port = free_port()
    router = zenoh.open(session_config("router", port))
    with open_link(f"zenoh:tcp/127.0.0.1:{port}?mode=client", Role.SERVICE, crafts=["alpha"]) as service:
        router.close()  # type: ignore[no-untyped-call]
        assert settle(lambda: service.counters["down"] == 1)
        service.send(vector(1))
        assert (service.counters["dropped"], service.counters["sent"]) == (1, 0)


def test_a_node_that_starts_first_connects_when_the_service_comes() -> None:
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    with open_link(address, Role.NODE, crafts=["alpha"]) as node:
        node.send(sample(0))
        assert node.counters["dropped"] == 1
        with open_link(address, Role.SERVICE, crafts=["alpha"]) as service:
            flows(node, service, sample, first=1)


def test_a_session_that_dies_is_opened_again(ends: ZenohEnds) -> None:
    flows(ends.node, ends.service, sample)
    session = cast(ZenohLink, ends.node)._session
    assert session is not None
    session.zenoh.close()  # type: ignore[no-untyped-call]
    flows(ends.node, ends.service, sample, first=1000)
    flows(ends.service, ends.node, vector)


def test_a_port_that_is_taken_is_an_error_at_once(ends: ZenohEnds) -> None:
    with pytest.raises(LinkError, match="another process has this port; free it or choose another"):
        open_link(ends.address(Role.SERVICE), Role.SERVICE)


@pytest.mark.parametrize(
    ("key", "reason"),
    [
        ("magcal/v1/beta/sample/magnetometer/mag", "refused.wrong_craft"),
        ("magcal/v1/alpha/sample/magnetometer/other", "refused.wrong_key"),
        ("magcal/v1/alpha/sample/reference/mag", "refused.wrong_key"),
        ("magcal/v1/alpha/sample/magnetometer/mag", "received"),
    ],
)
def test_a_key_that_disagrees_with_its_payload_is_refused(ends: ZenohEnds, key: str, reason: str) -> None:
    ends.put(key, encode(sample(1)))
    assert settle(lambda: bool(ends.service.receive(0.0)) or ends.service.counters[reason] == 1)
    assert ends.service.counters[reason] == 1


def test_an_address_that_this_machine_has_not_is_said_in_words() -> None:
    with pytest.raises(
        LinkError, match=r"cannot listen: this machine has no such address; give another address or port$"
    ):
        open_link("zenoh:tcp/198.51.100.1:7447", Role.SERVICE)


def test_an_oversized_payload_is_refused_before_it_is_queued(ends: ZenohEnds) -> None:
    ends.put("magcal/v1/alpha/sample/magnetometer/mag", bytes(20_000))
    assert settle(lambda: ends.service.counters["refused.too_large"] == 1)


def test_what_a_full_queue_pushes_out_is_counted_and_the_newest_stay(ends: ZenohEnds) -> None:
    ends.service.close()
    ends.service = ends.open(Role.SERVICE, "?queue=10")
    assert ends.connected()
    last = flows(ends.node, ends.service, sample)
    assert settle(lambda: not ends.service.receive(0.0) and ends.service.counters["received"] == last + 1)
    for number in range(1000, 1200):
        ends.node.send(sample(number))
    assert settle(lambda: ends.service.counters["overflow"] == 190)
    assert [message.sequence for message in ends.service.receive(1.0)] == list(range(1190, 1200))


def test_both_ends_know_that_the_other_is_alive_and_when_it_leaves(ends: ZenohEnds) -> None:
    service, node = cast(ZenohLink, ends.service), cast(ZenohLink, ends.node)
    assert settle(lambda: [presence.role for presence in service.alive()] == [Role.NODE])
    assert settle(lambda: [presence.role for presence in node.alive()] == [Role.SERVICE])
    node.close()
    assert settle(lambda: not service.alive())


def test_an_option_names_an_end_in_its_token(ends: ZenohEnds) -> None:
    with ends.viewer(options="?name=desk-1"):
        service = cast(ZenohLink, ends.service)
        assert settle(lambda: ("alpha", Role.VIEWER, "desk-1") in service.alive())


VICTIM = ("alpha", Role.VIEWER, "victim")


@contextlib.contextmanager
def victim(ends: ZenohEnds, lease_ms: int) -> Iterator[subprocess.Popen[bytes]]:
    """A viewer in a process of its own, alive, to be treated badly."""
    address = f"{ends.address(Role.VIEWER)}?name=victim&lease_ms={lease_ms}"
    code = (
        "from magcal_service.links import Role, open_link\n"
        f"with open_link({address!r}, Role.VIEWER, crafts=['alpha']) as link:\n"
        "    while True: link.receive(1.0)"
    )
    process = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT)
    try:
        assert settle(lambda: VICTIM in cast(ZenohLink, ends.service).alive())
        yield process
    finally:
        process.kill()
        process.wait()


def test_an_end_that_is_killed_is_missed_long_before_its_lease(ends: ZenohEnds) -> None:
    with victim(ends, lease_ms=60_000) as process:
        process.send_signal(signal.SIGKILL)
        assert settle(lambda: VICTIM not in cast(ZenohLink, ends.service).alive())


def test_an_end_that_falls_silent_is_missed_after_its_lease(ends: ZenohEnds) -> None:
    with victim(ends, lease_ms=500) as process:
        process.send_signal(signal.SIGSTOP)
        assert settle(lambda: VICTIM not in cast(ZenohLink, ends.service).alive())


def test_a_viewer_that_hangs_neither_blocks_the_service_nor_starves_the_node(ends: ZenohEnds) -> None:
    slowest_s = silence_s = 0.0
    with victim(ends, lease_ms=2500) as process:  # long enough to fill what the kernel buffers
        process.send_signal(signal.SIGSTOP)
        begun_s = heard_s = time.monotonic()
        for number in itertools.count():
            before_s = time.monotonic()
            if before_s > begun_s + 6.0:
                break
            ends.service.send(estimate(number))
            now_s = time.monotonic()
            slowest_s = max(slowest_s, now_s - before_s)
            silence_s = max(silence_s, now_s - heard_s)
            if ends.node.receive(0.0):
                heard_s = now_s
    assert silence_s < 2.5  # 4 s with the settings that zenoh comes with
    assert slowest_s < 2.5


@pytest.mark.parametrize("role", ["SERVICE", "NODE"])
def test_a_process_that_forgets_to_close_its_link_still_ends(role: str) -> None:
    code = (
        "from magcal_service.links import Role, open_link\n"
        f"link = open_link('zenoh:tcp/127.0.0.1:{free_port()}', Role.{role}, crafts=['alpha'])\n"
        "link.receive(0.1)"
    )
    finished = subprocess.run([sys.executable, "-c", code], cwd=ROOT, timeout=WAIT_S, capture_output=True, check=False)
    assert (finished.returncode, finished.stderr) == (0, b"")


def test_closing_does_not_wait_for_a_host_that_never_answers() -> None:
    link: Link = open_link("zenoh:tcp/127.0.0.1:1", Role.NODE)
    begun_s = time.monotonic()
    link.close()
    assert time.monotonic() - begun_s < 2.0


@pytest.mark.parametrize(
    ("address", "named"),
    [
        ("zenoh:127.0.0.1:7447", "'127.0.0.1:7447'"),
        ("zenoh:tcp/127.0.0.1", "host and port"),
        ("zenoh:tcp/127.0.0.1:99999", "host and port"),
        ("zenoh:tpc/127.0.0.1:7447", "did you mean 'tcp'"),
        ("zenoh://tcp/127.0.0.1:7447", "without the two slashes"),
        ("zenoh:?mode=pear", "did you mean 'peer'"),
        ("zenoh:?mode=client&listen=yes", "a client cannot listen"),
        ("zenoh:?config=/no/such/file.json5", "/no/such/file.json5"),
        ("zenoh:?name=two%20words", "'two words'"),
        ("zenoh:?queue=0", "'0'"),
    ],
)
def test_a_wrong_zenoh_address_is_refused_by_name(address: str, named: str) -> None:
    with pytest.raises(LinkAddressError, match=named):
        open_link(address, Role.SERVICE)


def test_what_a_configuration_file_sets_is_kept(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text("{transport: {link: {tx: {lease: 1234}}}, scouting: {multicast: {enabled: true}}, mode: 'router'}")
    from magcal_service.links import parse_address
    from magcal_service.links.zenoh_settings import ZenohSettings

    address = parse_address(f"zenoh:?config={file}")
    config = ZenohSettings.read(address, Role.SERVICE).session_config(address)
    assert config.get_json("transport/link/tx/lease") == "1234"
    assert config.get_json("scouting/multicast/enabled") == "true"
    assert config.get_json("timestamping/enabled") == "true"
    assert config.get_json("mode") == '"peer"'


def test_a_burst_of_vectors_on_a_busy_machine_arrives_whole(ends: ZenohEnds) -> None:
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2 * (os.cpu_count() or 1))]
    try:
        for number in range(500):
            ends.service.send(vector(number))
        assert len(gather(ends.node, 500)) == 500
    finally:
        for process in busy:
            process.kill()
            process.wait()


def test_more_sources_than_are_remembered_are_served_all_the_same(ends: ZenohEnds) -> None:
    session = cast(ZenohLink, ends.node)._session
    assert session is not None
    session.most = 5
    for number in range(20):
        ends.node.send(sample(0, source=f"mag-{number}"))
    assert len(gather(ends.service, 20)) == 20


def test_a_burst_of_vectors_survives_a_link_that_hardly_gets_a_processor() -> None:
    """Every vector of 4 bursts of 150 arrives, though zenoh's threads run only where nobody else wants to."""
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    command_line = [sys.executable, "-m", "tests.links.starved_service", address, "4", "150"]
    with subprocess.Popen(command_line, cwd=ROOT) as service, open_link(address, Role.NODE, crafts=["alpha"]) as node:
        arrived = gather(node, 600, 60.0)
        assert service.wait(60.0) == 0
    assert [message.sequence for message in arrived] == list(range(600))
