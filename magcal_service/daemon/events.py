"""Changes of state, each with its cause and its source: what the daemon reports in the log and in the status."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

BY_COMMAND: Final = "command"
"""Cause of an event that a command caused, and nothing else is to be said of."""


@dataclass(frozen=True, slots=True)
class Event:
    """One change of state of one craft.

    Parameters
    ----------
    craft: whose.
    what: a short fixed name, such as ``reset`` or ``restored``; docs/state.md lists them.
    cause: why, for people.
    source: who caused it: the source of a command, or ``magcal`` itself.
    time_ns: source time of the newest sample then [ns].
    """

    craft: str
    what: str
    cause: str
    source: str
    time_ns: int

    def __str__(self) -> str:
        return f"{self.what} ({self.cause}; by {self.source})"
