"""``[channels]`` of a descriptor: telemetry beside the magnetometer."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

from magcal_service.base.typed_toml import Table, nearest
from magcal_service.base.typed_toml.keys import optional_choice, special
from magcal_service.base.typed_toml.record import Reading, read_record
from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.recordings.scaled import Scaled

_ATTITUDE = ("order", "from", "to")
_NOT_ON_THE_WIRE = re.compile(r"[^A-Za-z0-9_-]")
_MAX_NAME = 32  # as long as a name on the wire
_MAX_COLUMNS = 16  # as many values as a telemetry message carries
_QUATERNION = 4  # columns of an attitude


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


def _columns(reading: Reading, _: str) -> tuple[str, ...]:
    """``column`` or ``columns``, exactly one of the two."""
    table = reading.table
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


def _unit(reading: Reading, name: str) -> str:
    unit = reading.table.text(name, "")
    if unit not in CHANNEL_UNITS:
        accepted = nearest(unit, filter(None, CHANNEL_UNITS))
        reading.table.refuse(name, unit, f"{accepted}; of another one give factor, its size in one of these")
        return ""
    return unit


def _check_attitude(reading: Reading, name: str, to_axes: Axes | None) -> None:
    """``order``, ``from`` and ``to`` belong together and to four columns."""
    table, values = reading.table, reading.values
    given = [key for key in _ATTITUDE if table.has(key)]
    if not given:
        return
    for key in _ATTITUDE:
        if key not in given:
            table.lack(key, f"an attitude needs order, from and to; here only {', '.join(given)}")
    if len(values["columns"]) != _QUATERNION:
        table.refuse("columns", list(values["columns"]), "an attitude quaternion has 4 columns")
    if to_axes is not None and values["from_axes"] is to_axes:
        table.refuse(name, to_axes.value, "an attitude leads from one set of axes to another")


@dataclass(frozen=True, slots=True)
class ChannelSpec(Scaled):
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
    columns: tuple[str, ...] = special(_columns)
    unit: str = special(_unit, "")
    frame: Axes | None = optional_choice(Axes)
    order: QuaternionOrder | None = optional_choice(QuaternionOrder)
    from_axes: Axes | None = optional_choice(Axes, name="from")
    to_axes: Axes | None = optional_choice(Axes, name="to", check=_check_attitude)

    @property
    def wire_name(self) -> str:
        """The name as messages carry it: what their alphabet lacks becomes ``_``."""
        return _NOT_ON_THE_WIRE.sub("_", self.name)

    @property
    def quantity(self) -> str:
        """What kind of channel this is, by its unit: ``"temperature"``, ``"current"``, ... or ``"attitude"``."""
        return "attitude" if self.order is not None else CHANNEL_UNITS[self.unit].quantity


def read_channels(reading: Reading, key: str) -> tuple[ChannelSpec, ...]:
    """Every channel of the descriptor, in its order; faults are added to the table's list."""
    section = reading.table.table(key)
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
    return None if table is None else read_record(table, ChannelSpec, {"name": name})
