"""The unit of a reference: sure only where its length is one that the Earth's field can have."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from magcal_service.base.units import FIELD_NT, FieldUnit
from magcal_service.recordings.describe.contradictions import refuse_absurd
from magcal_service.recordings.describe.draft import Draft, answered
from magcal_service.recordings.describe.field import EARTH_NT, Size, UnitFound, find_unit, in_earth_field
from magcal_service.recordings.describe.unit_answer import AnsweredUnit

_EARTH: Final = f"the {EARTH_NT[0] / 1e3:g} to {EARTH_NT[1] / 1e3:g} uT that the Earth's field can be"


def reference_unit(draft: Draft, size: Size | None, said: str, expected_nt: float | None = None) -> UnitFound:
    """The unit by the answer, else by names and numbers; open where it leads outside the Earth's field.

    A sure one tells the draft how strong the reference is.

    Parameters
    ----------
    size: of the reference's vectors or magnitudes, in its own unit.
    said: the unit that the names say, empty where none.
    expected_nt: the field [nT] that the sensor has there, where known.

    Raises
    ------
    InputRefusedError: the answer is no unit of a field.
    """
    answer = draft.answers.unit("reference.unit", FieldUnit)
    found = _as_answered(draft, size, answer) if answer is not None else _found(size, said, expected_nt)
    if found.sure and size is not None:
        draft.reference_nt = size.usual * found.unit_nt
    return found


def _found(size: Size | None, said: str, expected_nt: float | None) -> UnitFound:
    found = find_unit(size, said, whole=False, expected_nt=expected_nt)
    if not found.sure or size is None or in_earth_field(size.usual, found.unit):
        return found
    inside = tuple(unit.value for unit in FieldUnit if in_earth_field(size.usual, unit))
    amount = size.usual * FIELD_NT[FieldUnit(found.unit)] / 1e3
    says = f"the names say {said}" if said else "no name says it"
    why = f"{says}, but as {found.unit} their usual size is {amount:.3g} uT, outside {_EARTH}"
    return replace(found, unit="", sure=False, why=why, possible=(*inside, found.unit))


def _as_answered(draft: Draft, size: Size | None, answer: AnsweredUnit) -> UnitFound:
    found = UnitFound(answer.unit, True, answered("reference.unit"), (answer.unit,), answer.factor)
    if size is not None:
        amount_nt = size.usual * found.unit_nt
        refuse_absurd("reference.unit", answer, "the reference", size.usual, amount_nt)
        warn_outside(draft, f"reference.unit={answer}", amount_nt)
    return found


def warn_outside(draft: Draft, answer: str, amount_nt: float) -> None:
    """Say where an answer makes the reference [nT] one that the Earth's field cannot be."""
    if not EARTH_NT[0] <= amount_nt <= EARTH_NT[1]:
        draft.said.append(
            f"warning: by your answer {answer} the reference is {amount_nt / 1e3:.4g} uT, outside {_EARTH}"
        )
