"""Which columns are the magnetometer, and in which unit: sure where names and numbers agree."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.base.units import FIELD_NT, FieldUnit
from magcal_service.recordings.describe.columns import Column, Triple, words_of
from magcal_service.recordings.describe.draft import Draft, Question, answered
from magcal_service.recordings.describe.field import (
    EARTH_NT,
    Size,
    UnitFound,
    differs_from_model,
    find_unit,
    scale_by_model,
    size_of,
    unit_by_model,
)
from magcal_service.recordings.describe.foreign import of_cells
from magcal_service.recordings.describe.kinds import kind_of_triple, may_be_milli_g
from magcal_service.recordings.describe.stated_scale import StatedScale, stated_scales
from magcal_service.recordings.describe.unit_answer import AnsweredUnit
from magcal_service.recordings.describe.vocabulary import STRONG_MAGNETOMETER, Kind, kind_of

FloatArray = npt.NDArray[np.float64]

_RAW: Final = {"raw", "uncal", "uncalibrated", "uncalib", "uncorrected"}
_WORKED: Final = {"cal", "calib", "calibrated", "corrected", "comp", "compensated", "filt", "filtered", "fit"}
_ARDUPILOT: Final = {"timeus", "ofsx", "ofsy", "ofsz", "mox", "moy", "moz"}
"""Beside the axes in ArduPilot's message MAG: offsets and motor compensation, all in milligauss."""

_SURE_SCALE: Final = 1.05
"""Of whole numbers over a unit without a name; choice: counts of 0.92 mG (HMC5883L) are no mG, and a usual scale is
within 5 % of 1."""

_NOT_A_SOURCE: Final = re.compile(r"[^A-Za-z0-9_-]+")


@dataclass(frozen=True, slots=True)
class Magnetometer:
    """A magnetometer found: its columns, their unit and factor, and whether these were answered."""

    triple: Triple
    unit: str
    factor: float = 1.0
    answered: bool = False

    @property
    def unit_nt(self) -> float:
        """Nanotesla per 1 of a cell."""
        return self.factor * FIELD_NT[FieldUnit(self.unit)]

    @property
    def field_nt(self) -> FloatArray:
        """(n, 3) sampled field [nT]."""
        return self.triple.values * self.unit_nt


def find_magnetometers(draft: Draft, groups: list[Triple], model_nt: FloatArray | None) -> list[Magnetometer]:
    """Put the magnetometers into the draft, or ask; those that were found."""
    chosen = draft.columns("magnetometer.columns", (3,))
    if chosen is not None:
        x, y, z = chosen
        triple = Triple((x, y, z), x.stem, x.words)
        found = _as_answered(draft, [_with_unit(draft, triple, model_nt)])
        return _put(draft, found, answered("magnetometer.columns"))
    named = [group for group in groups if kind_of_triple(group) is Kind.MAGNETOMETER]
    named = named or _by_file(draft, groups)
    doubted = [group for group in named if {c.number for c in group.columns} & draft.reserved]
    for group in doubted:
        named.remove(group)
        draft.said.append(f"magnetometer: not believed: the header names {group.label}, which hold something else")
    unlike = [group for group in named if _short_name(group) and _unlike(group, model_nt)]
    if unlike and len(unlike) < len(named):
        named = [group for group in named if group not in unlike]
        draft.said += [f"magnetometer: {g.label} left out: their length does not follow IGRF" for g in unlike]
    elif unlike:
        why = f"{unlike[0].label} have a magnetometer's name, but their length does not follow IGRF along the way. "
        _ask_columns(draft, groups, model_nt, why)
        return []
    if draft.doubted:
        named = [group for group in named if _follows(group, model_nt)]
    if doubted or (draft.doubted and not named):
        _ask_columns(draft, groups, model_nt, "the header seems to name the wrong columns. ")
        return []
    found = _as_answered(draft, [_with_unit(draft, group, model_nt) for group in named])
    possible = [(group, unit) for group, unit in found if unit.possible]
    if found and not possible:
        return _ask_counts(draft, *found[0], model_nt)
    for group, unit in found:
        if not unit.possible:
            draft.said.append(f"magnetometer: {group.label} left out: in no unit a field near the Earth's ({unit.why})")
    possible = _uncalibrated(draft, possible)
    if not possible:
        why = "no columns are a magnetometer by their names and numbers. "
        unclear = [g.label for g in groups if kind_of_triple(g) is Kind.UNKNOWN and may_be_milli_g(g)]
        full = ((column, of_cells(column.cells)) for column in draft.log.columns if not column.numeric)
        why += next((f"In {column.label}, {fault}. " for column, fault in full if fault), "")
        why += "".join(f"The mg of {label} may be milligauss or milli-g. " for label in unclear)
        _ask_columns(draft, groups, model_nt, why)
        return []
    return _put(draft, possible, "")


def _by_file(draft: Draft, groups: list[Triple]) -> list[Triple]:
    """Nameless axes in a file that is called after a magnetometer."""
    if kind_of(words_of(draft.log.sample.path.name.split(".")[0])) is not Kind.MAGNETOMETER:
        return []
    return [group for group in groups if not group.words][:1]


def _as_answered(draft: Draft, found: list[tuple[Triple, UnitFound]]) -> list[tuple[Triple, UnitFound]]:
    """The unit as it was answered; of several groups, for those whose numbers allow it, or for the first.

    Where a size of a count was answered, that are those in no unit that is sure.
    """
    answer = draft.answers.unit("magnetometer.unit", FieldUnit)
    if answer is None or not found:
        return found
    told = UnitFound(answer.unit, True, answered("magnetometer.unit"), (answer.unit,), answer.factor)
    counts = answer.factor != 1.0
    fits = [not unit.sure if counts else answer.unit in unit.possible for _, unit in found]
    fits[0] = fits[0] or not any(fits)
    return [(triple, told if fit else unit) for (triple, unit), fit in zip(found, fits, strict=True)]


def _with_unit(draft: Draft, triple: Triple, model_nt: FloatArray | None) -> tuple[Triple, UnitFound]:
    size = size_of(triple.values)
    scale = None if model_nt is None else scale_by_model(triple.values, model_nt)
    by_model = unit_by_model(triple.unit, scale)
    said = triple.unit or _unit_by_maker(draft, triple)
    found = by_model or find_unit(size, said, whole=triple.whole, expected_nt=_usual(model_nt))
    counts = triple.whole and said in {"", "counts"}
    stated = stated_scales(draft.log) if counts else []
    if len(stated) == 1:
        found = _as_stated(size, stated[0], _usual(model_nt)) or found
    elif counts and scale is not None and by_model is not None and by_model.sure:
        found = _maybe_counts(by_model, scale)
    if said and not triple.unit and by_model is None:
        found = replace(
            found, why=f"the columns beside it are those of ArduPilot's MAG message, which is in {said}; {found.why}"
        )
    return triple, found


def _as_stated(size: Size | None, stated: StatedScale, expected_nt: float | None) -> UnitFound | None:
    """Whole numbers as counts of the one size that the log states; None where they are no field then."""
    if size is None:
        return None
    one = stated.size
    scaled = replace(size, usual=size.usual * one.factor, radius=size.radius and size.radius * one.factor)
    found = find_unit(scaled, "", whole=False, expected_nt=expected_nt)
    if found.unit != one.unit:
        return None
    amount = scaled.best * FIELD_NT[FieldUnit(one.unit)] / 1e3
    why = f"whole numbers, and the log says {stated.words!r}: one is {one}, and {scaled.shown} is {amount:.3g} uT"
    return replace(found, why=why, factor=one.factor)


def _maybe_counts(found: UnitFound, scale_nt: float) -> UnitFound:
    """The unit of whole numbers by the field model: not sure where the scale is rather another one."""
    ratio = scale_nt / FIELD_NT[FieldUnit(found.unit)]
    if 1.0 / _SURE_SCALE <= ratio <= _SURE_SCALE:
        return found
    why = f"no name says it, and whole numbers may be raw counts: the length follows IGRF with {scale_nt:.3g} nT each"
    return replace(found, unit="", sure=False, why=why)


def _unit_by_maker(draft: Draft, triple: Triple) -> str:
    """The unit of a maker whose names are unmistakable; empty where none is known."""
    names = {column.name.lower() for column in draft.log.columns}
    return "mG" if names >= _ARDUPILOT and "magx" in {column.name.lower() for column in triple.columns} else ""


def _follows(triple: Triple, model_nt: FloatArray | None) -> bool:
    """Whether three columns are a magnetometer's by the field model alone."""
    if model_nt is None:
        return False
    unit = unit_by_model(triple.unit, scale_by_model(triple.values, model_nt))
    return unit is not None and unit.sure


def _short_name(triple: Triple) -> bool:
    """Whether only a letter or two say a magnetometer, as in m1, m2, m3, and no unit does."""
    return not set(triple.words) & STRONG_MAGNETOMETER and triple.unit not in list(FieldUnit)


def _unlike(triple: Triple, model_nt: FloatArray | None) -> bool:
    return model_nt is not None and differs_from_model(triple.values, model_nt)


def _usual(model_nt: FloatArray | None) -> float | None:
    """The model's magnitude as ``size_of`` takes the usual length."""
    return None if model_nt is None else float(np.nanquantile(model_nt, 0.8))


def _uncalibrated(draft: Draft, found: list[tuple[Triple, UnitFound]]) -> list[tuple[Triple, UnitFound]]:
    """Of one sensor's values before and after somebody's correction, those before it."""
    raw = [pair for pair in found if set(pair[0].words) & _RAW]
    worked = [pair for pair in found if set(pair[0].words) & _WORKED]
    if worked and len(worked) < len(found):
        for triple, _ in worked:
            draft.said.append(f"magnetometer: {triple.label} left out: the names say corrected values of another group")
        found = [pair for pair in found if pair not in worked]
    if raw and len(raw) < len(found):
        return raw
    return found


def _put(draft: Draft, found: list[tuple[Triple, UnitFound]], by: str) -> list[Magnetometer]:
    """Write the sure ones; ask the unit where none is."""
    sure = [(triple, unit) for triple, unit in found if unit.sure]
    if not sure:
        _ask_unit(draft, found)
        return []
    for triple, unit in found:
        if not unit.sure:
            draft.said.append(f"magnetometer: {triple.label} left out: {unit.why}")
    several = len(sure) > 1
    names = _sources([triple for triple, _ in sure]) if several else []
    for number, (triple, unit) in enumerate(sure):
        section = f"[magnetometer]{number}" if several else "magnetometer"
        if several:
            draft.put(section, "source", names[number])
        draft.put(section, "columns", draft.names(triple.columns))
        size = AnsweredUnit(unit.unit, unit.factor)
        draft.put_unit(section, size)
        why = by or "the names say a magnetometer's x, y and z"
        draft.conclude("magnetometer.columns", triple.label, why)
        draft.conclude("magnetometer.unit", str(size), unit.why)
    if several:
        draft.said.append(f"magnetometer: several, each with its source; --source chooses: {', '.join(names)}")
    by_answer = answered("magnetometer.unit")
    return [Magnetometer(triple, unit.unit, unit.factor, unit.why == by_answer) for triple, unit in sure]


def _sources(found: list[Triple]) -> list[str]:
    """A name for each of several magnetometers: what its columns share, or its number."""
    names = [_NOT_A_SOURCE.sub("_", triple.stem).strip("_-")[:32] or f"mag{n}" for n, triple in enumerate(found, 1)]
    if len(set(names)) < len(names) or "magcal" in names:
        return [f"mag{number}" for number in range(1, len(found) + 1)]
    return names


def _ask_unit(draft: Draft, found: list[tuple[Triple, UnitFound]]) -> None:
    if len(found) > 1:
        candidates = tuple((",".join(draft.names(triple.columns)), unit.why) for triple, unit in found)
        asks = "several groups of columns are called a magnetometer's, and the unit of none is sure"
        draft.ask(Question("magnetometer.columns", asks, candidates, candidates[0][0]))
    triple, unit = found[0]
    candidates = tuple((one, _as_field(triple, one)) for one in unit.possible[:3])
    label = triple.label if len(found) == 1 else "the magnetometer"
    asks = f"in which unit is {label}? {unit.why}"
    draft.ask(
        Question("magnetometer.unit", asks, candidates, (unit.possible or ("uT",))[0], scaled=_scaled(draft, triple))
    )


def _scaled(draft: Draft, triple: Triple) -> str:
    """What the size of a count could be answered as, where whole numbers may be counts."""
    stated = stated_scales(draft.log)
    return str(stated[0].size) if stated else "0.15 uT" if triple.whole else ""


def _ask_counts(draft: Draft, triple: Triple, unit: UnitFound, model_nt: FloatArray | None) -> list[Magnetometer]:
    """Named a magnetometer, and in no unit a field."""
    asks = f"in no unit are {triple.label} a field near the Earth's ({unit.why}). Raw counts of a sensor? "
    asks += "How large is one?"
    candidates = [(str(one.size), f"the log says {one.words!r}") for one in stated_scales(draft.log)]
    scale = None if model_nt is None else scale_by_model(triple.values, model_nt)
    if scale is not None:
        candidates.append((f"{scale:.3g} nT", "with it the length follows IGRF along the way"))
    form = candidates[0][0] if candidates else "0.15 uT"
    draft.ask(Question("magnetometer.unit", asks, tuple(candidates), form))
    return []


def _as_field(triple: Triple, unit: str) -> str:
    size = size_of(triple.values)
    return "" if size is None else f"then {size.shown} is {size.best * FIELD_NT[FieldUnit(unit)] / 1e3:.3g} uT"


def _ask_columns(draft: Draft, groups: list[Triple], model_nt: FloatArray | None, why: str) -> None:
    """Ask for the three columns, with those that could be a field by their numbers."""
    by_names = [] if why.startswith("the header") else [g for g in groups if kind_of_triple(g) is Kind.UNKNOWN]
    pool = by_names + [t for t in _neighbours(draft) if all(t.columns != g.columns for g in by_names)]
    ranked = sorted((one for triple in pool if (one := _rank(draft, triple, model_nt)) is not None), key=lambda r: r[0])
    candidates = tuple((value, text) for _, value, text in ranked[:4])
    asks = f"{why}Which three columns are the magnetometer's x, y and z?"
    draft.ask(Question("magnetometer.columns", asks, candidates, candidates[0][0] if candidates else "mx,my,mz"))


def _rank(
    draft: Draft, triple: Triple, model_nt: FloatArray | None
) -> tuple[tuple[bool, bool, bool, float, bool], str, str] | None:
    """What speaks against three columns (the strongest first), their names, what they would be; None for no field."""
    size = size_of(triple.values)
    unit = find_unit(size, triple.unit, whole=False, expected_nt=_usual(model_nt))
    if size is None or not unit.possible:
        return None
    amount = size.best * FIELD_NT[FieldUnit(unit.possible[0])]
    inside = EARTH_NT[0] <= amount <= EARTH_NT[1]
    text = f"as {unit.possible[0]}, {'on a sphere of' if size.radius else 'most'} {amount / 1e3:.3g} uT"
    text += f", round to {size.roughness:.1%}" if size.radius is not None else ""
    by_model = unit_by_model(triple.unit, None if model_nt is None else scale_by_model(triple.values, model_nt))
    if by_model is not None:
        text = f"as {by_model.possible[0]}, their length follows IGRF along the way"
    rough = round(size.roughness, 2)  # noise alone does not decide
    against = (by_model is None, size.radius is None, not inside, rough, _mixed(triple))
    return against, ",".join(draft.names(triple.columns)), text


def _neighbours(draft: Draft) -> list[Triple]:
    """Every three neighbouring numeric columns that are not something else already."""
    columns = [column for column in draft.log.columns if column.numeric]
    found = []
    for x, y, z in zip(columns, columns[1:], columns[2:], strict=False):
        three = (x, y, z)
        if len({column.unit for column in three}) == 1 and all(_free(column, draft.reserved) for column in three):
            found.append(Triple(three, "", ()))
    return found


def _free(column: Column, taken: set[int]) -> bool:
    good = column.values[np.isfinite(column.values)]
    return column.numeric and column.number not in taken and bool(good.size) and float(np.ptp(good)) > 0.0


def _mixed(triple: Triple) -> bool:
    """Whether the three vary by very different amounts: no axes of one sensor that was turned."""
    spread = np.nanstd(triple.values, axis=0)
    return bool(spread.max() > 6.0 * max(float(spread.min()), 1e-12))
