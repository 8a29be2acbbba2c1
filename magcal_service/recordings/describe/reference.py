"""The reference: in the log, or the field model where place and date are known; else it is asked."""

from __future__ import annotations

import re
from typing import Final

import numpy as np

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.base.units import FIELD_NT, FieldUnit
from magcal_service.recordings.describe.columns import Column, Triple
from magcal_service.recordings.describe.draft import Draft, Question, answered
from magcal_service.recordings.describe.expected import frame_of_field
from magcal_service.recordings.describe.field import Size, UnitFound, find_unit, in_earth_field, size_of
from magcal_service.recordings.describe.kinds import kind_of_triple
from magcal_service.recordings.describe.magnetometer import Magnetometer
from magcal_service.recordings.describe.place import Place, likely_height
from magcal_service.recordings.describe.reference_unit import reference_unit, warn_outside
from magcal_service.recordings.describe.times_found import Times
from magcal_service.recordings.describe.unit_answer import AnsweredUnit
from magcal_service.recordings.describe.vocabulary import TEMPERATURE, Kind, frame_of
from magcal_service.recordings.reference_spec import MAX_FIELD_NT
from magcal_service.recordings.table import FloatArray

_CONSTANT: Final = re.compile(r"(?:constant\s+|=)?\s*([0-9.]+(?:[eE][+-]?\d+)?)\s*(nT|uT|mT|T|mG|G)?", re.ASCII)
_FIELD: Final = re.compile(r"(?:constant\s|=|[+-]?\.?[0-9])[^,]*$")
_MAGNITUDE: Final = {
    "f", "abs", "absolute", "ref", "reference", "igrf", "igrf13", "igrf14", "wmm", "model", "expected", "total",
    "magnitude", "norm", "intensity", "btot", "btotal", "bref", "href", "bnorm", "absb", "scalar", "strength",
    "bigrf", "h", "bmodel", "hmag", "bmag", "overhauser", "proton",
}  # fmt: skip
_REFERENCE: Final = {
    "ref", "reference", "igrf", "igrf13", "igrf14", "wmm", "model", "expected", "bref", "href", "bigrf", "bmodel",
    "hmag", "overhauser", "proton",
}  # fmt: skip
_SAME: Final = 2e-3  # relative: lengths that agree so closely were computed from one another
_STILL: Final = 0.01  # of the largest component; choice: a room changes by less, and an orbit by as much in ten seconds
_FORM: Final = "49.2 uT"


def find_reference(
    draft: Draft, groups: list[Triple], magnetometers: list[Magnetometer], times: Times | None, place: Place | None
) -> None:
    """Put the reference into the draft, or ask."""
    own = {column.number for one in magnetometers for column in one.triple.columns}
    if _by_answer(draft, times, place):
        return
    triples = [g for g in groups if kind_of_triple(g) is Kind.REFERENCE and not {c.number for c in g.columns} & own]
    for triple in triples:
        if _vector(draft, times, place, triple, ""):
            return
    if _magnitude_in_log(draft, groups, magnetometers):
        return
    if place is not None and times is not None and times.absolute:
        _model(
            draft,
            times,
            place,
            "no reference is in the log; its position and its date are, which the field model needs",
        )
        return
    _ask(draft, times, place)


def _ask(draft: Draft, times: Times | None, place: Place | None) -> None:
    asks = "no column is a reference, and without position and date the field model cannot be one. "
    asks += "How strong is the field there (one place on the ground)?"
    candidates = [("VALUE UNIT", "the total field of your place, by any IGRF or WMM calculator")]
    if place is not None and times is not None:
        candidates.append(
            ("igrf", "with --answer time.start=2025-06-01T00:00:00Z, the date that the log does not hold")
        )
    if place is None and times is not None and times.absolute:
        candidates.append(("igrf", "with --answer position.tle=FILE, the craft's element sets"))
    draft.ask(Question("reference", asks, tuple(candidates), _FORM))


def _by_answer(draft: Draft, times: Times | None, place: Place | None) -> bool:
    answers = draft.answers
    free, model = answers.get("reference"), answers.get("reference.model")
    constant, magnitude = answers.get("reference.constant"), answers.get("reference.magnitude")
    columns = answers.get("reference.columns")
    given = [one for one in (free, model, constant, magnitude, columns) if one is not None]
    if not given:
        return False
    if len(given) > 1:
        raise InputRefusedError([Fault("--answer reference", " and ".join(given), "exactly one reference is accepted")])
    text = given[0].strip()
    if model is not None or (free is not None and text.lower() in {"igrf", "model igrf", "model=igrf"}):
        if text.lower().split("=")[-1].split()[-1] != "igrf":
            raise InputRefusedError([Fault("--answer reference.model", text, "igrf is accepted")])
        return _model_by_answer(draft, times, place)
    if constant is not None:
        return _constant(draft, text, "reference.constant")
    if free is not None and _is_field(draft, text):
        return _constant(draft, text, "reference")
    key = "reference.magnitude" if magnitude else "reference.columns" if columns else "reference"
    named = draft.named(key, text.removeprefix("columns ").removeprefix("magnitude "), (1, 3))
    if len(named) == 1:
        size = _size(named[0])
        return _magnitude(draft, named[0], size, answered(key), None)
    x, y, z = named
    _vector(draft, times, place, Triple((x, y, z), x.stem, x.words), answered(key))
    return True


def _is_field(draft: Draft, text: str) -> bool:
    """Whether an answer is meant as a field: a number with or without something behind it, and no column's name."""
    parts = {part.strip() for part in text.split(",")}
    return bool(_FIELD.match(text)) and not parts <= {column.name for column in draft.log.columns}


def _constant(draft: Draft, text: str, key: str) -> bool:
    """One field for all rows, as it was answered; without a unit, the one that makes it the Earth's."""
    match = _CONSTANT.fullmatch(text)
    value = float(match.group(1)) if match is not None and match.group(1).count(".") < 2 else 0.0
    unit = (match.group(2) if match is not None else None) or draft.answers.get("reference.unit")
    why = answered("reference")
    if unit is None:
        unit = next((one.value for one in FieldUnit if in_earth_field(value, one)), None)
        why += f"; {value:g}: no unit given, {unit} taken, for it lies within the Earth's field"
    if unit not in list(FieldUnit) or not 0.0 < value * FIELD_NT[FieldUnit(unit)] <= MAX_FIELD_NT:
        accepted = f"a field above 0 and up to 1 mT with its unit is accepted, such as {_FORM}; units: "
        raise InputRefusedError([Fault(f"--answer {key}", text, accepted + " ".join(FieldUnit))])
    draft.put("reference", "constant", value)
    draft.put("reference", "unit", unit)
    draft.conclude("reference.constant", f"{value:g} {unit}", why)
    draft.reference_nt = value * FIELD_NT[FieldUnit(unit)]
    warn_outside(draft, f"{key}={text}", draft.reference_nt)
    return True


def _model_by_answer(draft: Draft, times: Times | None, place: Place | None) -> bool:
    if times is not None and not times.absolute:
        asks = "the field model needs a date; when was the log's time 0?"
        draft.ask(Question("time.start", asks, (), "2025-06-01T00:00:00Z"))
        return True
    if place is None:
        asks = "the field model needs a position; which columns are latitude and longitude (or x, y, z)?"
        draft.ask(Question("position.columns", asks, (), "lat,lon"))
        return True
    _model(draft, times, place, answered("reference"))
    return True


def _model(draft: Draft, times: Times | None, place: Place, why: str) -> None:
    draft.put("reference", "model", "igrf")
    draft.conclude("reference.model", "igrf", why)
    pending = {question.key for question in draft.questions}
    if place.altitude_open and "position.altitude.unit" not in pending:
        asks = "how high was it? no column says, and the field falls by a twentieth in 100 km"
        known = likely_height(place, times)
        draft.ask(Question("position.altitude_km", asks, known, known[0][0] if known else "0.2"))


def _vector(draft: Draft, times: Times | None, place: Place | None, triple: Triple, by: str) -> bool:
    """A reference vector for each row; false where the numbers are no field."""
    unit = reference_unit(draft, size_of(triple.values, still=True), triple.unit)
    if not unit.possible and not by:
        draft.said.append(f"reference: {triple.label} left out: {unit.why}")
        return False
    _ask_unit(draft, triple.label, unit)
    frame = draft.frame("reference.frame", ("ecef", "eci", "ned")) or frame_of(triple.words)
    if not frame and unit.sure:
        frame = frame_of_field(triple.values * unit.unit_nt, times, place)
        if frame:
            draft.conclude("reference.frame", frame, "in it, and in no other, they are IGRF's")
    if not frame and _says_ned(triple):
        frame = "ned"
        draft.conclude("reference.frame", frame, "the names differ in n, e and d")
    if not frame:
        asks = f"in which frame is the reference {triple.label}? no name says"
        candidates = [
            ("eci", "inertial, not turning with the Earth (TEME, J2000, GCRF), as a propagator gives"),
            ("ecef", "it turns with the Earth (ITRF)"),
            ("ned", "north, east, down, as a field model at latitude and longitude gives"),
        ]
        if _stands_still(triple.values):
            candidates = [
                ("ned", "north, east, down; it is one vector, as in one place on the ground"),
                *candidates[:2],
            ]
        draft.ask(Question("reference.frame", asks, tuple(candidates), candidates[0][0]))
    draft.reserved |= {column.number for column in triple.columns}
    draft.put("reference", "columns", draft.names(triple.columns))
    draft.put_unit("reference", AnsweredUnit(unit.unit, unit.factor))
    draft.put("reference", "frame", frame)
    given = f"{unit.unit or 'a unit that is asked below'}, {frame or 'in a frame that is asked below'}"
    draft.conclude("reference.columns", f"{triple.label} in {given}", by or "the names say a reference")
    if unit.sure:
        draft.conclude("reference.unit", unit.unit, unit.why)
    return True


def _says_ned(triple: Triple) -> bool:
    """Whether the three names are alike but for the letters n, e and d."""
    stems = [column.stem.lower() for column in triple.columns]
    differ = [signs for signs in zip(*stems, strict=False) if len(set(signs)) > 1]
    return len(set(map(len, stems))) == 1 and differ == [("n", "e", "d")]


def _stands_still(vectors: FloatArray) -> bool:
    """Whether rows (n, 3) are one vector: no craft in orbit has one, in any frame."""
    known = vectors[np.isfinite(vectors).all(axis=1)]
    size = float(np.max(np.abs(known), initial=0.0))
    return bool(len(known)) and float(np.ptp(known, axis=0).max()) < _STILL * size


def _ask_unit(draft: Draft, label: str, unit: UnitFound) -> None:
    """Ask for the reference's unit, unless it is sure."""
    if not unit.sure:
        asks = f"in which unit is the reference {label}? {unit.why}"
        draft.ask(Question("reference.unit", asks, tuple((one, "") for one in unit.possible), "nT", scaled="0.1 nT"))


def _size(column: Column) -> Size | None:
    good = np.abs(column.values[np.isfinite(column.values)])
    return Size(float(np.quantile(good, 0.8)), None) if good.size else None


def _magnitude(draft: Draft, column: Column, size: Size | None, by: str, expected_nt: float | None) -> bool:
    unit = reference_unit(draft, size, column.unit, expected_nt)
    _ask_unit(draft, column.label, unit)
    draft.reserved.add(column.number)
    draft.put("reference", "magnitude", draft.name(column))
    draft.put_unit("reference", AnsweredUnit(unit.unit, unit.factor))
    draft.conclude("reference.magnitude", f"{column.label} in {unit.unit or '?'}", f"{by}; {unit.why}")
    return True


def _magnitude_in_log(draft: Draft, groups: list[Triple], magnetometers: list[Magnetometer]) -> bool:
    """A column of magnitudes that is not the sensor's own length."""
    used = draft.reserved | {c.number for one in magnetometers for c in one.triple.columns}
    for column in draft.log.columns:
        words = set(column.words) | {column.stem.lower()}
        if not column.numeric or column.number in used or not _may_be_magnitude(column, words):
            continue
        if float(np.nanmin(column.values)) <= 0.0 or any(c is column for g in groups for c in g.columns):
            continue
        lengths = [np.sqrt((one.triple.values**2).sum(axis=1)) for one in magnetometers]
        if any(_same(column.values, length) for length in lengths):
            draft.said.append(
                f"reference: {column.label} left out: it is the sensor's own length, which proves nothing"
            )
            continue
        others = [g for g in groups if not {c.number for c in g.columns} & used]
        source = next((g for g in others if _same(column.values, np.sqrt((g.values**2).sum(axis=1)))), None)
        measured = size_of(magnetometers[0].field_nt) if magnetometers else None
        expected = None if measured is None else measured.best
        unit = find_unit(_size(column), column.unit, whole=False, expected_nt=None if column.unit else expected)
        if source is not None and unit.possible:
            by = f"it is the length of {source.label}, which is not the sensor's"
            return _magnitude(draft, column, _size(column), by, expected)
        if words & _REFERENCE and unit.possible:
            return _magnitude(draft, column, _size(column), "the name says a reference", expected)
        if unit.possible and magnetometers:
            asks = f"is {column.label} a reference, independent of the sensor? its name does not say"
            name = draft.name(column)
            draft.ask(Question("reference", asks, ((name, unit.why), (_FORM, "one field for all rows")), name))
            return True
    return False


def _may_be_magnitude(column: Column, words: set[str]) -> bool:
    """Whether a name can be that of a magnitude; a letter counts where it stands alone."""
    if column.unit not in {"", *FieldUnit} or words & TEMPERATURE:
        return False
    long = {word for word in words if len(word) > 1}
    return bool(long & _MAGNITUDE) or (words <= _MAGNITUDE and bool(words))


def _same(
    one: np.ndarray[tuple[int, ...], np.dtype[np.float64]], other: np.ndarray[tuple[int, ...], np.dtype[np.float64]]
) -> bool:
    good = np.isfinite(one) & np.isfinite(other)
    if good.sum() < 3:
        return False
    floor = 2e-3 * float(np.nanmax(np.abs(other[good])))
    return bool(np.mean(np.abs(one[good] - other[good]) <= _SAME * np.abs(other[good]) + floor) > 0.95)
