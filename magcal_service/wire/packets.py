"""Results as the user data of CCSDS space packets: fixed fields, one after the other, made from the table of kinds.

``magcal xtce`` describes the same parameters to mission control, ``links.ccsds`` adds the packet's headers;
``docs/mission-control.md`` has every byte.  All numbers are big-endian.
"""

from __future__ import annotations

import math
import struct
import types
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations_with_replacement
from typing import Any, Final, get_args, get_type_hints

from magcal_service.base.errors import DecodeError
from magcal_service.wire.kinds import KIND_BY_CODE, Field, Kind, kind_of
from magcal_service.wire.messages import SCHEMA_VERSION, Message

SENT: Final = (16, 17, 18, 33)
"""Kinds that go to mission control: what the daemon sends.  A kind's place here is its APID above the first one."""

HEALTH: Final = (
    "troubles",
    "accepted",
    "ticks",
    "ticks_skipped",
    "rejected",
    "failed",
    "events",
    "link.dropped",
    "link.lost",
    "tick_late_p50_us",
    "tick_late_p99_us",
    "rss_kb",
    "open_files",
    "threads",
)
"""Counters of a status that are numbers of their own, to be plotted and limited; all of them are in one text."""

_ERRORS: Final = ("bx", "by", "bz", "D11", "D22", "D33", "D12", "D13", "D23")

_PARTS: Final[Mapping[str, tuple[str, ...]]] = {
    "D": _ERRORS[3:],
    "covariance": tuple(f"{one}_{other}" for one, other in combinations_with_replacement(_ERRORS, 2)),
    "covariance_nt2": ("xx", "xy", "xz", "yy", "yz", "zz"),
}
"""Names of the numbers of an array; x, y, z where an array is not listed."""

_SIGNED: Final = ("time_ns",)
_SHORT: Final = ("sequence", "command_sequence")

_UNITS: Final = {"nt": "nT", "nt2": "nT^2", "ns": "ns", "s": "s"}


class Form(StrEnum):
    """How one parameter stands in a packet; the value of a number's is its code in ``struct``."""

    U8 = "B"
    U32 = "I"
    U64 = "Q"
    I64 = "q"
    F64 = "d"
    TEXT = "text"
    """A u16 with the number of bytes, and as many bytes of UTF-8."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a packet.

    Parameters
    ----------
    name: within its kind, such as ``bias_x_nt``.
    field: of the message that it is made of, such as ``bias_nt``.
    form: how it stands in the packet.
    unit: empty where it has none.
    labels: the words that the numbers 0, 1, ... of an enumeration stand for; empty where it is none.
    """

    name: str
    field: str
    form: Form
    unit: str = ""
    labels: tuple[str, ...] = ()


_Flat = Callable[[Any], Iterable[Any]]


def _unit(name: str) -> str:
    return _UNITS.get(name.rpartition("_")[2], "")


def _part(name: str, part: str) -> str:
    """``bias_nt`` and ``x`` make ``bias_x_nt``; ``D`` and ``D11`` make ``D11``."""
    if part.startswith(name):
        return part
    stem, _, last = name.rpartition("_")
    return f"{stem}_{part}_{last}" if last in _UNITS else f"{name}_{part}"


def _single(value: Any) -> tuple[Any]:
    return (value,)


def _integer(name: str) -> Form:
    return Form.I64 if name in _SIGNED else Form.U32 if name in _SHORT else Form.U64


def _layout(field: Field, hint: Any) -> tuple[tuple[Parameter, ...], _Flat]:
    """The parameters of a field of type ``hint``, and what makes their values of the field's."""
    name, unit = field.name, _unit(field.name)
    if isinstance(hint, types.UnionType):  # what may be nil: not a number, or an empty text
        hint, _ = get_args(hint)
        none: Any = math.nan if hint is float else ""
        return (
            (Parameter(name, name, Form.F64 if hint is float else Form.TEXT, unit),),
            lambda value: (none if value is None else value,),
        )
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        labels = tuple(member.value for member in hint)
        return (Parameter(name, name, Form.U8, labels=labels),), lambda value: (labels.index(value),)
    if hint is bool:
        return (Parameter(name, name, Form.U8, labels=("no", "yes")),), lambda value: (int(value),)
    if hint is int:
        return (Parameter(name, name, _integer(name), unit),), _single
    if hint is float:
        return (Parameter(name, name, Form.F64, unit),), _single
    if hint is str:
        return (Parameter(name, name, Form.TEXT),), _single
    if get_args(hint)[0] is float:
        parts = _PARTS.get(name, ("x", "y", "z"))
        return tuple(Parameter(_part(name, part), name, Form.F64, unit) for part in parts), tuple
    if get_args(hint) == (str, int):
        numbers = tuple(Parameter(one.replace(".", "_"), name, Form.U64) for one in HEALTH)
        return (*numbers, Parameter(name, name, Form.TEXT)), _counters
    return (Parameter(name, name, Form.TEXT),), lambda value: (",".join(value),)


def _counters(value: Mapping[str, int]) -> Iterable[Any]:
    return (*(value.get(one, 0) for one in HEALTH), " ".join(f"{name}={value[name]}" for name in sorted(value)))


def _layouts(kind: Kind) -> tuple[tuple[str, tuple[Parameter, ...], _Flat], ...]:
    hints = get_type_hints(kind.record)
    return tuple((field.name, *_layout(field, hints[field.name])) for field in kind.fields)


_LAYOUTS: Final = {code: _layouts(KIND_BY_CODE[code]) for code in SENT}

PARAMETERS: Final[Mapping[int, tuple[Parameter, ...]]] = {
    code: (
        Parameter("schema_version", "schema_version", Form.U8),
        *(parameter for _, parameters, _ in layouts for parameter in parameters),
    )
    for code, layouts in _LAYOUTS.items()
}
"""The parameters of each kind that is sent, by its code, in the order of the packet."""


def values_of(message: Message) -> tuple[Any, ...]:
    """The value of each of a message's ``PARAMETERS``: numbers, texts, and the number of an enumeration's word."""
    flat: list[Any] = [SCHEMA_VERSION]
    for name, _, flatten in _LAYOUTS[kind_of(message).code]:
        flat.extend(flatten(getattr(message, name)))
    return tuple(flat)


def pack(message: Message) -> bytes:
    """The user data of a message's packet, of a message that ``codec.encode`` accepts.

    Raises ``DecodeError`` where it is of no kind that is sent.
    """
    kind = kind_of(message)
    if kind.code not in SENT:
        names = ", ".join(KIND_BY_CODE[code].name for code in SENT)
        raise DecodeError("unknown_kind", f"a {kind.name} is not sent in space packets; {names} are accepted")
    values, parameters = values_of(message), PARAMETERS[kind.code]
    return b"".join(
        _text(value) if parameter.form is Form.TEXT else struct.pack(f">{parameter.form}", value)
        for parameter, value in zip(parameters, values, strict=True)
    )


def _text(value: str) -> bytes:
    data = value.encode()
    return struct.pack(">H", len(data)) + data
