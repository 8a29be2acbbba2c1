"""What a status says in words, taken apart: the watch's finding with its command, and the newest event."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from magcal_service.watch.diagnosing import found_in, of_recording

_EVENT: Final = re.compile(r"last event: (?P<event>.+)$", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Finding:
    """What the watch over the model has found: ``what`` in words, ``command`` diagnoses it."""

    what: str
    command: str


def finding_of(text: str, recording: str | None = None) -> Finding | None:
    """The finding that a status' text tells, None where it tells none; its command is for a ``recording`` at a path."""
    found = found_in(text if recording is None else of_recording(text, recording))
    return None if found is None else Finding(*found)


def event_of(text: str) -> str:
    """The newest event that a status' text ends with; empty where it tells none."""
    found = _EVENT.search(text)
    return "" if found is None else found["event"]
