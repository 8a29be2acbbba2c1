"""What a joining node sends again is held back for a moment and given in the order of its time."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_service.links import Role, open_link
from magcal_service.links import joining as module
from magcal_service.links.joining import ALONE_QUIET_S, ALONE_S, APART_S, LONGEST_S, QUIET_S, Joining, in_order_of_time
from magcal_service.wire.messages import Message, ReferenceSample
from tests.links.link_messages import START_NS, free_port, gather, sample, settle

SECOND_NS = 1_000_000_000


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


def test_nothing_is_held_where_nobody_joins() -> None:
    """A live sample passes at once."""
    joining = Joining(64)
    assert not joining.keeps(sample(0), 0.0)
    assert joining.due(0.0) == []
    assert joining.wait_s(0.0, 0.5) == 0.5


def test_a_quiet_moment_ends_the_hold() -> None:
    """What was missed leaves when nothing more has come for a while; another craft is not held."""
    joining = Joining(64)
    joining.begin("alpha", 0.0)
    assert joining.due(2 * QUIET_S) == []
    assert joining.keeps(sample(1), 0.5)
    assert joining.keeps(reference(0), 0.6)
    assert not joining.keeps(sample(1, craft="beta"), 0.6)
    assert joining.due(0.6 + 0.9 * QUIET_S) == []
    assert joining.due(0.6 + QUIET_S) == [reference(0), sample(1)]
    assert not joining.keeps(sample(2), 1.0)


def test_samples_wait_for_the_references_of_their_seconds() -> None:
    """While the references are behind, nothing leaves; once they are no more than the ticks' own patience, all does."""
    joining = Joining(1000)
    joining.begin("alpha", 0.0)
    for number in range(100):
        assert joining.keeps(sample(number), 0.1)
    for number in range(96):
        assert joining.due(0.3 + number / 20) == []
        assert joining.keeps(reference(number), 0.3 + number / 20)
    assert joining.due(5.09) == []
    assert joining.keeps(reference(96), 5.1)
    assert len(joining.due(5.1)) == 197


def test_a_node_that_sends_nothing_again_costs_its_first_sample_a_moment() -> None:
    """The hold ends by itself, and after it a sample passes at once."""
    joining = Joining(64)
    joining.begin("alpha", 0.0)
    assert joining.wait_s(0.0, 5.0) == LONGEST_S
    assert joining.due(LONGEST_S) == []
    assert not joining.keeps(sample(0), LONGEST_S)


def test_a_stream_that_never_pauses_is_held_no_longer_than_the_limit() -> None:
    """At any rate the first vector comes after the longest hold."""
    joining = Joining(10_000)
    joining.begin("alpha", 0.0)
    joining.keeps(reference(500), 0.0)
    held = [joining.keeps(sample(500 + number % 3), number / 1000) for number in range(int(1000 * LONGEST_S))]
    assert all(held)
    joining.begin("alpha", 0.5 * LONGEST_S)
    assert len(joining.due(LONGEST_S)) == len(held) + 1


def test_a_reference_that_stays_behind_does_not_stop_the_samples() -> None:
    """Samples wait for it for a while, and then leave without."""
    joining = Joining(64)
    joining.begin("alpha", 0.0)
    joining.keeps(sample(100), 0.1)
    joining.keeps(reference(0), 0.1)
    assert joining.due(0.9 * APART_S) == []
    assert joining.due(APART_S) == [reference(0), sample(100)]


def test_samples_alone_leave_after_a_moment_and_a_stream_of_them_after_a_longer_one() -> None:
    """Where no reference comes at all, nobody waits for it for long."""
    joining = Joining(10_000)
    joining.begin("alpha", 0.0)
    joining.keeps(sample(0), 0.1)
    assert joining.due(0.1 + ALONE_QUIET_S) == [sample(0)]
    joining.begin("alpha", 5.0)
    held = [joining.keeps(sample(number), 5.0 + number / 100) for number in range(int(100 * ALONE_S))]
    assert joining.due(5.0 + 0.99 * ALONE_S) == []
    assert len(joining.due(5.0 + ALONE_S)) == len(held)


def test_a_long_history_leaves_in_turns_and_what_comes_meanwhile_stays_behind_it() -> None:
    """Other craft get their turns in between, and order is kept."""
    joining = Joining(10)
    joining.begin("alpha", 0.0)
    for number in range(25):
        joining.keeps(sample(number), 0.0)
    first = joining.due(ALONE_S)
    assert joining.keeps(sample(25), ALONE_S)
    assert joining.wait_s(ALONE_S, 0.5) == 0.0
    given = first + joining.due(ALONE_S) + joining.due(ALONE_S)
    assert given == [sample(number) for number in range(26)]
    assert len(first) == 10


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
    newest_ns = START_NS
    for message in arrived:
        if isinstance(message, ReferenceSample):
            newest_ns = message.time_ns
        assert message.time_ns <= newest_ns + SECOND_NS
    assert len(arrived) == 1000


def test_a_hold_that_is_full_ends_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A node that sends without end takes bounded memory."""
    monkeypatch.setattr(module, "_MOST_HELD", 5)
    joining = Joining(64)
    joining.begin("alpha", 0.0)
    for number in range(4):
        joining.keeps(sample(number), 0.0)
    assert joining.due(0.0) == []
    joining.keeps(sample(4), 0.0)
    assert joining.due(0.0) == [sample(number) for number in range(5)]
