"""What a file is, and which figure shows it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from magcal_service.errors import Fault, InputRefusedError
from magcal_service.offline.given import read_given
from magcal_service.plots.of_recording import FIGURES, shown
from magcal_service.plots.of_result import of_calibration, of_diagnosis, of_study
from magcal_service.plots.paper import Sheet
from magcal_service.recordings.reader import read_recording

_ACCEPTED: Final = (
    "a RECORDING.toml, a session .mcap, or the JSON of calibrate, diagnose (of one recording) or study is accepted"
)


def sheet_of(
    path: Path, figure: str | None, given: Path | None, craft: str | None = None, source: str | None = None
) -> Sheet:
    """The figure of a file.

    Parameters
    ----------
    path: a recording, or a result in JSON.
    figure: of a recording one of ``FIGURES``; None: the first.
    given: a result whose nine errors are shown on a recording; None: those of a replay.
    craft, source: which one of a recording that holds several.

    Raises ``InputRefusedError`` or ``RecordingError`` for what is none of these or cannot be shown so.
    """
    if path.suffix.lower() == ".json":
        wrong = {"--figure": figure, "--with": given, "--craft": craft, "--source": source}
        accepted = "it goes with a recording; leave it out"
        if faults := [Fault(name, str(value), accepted) for name, value in wrong.items() if value is not None]:
            raise InputRefusedError(faults)
        return _of_json(path)
    name = figure or next(iter(FIGURES))
    if name not in FIGURES:
        raise InputRefusedError([Fault("--figure", name, f"one of {', '.join(FIGURES)} is accepted")])
    nine = None if given is None else read_given(given)
    return FIGURES[name](shown(read_recording(path, craft, source=source), nine))


def _of_json(path: Path) -> Sheet:
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputRefusedError([Fault(str(path), error.strerror or str(error), "give a readable file")]) from None
    except (ValueError, RecursionError):
        raise InputRefusedError([Fault(str(path), "no JSON", _ACCEPTED)]) from None
    kind = content if isinstance(content, dict) else {}
    try:
        if "study" in kind:
            return of_study(kind)
        if "effects" in kind and "fit" in kind:
            return of_diagnosis(kind)
        if "residual_rms_nt" in kind:
            return of_calibration(kind, read_given(path))
    except (KeyError, TypeError, AttributeError) as error:
        raise InputRefusedError([Fault(str(path), f"without {error}", _ACCEPTED)]) from None
    raise InputRefusedError([Fault(str(path), "another JSON", _ACCEPTED)])
