"""The table of a link's states, and the pauses between attempts to open."""

from __future__ import annotations

import pytest

from magcal_service.links import Role, open_link
from magcal_service.links.states import (
    FIRST_PAUSE_S,
    LONGEST_PAUSE_S,
    TRANSITIONS,
    BackOff,
    LinkEvent,
    LinkLife,
    LinkState,
)

HISTORIES = {
    LinkState.CONNECTING: (),
    LinkState.RETRYING: (LinkEvent.FAILED,),
    LinkState.OPEN: (LinkEvent.OPENED,),
    LinkState.LOST: (LinkEvent.OPENED, LinkEvent.DIED),
    LinkState.EXHAUSTED: (LinkEvent.OPENED, LinkEvent.ENDED),
    LinkState.CLOSED: (LinkEvent.CLOSE,),
}


def life_in(state: LinkState, counted: list[str]) -> LinkLife:
    life = LinkLife(counted.append)
    for event in HISTORIES[state]:
        life.happens(event)
    assert life.state is state
    counted.clear()
    return life


def test_up_and_down_are_counted_by_turns() -> None:
    """Whatever happened before, leaving what is open counts ``down`` and opening counts ``up``, and nothing else."""
    passing = (LinkState.OPEN, LinkState.EXHAUSTED)
    for (state, _), step in TRANSITIONS.items():
        crossed = (state in passing) - (step.to in passing)
        assert step.counts == {-1: "up", 0: "", 1: "down"}[crossed]


@pytest.mark.parametrize("event", LinkEvent)
def test_a_closed_link_stays_closed(event: LinkEvent) -> None:
    counted: list[str] = []
    life = life_in(LinkState.CLOSED, counted)
    assert (life.happens(event), life.state, counted) == ((LinkState.CLOSED, "", False), LinkState.CLOSED, [])


@pytest.mark.parametrize("state", LinkState)
def test_every_state_can_be_closed(state: LinkState) -> None:
    life = life_in(state, [])
    assert life.happens(LinkEvent.CLOSE).to is LinkState.CLOSED
    assert life.is_closed


def test_a_link_that_does_not_open_is_logged_once() -> None:
    life = LinkLife()
    assert [life.happens(LinkEvent.FAILED).logged for _ in range(3)] == [True, False, False]


def test_a_line_that_died_is_logged_once_until_it_is_open_again() -> None:
    life = life_in(LinkState.OPEN, [])
    events = (LinkEvent.DIED, LinkEvent.DIED, LinkEvent.FAILED, LinkEvent.OPENED, LinkEvent.DIED)
    assert [life.happens(event).logged for event in events] == [True, False, False, False, True]


def test_a_session_that_ended_is_connected_anew_and_its_first_failure_is_logged() -> None:
    life = life_in(LinkState.OPEN, [])
    events = (LinkEvent.SESSION_ENDED, LinkEvent.FAILED, LinkEvent.FAILED)
    assert [life.happens(event).logged for event in events] == [True, True, False]


def test_a_link_that_counts_its_other_ends_itself_counts_no_opening() -> None:
    with open_link("loop:alone", Role.SERVICE) as link:
        assert (link.state, link.counters["up"]) == (LinkState.OPEN, 0)
    assert (link.state, link.counters["down"]) == (LinkState.CLOSED, 0)


def test_the_pauses_double_up_to_the_longest_and_begin_anew_after_a_success() -> None:
    back_off = BackOff()
    assert [back_off.next_s() for _ in range(7)] == [
        FIRST_PAUSE_S,
        0.4,
        0.8,
        1.6,
        3.2,
        LONGEST_PAUSE_S,
        LONGEST_PAUSE_S,
    ]
    back_off.reset()
    assert back_off.next_s() == FIRST_PAUSE_S == 0.2
