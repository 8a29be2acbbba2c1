"""A bounded queue shared fairly: a source that floods displaces its own items, and other sources keep their turns."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, Generic, TypeVar

T = TypeVar("T")

TURN: Final = 64
"""Most items of one group that one call of ``drain`` returns: some 20 ms of the daemon's work on samples."""

BATCH: Final = 256
"""Most items of one call of ``drain`` where a group has turns: what is drained cannot be pushed out any more."""

MOST_SOURCES: Final = 64
"""Sources of one group that have a share of their own; all others share one, so invented names gain no room."""


class _Source(Generic[T]):
    """What one source has in the inbox, oldest first."""

    __slots__ = ("group", "items", "name")

    def __init__(self, group: str, name: str) -> None:
        self.group, self.name = group, name
        self.items: deque[_Entry[T]] = deque()


class _Entry(Generic[T]):
    """One item; ``held`` turns false where it is pushed out, and its place in its group is passed over."""

    __slots__ = ("held", "item", "number", "source")

    def __init__(self, number: int, item: T, source: _Source[T]) -> None:
        self.number, self.item, self.source = number, item, source
        self.held = True


class _Fullest(Generic[T]):
    """The sources by how many items they hold, so that the fullest is known without a search."""

    def __init__(self) -> None:
        self._by_count: dict[int, dict[_Source[T], None]] = {}
        self._most = 0

    def changed(self, source: _Source[T], before: int) -> None:
        """A source held ``before`` items until now."""
        now = len(source.items)
        if before:
            same = self._by_count[before]
            del same[source]
            if not same:
                del self._by_count[before]
        if now:
            self._by_count.setdefault(now, {})[source] = None
        self._most = max(self._most, now)
        while self._most and self._most not in self._by_count:
            self._most -= 1

    def get(self) -> _Source[T]:
        """The fullest source; of several the one that has been so for longest."""
        return next(iter(self._by_count[self._most]))


class FairInbox(Generic[T]):
    """Holds at most ``limit`` items of many sources in groups, such as the craft of a fleet.

    When it is full, the source with the most items loses its oldest one to the new item; ``put`` costs the same however
    many sources there are.  ``drain`` gives items in the order of arrival: of each group at most ``turn`` in one call,
    and ``BATCH`` in all, the groups in turn.

    Parameters
    ----------
    limit: items held at most.
    overflowed: called with its group, from the thread that puts, for each item that is pushed out.
    groups: names with a queue of their own; where given, all others share one, named ``""``.
    turn: items of one group in one call of ``drain``; None: everything at once.
    """

    def __init__(
        self, limit: int, overflowed: Callable[[str], None], groups: Sequence[str] = (), turn: int | None = None
    ) -> None:
        self._limit, self._overflowed = limit, overflowed
        self._turn, self._batch = (limit, limit) if turn is None else (turn, max(turn, BATCH))
        self._known = frozenset(groups)
        self._groups: dict[str, deque[_Entry[T]]] = {}  # in the order of their turns
        self._sources: dict[str, dict[str, _Source[T]]] = {}
        self._fullest: _Fullest[T] = _Fullest()
        self._size = self._arrived = self._gone = 0
        self._ready = threading.Condition(threading.Lock())

    def put(self, item: T, group: str = "", source: str = "") -> None:
        """Add one item, from any thread, without waiting for the consumer."""
        pushed_out = None
        with self._ready:
            if self._size >= self._limit:
                pushed_out = self._push_out()
            if self._known and group not in self._known:
                group = ""
            of = self._source(group, source)
            self._arrived += 1
            entry = _Entry(self._arrived, item, of)
            of.items.append(entry)
            self._groups.setdefault(group, deque()).append(entry)
            self._fullest.changed(of, len(of.items) - 1)
            self._size += 1
            if self._size == 1:  # the consumer waits only where there is nothing
                self._ready.notify()
        if pushed_out is not None:
            self._overflowed(pushed_out)

    def _source(self, group: str, name: str) -> _Source[T]:
        sources = self._sources.setdefault(group, {})
        if name not in sources and len(sources) >= MOST_SOURCES:
            name = ""
        found = sources.get(name)
        if found is None:
            found = sources[name] = _Source(group, name)
        return found

    def _push_out(self) -> str:
        """Drop the oldest item of the fullest source; its group."""
        source = self._fullest.get()
        source.items[0].held = False
        self._take(source)
        self._gone += 1
        if self._gone > self._limit:  # places of items that are gone
            for group, entries in list(self._groups.items()):
                self._groups[group] = deque(entry for entry in entries if entry.held)
            self._gone = 0
        return source.group

    def _take(self, source: _Source[T]) -> None:
        """Take a source's oldest item off the books; a source that holds nothing is forgotten."""
        source.items.popleft()
        self._fullest.changed(source, len(source.items) + 1)
        self._size -= 1
        if not source.items:
            sources = self._sources[source.group]
            del sources[source.name]
            if not sources:
                del self._sources[source.group]

    def drain(self, wait_s: float) -> list[T]:
        """The items at hand, oldest first; waits at most ``wait_s`` [s] for the first."""
        taken: list[_Entry[T]] = []
        with self._ready:
            if not self._size and wait_s > 0.0:
                self._ready.wait_for(lambda: self._size, wait_s)
            for group in list(self._groups):
                if len(taken) >= self._batch:
                    break
                self._turn_of(group, taken)
        taken.sort(key=lambda entry: entry.number)
        return [entry.item for entry in taken]

    def _turn_of(self, group: str, taken: list[_Entry[T]]) -> None:
        """Take the oldest items of a group, at most a turn; the group goes to the end of the row."""
        entries = self._groups.pop(group)
        most = min(self._batch, len(taken) + self._turn)
        while entries and len(taken) < most:
            entry = entries.popleft()
            if entry.held:
                self._take(entry.source)
                taken.append(entry)
            else:
                self._gone -= 1
        if entries:
            self._groups[group] = entries
