"""A source that floods pushes out itself, waits its turn, and where a rate is set, is cut to it."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_service.links import Link, Role, open_link
from magcal_service.links.fair_inbox import BATCH, MOST_SOURCES, FairInbox
from magcal_service.links.rate_limit import MOST_BUCKETS, RateLimit
from magcal_service.wire.messages import Message
from tests.links.link_messages import free_port, gather, sample, settle

Named = tuple[str, str, int]


def filled(limit: int, items: list[Named], turn: int | None = None, groups: tuple[str, ...] = ()) -> FairInbox[Named]:
    gone: list[None] = []
    inbox: FairInbox[Named] = FairInbox(limit, lambda _: gone.append(None), groups, turn)
    for item in items:
        inbox.put(item, item[0], item[1])
    assert len(gone) == max(0, len(items) - limit)
    return inbox


def test_the_flood_is_pushed_out_and_the_others_stay() -> None:
    """100 messages of one source and one each of two others in 10 places: the two are there, in their order."""
    flood: list[Named] = [("a", "flood", number) for number in range(100)]
    items = [("a", "calm", 0), *flood[:50], ("b", "calm", 1), *flood[50:]]
    assert filled(10, items).drain(0.0) == [("a", "calm", 0), ("b", "calm", 1), *flood[92:]]


def test_a_group_that_floods_waits_its_turn() -> None:
    """Each call gives at most a turn of the flood and all of the calm craft, in the order of arrival."""
    flood: list[Named] = [("a", "x", number) for number in range(30)]
    inbox = filled(100, [*flood, ("b", "y", 0)], turn=10)
    assert inbox.drain(0.0) == [*flood[:10], ("b", "y", 0)]
    assert [inbox.drain(0.0), inbox.drain(0.0), inbox.drain(0.0)] == [flood[10:20], flood[20:], []]


def test_invented_groups_share_one_turn() -> None:
    """Where the groups are known, a flood under many other names is one group."""
    strangers: list[Named] = [(f"x{number}", "s", number) for number in range(50)]
    inbox = filled(100, [*strangers, ("known", "s", 0)], turn=10, groups=("known",))
    assert inbox.drain(0.0) == [*strangers[:10], ("known", "s", 0)]


def test_invented_sources_share_one_place() -> None:
    """Beyond the number that is told apart, sources push out each other and not the one that was there."""
    invented: list[Named] = [("a", f"s{number}", number) for number in range(1000)]
    left = filled(200, [("a", "calm", 0), *invented]).drain(0.0)
    assert left[0] == ("a", "calm", 0)
    assert len(left) == 200
    assert [item for item in left[1:] if item[2] >= MOST_SOURCES] == invented[-(200 - MOST_SOURCES) :]


def test_a_full_inbox_of_many_sources_costs_a_put_hardly_more_than_one_with_room() -> None:
    """2000 sources: a search for the fullest took 170 times as long."""
    inbox: FairInbox[int] = FairInbox(4096, lambda _: None)
    took_s = []
    for _ in range(6):  # the first round fills it; of the others the quickest counts, which nothing has held up
        begun_s = time.process_time()
        for number in range(4096):
            inbox.put(number, f"c{number % 2000}", "s")
        took_s.append(time.process_time() - begun_s)
    assert min(took_s[1:]) < 20.0 * took_s[0]


def test_one_call_gives_a_batch_and_every_group_its_turn_by_and_by() -> None:
    """300 groups of two: a full batch, whole groups, and the rest with the next calls, nothing twice."""
    items: list[Named] = [(f"g{number % 300}", "s", number) for number in range(600)]
    inbox = filled(1000, items, turn=64)
    parts = [inbox.drain(0.0) for _ in range(4)]
    assert [len(part) for part in parts] == [BATCH, BATCH, 600 - 2 * BATCH, 0]
    assert sorted((item for part in parts for item in part), key=lambda item: item[2]) == items


@given(
    st.lists(st.tuples(st.sampled_from("abc"), st.sampled_from("xyz")), max_size=60),
    st.integers(1, 20),
    st.integers(1, 20),
)
def test_nothing_is_lost_doubled_or_out_of_order(names: list[tuple[str, str]], limit: int, turn: int) -> None:
    """What comes out in all is what was not pushed out, once each, and in order within its group."""
    items = [(group, source, number) for number, (group, source) in enumerate(names)]
    inbox, out = filled(limit, items, turn), list[Named]()
    while part := inbox.drain(0.0):
        assert part == sorted(part, key=lambda item: item[2])
        out += part
    assert len(out) == len(set(out)) == min(limit, len(items))
    for group in "abc":
        numbers = [number for name, _, number in out if name == group]
        assert numbers == sorted(numbers)


def test_a_rate_lets_a_burst_pass_and_then_its_rate() -> None:
    """10 at once, then 5 a second, each source for itself."""
    limit = RateLimit(5.0, 10.0)
    assert sum(limit.allows("a", 0.0) for _ in range(100)) == 10
    assert sum(limit.allows("a", number / 128) for number in range(1, 257)) == 10
    assert limit.allows("b", 2.0)


def test_the_wait_for_the_next_is_what_the_bucket_takes_to_hold_one() -> None:
    """Emptied at 10 s, at 5 a second: the next may pass at 10.2 s, and then it does."""
    limit = RateLimit(5.0, 2.0)
    assert limit.wait_s("a", 10.0) == 0.0
    assert [limit.allows("a", 10.0) for _ in range(3)] == [True, True, False]
    assert [limit.wait_s("a", now_s) for now_s in (10.0, 10.05, 10.2, 99.0)] == pytest.approx([0.2, 0.15, 0.0, 0.0])
    assert not limit.allows("a", 10.19)
    assert limit.allows("a", 10.21)


def test_no_rate_is_no_limit() -> None:
    """0 lets everything pass, at once."""
    limit = RateLimit(0.0, 1.0)
    assert limit.wait_s("a", 0.0) == 0.0
    assert all(limit.allows("a", 0.0) for _ in range(10_000))


def test_invented_sources_take_no_memory() -> None:
    """The number of buckets is bounded whatever comes."""
    limit = RateLimit(1.0, 1.0)
    for number in range(3 * MOST_BUCKETS):
        limit.allows(str(number), 0.0)
    assert len(limit._buckets) <= MOST_BUCKETS


@pytest.fixture
def ends() -> Iterator[tuple[Link, Link]]:
    """A service that serves two craft at a low rate, and a node."""
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    with (
        open_link(f"{address}?rate=10&queue=100", Role.SERVICE, crafts=["alpha", "beta"]) as service,
        open_link(address, Role.NODE, crafts=["alpha", "beta"]) as node,
    ):
        assert settle(lambda: min(service.counters["up"], node.counters["up"]) > 0)
        yield service, node


def test_a_source_beyond_its_rate_is_cut_and_another_is_not(ends: tuple[Link, Link]) -> None:
    """1000 samples of one craft at once: a burst passes, the rest is counted, and the other craft's sample is there."""
    service, node = ends
    node.send(sample(0))
    assert gather(service, 1) == [sample(0)]
    begun_s = time.monotonic()
    for number in range(1, 1001):
        node.send(sample(number))
    node.send(sample(0, craft="beta"))
    heard: list[Message] = []

    def come() -> bool:
        heard.extend(service.receive(0.0))
        cut = service.counters["refused.too_fast"] + service.counters["overflow"]
        return len(heard) + cut >= 1001

    assert settle(come)
    passed = 99 + 10 * (time.monotonic() - begun_s) + 1
    assert [message for message in heard if message.craft == "beta"] == [sample(0, craft="beta")]
    assert 1000 - passed <= service.counters["refused.too_fast"] <= 901


def test_a_pause_saves_up_no_more_than_a_burst() -> None:
    """After an hour of silence a source may send a burst and not an hour's messages."""
    limit = RateLimit(5.0, 10.0)
    assert limit.allows("a", 0.0)
    assert sum(limit.allows("a", 3600.0) for _ in range(100)) == 10
