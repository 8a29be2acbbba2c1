"""Channels beside the magnetometer: gyro, temperatures, currents, torquers and the like, where their unit is sure."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.base.typed_toml import nearest
from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.recordings.describe.columns import Column, Triple
from magcal_service.recordings.describe.draft import Draft, Question, answered
from magcal_service.recordings.describe.fahrenheit import steps_of_degf, swings_as_degf
from magcal_service.recordings.describe.kinds import kind_of_triple
from magcal_service.recordings.describe.times_found import Times
from magcal_service.recordings.describe.unit_answer import read_unit
from magcal_service.recordings.describe.vocabulary import CURRENT, TEMPERATURE, Kind
from magcal_service.recordings.inspect.current_unit import MOST_A
from magcal_service.recordings.inspect.gyro_unit import by_turning
from magcal_service.recordings.unit_words import unknown_unit

FloatArray = npt.NDArray[np.float64]

_NAMES: Final = {Kind.GYRO: "gyro", Kind.ACCELEROMETER: "accelerometer", Kind.SUN: "sun", Kind.TORQUER: "torquer"}
_QUANTITY: Final = {Kind.GYRO: "angular rate", Kind.ACCELEROMETER: "acceleration", Kind.TORQUER: "magnetic moment"}
_COUNTS: Final = ": counts"
"""How the reason ends where a gyro is in none of the units that a descriptor knows."""

_LIKE_COUNTS: Final = "mrad/s"
"""Whole numbers of this size may be counts as well: 16.4 of a deg/s are usual, and one is then 1.06 mrad/s."""

_RANGES: Final = {
    "temperature": {"degC": (-100.0, 200.0), "K": (173.0, 473.0), "degF": (-150.0, 400.0)},
    "current": {"A": (-500.0, 500.0), "mA": (-5e5, 5e5), "uA": (-5e8, 5e8)},
    "voltage": {"V": (-1e3, 1e3), "mV": (-1e6, 1e6)},
    "pressure": {"Pa": (0.0, 2e5), "hPa": (0.0, 2e3), "kPa": (0.0, 200.0), "mbar": (0.0, 2e3), "bar": (0.0, 2.0)},
    "fraction": {"%": (-5.0, 105.0)},
    "angular rate": {"deg/s": (-4e3, 4e3), "rad/s": (-70.0, 70.0), "mrad/s": (-7e4, 7e4), "rpm": (-700.0, 700.0)},
}
"""What values of a unit can be; beyond that the name is not believed."""

_HOT_DEGC: Final = 55.0
"""A whole log at least as warm is asked about: choice, above what electronics are at and in degF a cool room."""

_HOT_DEGF: Final = 110.0  # 43 degC: warmer than that the same log in degF is no more usual than in degC

_SCALARS: Final = ("temperature", "current", "voltage", "pressure", "fraction", "power", "irradiance")


@dataclass(frozen=True, slots=True)
class _Unit:
    unit: str
    why: str
    possible: tuple[str, ...] = ()


def find_channels(draft: Draft, groups: list[Triple], field_nt: FloatArray | None, times: Times | None) -> None:
    """Put the channels into the draft whose names and numbers agree; say what is left out."""
    answers = _asked_channels(draft)
    names: set[str] = {"attitude"}
    for name, parts in answers.items():
        _answered_channel(draft, name, parts)
        names.add(name)
    for group in groups:
        kind = kind_of_triple(group)
        if {c.number for c in group.columns} & draft.reserved or kind not in _NAMES:
            continue
        name = _free_name(_NAMES[kind], group.stem, names)
        if _vector(draft, name, kind, group, field_nt, times):
            names.add(name)
    for column in draft.log.columns:
        if column.number not in draft.reserved and column.numeric and column.name:
            _scalar(draft, column, names)


def left_out(draft: Draft) -> list[str]:
    """Columns that neither the descriptor nor a question names."""
    return [
        c.label
        for c in draft.log.columns
        if c.number not in draft.reserved and (c.name or c.numeric) and any(c.cells) and not _asked_about(draft, c)
    ]


def _asked_about(draft: Draft, column: Column) -> bool:
    """Whether an open question names a column, in its text or as what it could be."""
    label = re.compile(rf"(?<!\w){re.escape(column.label)}(?!\w)")
    of_columns = [one for one in draft.questions if one.key.endswith((".column", ".columns"))]
    offered = {name for one in of_columns for value, _ in one.candidates for name in value.split(",")}
    return draft.name(column) in offered or any(label.search(one.asks) for one in draft.questions)


def _asked_channels(draft: Draft) -> dict[str, dict[str, str]]:
    found: dict[str, dict[str, str]] = {}
    for key, value in draft.answers.beginning("channels.").items():
        name, _, part = key.partition(".")
        if name == "attitude":
            continue
        found.setdefault(name, {})[part or "columns"] = value
    return found


def _answered_channel(draft: Draft, name: str, parts: dict[str, str]) -> None:
    """A channel by its answers: columns, and its unit or axes."""
    given = parts.get("columns") or parts.get("column")
    if given is None:
        columns = _by_channel_name(draft, name)
    else:
        columns = draft.named(f"channels.{name}.columns", given, range(1, 17))
    said = parts.get("unit") or (columns[0].unit if columns[0].unit in CHANNEL_UNITS else "")
    unit = read_unit(f"channels.{name}.unit", said, CHANNEL_UNITS, parts.get("factor"))
    value: dict[str, object] = _columns(draft, columns)
    value |= unit.entries if unit.unit else {}
    value |= {key: parts[key] for key in ("frame", "order", "from", "to") if key in parts}
    draft.put("channels", name, value)
    draft.reserved |= {column.number for column in columns}
    label = ", ".join(column.label for column in columns)
    draft.conclude(f"channels.{name}", f"{label} in {str(unit) or 'no unit'}", answered(f"channels.{name}"))


def _by_channel_name(draft: Draft, name: str) -> list[Column]:
    """The columns of an open question's channel."""
    from magcal_service.recordings.describe.columns import triples

    for group in triples(draft.log):
        kind = kind_of_triple(group)
        if (
            kind in _NAMES
            and name in {_NAMES[kind], _clean(group.stem)}
            and not {c.number for c in group.columns} & draft.reserved
        ):
            return list(group.columns)
    free = [column for column in draft.log.columns if column.number not in draft.reserved]
    for column in free:
        if name in {_quantity(column), _clean(column.stem), column.name}:
            return [column]
    known = {name for column in free if column.numeric and column.name for name in (column.name, _clean(column.stem))}
    accepted = f"{nearest(name, known)}; or name its columns: --answer channels.{name}.columns=NAME,NAME"
    raise InputRefusedError([Fault("--answer channels", name, accepted)])


def _columns(draft: Draft, columns: list[Column] | tuple[Column, ...]) -> dict[str, object]:
    names = draft.names(columns)
    return {"column": names[0]} if len(names) == 1 else {"columns": names}


def _clean(text: str) -> str:
    return "".join(sign if sign.isalnum() or sign in "_-" else "_" for sign in text).strip("_")[:32] or "channel"


def _free_name(name: str, stem: str, names: set[str]) -> str:
    if name not in names:
        return name
    name = _clean(stem)
    number = 2
    while name in names:
        name, number = f"{_clean(stem)[:29]}_{number}", number + 1
    return name


def _vector(
    draft: Draft, name: str, kind: Kind, group: Triple, field_nt: FloatArray | None, times: Times | None
) -> bool:
    """Whether three columns became a channel."""
    if kind is Kind.SUN:
        return _sun(draft, name, group)
    quantity = _QUANTITY[kind]
    possible = _possible(quantity)
    found = _said(group.columns, group.unit, quantity)
    if kind is Kind.GYRO and field_nt is not None and times is not None:
        found = _by_turning(group, found, field_nt, times, draft.log.neighbours())
        possible = found.possible or possible
        if not found.unit and found.why.endswith(_COUNTS):
            draft.said.append(f"channels: {group.label} left out: {found.why}; write them in deg/s to have the channel")
            return False
    if not found.unit and not group.unit and kind is Kind.ACCELEROMETER:
        found = _by_gravity(group.values)
    if not found.unit:
        if kind is Kind.TORQUER or (kind is Kind.GYRO and (found.possible or not group.unit)):
            asks = f"in which unit is {group.label}, by name {name}? {found.why}"
            draft.ask(_unit_question(name, asks, possible))
        return False
    draft.put("channels", name, _columns(draft, group.columns) | {"unit": found.unit})
    draft.reserved |= {column.number for column in group.columns}
    draft.conclude(f"channels.{name}", f"{group.label} in {found.unit}", found.why)
    return True


def _unit_question(name: str, asks: str, possible: tuple[str, ...]) -> Question:
    """Which unit a channel has."""
    candidates = tuple((one, "") for one in possible)
    scaled = f"0.1 {possible[0]}"
    return Question(f"channels.{name}.unit", asks, candidates, possible[0], needed=False, scaled=scaled)


def _sun(draft: Draft, name: str, group: Triple) -> bool:
    length = np.sqrt((group.values**2).sum(axis=1))
    good = length[np.isfinite(length) & (length > 0)]
    if not good.size or float(np.mean(np.abs(good - 1.0) < 0.05)) < 0.9:
        return False
    asks = f"{group.label} are a unit vector and are called the Sun's; in which axes?"
    candidates = (("body", "as a Sun sensor gives"), ("eci", "as an ephemeris gives"))
    draft.ask(Question(f"channels.{name}.frame", asks, candidates, "body", needed=False))
    return False


def _said(columns: tuple[Column, ...], unit: str, quantity: str) -> _Unit:
    """The unit that the names say, where it is of this quantity and the numbers can be that."""
    if not unit:
        return _Unit("", "no name says it")
    if unit not in CHANNEL_UNITS or CHANNEL_UNITS[unit].quantity != quantity:
        return _Unit("", f"the name says {unit}, which is no unit of {quantity}")
    low, high = _RANGES.get(quantity, {}).get(unit, (-1e18, 1e18))
    values = np.concatenate([column.values for column in columns])
    good = values[np.isfinite(values)]
    if not good.size or float(np.mean((good < low) | (good > high))) > 0.02:
        return _Unit("", f"the name says {unit}, but the numbers cannot be that")
    if unit == "degC" and float(np.quantile(good, 0.02)) >= _HOT_DEGC and float(np.quantile(good, 0.98)) <= _HOT_DEGF:
        why = f"the name says degC, but {good.min():.4g} to {good.max():.4g} are hot for that and usual in degF"
        return _Unit("", why, ("degF", "degC"))
    return _Unit(unit, f"the names say {quantity} in {unit}, and the numbers can be that")


def _by_turning(
    group: Triple, found: _Unit, field: FloatArray, times: Times, neighbours: npt.NDArray[np.bool_]
) -> _Unit:
    """The gyro's unit as ``found`` by its names, or by how the measured field turns; open where the two differ."""
    turning = by_turning(group.values, field, times.seconds, neighbours)
    if turning is None:
        if found.unit or group.unit:
            return found
        return _Unit("", "no name says it, and the measured field does not turn with it in any")
    if found.unit:
        if turning.unit == found.unit:
            return found
        other = f"{turning.unit}, in which it turns as the measured field does" if turning.unit else turning.as_counts
        possible = (turning.unit, found.unit) if turning.unit else (found.unit,)
        return _Unit("", f"the name says {found.unit}, but as the measured field turns {other}", possible)
    if not turning.unit or (group.whole and turning.unit == _LIKE_COUNTS):
        return _Unit("", f"as the measured field turns {turning.as_counts}{_COUNTS}")
    return _Unit(turning.unit, f"the name says a gyro, and in {turning.unit} it turns as the measured field does")


def _by_gravity(values: FloatArray) -> _Unit:
    length = np.sqrt((values**2).sum(axis=1))
    good = length[np.isfinite(length)]
    middle = float(np.median(good)) if good.size else 0.0
    for unit, low, high in (("m/s2", 9.0, 10.6), ("g", 0.92, 1.08)):
        if low < middle < high:
            return _Unit(unit, f"the name says acceleration, and its usual size is {middle:.4g}, gravity in {unit}")
    return _Unit("", "no name says it")


def _quantity(column: Column) -> str:
    words = set(column.words) | {column.stem.lower()}
    if (
        words & TEMPERATURE
        or column.stem in {"T", "imu_T"}
        or (column.words[-1:] == ("t",) and column.stem.endswith("T"))
    ):
        return "temperature"
    if words & CURRENT:
        return "current"
    if column.unit in CHANNEL_UNITS and CHANNEL_UNITS[column.unit].quantity in _SCALARS:
        return CHANNEL_UNITS[column.unit].quantity
    return ""


def _scalar(draft: Draft, column: Column, names: set[str]) -> None:
    quantity = _quantity(column)
    if not quantity or not np.isfinite(column.values).any():
        return
    found = _said((column,), column.unit, quantity)
    if not column.unit:
        found = _by_range(quantity, column.values)
        if strange := unknown_unit(column.name):
            found = _Unit("", f"the name says {strange}, which is no unit of {quantity} here", _possible(quantity))
    if quantity == "temperature" and (found.unit == "degC" or "degF" in found.possible):
        found = _not_degf(draft, column, found)
    base = quantity if quantity in {"temperature", "current"} else _clean(column.stem)
    name = _free_name(base, column.stem, names)
    if not found.unit:
        if found.possible:
            asks = f"in which unit is {column.label}, by name {quantity}? {found.why}"
            draft.ask(_unit_question(name, asks, found.possible))
        else:
            draft.said.append(f"channels: {column.label} left out: {found.why}")
        return
    draft.put("channels", name, {"column": draft.name(column), "unit": found.unit})
    draft.reserved.add(column.number)
    names.add(name)
    draft.conclude(f"channels.{name}", f"{column.label} in {found.unit}", found.why)


def _possible(quantity: str) -> tuple[str, ...]:
    """Units of a quantity."""
    return tuple(unit for unit, known in CHANNEL_UNITS.items() if known.quantity == quantity)


def _not_degf(draft: Draft, column: Column, found: _Unit) -> _Unit:
    """A temperature in degC, open where something shows that it is in degF."""
    others = [c for c in draft.log.columns if c is not column and c.numeric and _quantity(c) == "temperature"]
    in_degc = [(c, CHANNEL_UNITS[c.unit or "degC"].to_base(c.values)) for c in others if c.unit in {"", "degC", "K"}]
    why = steps_of_degf(column) or swings_as_degf(column, in_degc)
    if why:
        says = f"the name says {column.unit}" if column.unit else "no name says it"
        return _Unit("", f"{says}, but {why}", ("degF", "degC"))
    if column.unit or not found.unit:
        return found
    low, high = (CHANNEL_UNITS["degF"].to_base(one) for one in (np.nanmin(column.values), np.nanmax(column.values)))
    return _Unit("degC", f"{found.why}; in degF it would be {low:.3g} to {high:.3g} degC")


def _by_range(quantity: str, values: FloatArray) -> _Unit:
    """The unit of a temperature or a current whose name says none."""
    good = values[np.isfinite(values)]
    low, high = (float(q) for q in np.quantile(good, (0.02, 0.98)))
    if quantity == "temperature":
        if low >= 200.0 and high <= 400.0:
            return _Unit("K", f"the name says temperature, and {low:.4g} to {high:.4g} can be K only")
        if low >= -40.0 and high <= 60.0:
            return _Unit("degC", f"the name says temperature, and {low:.4g} to {high:.4g} are usual in degC")
        if low >= -150.0 and high <= 400.0:
            return _Unit("", f"no name says it, and {low:.4g} to {high:.4g} leave it open", ("degC", "degF", "K"))
        return _Unit("", f"the name says temperature, but {low:.4g} to {high:.4g} are none in any unit")
    if quantity == "current":
        units = ("mA", "A") if max(-low, high) > MOST_A else ("A", "mA")
        return _Unit("", f"no name says it, and {low:.4g} to {high:.4g} leave it open", units)
    return _Unit("", "no name says its unit")
