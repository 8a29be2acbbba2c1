"""``[reference]`` of a descriptor: exactly one of four forms."""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches
from enum import StrEnum
from typing import Final

from magcal_service.base.errors import Lacking
from magcal_service.base.typed_toml import Table
from magcal_service.base.typed_toml.keys import choice, special, text, texts
from magcal_service.base.typed_toml.record import Reading, read_record
from magcal_service.base.units import FIELD_NT, FieldUnit
from magcal_service.recordings.scaled import FieldCells
from magcal_service.wire.messages import Frame

MAX_FIELD_NT = 1e6
"""1 mT: more than this is no magnetometer reading, here and on the wire."""


class FieldModel(StrEnum):
    """Field models that can stand in for a recorded reference."""

    IGRF = "igrf"


def _constant_nt(reading: Reading, name: str) -> float:
    table = reading.table
    if isinstance(table.content.get(name), str):
        table.refuse(name, table.content[name], 'a number is accepted, and its unit beside it: unit = "uT"')
        table.choice("unit", FieldUnit)
        return 0.0
    value = table.number(name, required=True)
    factor = FIELD_NT[table.choice("unit", FieldUnit)]
    if value is None:
        return 0.0
    if not 0.0 < value * factor <= MAX_FIELD_NT:
        table.refuse(name, value, "a magnitude above 0 and up to 1 mT is accepted")
    return value * factor


@dataclass(frozen=True, slots=True)
class VectorReference(FieldCells):
    """A reference vector per row."""

    columns: tuple[str, ...] = texts(3)
    frame: Frame = choice(Frame)


@dataclass(frozen=True, slots=True)
class MagnitudeReference(FieldCells):
    """A reference magnitude per row."""

    column: str = text(name="magnitude", accepted="the column of it (of one magnitude for all rows: constant)")


@dataclass(frozen=True, slots=True)
class ModelReference:
    """A field model evaluated at the recorded position and time."""

    model: FieldModel = choice(FieldModel)


@dataclass(frozen=True, slots=True)
class ConstantReference:
    """One magnitude [nT] for all rows."""

    magnitude_nt: float = special(_constant_nt, name="constant")


ReferenceSpec = VectorReference | MagnitudeReference | ModelReference | ConstantReference

_FORMS: dict[str, type[ReferenceSpec]] = {
    "columns": VectorReference,
    "magnitude": MagnitudeReference,
    "model": ModelReference,
    "constant": ConstantReference,
}
"""The record of each form, by the key that only this form has."""

_ALSO: Final = {"igrf": "model", "vector": "columns", "field": "constant", "value": "constant", "strength": "constant"}
"""Forms by other words for them; choice: those that a reader of other files brings along."""


_HOW: Final = (
    'model = "igrf" (from [position] and the time), columns = [x, y, z] with unit and frame, magnitude = COLUMN with '
    "unit, or constant = NUMBER with unit (one place)"
)
"""Every form in a line, for whoever wrote none of them."""


def read_reference(reading: Reading, name: str) -> ReferenceSpec | None:
    """The reference; None where it is missing or not exactly one of the forms."""
    top = reading.table
    if not isinstance(top.content.get(name), dict):
        top.has(name)
        top.refuse_or_lack(name, f"a table [{name}] is required, with one of: {_HOW}")
        return None
    section = top.table(name)
    assert section is not None
    forms = [form for form in _FORMS if section.has(form)]
    if len(forms) == 1:
        return _read_form(section, _FORMS[forms[0]])
    if forms:
        top.refuse(name, " + ".join(forms), f"exactly one of these is accepted: {_HOW}")
        return None
    none = f"no form of a reference is there{_meant(section)}"
    top.faults.append(Lacking(top.where(name), none, f"exactly one of these is accepted: {_HOW}"))
    return None


def _meant(section: Table) -> str:
    """The form that a key of a section was probably meant to be; empty where none is like one."""
    for key in section.content:
        form = _ALSO.get(key.lower()) or next(iter(get_close_matches(key.lower(), _FORMS, n=1)), "")
        if form:
            return f" ({key!r}: did you mean {form!r}?)"
    return ""


def _read_form(section: Table, kind: type[ReferenceSpec]) -> ReferenceSpec:
    spec: ReferenceSpec = read_record(section, kind)
    return spec
