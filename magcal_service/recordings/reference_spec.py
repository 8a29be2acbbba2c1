"""``[reference]`` of a descriptor: exactly one of four forms."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

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
    value = reading.table.number(name, required=True)
    factor = FIELD_NT[reading.table.choice("unit", FieldUnit)]
    if value is None:
        return 0.0
    if not 0.0 < value * factor <= MAX_FIELD_NT:
        reading.table.refuse(name, value, "a magnitude above 0 and up to 1 mT is accepted")
    return value * factor


@dataclass(frozen=True, slots=True)
class VectorReference(FieldCells):
    """A reference vector per row."""

    columns: tuple[str, ...] = texts(3)
    frame: Frame = choice(Frame)


@dataclass(frozen=True, slots=True)
class MagnitudeReference(FieldCells):
    """A reference magnitude per row."""

    column: str = text(name="magnitude")


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


def read_reference(reading: Reading, name: str) -> ReferenceSpec | None:
    """The reference; None where it is missing or not exactly one of the forms."""
    top = reading.table
    section = top.table(name, required=True)
    if section is None:
        return None
    forms = [form for form in _FORMS if section.has(form)]
    if len(forms) != 1:
        top.refuse(name, " + ".join(forms) or "none", "exactly one of columns, magnitude, model, constant")
        return None
    return _read_form(section, _FORMS[forms[0]])


def _read_form(section: Table, kind: type[ReferenceSpec]) -> ReferenceSpec:
    spec: ReferenceSpec = read_record(section, kind)
    return spec
