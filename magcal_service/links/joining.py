"""A node that joins sends again what was missed: held back for a moment and put into the order of its time.

zenoh brings what was missed source by source, so a run of magnetometer samples may come before the references of the
same seconds, and the ticks would close without them.
"""

from __future__ import annotations

import heapq
import math
import threading
from collections import deque
from typing import Final

from magcal_service.wire.messages import MagnetometerSample, Message

QUIET_S: Final = 0.15
"""What was missed is all there when, once it has begun, nothing more has come for this long [s]."""

LONGEST_S: Final = 1.0
"""Longest hold [s], from the joining: also how late the first vector of a node at many samples a second may be then."""


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
        self._until_s: dict[str, tuple[float, float]] = {}  # craft -> (quiet, at the latest) [s]
        self._held: dict[str, list[Message]] = {}
        self._ordered: dict[str, deque[Message]] = {}

    def begin(self, craft: str, now_s: float) -> None:
        """A node of this craft has joined; one after the other makes the hold no longer."""
        with self._lock:
            self._until_s.setdefault(craft, (math.inf, now_s + LONGEST_S))

    def keeps(self, message: Message, now_s: float) -> bool:
        """Whether a sample is kept back; ``due`` gives it later."""
        with self._lock:
            until_s = self._until_s.get(message.craft)
            if until_s is not None:
                self._until_s[message.craft] = now_s + QUIET_S, until_s[1]
        if until_s is not None:
            self._held.setdefault(message.craft, []).append(message)
        elif message.craft in self._ordered:  # those before it are still on their way
            self._ordered[message.craft].append(message)
        else:
            return False
        return True

    def due(self, now_s: float) -> list[Message]:
        """What is held back no longer, a turn of each craft."""
        if not self._until_s and not self._ordered:
            return []
        with self._lock:
            over = [craft for craft, until_s in self._until_s.items() if now_s >= min(until_s)]
            for craft in over:
                del self._until_s[craft]
        for craft in over:
            ordered = in_order_of_time(self._held.pop(craft, []))
            self._ordered.setdefault(craft, deque()).extend(ordered)
        return [message for craft in list(self._ordered) for message in self._turn_of(craft)]

    def wait_s(self, now_s: float, longest_s: float) -> float:
        """How long to wait for more before ``due`` has something [s]."""
        if self._ordered:
            return 0.0
        with self._lock:
            ends_s = [min(until_s) for until_s in self._until_s.values()]
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
