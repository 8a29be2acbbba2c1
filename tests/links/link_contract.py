"""What every link keeps to.  A test class of a link derives from ``LinkContract`` and provides ``ends``."""

from __future__ import annotations

import abc
import time

import pytest

from magcal_service.base.errors import LinkAddressError
from magcal_service.links import Link, Role, open_link
from magcal_service.wire.messages import Message
from tests.links.link_messages import (
    RESULTS,
    SAMPLES,
    SECOND_NS,
    SOON_S,
    START_NS,
    WAIT_S,
    flows,
    gather,
    sample,
    settle,
    vector,
)

LATER_NS = START_NS + 3600 * SECOND_NS


class Ends(abc.ABC):
    """A service's and a node's end of one connected link, each of which can be closed and opened again."""

    def __init__(self) -> None:
        self.service = self.open(Role.SERVICE)
        self.node = self.open(Role.NODE)
        assert self.connected()

    @abc.abstractmethod
    def address(self, role: Role) -> str:
        """The address of one end."""

    @abc.abstractmethod
    def garbage(self) -> str:
        """Put bytes that are no message on the way to the service; the counter they have to show up in."""

    def connected(self) -> bool:
        """Wait until what one end sends can reach the other."""
        return settle(lambda: min(self.service.counters["up"], self.node.counters["up"]) > 0)

    def open(self, role: Role, options: str = "") -> Link:
        """Open one end."""
        address = self.address(role)
        return open_link(address + ("&" if options and "?" in address else "") + options, role, crafts=["alpha"])

    def close(self) -> None:
        """Close both ends."""
        self.node.close()
        self.service.close()


class LinkContract:
    """Every test here holds for every link; ``known_option`` is an option that the link has."""

    known_option = "queue"

    @pytest.mark.parametrize("message", SAMPLES, ids=lambda message: type(message).__name__)
    def test_a_sample_reaches_the_service_unchanged(self, ends: Ends, message: Message) -> None:
        ends.node.send(message)
        assert gather(ends.service, 1) == [message]

    @pytest.mark.parametrize("message", RESULTS, ids=lambda message: type(message).__name__)
    def test_a_result_reaches_the_node_unchanged(self, ends: Ends, message: Message) -> None:
        ends.service.send(message)
        assert gather(ends.node, 1) == [message]

    def test_a_burst_of_1000_samples_arrives_complete_and_in_order(self, ends: Ends) -> None:
        burst: list[Message] = [sample(number) for number in range(1000)]
        arrived: list[Message] = []
        for message in burst:
            ends.node.send(message)
        deadline_s = time.monotonic() + WAIT_S
        while len(arrived) < 1000 and time.monotonic() < deadline_s:
            arrived += ends.service.receive(0.01)
            ends.node.receive(0.0)
        assert arrived == burst

    def test_what_was_received_and_sent_is_counted(self, ends: Ends) -> None:
        for number in range(7):
            ends.node.send(sample(number))
        gather(ends.service, 7)
        assert (ends.node.counters["sent"], ends.service.counters["received"]) == (7, 7)

    def test_garbage_is_counted_and_the_next_sample_arrives(self, ends: Ends) -> None:
        reason = ends.garbage()
        ends.node.send(sample(1))
        assert gather(ends.service, 1) == [sample(1)]
        assert ends.service.counters[reason] == 1

    def test_receive_gives_up_at_its_timeout(self, ends: Ends) -> None:
        begun_s = time.monotonic()
        assert ends.service.receive(0.2) == []
        assert 0.2 <= time.monotonic() - begun_s < SOON_S

    def test_receive_without_a_timeout_returns_at_once(self, ends: Ends) -> None:
        begun_s = time.monotonic()
        assert ends.service.receive(0.0) == []
        assert time.monotonic() - begun_s < SOON_S

    def test_receive_wakes_for_a_sample_long_before_its_timeout(self, ends: Ends) -> None:
        ends.node.send(sample(1))
        begun_s = time.monotonic()
        assert ends.service.receive(WAIT_S) == [sample(1)]
        assert time.monotonic() - begun_s < SOON_S

    def test_waiting_takes_next_to_no_processor_time(self, ends: Ends) -> None:
        begun_s = time.process_time()
        ends.service.receive(0.6)
        assert time.process_time() - begun_s < 0.06

    def test_sending_on_a_closed_link_is_counted_and_raises_nothing(self, ends: Ends) -> None:
        ends.node.close()
        ends.node.send(sample(1))
        assert ends.node.counters["dropped"] == 1

    def test_receiving_on_a_closed_link_is_empty_after_its_timeout(self, ends: Ends) -> None:
        ends.service.close()
        begun_s = time.monotonic()
        assert ends.service.receive(0.1) == []
        assert 0.1 <= time.monotonic() - begun_s < SOON_S

    def test_a_message_that_no_receiver_would_take_is_counted_and_not_sent(self, ends: Ends) -> None:
        ends.node.send(sample(1, craft="no such name!"))
        assert (ends.node.counters["unsendable.bad_name"], ends.node.counters["sent"]) == (1, 0)

    def test_closing_twice_is_allowed(self, ends: Ends) -> None:
        ends.service.close()
        ends.service.close()

    def test_an_unknown_option_is_refused_by_name_with_the_nearest(self, ends: Ends) -> None:
        known = self.known_option
        with pytest.raises(LinkAddressError, match=f"'{known}x'.*did you mean '{known}'"):
            open_link(f"{ends.address(Role.NODE).partition('?')[0]}?{known}x=1", Role.NODE)

    def test_another_crafts_samples_are_counted_and_not_received(self, ends: Ends) -> None:
        ends.node.send(sample(1, craft="stranger"))
        ends.node.send(sample(2))
        assert gather(ends.service, 1) == [sample(2)]
        assert settle(lambda: not ends.service.receive(0.0) and ends.service.counters["refused.unknown_craft"] == 1)

    def test_a_node_link_opened_anew_flows_again_and_the_gap_is_counted_as_lost(self, ends: Ends) -> None:
        ends.node.send(sample(0))
        gather(ends.service, 1)
        ends.node.close()
        ends.node = ends.open(Role.NODE)
        flows(ends.node, ends.service, sample, first=6)
        gather(ends.service, 1, timeout_s=0.3)
        (record,) = ends.service.sources()
        assert record.lost == 5 == ends.service.counters["lost"]

    def test_a_node_that_counts_from_zero_again_is_counted_as_restarted(self, ends: Ends) -> None:
        for number in range(100):
            ends.node.send(sample(number))
        gather(ends.service, 100)
        ends.node.close()
        ends.node = ends.open(Role.NODE)
        flows(ends.node, ends.service, lambda number: sample(number, start_ns=LATER_NS))
        (record,) = ends.service.sources()
        assert (record.restarts, ends.service.counters["restarted"]) == (1, 1)

    def test_a_node_outlives_its_service_and_flows_to_the_next_one(self, ends: Ends) -> None:
        ends.node.send(sample(0))
        gather(ends.service, 1)
        ends.service.close()
        ends.node.send(sample(1))
        ends.service = ends.open(Role.SERVICE)
        flows(ends.node, ends.service, sample, first=2)
        flows(ends.service, ends.node, vector)
