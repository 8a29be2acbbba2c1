"""Messages that once ended the daemon, on real processes: it goes on, and its history brings them back in vain."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from magcal_service.ticks.time_window import EARLIEST_NS, LATEST_NS
from magcal_service.wire.messages import MagnetometerSample, Message
from tests.daemon.service_processes import Node, daemon, free_port, kill, stream, write_config

SECOND_NS = 1_000_000_000
WIRE_NS = (-(1 << 63), (1 << 63) - 1)


def samples(messages: tuple[Message, ...]) -> list[MagnetometerSample]:
    return [one for one in messages if isinstance(one, MagnetometerSample)]


def at(messages: list[MagnetometerSample], first_ns: int) -> list[Message]:
    """Samples at other times, a second apart."""
    return [replace(one, time_ns=first_ns + number * SECOND_NS) for number, one in enumerate(messages)]


def newest(folder: Path) -> str:
    """Name of the newest checkpoint, empty where there is none."""
    return max((path.name for path in (folder / "paper").glob("*.state")), default="")


def test_three_samples_near_the_smallest_time_end_nothing_and_neither_does_the_history_that_brings_them_back(
    tmp_path: Path,
) -> None:
    """100 s of flight, three samples near -2^63 ns, a checkpoint; SIGKILL; the history; flight; a checkpoint."""
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    config = write_config(tmp_path, address)
    state = tmp_path / "state"
    config.write_text(f"{config.read_text()}[state]\ndirectory = {json.dumps(str(state))}\nperiod_s = 10.0\n")
    flight = stream(seconds=300)
    poison = at(samples(flight)[:3], WIRE_NS[0] + SECOND_NS)
    with daemon(config) as first, Node(address) as node:
        node.until_heard()
        node.send(flight[:200])
        node.settle()
        for message in poison:
            node.link.send(message)
        node.until("the poison", lambda: node.counters().get("time_out_of_range") == 3)
        earlier = newest(state)
        node.until("no checkpoint with it", lambda: newest(state) > earlier)
        before = newest(state)
        node.send(flight[200:240])
        node.settle()
        kill(first)
        with daemon(config, 2) as second:
            node.until_heard()
            node.until("no history", lambda: node.counters().get("time_out_of_range", 0) >= 6)
            node.send(flight[240:400])
            node.until_accepted(200)
            node.until("no later checkpoint", lambda: newest(state) > before)
            counters = node.counters()
            assert second.stop() == 0
    assert (counters["state.restored"], counters.get("failed", 0), counters.get("clock_step", 0)) == (1, 0, 0)


def test_times_that_hop_between_both_ends_of_64_bits_end_nothing(tmp_path: Path) -> None:
    """Without a state: ends of the wire, where all is refused, and ends of the window, where each hop is believed."""
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    config = write_config(tmp_path, address)
    flight = stream(seconds=100)
    ends = (WIRE_NS[0], WIRE_NS[1] - 10 * SECOND_NS, EARLIEST_NS, LATEST_NS - 10 * SECOND_NS)
    with daemon(config) as process, Node(address) as node:
        node.until_heard()
        for hop in range(16):
            for message in at(samples(flight)[4 * hop : 4 * hop + 4], ends[hop % 4]):
                node.link.send(message)
        node.until("not all came", lambda: node.counters().get("time_out_of_range") == 32)
        node.until("no step was believed", lambda: node.counters().get("clock_step", 0) >= 7)
        node.until("not all of it was accepted", lambda: node.counters()["accepted"] == 4 + 7 * 2)
        assert process.stop() == 0
