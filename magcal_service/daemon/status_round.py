"""Whose status is due: a few craft at a time, so that the vectors of others do not wait for those of a thousand."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Final

AT_ONCE: Final = 8
"""Statuses that are sent between two looks for messages: 2 ms of work."""


class StatusRound:
    """The craft that are still to publish their status in this round."""

    def __init__(self) -> None:
        self._left: deque[str] = deque()

    def begin(self, crafts: Iterable[str]) -> None:
        """Begin a round, unless one is under way: a daemon that has too much to do publishes it less often."""
        if not self._left:
            self._left.extend(crafts)

    def turn(self) -> list[str]:
        """The next few craft."""
        return [self._left.popleft() for _ in range(min(AT_ONCE, len(self._left)))]

    @property
    def pending(self) -> bool:
        """Whether craft are left."""
        return bool(self._left)
