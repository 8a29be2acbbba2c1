"""A bounded queue between a link's own threads and the one that receives."""

from __future__ import annotations

import queue
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class Inbox(Generic[T]):
    """Holds at most ``limit`` items; when it is full, the oldest is dropped for a new one and ``overflowed`` is called.

    ``put`` is short enough for a callback that must not delay the network's thread; ``drain`` sleeps in the kernel
    until the first item, so waiting costs no processor time and wakes at once.
    """

    def __init__(self, limit: int, overflowed: Callable[[], None]) -> None:
        self._queue: queue.SimpleQueue[T] = queue.SimpleQueue()
        self._limit, self._overflowed = limit, overflowed

    def put(self, item: T) -> None:
        """Add one item, from any thread."""
        if self._queue.qsize() >= self._limit:
            try:
                self._queue.get_nowait()
            except queue.Empty:  # the receiver was faster: there is room after all
                pass
            else:
                self._overflowed()
        self._queue.put(item)

    def drain(self, wait_s: float) -> list[T]:
        """All items at hand, oldest first; waits at most ``wait_s`` [s] for the first."""
        items: list[T] = []
        try:
            items.append(self._queue.get(timeout=wait_s) if wait_s > 0.0 else self._queue.get_nowait())
            while len(items) < self._limit:
                items.append(self._queue.get_nowait())
        except queue.Empty:
            pass
        return items
