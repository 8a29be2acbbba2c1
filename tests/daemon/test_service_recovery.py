"""Daemon killed, link pulled, node restarted, on real processes: sent is accepted, refused and lost, to the sample."""

from __future__ import annotations

import contextlib
import csv
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from magcal_service.daemon.estimate_csv import COLUMNS
from magcal_service.ticks.rejection import Rejection
from tests.daemon.service_processes import CutCable, Node, daemon, free_port, kill, stream, wait_for, write_config

ROUTER = Path(__file__).resolve().parents[2] / "deploy" / "router.py"


def refused(counters: dict[str, int]) -> int:
    return sum(counters.get(kind, 0) for kind in Rejection)


def test_samples_sent_while_the_daemon_is_dead_are_kept_for_it(tmp_path: Path) -> None:
    """zenoh: 100 s of samples, SIGKILL, 50 s of samples, restart, 50 s.

    The node's cache holds what the daemon missed, and as much before as the daemon asks for: 100 samples.  So none is
    lost, and the 50 newest of those already answered are answered again by the new daemon.
    """
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    config = write_config(tmp_path, address, csv=tmp_path / "rows.csv")
    with contextlib.ExitStack() as stack:
        first = stack.enter_context(daemon(config))
        node = stack.enter_context(Node(address))
        node.until_heard()
        node.send(stream()[:200])
        node.settle()
        kill(first)
        node.send(stream()[200:300])
        second = stack.enter_context(daemon(config, 2))
        node.until_heard()
        node.send(stream()[300:400])
        node.settle()
        node.until_accepted(150)
        assert (node.sent, len(node.answers), node.flow.counters["unanswered"]) == (200, 200, 0)
        assert sorted(number for (_, number), count in node.answers.items() if count == 2) == list(range(50, 100))
        assert (node.counters()["accepted"], refused(node.counters()), node.counters().get("link.lost", 0)) == (
            150,
            0,
            0,
        )
        assert second.stop() == 0
    assert_rows_are_whole(tmp_path / "rows.csv")


def assert_rows_are_whole(path: Path) -> None:
    """Two daemons, one killed in the middle, wrote into it: one header, whole rows."""
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    assert tuple(rows[0]) == COLUMNS
    assert {len(row) for row in rows} == {len(COLUMNS)}
    assert sum(row[0] == "craft" for row in rows) == 1


def test_a_daemon_that_asks_for_no_history_says_nothing_of_what_it_missed_but_the_node_does(tmp_path: Path) -> None:
    """zenoh with history=0: of the 50 samples sent while the daemon was dead, those that are lost the node counts.

    All of them mostly; none where zenoh on a busy machine has still held them when the link came back.  What it then
    brings of those before is answered once more: the daemon accepts what it answers, and nothing else.
    """
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    config = write_config(tmp_path, f"{address}?history=0")
    with contextlib.ExitStack() as stack:
        first = stack.enter_context(daemon(config))
        node = stack.enter_context(Node(address))
        node.until_heard()
        node.send(stream()[:200])
        node.settle()
        kill(first)
        node.until("still connected", lambda: not node.connected)
        node.send(stream()[200:300])
        stack.enter_context(daemon(config, 2))
        node.until_heard()
        node.send(stream()[300:400])
        node.flow.wait_for_room()
        lost = node.flow.counters["unanswered"]
        assert 0 <= lost <= 50
        node.until_accepted(100 - lost)
        assert node.flow.counters["samples"] == node.flow.counters["answered"] + lost
        assert (node.sent, len(node.answers)) == (200, 200 - lost)

        def once_more() -> int:
            return sum(node.answers.values()) - len(node.answers)

        node.until("the books do not close", lambda: node.counters()["accepted"] == 100 - lost + once_more())
        assert refused(node.counters()) == 0


@pytest.fixture
def cable() -> Iterator[CutCable]:
    with CutCable() as cable:
        yield cable


def test_a_serial_cable_pulled_and_restored_costs_what_was_sent_meanwhile(tmp_path: Path, cable: CutCable) -> None:
    """100 s of samples, cable out for 40 s of them, 100 s: 40 samples and 40 references are counted as lost."""
    config = write_config(tmp_path, f"serial:{cable.paths[0]}")
    with daemon(config), Node(f"serial:{cable.paths[1]}") as node:
        node.until_heard()
        node.send(stream()[:200])
        node.settle()
        cable.cut.set()
        node.send(stream()[200:280])
        node.listen(0.5)
        cable.cut.clear()
        node.send(stream()[280:480])
        node.flow.wait_for_room()
        node.until_accepted(200)
        counters = node.counters()
        assert cable.lost_bytes > 0
        assert (node.sent, counters["accepted"], refused(counters), counters["link.lost"]) == (240, 200, 0, 80)
        assert (counters["ticks_empty"], node.flow.counters["unanswered"]) == (40, 40)


@contextlib.contextmanager
def router(port: int, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    command = [sys.executable, "-u", str(ROUTER), "--listen", f"tcp/127.0.0.1:{port}"]
    with log.open("wb") as output, subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT) as process:
        try:
            wait_for("router open", log)
            yield process
        finally:
            process.terminate()


def test_a_router_stopped_and_started_again_costs_no_sample(tmp_path: Path) -> None:
    """Both ends keep what they could not send: 100 samples before, 40 without a router, 100 after, none is lost."""
    port = free_port()
    address = f"zenoh:tcp/127.0.0.1:{port}?mode=client"
    config = write_config(tmp_path, address)
    with contextlib.ExitStack() as stack:
        with router(port, tmp_path / "router-1.log"):
            process = stack.enter_context(daemon(config))
            node = stack.enter_context(Node(address))
            node.until_heard()
            node.send(stream()[:200])
            node.settle()
        node.until("the router is gone", lambda: node.link.counters["down"])
        node.send(stream()[200:280])
        stack.enter_context(router(port, tmp_path / "router-2.log"))
        node.until_heard()
        node.send(stream()[280:480])
        node.until_accepted(240)
        process.check()
        counters = node.counters()
        assert (node.sent, counters["accepted"], refused(counters), counters.get("link.lost", 0)) == (240, 240, 0, 0)
        assert counters["link.down"] >= 1


def test_a_node_that_restarts_counts_from_0_again_and_nothing_is_lost(tmp_path: Path) -> None:
    """100 samples, a new node, 100 samples numbered from 0 again: two restarts, of samples and of references."""
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    config = write_config(tmp_path, address)
    with daemon(config):
        with Node(address) as node:
            node.until_heard()
            node.send(stream()[:200])
            node.settle()
        again = [replace(message, sequence=message.sequence - 100) for message in stream()[200:400]]
        with Node(address) as other:
            other.until_heard()
            other.send(again)
            other.settle()
            other.until_accepted(200)
            counters = other.counters()
        assert node.sent + other.sent == counters["accepted"] + refused(counters) == 200
        assert (counters["link.restarted"], counters.get("link.lost", 0)) == (2, 0)
        assert counters.get("ticks_empty", 0) == 0


def test_what_a_node_leaves_out_is_counted_as_lost(tmp_path: Path) -> None:
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    with daemon(write_config(tmp_path, address)), Node(address) as node:
        node.until_heard()
        node.send([*stream()[:100], *stream()[120:200]])
        node.settle()
        node.until_accepted(90)
        assert node.counters()["link.lost"] == 20


def test_two_crafts_share_one_daemon_and_a_third_is_counted_as_unknown(tmp_path: Path) -> None:
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    config = write_config(tmp_path, address, crafts=("alpha", "beta"))
    with daemon(config), Node(address, crafts=("alpha", "beta", "gamma")) as node:
        node.until_heard()
        mixed = [m for pair in zip(stream("alpha")[:100], stream("beta", seed=2)[:100], strict=True) for m in pair]
        node.send(mixed)
        node.settle()
        for message in stream("gamma")[:20]:
            node.link.send(message)
        for craft in ("alpha", "beta"):
            node.until_accepted(50, craft)
            node.until("49 ticks", lambda craft=craft: node.counters(craft).get("ticks", 0) == 49)
        node.until("unknown", lambda: node.counters("alpha").get("link.refused.unknown_craft", 0) == 20)
        last = {estimate.craft: estimate for estimate in node.estimates}
        assert set(last) == {"alpha", "beta"}
        assert {craft for craft, _ in node.answers} == {"alpha", "beta"}
