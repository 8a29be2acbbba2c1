"""A unit as it was answered: its name, or the size of one cell in it, such as ``0.15 uT`` for counts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.base.typed_toml import nearest
from magcal_service.base.units import FACTORS

_LEAST, _MOST = FACTORS
_ONE: Final = 1.0  # the factor of cells that are in the unit itself


@dataclass(frozen=True, slots=True)
class AnsweredUnit:
    """Cells that times ``factor`` are in ``unit``."""

    unit: str
    factor: float = _ONE

    def __str__(self) -> str:
        return self.unit if self.factor == _ONE else f"{self.factor:g} {self.unit}"

    @property
    def entries(self) -> dict[str, Any]:
        """What a descriptor says of it."""
        return {"unit": self.unit} | ({} if self.factor == _ONE else {"factor": self.factor})


def read_unit(key: str, answer: str, known: Iterable[str], factor: str | None = None) -> AnsweredUnit:
    """A unit with the size of a cell before it, or its factor beside it; raises ``InputRefusedError``."""
    units = [str(unit) for unit in known]
    if answer in units:
        return AnsweredUnit(answer, _ONE if factor is None else _size(f"{key.removesuffix('unit')}factor", factor))
    size, _, unit = answer.partition(" ")
    unit = unit.strip()
    if unit not in units or not _is_number(size):
        accepted = (
            f"{nearest(answer, filter(None, units))}; of another one its size in one of these, as '0.1 {units[0]}'"
        )
        raise InputRefusedError([Fault(f"--answer {key}", answer, accepted)])
    if factor is not None:
        accepted = "one of the two is accepted: a size in the unit's answer, or a factor"
        raise InputRefusedError([Fault(f"--answer {key}", f"{answer} with factor={factor}", accepted)])
    return AnsweredUnit(unit, _size(key, size))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _size(key: str, text: str) -> float:
    size = float(text) if _is_number(text) else 0.0
    if not _LEAST <= size <= _MOST:
        raise InputRefusedError([Fault(f"--answer {key}", text, f"a number from {_LEAST:g} to {_MOST:g} is accepted")])
    return size
