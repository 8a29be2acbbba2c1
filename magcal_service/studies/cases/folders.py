"""Folders of concealed cases: each is one simulator, or one strength of it, named as the folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from magcal_service.base.errors import ConfigError, Fault
from magcal_service.studies.cases.truth import Truth, read_answers

CASES: Final = "case-*"
DESCRIPTOR: Final = "recording.toml"
"""A case is a folder of such a name with this file in it, whose letters may be capitals."""


@dataclass(frozen=True, slots=True)
class Case:
    """One concealed case: whose it is, its name, its descriptor, and what is true of it."""

    simulator: str
    name: str
    path: Path
    truth: Truth


def cases_of(folders: Sequence[Path]) -> list[Case]:
    """Every case of the folders, in their order.

    Raises ``ConfigError`` where no folder is given, or two of one name, and for a folder that is not there, that has no
    cases or no answers, or whose answers are not those of its cases.
    """
    if not folders:
        accepted = "folders of concealed cases are accepted; `python -m tests.blind` in a checkout writes one"
        raise ConfigError([Fault("--recordings", "none", accepted)])
    names = [folder.absolute().name for folder in folders]
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        accepted = "a folder's name is its simulator's in the tables; name each folder once, and no two alike"
        raise ConfigError([Fault("--recordings", name, accepted) for name in twice])
    return [case for folder in folders for case in _of_one(folder)]


def _of_one(folder: Path) -> list[Case]:
    given = str(folder)
    folder = folder.absolute()
    paths = {path.parent.name: path for path in sorted(folder.glob(f"{CASES}/*")) if path.name.lower() == DESCRIPTOR}
    if not paths:
        accepted = f"a folder with {CASES}/{DESCRIPTOR} is accepted; `python -m tests.blind` in a checkout writes one"
        raise ConfigError([Fault("--recordings", given, accepted)])
    truths = read_answers(folder)
    strange = sorted(paths.keys() ^ truths.keys())
    if strange:
        what = "has a recording and no answer" if strange[0] in paths else "has an answer and no recording"
        accepted = (
            f"of each case a recording and an answer are accepted, but {strange[0]} {what}; write the folder anew"
        )
        raise ConfigError([Fault("--recordings", given, accepted)])
    return [Case(folder.name, name, path, truths[name]) for name, path in paths.items()]
