"""The life of a link as one table: its states, what moves it from one to the next, and what each move counts.

States and events of every scheme stand here; a link says only what has happened to it.  ``up`` and ``down`` of
``loop:`` and ``zenoh:`` count the other ends that come and go instead, so these two pass no counter in.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import Final, NamedTuple


class LinkState(StrEnum):
    """Where a link stands."""

    CONNECTING = "connecting"
    """Not open yet, and no attempt has failed."""
    RETRYING = "retrying"
    """Not open yet; the first failure has been logged, later ones are silent."""
    OPEN = "open"
    """Messages pass."""
    LOST = "lost"
    """It was open and died; the loss has been logged, failures to open it again are silent."""
    EXHAUSTED = "exhausted"
    """A recording at its end: nothing more can arrive, and what is sent is still taken."""
    CLOSED = "closed"
    """Released by its owner, for good."""


class LinkEvent(StrEnum):
    """What happens to a link."""

    OPENED = "opened"
    """The device, session, hub or recording is open."""
    FAILED = "failed"
    """An attempt to open it failed and will be repeated."""
    DIED = "died"
    """A device that was open failed: it is opened again after a pause."""
    SESSION_ENDED = "session ended"
    """A session that was open is gone: connecting begins anew, and its first failure is logged again."""
    ENDED = "ended"
    """The last message of a recording was taken."""
    CLOSE = "close"
    """The owner closes the link."""


class Step(NamedTuple):
    """One move: the state it leads to, the counter that goes up (or none), and whether the link logs it."""

    to: LinkState
    counts: str = ""
    logged: bool = False


_CONNECTING, _RETRYING, _OPEN = LinkState.CONNECTING, LinkState.RETRYING, LinkState.OPEN
_LOST, _EXHAUSTED, _CLOSED = LinkState.LOST, LinkState.EXHAUSTED, LinkState.CLOSED

TRANSITIONS: Final[Mapping[tuple[LinkState, LinkEvent], Step]] = MappingProxyType(
    {
        (_CONNECTING, LinkEvent.OPENED): Step(_OPEN, counts="up"),
        (_CONNECTING, LinkEvent.FAILED): Step(_RETRYING, logged=True),
        (_CONNECTING, LinkEvent.CLOSE): Step(_CLOSED),
        (_RETRYING, LinkEvent.OPENED): Step(_OPEN, counts="up"),
        (_RETRYING, LinkEvent.CLOSE): Step(_CLOSED),
        (_OPEN, LinkEvent.DIED): Step(_LOST, counts="down", logged=True),
        (_OPEN, LinkEvent.SESSION_ENDED): Step(_CONNECTING, counts="down", logged=True),
        (_OPEN, LinkEvent.ENDED): Step(_EXHAUSTED),
        (_OPEN, LinkEvent.CLOSE): Step(_CLOSED, counts="down"),
        (_LOST, LinkEvent.OPENED): Step(_OPEN, counts="up"),
        (_LOST, LinkEvent.CLOSE): Step(_CLOSED),
        (_EXHAUSTED, LinkEvent.CLOSE): Step(_CLOSED, counts="down"),
    }
)
"""Every move that changes, counts or logs something; any other event leaves the state as it is, in silence."""


class LinkLife:
    """The state of one link, moved by events from any thread.

    Parameters
    ----------
    count: called with ``up`` or ``down`` where the table says so; None where the link counts its other ends itself.
    """

    def __init__(self, count: Callable[[str], None] | None = None) -> None:
        self.state = LinkState.CONNECTING
        self._count = count
        self._moving = threading.Lock()

    def happens(self, event: LinkEvent) -> Step:
        """Move as the table says; the step taken, which stays where it is for an event without a row."""
        with self._moving:
            step = TRANSITIONS.get((self.state, event), Step(self.state))
            self.state = step.to
        if step.counts and self._count is not None:
            self._count(step.counts)
        return step

    @property
    def is_open(self) -> bool:
        """Whether messages pass now."""
        return self.state is LinkState.OPEN

    @property
    def is_closed(self) -> bool:
        """Whether the owner has closed the link."""
        return self.state is LinkState.CLOSED


FIRST_PAUSE_S: Final = 0.2
"""Before the second attempt to open [s]: a device that was only plugged anew is back with hardly a sample lost."""

LONGEST_PAUSE_S: Final = 5.0
"""Between attempts in the long run [s]: an end that comes back is found within this; trades that against idle work."""

_GROWTH: Final = 2.0
"""Of the pause after each failure: 0.2, 0.4, 0.8, 1.6, 3.2 and then 5 s, so six attempts within the first 6.2 s."""


class BackOff:
    """Pauses between attempts to open: each twice the one before, from ``FIRST_PAUSE_S`` to ``LONGEST_PAUSE_S``."""

    def __init__(self) -> None:
        self._pause_s = FIRST_PAUSE_S

    def next_s(self) -> float:
        """The pause after one more failed attempt [s]."""
        pause_s = self._pause_s
        self._pause_s = min(_GROWTH * pause_s, LONGEST_PAUSE_S)
        return pause_s

    def reset(self) -> None:
        """An attempt succeeded: the next failure is followed by the first pause."""
        self._pause_s = FIRST_PAUSE_S
