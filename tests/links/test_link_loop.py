"""The in-memory link keeps the contract, and what is its own."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import cast

import pytest

from magcal_service.base.errors import LinkError
from magcal_service.links import Role, open_link
from magcal_service.links.loop import LoopLink
from tests.links.link_contract import Ends, LinkContract
from tests.links.link_messages import command, estimate, gather, sample

_names = itertools.count()


class LoopEnds(Ends):
    """Two ends in this process."""

    def __init__(self) -> None:
        self._name = f"test-{next(_names)}"
        super().__init__()

    def address(self, role: Role) -> str:
        return f"loop:{self._name}"

    def garbage(self) -> str:
        cast(LoopLink, self.node).inject(b"\xc1 no msgpack")
        return "refused.not_msgpack"


@pytest.fixture
def ends() -> Iterator[LoopEnds]:
    pair = LoopEnds()
    yield pair
    pair.close()


class TestLoopLink(LinkContract):
    """The contract, in memory."""


def test_a_viewer_sees_samples_and_results_and_reaches_the_service(ends: LoopEnds) -> None:
    with open_link(ends.address(Role.VIEWER), Role.VIEWER) as viewer:
        ends.node.send(sample(1))
        ends.service.send(estimate(1))
        viewer.send(command(1))
        assert gather(viewer, 2) == [sample(1), estimate(1)]
        assert gather(ends.service, 2) == [sample(1), command(1)]


def test_a_second_service_of_the_same_name_is_refused(ends: LoopEnds) -> None:
    with pytest.raises(LinkError, match="already stands"):
        open_link(ends.address(Role.SERVICE), Role.SERVICE)


def test_what_a_full_queue_pushes_out_is_counted_and_the_newest_stay(ends: LoopEnds) -> None:
    ends.service.close()
    ends.service = open_link(ends.address(Role.SERVICE) + "?queue=10", Role.SERVICE)
    for number in range(25):
        ends.node.send(sample(number))
    assert [message.sequence for message in ends.service.receive(1.0)] == list(range(15, 25))
    assert ends.service.counters["overflow"] == 15


def test_the_last_one_left_counts_down(ends: LoopEnds) -> None:
    ends.node.close()
    assert ends.service.counters["down"] == 1
