"""The command that diagnoses what the watch has found: written where it is said, read where it is shown."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from typing import Final

_RUN: Final = "; run: magcal diagnose "
_ANY: Final = "RECORDING"
_DOUBT: Final = re.compile(rf"model doubtful: (?P<what>.+?){_RUN}(?P<recording>(?:'[^']*'|\"[^\"]*\"|[^;'\"])+)")


def doubt(what: str) -> str:
    """What the model seems to leave out, and the command to run, for a recording that is not known here."""
    return f"model doubtful: {what}{_RUN}{_ANY}"


def of_recording(text: str, recording: str, options: Sequence[str] = ()) -> str:
    """A text with its commands for the recording at a path, quoted for a shell; ``options`` follow, such as a craft."""
    return text.replace(f"{_RUN}{_ANY}", _RUN + " ".join(shlex.quote(one) for one in (recording, *options)))


def found_in(text: str) -> tuple[str, str] | None:
    """What a text says is left out, and the command; None where it says nothing of it."""
    found = _DOUBT.search(text)
    return None if found is None else (found["what"], f"{_RUN.removeprefix('; run: ')}{found['recording'].strip()}")
