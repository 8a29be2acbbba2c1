"""[channels] of a descriptor: telemetry beside the magnetometer."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

from magcal_service.typed_toml import Table, nearest
from magcal_service.units import CHANNEL_UNITS

E = TypeVar("E", bound=StrEnum)

_NOT_ON_THE_WIRE = re.compile(r"[^A-Za-z0-9_-]")
_MAX_NAME = 32
_MAX_COLUMNS = 16
_QUATERNION = 4


class Axes(StrEnum):
    """Axes a channel's vector is given in, or an attitude leads from or to."""

    BODY = "body"
    ECI = "eci"
    ECEF = "ecef"
    NED = "ned"
    ENU = "enu"


class QuaternionOrder(StrEnum):
    """Where the scalar part of an attitude stands."""

    WXYZ = "wxyz"
    XYZW = "xyzw"


@dataclass(frozen=True, slots=True)
class ChannelSpec:
    """One telemetry channel.

    Parameters
    ----------
    name: key in the descriptor.
    columns: its 1 to 16 columns in the log.
    unit: one of ``units.CHANNEL_UNITS``; empty where it has none.
    frame: axes of a vector, where stated.
    order, from_axes, to_axes: only for an attitude quaternion, which turns vectors of ``from_axes`` into ``to_axes``.
    """

    name: str
    columns: tuple[str, ...]
    unit: str = ""
    frame: Axes | None = None
    order: QuaternionOrder | None = None
    from_axes: Axes | None = None
    to_axes: Axes | None = None

    @property
    def wire_name(self) -> str:
        """The name as messages carry it: what their alphabet lacks becomes ``_``."""
        return _NOT_ON_THE_WIRE.sub("_", self.name)

    @property
    def quantity(self) -> str:
        """What kind of channel this is, by its unit: ``"temperature"``, ``"current"``, ... or ``"attitude"``."""
        return "attitude" if self.order is not None else CHANNEL_UNITS[self.unit].quantity


def read_channels(top: Table) -> tuple[ChannelSpec, ...]:
    """Every channel of the descriptor, in its order; faults are added to the table's list."""
    section = top.table("channels")
    if section is None:
        return ()
    specs = [_channel(section, name) for name in tuple(section.content)]
    channels = tuple(spec for spec in specs if spec is not None)
    taken: dict[str, str] = {}
    for spec in channels:
        other = taken.setdefault(spec.wire_name, spec.name)
        if other != spec.name:
            section.refuse(spec.name, spec.name, f"a name that differs from {other!r} in A-Z a-z 0-9 _ - is accepted")
    return channels


def _channel(section: Table, name: str) -> ChannelSpec | None:
    table = section.table(name, required=True)
    if not name or len(name) > _MAX_NAME or not name.isprintable():
        section.refuse(name, name, f"a channel's name has 1 to {_MAX_NAME} printable characters")
    if table is None:
        return None
    spec = ChannelSpec(
        name=name,
        columns=_columns(table),
        unit=_unit(table),
        frame=_optional(table, "frame", Axes),
        order=_optional(table, "order", QuaternionOrder),
        from_axes=_optional(table, "from", Axes),
        to_axes=_optional(table, "to", Axes),
    )
    _check_attitude(table, spec)
    table.finish()
    return spec


def _optional(table: Table, key: str, kind: type[E]) -> E | None:
    return table.choice(key, kind) if table.has(key) else None


def _columns(table: Table) -> tuple[str, ...]:
    """``column`` or ``columns``, exactly one of the two."""
    if table.has("column") == table.has("columns"):
        given = "both" if table.has("column") else "neither"
        table.refuse("columns", given, 'exactly one of column = "a" or columns = ["a", "b"] is accepted')
        return ()
    if table.has("column"):
        return (table.text("column"),)
    columns = table.texts("columns") or ()
    if not 1 <= len(columns) <= _MAX_COLUMNS and isinstance(table.content["columns"], list):
        table.refuse("columns", list(columns), f"1 to {_MAX_COLUMNS} columns are accepted")
    return columns


def _unit(table: Table) -> str:
    unit = table.text("unit", "")
    if unit not in CHANNEL_UNITS:
        table.refuse("unit", unit, nearest(unit, CHANNEL_UNITS))
        return ""
    return unit


def _check_attitude(table: Table, spec: ChannelSpec) -> None:
    """``order``, ``from`` and ``to`` belong together and to four columns."""
    given = [key for key in ("order", "from", "to") if table.has(key)]
    if not given:
        return
    for key in ("order", "from", "to"):
        if key not in given:
            table.refuse(key, "missing", f"an attitude needs order, from and to; here only {', '.join(given)}")
    if len(spec.columns) != _QUATERNION:
        table.refuse("columns", list(spec.columns), "an attitude quaternion has 4 columns")
    if spec.from_axes is not None and spec.from_axes is spec.to_axes:
        table.refuse("to", spec.to_axes.value, "an attitude leads from one set of axes to another")
