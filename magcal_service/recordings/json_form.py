"""Messages as JSON objects and back, and the JSON schema of each kind: the form in which a session is recorded.

An object has ``timestamp`` (whole ``sec`` and ``nsec`` on ``clock``, exact in any reader), ``clock``, ``craft``,
``source`` and ``sequence``, then the kind's own fields under their names on the wire; what is nil there is left out.
Numbers are written so that reading gives the same bits, and reading passes the checks of the wire: what can be read
from a recording is exactly what a link could have received.
"""

from __future__ import annotations

import json
import types
from collections.abc import Mapping
from enum import StrEnum
from typing import Any, NoReturn, get_args, get_origin, get_type_hints

from magcal_service.base.errors import DecodeError
from magcal_service.wire.fields import shown
from magcal_service.wire.kinds import KINDS, Kind, kind_of
from magcal_service.wire.messages import Clock, Message

_NS_PER_S = 1_000_000_000  # nanoseconds in a second
_OWN = {kind.code: tuple(field.name for field in kind.own) for kind in KINDS}
_COMMON = ("timestamp", "clock", "craft", "source", "sequence")
_KNOWN = {kind.code: frozenset((*_COMMON, *_OWN[kind.code])) for kind in KINDS}

_TIMESTAMP = {
    "type": "object",
    "title": "time",
    "description": "source time on the clock: whole seconds, and nanoseconds from 0 to 999999999",
    "properties": {
        "sec": {"type": "integer"},
        "nsec": {"type": "integer", "minimum": 0, "maximum": _NS_PER_S - 1},
    },
    "required": ["sec", "nsec"],
    "additionalProperties": False,
}


def to_json(message: Message) -> bytes:
    """One message as UTF-8 JSON; ``DecodeError`` where it is of no kind or holds a number that is not finite."""
    kind = kind_of(message)
    sec, nsec = divmod(message.time_ns, _NS_PER_S)
    content: dict[str, Any] = {
        "timestamp": {"sec": sec, "nsec": nsec},
        "clock": message.clock,
        "craft": message.craft,
        "source": message.source,
        "sequence": message.sequence,
    }
    for name in _OWN[kind.code]:
        value = getattr(message, name)
        if value is not None:
            content[name] = dict(value) if isinstance(value, Mapping) else value
    try:
        return json.dumps(content, allow_nan=False, ensure_ascii=False, separators=(",", ":")).encode()
    except ValueError as error:  # NaN or infinity, or half a surrogate pair
        raise DecodeError("not_finite", f"a {kind.name} that JSON cannot hold: {error}") from None


def from_json(kind: Kind, data: bytes) -> Message:
    """The message of a JSON object.

    Raises
    ------
    DecodeError: for everything that is not exactly one acceptable message of this kind; nothing else, whatever the
        bytes.  ``not_json`` and the reasons of the wire say why.
    """
    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise DecodeError("not_json", f"{error}; one JSON object is accepted") from None
    if not isinstance(content, dict):
        _refuse(kind, content)
    unknown = content.keys() - _KNOWN[kind.code]
    if unknown or not content.keys() >= set(_COMMON):
        _refuse(kind, sorted(content))
    content["time_ns"] = _time_ns(content.get("timestamp"))
    values: dict[str, Any] = {}
    for field in kind.fields:
        value = content.get(field.name)
        values[field.name] = field.check(value if field.dump is None else field.dump(value), field.name)
    if kind.rule is not None:
        kind.rule(values)
    return kind.record(**values)


def _refuse(kind: Kind, value: object) -> NoReturn:
    accepted = ", ".join((*_COMMON, *_OWN[kind.code]))
    raise DecodeError("wrong_shape", f"{shown(value)}; an object of {accepted} is accepted")


def _time_ns(stamp: object) -> int:
    if isinstance(stamp, dict) and stamp.keys() == {"sec", "nsec"}:
        sec, nsec = stamp["sec"], stamp["nsec"]
        if type(sec) is int and type(nsec) is int and 0 <= nsec < _NS_PER_S:
            return sec * _NS_PER_S + nsec
    raise DecodeError("wrong_shape", f"timestamp is {shown(stamp)}; sec and nsec (0 to 999999999) are accepted")


def schema_name(kind: Kind) -> str:
    """Name of a kind's schema, such as ``magcal.MagnetometerSample``."""
    return f"magcal.{kind.record.__name__}"


def schema_of(kind: Kind) -> dict[str, Any]:
    """JSON schema (draft 2020-12) of the objects that ``to_json`` writes for a kind."""
    hints = get_type_hints(kind.record)
    properties: dict[str, Any] = {
        "timestamp": _TIMESTAMP,
        "clock": _type_schema(Clock),
        "craft": {"type": "string"},
        "source": {"type": "string"},
        "sequence": {"type": "integer", "minimum": 0},
    }
    required = list(properties)
    for name in _OWN[kind.code]:
        hint, optional = _without_none(hints[name])
        properties[name] = _type_schema(hint)
        if not optional:
            required.append(name)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": schema_name(kind),
        "description": (kind.record.__doc__ or "").strip().partition("\n")[0],
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": False,
    }


def _without_none(hint: Any) -> tuple[Any, bool]:
    """A field's type, and whether it may be nil."""
    if get_origin(hint) is types.UnionType and types.NoneType in get_args(hint):
        (kept,) = (part for part in get_args(hint) if part is not types.NoneType)
        return kept, True
    return hint, False


_PLAIN: dict[Any, str] = {str: "string", bool: "boolean", int: "integer", float: "number"}


def _type_schema(hint: Any) -> dict[str, Any]:
    """The schema of a record's field by its type."""
    if hint in _PLAIN:
        return {"type": _PLAIN[hint]}
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        return {"type": "string", "enum": [member.value for member in hint]}
    arguments = get_args(hint)
    if get_origin(hint) is tuple:
        schema: dict[str, Any] = {"type": "array", "items": _type_schema(arguments[0])}
        if arguments[-1] is not Ellipsis:
            schema |= {"minItems": len(arguments), "maxItems": len(arguments)}
        return schema
    if get_origin(hint) is types.UnionType:
        return {"type": [_PLAIN[part] for part in arguments]}
    if get_origin(hint) is not None and issubclass(get_origin(hint), Mapping):
        return {"type": "object", "additionalProperties": _type_schema(arguments[1])}
    raise TypeError(f"{hint!r} has no JSON schema; add it here")
