"""A node that joins sends missed messages again: they are held back for a moment and sorted by their time.

zenoh delivers them source by source, so a run of magnetometer samples may arrive before the references of the same
seconds, and the ticks would close without them.
"""

from __future__ import annotations

import heapq
import threading
from collections import deque
from typing import Final

from magcal_service.wire.messages import MagnetometerSample, Message, ReferenceSample

QUIET_S: Final = 0.15
"""A recovery is complete when samples and references are level and nothing has arrived for this long [s]."""

LONGEST_S: Final = 1.0
"""The longest hold of a stream that never pauses, from the joining [s]: how late its first vector may be."""

ALONE_S: Final = 2.0
"""How long samples wait for references, or references for samples, where none have arrived at all [s]; ..."""

ALONE_QUIET_S: Final = 0.4
"""... and how long after the last of them."""

APART_S: Final = 10.0
"""How long samples wait for the references of the same seconds while these still arrive, or the reverse [s]."""

_APART_NS: Final = 3_000_000_000  # what a tick waits for its reference anyway
_MOST_HELD: Final = 20_000  # messages of one craft: bounds the memory; at 1 Hz with references nearly three hours


class _Hold:
    """The messages that one craft's nodes have sent since one of them joined."""

    def __init__(self, now_s: float) -> None:
        self.messages: list[Message] = []
        self._begun_s = self._last_s = now_s
        self._newest_ns: dict[type[Message], int] = {}

    def add(self, message: Message, now_s: float) -> None:
        """Hold one message back."""
        self.messages.append(message)
        self._last_s = now_s
        if isinstance(message, MagnetometerSample | ReferenceSample):
            self._newest_ns[type(message)] = message.time_ns

    def until_s(self) -> float:
        """When the hold ends if nothing more arrives, on the caller's monotonic clock [s]."""
        if len(self.messages) >= _MOST_HELD:
            return self._begun_s
        if len(self._newest_ns) < 2:
            return (
                min(self._begun_s + ALONE_S, self._last_s + ALONE_QUIET_S)
                if self.messages
                else self._begun_s + LONGEST_S
            )
        if max(self._newest_ns.values()) - min(self._newest_ns.values()) > _APART_NS:
            return self._begun_s + APART_S
        return min(self._last_s + QUIET_S, max(self._begun_s + LONGEST_S, self._last_s))


class Joining:
    """The samples of craft whose node has just joined.

    ``begin`` may be called from any thread; the others belong to the one who receives.

    Parameters
    ----------
    turn: most samples of one craft that ``due`` gives at once.
    """

    def __init__(self, turn: int) -> None:
        self._turn = turn
        self._lock = threading.Lock()
        self._holds: dict[str, _Hold] = {}
        self._ordered: dict[str, deque[Message]] = {}

    def begin(self, craft: str, now_s: float) -> None:
        """Begin a hold for a craft whose node has joined at ``now_s`` [s]; a second node does not prolong the hold."""
        with self._lock:
            self._holds.setdefault(craft, _Hold(now_s))

    def keeps(self, message: Message, now_s: float) -> bool:
        """Hold a message back where its craft has a hold; whether it was, and ``due`` returns it later."""
        with self._lock:
            hold = self._holds.get(message.craft)
        if hold is not None:
            hold.add(message, now_s)
        elif message.craft in self._ordered:  # those before it are still on their way
            self._ordered[message.craft].append(message)
        else:
            return False
        return True

    def due(self, now_s: float) -> list[Message]:
        """The messages whose hold has ended, at most a turn of each craft."""
        if not self._holds and not self._ordered:
            return []
        with self._lock:
            over = [craft for craft, hold in self._holds.items() if now_s >= hold.until_s()]
            ended = {craft: self._holds.pop(craft) for craft in over}
        for craft, hold in ended.items():
            if hold.messages:
                self._ordered.setdefault(craft, deque()).extend(in_order_of_time(hold.messages))
        return [message for craft in list(self._ordered) for message in self._turn_of(craft)]

    def wait_s(self, now_s: float, longest_s: float) -> float:
        """How long to wait for more before ``due`` has something [s]."""
        if self._ordered:
            return 0.0
        with self._lock:
            ends_s = [hold.until_s() for hold in self._holds.values()]
        return min([longest_s, *(max(0.0, end_s - now_s) for end_s in ends_s)])

    def _turn_of(self, craft: str) -> list[Message]:
        waiting = self._ordered[craft]
        taken = [waiting.popleft() for _ in range(min(self._turn, len(waiting)))]
        if not waiting:
            del self._ordered[craft]
        return taken


def in_order_of_time(messages: list[Message]) -> list[Message]:
    """Messages of several sources merged by time, references first; each source's of one kind stay in their order."""
    streams: dict[tuple[str, type[Message]], list[Message]] = {}
    for message in messages:
        streams.setdefault((message.source, type(message)), []).append(message)
    return list(heapq.merge(*streams.values(), key=lambda one: (one.time_ns, isinstance(one, MagnetometerSample))))
