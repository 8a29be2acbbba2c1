"""One question put to many recordings of different craft: a result of each, a summary, and one exit code."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from magcal_service.base.disk import write_whole
from magcal_service.base.errors import Fault, InputRefusedError, RecordingError, unwritable
from magcal_service.many.executor import Executor
from magcal_service.many.pieces import Done, Outcome, Piece, Refused
from magcal_service.offline.result_files import SUMMARY, earlier_files, remove, removed_line
from magcal_service.recordings.descriptor import load_descriptor
from magcal_service.recordings.specs import SESSION_SUFFIX

_TRUSTED, _FAILED, _REFUSED, _NOT_TRUSTED = 0, 1, 2, 3  # exit codes of `magcal diagnose` and `calibrate`
_WORST: Final = (_FAILED, _REFUSED, _NOT_TRUSTED, _TRUSTED)
"""Exit codes from the worst on: the one of many recordings is the first of these that any of them has."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What came of one recording.

    Parameters
    ----------
    trusted: whether it may be acted on.
    verdict: in a word.
    says: why, or what was found, for a line of a table.
    files: contents by name, for the recording's own folder.
    more: further entries of the summary.
    """

    trusted: bool
    verdict: str
    says: str
    files: Mapping[str, str]
    more: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Asked:
    """What came of all: a row of the summary for each, in their order, and a line for each that has no result.

    ``remarks`` are lines on what an earlier run had left in the folder.
    """

    rows: tuple[Mapping[str, Any], ...]
    faults: tuple[str, ...]
    remarks: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """The worst: 1 where one failed, else 2 where one was refused, else 3 where one is not trusted, else 0."""
        return min((row["exit"] for row in self.rows), key=_WORST.index, default=_TRUSTED)

    def table(self) -> list[str]:
        """The rows as lines of a table under a header, and how many there are of each exit code."""
        width = max(len("folder"), *(len(row["folder"]) for row in self.rows))
        lines = [f"exit  {'folder':<{width}}  {'verdict':<12}  what was found"]
        lines += [
            f"{row['exit']:<4}  {row['folder']:<{width}}  {row['verdict']:<12}  {row['says']}" for row in self.rows
        ]
        counts = Counter(row["exit"] for row in self.rows)
        words = {_TRUSTED: "trusted", _NOT_TRUSTED: "not to be trusted", _REFUSED: "refused", _FAILED: "failed"}
        shares = [f"{counts[code]} {word}" for code, word in words.items() if counts[code]]
        counted = f"{len(self.rows)} recordings: {', '.join(shares)}"
        return [*(line.rstrip() for line in lines), counted, *self.remarks]


def ask_each(
    what: str, question: Callable[[Path], Answer], paths: Sequence[Path], out: Path, executor: Executor, *more: Path
) -> Asked:
    """Put a question to each recording; its files are in a folder of ``out`` as soon as it is answered.

    Parameters
    ----------
    what: the question's name, in progress and summary.
    question: of a module, or a ``partial`` of one; it gets an absolute path.
    paths: descriptors or sessions.
    out: folder, made where it is not there; ``SUMMARY`` is written there at the end.
    more: files that each question reads.

    Results that an earlier run has left in ``out``, and in the folders below it that are written to, are removed first.

    Raises ``InputRefusedError`` for a recording that is named twice, and for a file that cannot be written.
    """
    folders = folders_of(paths)
    pieces = [
        Piece(folder, question, path.absolute(), (*inputs_of(path.absolute()), *more))
        for path, folder in zip(paths, folders, strict=True)
    ]
    earlier = earlier_files(out, folders)
    remove(earlier)
    rows, faults, written = [], [], [out / SUMMARY]
    for path, piece, outcome in zip(paths, pieces, executor.outcomes(what, pieces), strict=True):
        if isinstance(outcome, Done):
            for name, content in outcome.value.files.items():
                written.append(_write(out / piece.name / name, content))
        else:
            faults += [f"{path}: {line}" for line in outcome.text.splitlines()]
        rows.append({"recording": str(path), "folder": piece.name, **_row(outcome)})
    asked = Asked(tuple(rows), tuple(faults), tuple(removed_line(out, earlier, written)))
    content = {"question": what, "exit": asked.exit_code, "recordings": rows}
    _write(out / SUMMARY, json.dumps(content, indent=2, allow_nan=False) + "\n")
    return asked


def _row(outcome: Outcome) -> dict[str, Any]:
    if isinstance(outcome, Done):
        answer: Answer = outcome.value
        code = _TRUSTED if answer.trusted else _NOT_TRUSTED
        return {"exit": code, "verdict": answer.verdict, "says": answer.says, **answer.more}
    if isinstance(outcome, Refused):
        lines = outcome.text.splitlines()
        return {"exit": outcome.exit_code, "verdict": "refused", "says": lines[0], "faults": lines}
    return {"exit": _FAILED, "verdict": "failed", "says": outcome.text, "faults": outcome.text.splitlines()}


def folders_of(paths: Sequence[Path]) -> list[str]:
    """A folder's name for each recording, no two the same.

    The file's stem where that is enough; else where it lies, from what all have in common, without a file name that all
    have.  Raises ``InputRefusedError`` for a recording that is named twice.
    """
    places = [path.absolute() for path in paths]
    for place, count in Counter(places).items():
        if count > 1:
            raise InputRefusedError([Fault("recordings", str(place), f"it is named {count} times; name it once")])
    stems = [place.stem for place in places]
    if len(set(stems)) == len(stems):
        return stems
    common = Path(os.path.commonpath([place.parent for place in places]))
    if len({place.name for place in places}) == 1 and all(place.parent != common for place in places):
        return [str(place.parent.relative_to(common)) for place in places]
    inner = [place.relative_to(common) for place in places]
    shorter = [str(place.with_suffix("")) for place in inner]
    return shorter if len(set(shorter)) == len(shorter) else [str(place) for place in inner]


def inputs_of(path: Path) -> tuple[Path, ...]:
    """Every file that a recording comes from; of a descriptor that is refused, itself alone."""
    if path.suffix.lower() == SESSION_SUFFIX:
        return (path,)
    try:
        return load_descriptor(path).files
    except RecordingError:
        return (path,)


def _write(path: Path, content: str) -> Path:
    """Write a file whole, over whatever an earlier run left there."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content.encode())
    except OSError as exc:
        raise unwritable(path, exc) from None
    return path
