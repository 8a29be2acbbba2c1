"""Whose turn it is: a few craft at a time, so that the vectors of others do not wait for what a thousand take."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable


class Turns:
    """The craft that are still to have their turn in this round.

    Parameters
    ----------
    at_once: how many have it between two looks for messages.
    """

    def __init__(self, at_once: int) -> None:
        self._at_once = at_once
        self._left: deque[str] = deque()

    def begin(self, crafts: Iterable[str]) -> None:
        """Begin a round, unless one is under way: a daemon that has too much to do has fewer rounds."""
        if not self._left:
            self._left.extend(crafts)

    def take(self) -> list[str]:
        """The next few craft."""
        return [self._left.popleft() for _ in range(min(self._at_once, len(self._left)))]

    @property
    def pending(self) -> bool:
        """Whether craft are left."""
        return bool(self._left)
