"""A bounded queue shared fairly: a source that floods displaces its own items, and other sources keep their turns."""

from __future__ import annotations

import heapq
import itertools
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, Generic, TypeVar

T = TypeVar("T")

TURN: Final = 64
"""Most items of one group that one call of ``drain`` returns: some 20 ms of the daemon's work on samples."""

MOST_SOURCES: Final = 64
"""Sources of one group that have a share of their own; all others share one, so invented names gain no room."""


class FairInbox(Generic[T]):
    """Holds at most ``limit`` items of many sources in groups, such as the craft of a fleet.

    When it is full, the source with the most items loses its oldest one to the new item.  ``drain`` gives items in the
    order of arrival, and of each group at most ``turn`` in one call.

    Parameters
    ----------
    limit: items held at most.
    overflowed: called, from the thread that puts, for each item that is pushed out.
    groups: names with a queue of their own; where given, all others share one.
    turn: items of one group in one call of ``drain``.
    """

    def __init__(
        self, limit: int, overflowed: Callable[[], None], groups: Sequence[str] = (), turn: int | None = None
    ) -> None:
        self._limit, self._overflowed, self._turn = limit, overflowed, limit if turn is None else turn
        self._groups = frozenset(groups)
        self._held: dict[str, dict[str, deque[tuple[int, T]]]] = {}  # group -> source -> (number of arrival, item)
        self._size = self._arrived = 0
        self._ready = threading.Condition()

    def put(self, item: T, group: str = "", source: str = "") -> None:
        """Add one item, from any thread, without waiting for the consumer."""
        with self._ready:
            queue = self._queue(group, source)
            full = self._size >= self._limit
            if full:
                self._push_out(queue)
            self._arrived += 1
            queue.append((self._arrived, item))
            self._size += 1
            self._ready.notify()
        if full:
            self._overflowed()

    def _queue(self, group: str, source: str) -> deque[tuple[int, T]]:
        if self._groups and group not in self._groups:
            group = ""
        sources = self._held.setdefault(group, {})
        if source not in sources and len(sources) >= MOST_SOURCES:
            source = ""
        return sources.setdefault(source, deque())

    def _push_out(self, newest: deque[tuple[int, T]]) -> None:
        """Drop the oldest item of the fullest source, or of ``newest`` where that has its share (spares the search)."""
        sources = sum(len(group) for group in self._held.values())
        if len(newest) * sources < self._limit:
            newest = max((queue for group in self._held.values() for queue in group.values()), key=len)
        newest.popleft()
        self._size -= 1

    def drain(self, wait_s: float) -> list[T]:
        """The items at hand, oldest first; waits at most ``wait_s`` [s] for the first."""
        deadline_s = time.monotonic() + wait_s
        with self._ready:
            while not self._size:
                left_s = deadline_s - time.monotonic()
                if left_s <= 0.0 or not self._ready.wait(left_s):
                    break
            taken = [entry for group in list(self._held) for entry in self._turn_of(group)]
        taken.sort(key=lambda entry: entry[0])
        return [item for _, item in taken]

    def _turn_of(self, group: str) -> list[tuple[int, T]]:
        """The oldest items of a group, at most a turn; a group and a source that hold nothing are forgotten."""
        sources = self._held[group]
        taken = list(itertools.islice(heapq.merge(*sources.values()), self._turn))
        for source, queue in list(sources.items()):
            while queue and queue[0][0] <= taken[-1][0]:
                queue.popleft()
            if not queue:
                del sources[source]
        if not sources:
            del self._held[group]
        self._size -= len(taken)
        return taken
