"""What a joining node sends again is asked for, held back until it is there, and given in the order of its time."""

from __future__ import annotations

import time
from dataclasses import replace
from threading import Event, Thread

import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_service.links import Role, open_link
from magcal_service.links import joining as module
from magcal_service.links.joining import (
    ALONE_QUIET_S,
    ALONE_S,
    ASKED_S,
    TOKEN_S,
    Joining,
    StreamName,
    in_order_of_time,
)
from magcal_service.wire.messages import MagnetometerSample, Message, ReferenceSample
from tests.links.link_messages import START_NS, WAIT_S, free_port, gather, sample, settle

SECOND_NS = 1_000_000_000


MAG = StreamName("alpha", "magnetometer", "mag", "one", "1")
REF = StreamName("alpha", "reference", "ref", "one", "2")


def joining(turn: int = 64, most: int = 100) -> Joining[Message]:
    """Of streams whose messages are sent again as they are."""
    return Joining(turn, lambda message: message, most)


def flowing(turn: int = 64) -> Joining[Message]:
    """Both streams of a craft are there, each has sent message 0, and nothing waits."""
    one = joining(turn)
    for name, message in ((REF, reference(0)), (MAG, sample(0))):
        assert one.shown(name, 0.0)
        one.complete(name, 0.0)
        assert one.due(0.0) == []
        assert not one.keeps(name, 0, message, 0.0)
    return one


def reference(number: int, craft: str = "alpha") -> ReferenceSample:
    time_ns = START_NS + number * SECOND_NS
    return ReferenceSample(craft=craft, source="ref", sequence=number, time_ns=time_ns, magnitude_nt=45000.0)


def test_two_runs_are_merged_by_time() -> None:
    """A run of samples and then a run of references come out second by second."""
    runs: list[Message] = [*(sample(number) for number in range(5)), *(reference(number) for number in range(5))]
    merged = in_order_of_time(runs)
    assert merged == [m for number in range(5) for m in (reference(number), sample(number))]


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 20)), max_size=40))
def test_a_source_keeps_its_order_and_nothing_is_lost(drawn: list[tuple[bool, int]]) -> None:
    """Whatever the times, each source's messages stay in their own order."""
    messages = [
        replace((sample if of_sample else reference)(time), sequence=number)
        for number, (of_sample, time) in enumerate(drawn)
    ]
    merged = in_order_of_time(list(messages))
    for kind in (type(sample(0)), ReferenceSample):
        assert [m for m in merged if isinstance(m, kind)] == [m for m in messages if isinstance(m, kind)]
    assert len(merged) == len(messages)


def test_a_live_message_that_overtakes_those_before_it_waits_for_them() -> None:
    """In the order of time, each once, whatever comes again later; zenoh alone drops what is older than the first."""
    one = joining()
    assert one.keeps(MAG, 100, sample(100), 0.0)
    assert one.due(0.5 * TOKEN_S) == []
    assert one.shown(MAG, 0.6)
    assert one.shown(REF, 0.6)
    for number in range(90, 101):
        one.again(MAG, number, sample(number))
    one.complete(MAG, 0.7)
    assert one.due(0.7) == []
    for number in range(90, 101):
        one.again(REF, number, reference(number))
    assert one.keeps(REF, 101, reference(101), 0.75)
    one.complete(REF, 0.8)
    assert one.wait_s(0.8, 5.0) == 0.0
    expected = [m for number in range(90, 101) for m in (reference(number), sample(number))]
    assert one.due(0.8) == [*expected, reference(101)]
    assert one.keeps(MAG, 95, sample(95), 0.9)  # zenoh's own recovery brings it once more
    assert not one.keeps(MAG, 101, sample(101), 0.9)
    assert one.due(9.9) == []


def test_what_flows_is_not_held_by_another_node_that_joins() -> None:
    """Nor is a second publisher of the craft held by what flows."""
    one = flowing()
    other = StreamName("alpha", "telemetry", "eps", "two", "1")
    assert one.shown(other, 1.0)
    assert not one.keeps(MAG, 1, sample(1), 1.0)
    assert not one.keeps(REF, 1, reference(1), 1.0)
    one.complete(other, 1.1)
    assert one.due(1.1) == []
    assert one.wait_s(1.1, 5.0) == 5.0


def test_a_publisher_that_comes_back_is_asked_and_gives_only_what_was_missed() -> None:
    one = flowing()
    one.gone(MAG)
    assert one.shown(MAG, 5.0)
    for number in range(4):
        one.again(MAG, number, sample(number))
    assert one.keeps(MAG, 4, sample(4), 5.1)
    one.complete(MAG, 5.2)
    assert one.due(5.2) == [sample(number) for number in (1, 2, 3, 4)]


def test_a_number_that_was_passed_over_is_taken_once_when_it_comes() -> None:
    one = flowing()
    assert not one.keeps(MAG, 3, sample(3), 0.0)
    assert not one.keeps(MAG, 1, sample(1), 0.0)
    assert one.keeps(MAG, 1, sample(1), 0.0)
    assert one.keeps(MAG, 3, sample(3), 0.0)


def test_numbers_wrap() -> None:
    one = joining()
    one.shown(MAG, 0.0)
    for number in (2**32 - 2, 2**32 - 1, 0, 1):
        one.again(MAG, number, sample((number + 2) % 2**32))
    one.complete(MAG, 0.0)
    assert one.due(ALONE_QUIET_S) == [sample(number) for number in range(4)]
    assert one.keeps(MAG, 2**32 - 1, sample(1), 1.0)
    assert not one.keeps(MAG, 2, sample(4), 1.0)


def test_samples_alone_leave_after_a_moment_and_a_stream_of_them_after_a_longer_one() -> None:
    """Where no reference comes at all, nobody waits for it for long."""
    for rate_hz, least_s, most_s in ((0, 0.9 * ALONE_QUIET_S, ALONE_QUIET_S), (100, 0.99 * ALONE_S, ALONE_S)):
        one = joining(1000)
        one.shown(MAG, 0.0)
        one.again(MAG, 0, sample(0))
        one.again(MAG, 1, sample(1))
        one.complete(MAG, 0.0)
        live = [one.keeps(MAG, 2 + number, sample(2 + number), number / 100) for number in range(2 * rate_hz)]
        assert all(live)
        assert one.due(least_s) == []
        assert len(one.due(most_s)) == 2 + len(live)


def test_nobody_waits_for_ever_for_a_publisher_that_does_not_answer_or_show_itself() -> None:
    one = joining()
    one.shown(REF, 0.0)
    assert one.keeps(MAG, 7, sample(7), 0.0)
    assert one.due(0.99 * ASKED_S) == []
    assert one.due(ASKED_S) == [sample(7)]
    silent = joining()
    assert silent.keeps(MAG, 7, sample(7), 0.0)
    assert silent.wait_s(0.0, 5.0) == TOKEN_S
    assert silent.due(TOKEN_S) == [sample(7)]


def test_a_long_history_leaves_in_turns_and_what_comes_meanwhile_stays_behind_it() -> None:
    """Other craft get their turns in between, and order is kept."""
    one = joining(10)
    one.shown(MAG, 0.0)
    for number in range(25):
        one.again(MAG, number, sample(number))
    one.complete(MAG, 0.0)
    first = one.due(ALONE_S)
    assert one.keeps(MAG, 25, sample(25), ALONE_S)
    assert one.wait_s(ALONE_S, 0.5) == 0.0
    given = first + one.due(ALONE_S) + one.due(ALONE_S)
    assert given == [sample(number) for number in range(26)]
    assert len(first) == 10


def test_of_more_publishers_than_are_remembered_those_that_are_gone_are_forgotten() -> None:
    one = joining(most=2)
    names = [MAG._replace(session=session) for session in "abc"]
    for name in names[:2]:
        one.shown(name, 0.0)
        one.complete(name, 0.0)
    assert one.due(0.0) == []
    assert not one.shown(names[2], 0.0)
    assert not one.keeps(names[2], 0, sample(0), 0.0)
    one.gone(names[0])
    assert one.shown(names[2], 0.0)
    assert one.keeps(names[2], 0, sample(0), 0.0)


def test_a_hold_that_is_full_ends_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A node that sends without end takes bounded memory."""
    monkeypatch.setattr(module, "_MOST_HELD", 5)
    one = joining()
    one.shown(MAG, 0.0)
    for number in range(4):
        assert one.keeps(MAG, number, sample(number), 0.0)
    assert one.due(0.0) == []
    assert one.keeps(MAG, 4, sample(4), 0.0)
    one.again(MAG, 9, sample(9))
    assert one.due(0.0) == [sample(number) for number in range(5)]


def test_a_service_that_starts_late_gets_samples_and_references_second_by_second() -> None:
    """A node that has sent 500 s before its service came: no sample comes before the reference of its second."""
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    with open_link(address, Role.SERVICE, crafts=["alpha"]) as first, open_link(address, Role.NODE) as node:
        assert settle(lambda: min(first.counters["up"], node.counters["up"]) > 0)
        for number in range(500):
            node.send(reference(number))
            node.send(sample(number))
        gather(first, 1000)
        first.close()
        with open_link(f"{address}?history=1000", Role.SERVICE, crafts=["alpha"]) as second:
            arrived = gather(second, 1000)
    assert seconds_before_reference(arrived) <= 1.0
    assert len(arrived) == 1000


def seconds_before_reference(arrived: list[Message]) -> float:
    """By how much a sample is ahead of the newest reference that came before it, at most [s]."""
    newest_ns, ahead_ns = START_NS, 0
    for message in arrived:
        if isinstance(message, ReferenceSample):
            newest_ns = message.time_ns
        ahead_ns = max(ahead_ns, message.time_ns - newest_ns)
    return ahead_ns / SECOND_NS


@pytest.mark.parametrize("_", range(3))
def test_a_busy_service_gets_no_sample_before_its_reference(_: int) -> None:
    """A node joins and sends a burst while the service looks elsewhere: what is sent again waits for what arrived."""
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    with open_link(address, Role.SERVICE, crafts=["alpha"]) as service, open_link(address, Role.NODE) as node:
        assert settle(lambda: min(service.counters["up"], node.counters["up"]) > 0)
        for number in range(300):
            node.send(reference(number))
            node.send(sample(number))
        time.sleep(0.1)
        arrived = gather(service, 600)
    assert seconds_before_reference(arrived) <= 1.0
    assert len(arrived) == 600


def test_no_sample_is_lost_to_a_live_one_that_overtakes_it_at_a_restart() -> None:
    """Services come and go while a node sends 500 samples a second: each has all from its first on, each once."""
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    over = Event()

    def feed() -> None:
        number = 0
        while not over.is_set():
            node.send(reference(number))
            node.send(sample(number))
            number += 1
            time.sleep(0.002)

    with open_link(f"{address}?listen=yes&mode=peer&cache=10000", Role.NODE, crafts=["alpha"]) as node:
        feeder = Thread(target=feed)
        feeder.start()
        try:
            for _ in range(4):
                with open_link(f"{address}?mode=client&history=10000", Role.SERVICE, crafts=["alpha"]) as service:
                    numbers: list[int] = []
                    begun_s = time.monotonic()
                    while len(numbers) <= 50 or time.monotonic() - begun_s < 0.6:
                        assert time.monotonic() - begun_s < WAIT_S
                        arrived = service.receive(0.1)
                        numbers += [one.sequence for one in arrived if isinstance(one, MagnetometerSample)]
                assert numbers == list(range(len(numbers)))
        finally:
            over.set()
            feeder.join()


def test_an_empty_node_that_joins_and_leaves_keeps_nothing_waiting() -> None:
    """Ten times; the service has each sample of the other node at once: a wait for the empty one would be 400 ms."""
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    late_s = []
    with open_link(address, Role.SERVICE, crafts=["alpha"]) as service, open_link(address, Role.NODE) as node:
        assert settle(lambda: min(service.counters["up"], node.counters["up"]) > 0)
        node.send(sample(0))
        gather(service, 1)
        for number in range(1, 11):
            with open_link(address, Role.NODE, crafts=["alpha"]):
                assert settle(lambda number=number: service.counters["joined"] > number)  # type: ignore[misc]
                begun_s = time.monotonic()
                node.send(sample(number))
                assert gather(service, 1) == [sample(number)]
                late_s.append(time.monotonic() - begun_s)
    assert sorted(late_s)[5] < 0.2
