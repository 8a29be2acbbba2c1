"""The unit that a descriptor gives its cells, and their ``factor``: what a cell is multiplied by to be in the unit."""

from __future__ import annotations

from dataclasses import dataclass

from magcal_service.base.typed_toml.keys import choice, number
from magcal_service.base.units import FACTORS, FIELD_NT, LENGTH_KM, FieldUnit, LengthUnit


@dataclass(frozen=True, slots=True, kw_only=True)
class Scaled:
    """Cells that times ``factor`` are in their unit."""

    factor: float = number(1.0, *FACTORS)


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldCells(Scaled):
    """Cells of a magnetic flux density."""

    unit: FieldUnit = choice(FieldUnit)

    @property
    def unit_nt(self) -> float:
        """Nanotesla per 1 of a cell."""
        return self.factor * FIELD_NT[self.unit]


@dataclass(frozen=True, slots=True, kw_only=True)
class LengthCells(Scaled):
    """Cells of a length."""

    unit: LengthUnit = choice(LengthUnit)

    @property
    def unit_km(self) -> float:
        """Kilometres per 1 of a cell."""
        return self.factor * LENGTH_KM[self.unit]
