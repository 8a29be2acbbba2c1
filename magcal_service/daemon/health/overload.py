"""Overload as it is reported: which craft lose messages in the link's queue, since when, and how many."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

QUIET_S: Final = 10.0
"""An overload is over when nothing was shed for so long [s]."""


@dataclass(slots=True)
class _Spell:
    """Messages shed before it began, and until it was last looked at; the time when that number last grew [s]."""

    before: int
    count: int
    grown_s: float


class Overload:
    """Follows the messages that a link's queue has shed, by craft.

    Parameters
    ----------
    shed: counts by craft, which the link goes on with (``Link.overflows``).
    clock: monotonic time [s].
    """

    def __init__(self, shed: Counter[str], clock: Callable[[], float] = time.monotonic) -> None:
        self._shed, self._clock = shed, clock
        self._seen: dict[str, int] = {}
        self._spells: dict[str, _Spell] = {}

    def changes(self) -> list[tuple[str, bool, str]]:
        """Craft, whether its overload has begun (else ended), and the cause, since the last call."""
        now_s = self._clock()
        found = [self._look(craft, count, now_s) for craft, count in list(self._shed.items())]
        return [change for change in found if change is not None]

    def _look(self, craft: str, count: int, now_s: float) -> tuple[str, bool, str] | None:
        before, self._seen[craft] = self._seen.get(craft, 0), count
        spell = self._spells.get(craft)
        if spell is None:
            if count == before:
                return None
            self._spells[craft] = _Spell(before, count, now_s)
            return craft, True, f"{count - before} messages shed so far, the oldest in the queue"
        if count != before:
            spell.count, spell.grown_s = count, now_s
        elif now_s - spell.grown_s >= QUIET_S:
            del self._spells[craft]
            return craft, False, f"{count - spell.before} messages shed, none for {QUIET_S:g} s"
        return None

    def trouble(self, craft: str) -> str:
        """What is amiss with a craft; empty where it is not overloaded."""
        spell = self._spells.get(craft)
        return "" if spell is None else f"overloaded: {spell.count - spell.before} messages shed"
