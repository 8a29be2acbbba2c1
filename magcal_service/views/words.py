"""What a status says in words, taken apart: the watch's finding with its command, and the newest event."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from typing import Final

_FINDING: Final = re.compile(r"model doubtful: (?P<what>.+?); run: (?P<command>magcal diagnose RECORDING)")
_EVENT: Final = re.compile(r"last event: (?P<event>.+)$", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Finding:
    """What the watch over the model has found: ``what`` in words, ``command`` diagnoses it."""

    what: str
    command: str


def finding_of(text: str, recording: str = "RECORDING") -> Finding | None:
    """The finding that a status' text tells, None where it tells none; ``recording`` is put into the command."""
    found = _FINDING.search(text)
    if found is None:
        return None
    name = recording if recording == "RECORDING" else shlex.quote(recording)
    return Finding(found["what"], found["command"].replace("RECORDING", name))


def event_of(text: str) -> str:
    """The newest event that a status' text ends with; empty where it tells none."""
    found = _EVENT.search(text)
    return "" if found is None else found["event"]
