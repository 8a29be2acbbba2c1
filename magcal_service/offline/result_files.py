"""The names of result files, and removing what an earlier run has left under them in a folder."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from magcal_service.base.errors import Fault, FileFault, InputRefusedError, unwritable

CALIBRATION: Final = "calibration.json"
DIAGNOSIS: Final = "diagnosis.json"
REPORT: Final = "report.html"
PHYSICS: Final = "physics.toml"
SUMMARY: Final = "summary.json"

_OF_ONE: Final = (CALIBRATION, DIAGNOSIS, REPORT, PHYSICS)
"""Files that the result of one recording, or of several together, consists of."""


def prepare_folder(folder: Path) -> None:
    """Make a folder of results, or refuse before the work is done what could not be written after it."""
    if "\0" in str(folder):
        raise InputRefusedError([Fault("--out", str(folder), "give a folder that can be made")])
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        accepted = "give a folder that can be made or written"
        raise InputRefusedError([FileFault(str(folder), exc, accepted)]) from None


def earlier_files(folder: Path, own: Sequence[str] = ()) -> list[Path]:
    """The results that earlier runs have left in a folder, in the order of their names.

    Parameters
    ----------
    folder: of the results.
    own: folders below it that this run writes to as well.

    By name alone, and only where a run of this tool was: in ``folder`` beside a ``diagnosis.json`` or a
    ``summary.json`` that it has written, in the folders that such a summary names, and in ``own``.
    """
    summary = _content(folder / SUMMARY)
    is_summary = "question" in summary and isinstance(summary.get("recordings"), list)
    found = [folder / SUMMARY] if is_summary else []
    if "verdict" in _content(folder / DIAGNOSIS):
        found += _results(folder)
    named = [row.get("folder") for row in summary["recordings"] if isinstance(row, dict)] if is_summary else []
    for name in dict.fromkeys([*named, *own]):
        if isinstance(name, str) and _is_below(folder, folder / name):
            found += _results(folder / name)
    return sorted(set(found))


def remove(files: Iterable[Path]) -> None:
    """Remove files.  Raises ``InputRefusedError`` where one cannot be removed."""
    for file in files:
        try:
            file.unlink(missing_ok=True)
        except OSError as exc:
            raise unwritable(file, exc) from None


def removed_line(folder: Path, files: Iterable[Path], written: Iterable[Path]) -> list[str]:
    """A line on what was removed and has not been written anew; none where that is nothing."""
    anew = {path.resolve() for path in written}
    names = [str(path.relative_to(folder)) for path in files if path.resolve() not in anew]
    return [f"removed from {folder}, of an earlier run: {', '.join(names)}"] if names else []


def kept_line(folder: Path) -> list[str]:
    """For a run that was refused: a line on the results of an earlier one that are still there; none without any."""
    names = [str(path.relative_to(folder)) for path in earlier_files(folder)]
    return [f"{folder} still has the files of an earlier run: {', '.join(names)}"] if names else []


def _results(folder: Path) -> list[Path]:
    return [path for name in _OF_ONE if (path := folder / name).is_file()]


def _is_below(folder: Path, inner: Path) -> bool:
    """Whether a path lies inside a folder, wherever links lead."""
    place, whole = inner.resolve(), folder.resolve()
    return place != whole and place.is_relative_to(whole)


def _content(path: Path) -> dict[str, Any]:
    """What a JSON file holds; empty where it is absent, damaged, or no object."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}
