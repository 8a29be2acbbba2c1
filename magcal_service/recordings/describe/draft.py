"""What is being made: sections of a descriptor, what was concluded and why, what has to be asked, what was answered."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from shlex import quote
from typing import Final

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.base.typed_toml import nearest
from magcal_service.recordings.describe.columns import Column, Log
from magcal_service.recordings.describe.unit_answer import AnsweredUnit, read_unit
from magcal_service.recordings.describe.vocabulary import FRAMES

KEYS: Final = (
    "samples.delimiter",
    "samples.decimal",
    "samples.craft",
    "time.column",
    "time.columns",
    "time.format",
    "time.pattern",
    "time.start",
    "time.rate_hz",
    "time.gps_rollovers",
    "magnetometer.columns",
    "magnetometer.unit",
    "magnetometer.factor",
    "magnetometer.noise_nt",
    "magnetometer.range_nt",
    "reference",
    "reference.columns",
    "reference.magnitude",
    "reference.model",
    "reference.constant",
    "reference.unit",
    "reference.factor",
    "reference.frame",
    "position.columns",
    "position.unit",
    "position.factor",
    "position.frame",
    "position.altitude_km",
    "position.altitude",
    "position.altitude.unit",
    "position.altitude.factor",
    "position.radius",
    "position.tle",
    "platform.kind",
    "spin.axis",
    "spin.rate_rpm",
)
"""What can be answered, besides ``channels.NAME.KEY``."""

_CHANNEL_KEYS: Final = ("column", "columns", "unit", "factor", "frame", "order", "from", "to")
NO: Final = "none"
"""The answer that leaves a part out."""


@dataclass(frozen=True, slots=True)
class Question:
    """Something that names and numbers leave open.

    Parameters
    ----------
    key: what ``--answer KEY=VALUE`` takes.
    asks: the question, with the reason why it is open.
    candidates: values that are possible, each with what speaks for it; the likeliest first.
    form: what an answer looks like.
    scaled: what an answer looks like where one cell has another size than any unit; empty where that is no answer.
    needed: whether nothing can be read without the answer; the others leave a part out.
    """

    key: str
    asks: str
    candidates: tuple[tuple[str, str], ...]
    form: str
    needed: bool = True
    scaled: str = ""

    def lines(self) -> list[str]:
        """The question as it is printed."""
        kind = "question" if self.needed else "open (left out without an answer)"
        found = [f"{kind} {self.key}: {self.asks}"]
        found += [f"    could be {value}: {why}" if why else f"    could be {value}" for value, why in self.candidates]
        found.append(f"    answer with: --answer {quote(f'{self.key}={self.form}')}")
        if self.scaled:
            found.append(f"    in another unit, the size of 1: --answer {quote(f'{self.key}={self.scaled}')}")
        return found


class Answers:
    """What was answered; each answer has to be used."""

    def __init__(self, given: Mapping[str, str]) -> None:
        self._given = dict(given)
        self.used: set[str] = set()
        faults = [fault for key, value in self._given.items() if (fault := _fault(key, value)) is not None]
        if faults:
            raise InputRefusedError(faults)

    def get(self, key: str) -> str | None:
        """The answer to a key; None where there is none."""
        if key not in self._given:
            return None
        self.used.add(key)
        return self._given[key]

    def unit(self, key: str, known: Iterable[str]) -> AnsweredUnit | None:
        """The unit that was answered to ``SECTION.unit``, with ``SECTION.factor`` where that was given.

        Raises
        ------
        InputRefusedError: it is none of the known ones, or the factor is none, or without a unit.
        """
        factor_key = f"{key.removesuffix('unit')}factor"
        answer, factor = self.get(key), self.get(factor_key)
        if answer is None and factor is not None:
            accepted = f"it goes with {key}, the unit that cells times it are in"
            raise InputRefusedError([Fault(f"--answer {factor_key}", factor, accepted)])
        return None if answer is None else read_unit(key, answer, known, factor)

    def beginning(self, prefix: str) -> dict[str, str]:
        """All answers whose keys begin so, without that beginning."""
        found = {key[len(prefix) :]: value for key, value in self._given.items() if key.startswith(prefix)}
        self.used |= {prefix + key for key in found}
        return found

    def unused(self) -> list[str]:
        """Keys whose answers nothing asked for."""
        return [key for key in self._given if key not in self.used]


def _fault(key: str, value: str) -> Fault | None:
    parts = key.split(".")
    if parts[0] == "channels":
        if len(parts) == 2 or (len(parts) == 3 and parts[2] in _CHANNEL_KEYS):
            return None if value else Fault(f"--answer {key}", value, "a value is accepted after the =")
        accepted = f"channels.NAME.KEY is accepted; of KEY, {nearest(parts[-1], _CHANNEL_KEYS)}"
        return Fault("--answer", key, accepted)
    if key not in KEYS:
        return Fault("--answer", key, nearest(key, KEYS))
    return None if value else Fault(f"--answer {key}", value, "a value is accepted after the =")


@dataclass
class Draft:
    """A descriptor in the making.

    Parameters
    ----------
    folder: where the descriptor will lie.
    reserved: numbers of columns whose meaning is known.
    doubted: whether the header was seen to name wrong columns.
    reference_nt: how strong the reference usually is [nT], where it is in the log or answered and its unit is sure.
    """

    log: Log
    answers: Answers
    folder: Path
    sections: dict[str, list[str]] = field(default_factory=dict)
    said: list[str] = field(default_factory=list)
    questions: list[Question] = field(default_factory=list)
    reserved: set[int] = field(default_factory=set)
    doubted: bool = False
    reference_nt: float | None = None

    def frame(self, key: str, known: Sequence[str]) -> str:
        """The frame that was answered to a key; empty where none was.

        Raises
        ------
        InputRefusedError: it is none of the known ones; where it is another word for one, that one is named.
        """
        answer = self.answers.get(key)
        plain = (answer or "").strip().lower()
        if answer is None or plain in known:
            return plain
        like = FRAMES.get(plain, "")
        accepted = f"its axes are read as {like}: did you mean {like!r}? known: {', '.join(known)}"
        fault = Fault(f"--answer {key}", answer, accepted if like in known else nearest(plain, known))
        raise InputRefusedError([fault])

    def conclude(self, key: str, value: str, why: str) -> None:
        """Say what was concluded, and on what evidence."""
        self.said.append(f"{key} = {value}: {why}")

    def put(self, section: str, key: str, value: object) -> None:
        """A line of the descriptor."""
        self.sections.setdefault(section, []).append(f"{key} = {toml(value)}")

    def put_unit(self, section: str, unit: AnsweredUnit) -> None:
        """A unit, and its factor where there is one."""
        for key, value in unit.entries.items():
            self.put(section, key, value)

    def beside(self, file: Path) -> str:
        """A file as the descriptor names it."""
        return Path(os.path.relpath(file.resolve(), self.folder.resolve())).as_posix()

    def ask(self, question: Question) -> None:
        """Leave something open."""
        if all(other.key != question.key for other in self.questions):
            self.questions.append(question)

    def names(self, columns: Iterable[Column]) -> list[str]:
        """Columns as the descriptor names them."""
        return [self.name(column) for column in columns]

    def name(self, column: Column) -> str:
        """A column as the descriptor names it: by name, or by number where the log has no header."""
        return str(column.number) if self.log.numbered else column.name

    def columns(self, key: str, count: Sequence[int]) -> list[Column] | None:
        """The columns that the answer to a key names, by name or number; raises ``InputRefusedError``."""
        given = self.answers.get(key)
        return None if given is None else self.named(key, given, count)

    def named(self, key: str, given: str, count: Sequence[int]) -> list[Column]:
        """Columns by name or number, separated by commas; raises ``InputRefusedError``."""
        found = []
        for one in (part.strip() for part in given.split(",")):
            column = self._column(one)
            if column is None:
                known = {column.name or str(column.number) for column in self.log.columns}
                raise InputRefusedError([Fault(f"--answer {key}", one, nearest(one, known))])
            found.append(column)
        if len(found) not in count:
            accepted = f"{' or '.join(map(str, count))} columns of the log, separated by commas, are accepted"
            raise InputRefusedError([Fault(f"--answer {key}", given, accepted)])
        return found

    def _column(self, name: str) -> Column | None:
        by_name = [column for column in self.log.columns if column.name == name and name]
        if not by_name and name.isdecimal() and 1 <= int(name) <= len(self.log.columns):
            return self.log.columns[int(name) - 1]
        return by_name[0] if by_name else None


def toml(value: object) -> str:
    """A value as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return "".join(one if one.isprintable() else _escaped(one) for one in json.dumps(value, ensure_ascii=False))
    if isinstance(value, list | tuple):
        return f"[{', '.join(toml(one) for one in value)}]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(key)} = {toml(one)}" for key, one in value.items()) + " }"
    return repr(value)


def _escaped(sign: str) -> str:
    """A sign that a terminal might obey, as TOML writes it."""
    return f"\\U{ord(sign):08X}"


def _key(key: str) -> str:
    return key if key.replace("_", "a").replace("-", "a").isalnum() and key.isascii() else toml(key)


def answered(key: str) -> str:
    """The evidence of what was answered."""
    return f"by your answer {key}"
