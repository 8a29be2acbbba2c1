"""The size of a count as a log states it, before the rows or in a name: ``0.15 uT/LSB``, ``1090 LSB per Gauss``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from magcal_service.base.units import FieldUnit
from magcal_service.recordings.describe.columns import Log
from magcal_service.recordings.describe.unit_answer import AnsweredUnit
from magcal_service.recordings.unit_words import unit_of

_NUMBER: Final = r"(?<![\w.])(\d+(?:\.\d*)?(?:[eE][+-]?\d+)?|\.\d+)"
_COUNT: Final = r"(?:lsb|counts?|digits?|bits?|cts?|cnts?)(?![a-zA-Z0-9])"
_UNIT: Final = r"([A-Za-zµμ]{1,12})(?![a-zA-Z0-9])"
_PER: Final = r"\s*(?:/|\bper\b)\s*"
_SIZES: Final = (
    re.compile(rf"{_NUMBER}\s*{_UNIT}{_PER}(?:1\s*)?{_COUNT}", re.IGNORECASE),
    re.compile(rf"\b(?:1\s*)?{_COUNT}\s*(?:=|:|\bis\b)\s*{_NUMBER}\s*{_UNIT}", re.IGNORECASE),
)
_COUNTS: Final = re.compile(rf"{_NUMBER}\s*{_COUNT}{_PER}(?:1\s*)?{_UNIT}", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class StatedScale:
    """The size of a count, and the words that say it."""

    size: AnsweredUnit
    words: str


def stated_scales(log: Log) -> list[StatedScale]:
    """Every size of a count of a field that a log states, each once."""
    found: dict[AnsweredUnit, StatedScale] = {}
    for line in (*log.layout.preamble, *(column.name for column in log.columns), *log.layout.units):
        for pattern in (*_SIZES, _COUNTS):
            for match in pattern.finditer(line):
                unit = unit_of(match.group(2))
                number = float(match.group(1))
                if unit not in list(FieldUnit) or number <= 0.0:
                    continue
                size = AnsweredUnit(unit, float(f"{1.0 / number:.12g}") if pattern is _COUNTS else number)
                found.setdefault(size, StatedScale(size, match.group().strip()))
    return list(found.values())
