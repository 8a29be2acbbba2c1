"""Messages to payload bytes and back; the byte-for-byte specification is ``docs/wire.md``.

A payload is one msgpack array ``[schema_version, kind, craft, source, sequence, time_ns, clock, ...own fields]``.
"""

from __future__ import annotations

from collections.abc import Iterable
from operator import attrgetter
from typing import Any

import msgpack

from magcal_service.base.errors import DecodeError
from magcal_service.wire import fields as check
from magcal_service.wire.kinds import KIND_BY_CODE, KINDS, MAX_COUNTERS, Kind, kind_names, kind_of
from magcal_service.wire.messages import SCHEMA_VERSION, Message

MAX_PAYLOAD_BYTES = 10240  # the largest message the limits allow, a status of 128 counters, has 10216 bytes

# What encode and decode walk through for each kind, worked out once.
_CONTENT = {kind.code: attrgetter(*(field.name for field in kind.fields)) for kind in KINDS}
_DUMPS = {kind.code: tuple(field.dump for field in kind.fields) for kind in KINDS}
_CHECKS = {kind.code: tuple((field.name, field.check) for field in kind.fields) for kind in KINDS}
_LEAST = {kind.code: len(kind.fields) - kind.appended + 2 for kind in KINDS}


def encode(message: Message) -> bytes:
    """One message as a payload of at most ``MAX_PAYLOAD_BYTES``.

    The message passes the checks of ``decode`` first, so nothing is sent that a receiver would refuse:
    ``DecodeError`` with the same reasons says what is wrong with it.
    """
    kind = kind_of(message)
    _, content = _checked(_values(kind.code, _CONTENT[kind.code](message)))
    payload: bytes = msgpack.packb(_values(kind.code, content.values()))
    return payload


def decode(payload: bytes) -> Message:
    """The message of a payload.

    Raises
    ------
    DecodeError: for every payload that is not exactly one acceptable message; nothing else, whatever the bytes.
    """
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise DecodeError("too_large", f"{len(payload)} bytes; up to {MAX_PAYLOAD_BYTES} are accepted")
    kind, content = _checked(_unpack(payload))
    return kind.record(**content)


def _values(code: int, content: Iterable[Any]) -> list[Any]:
    own = [value if dump is None else dump(value) for value, dump in zip(content, _DUMPS[code], strict=True)]
    values, least = [SCHEMA_VERSION, code, *own], _LEAST[code]
    while len(values) > least and values[-1] is None:
        values.pop()
    return values


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) != len(pairs):
        raise DecodeError("wrong_shape", "a map holds one key twice; each key once is accepted")
    return entries


def _no_extension(code: int, data: bytes) -> Any:
    raise DecodeError("wrong_type", f"a msgpack extension {code} of {len(data)} bytes; no extension is accepted")


def _unpack(payload: bytes) -> Any:
    try:
        return msgpack.unpackb(
            payload,
            raw=False,
            use_list=False,
            strict_map_key=True,
            object_pairs_hook=_unique_keys,
            max_str_len=check.TEXT_BYTES,
            max_bin_len=0,
            max_array_len=45,  # the covariance of the nine errors
            max_map_len=MAX_COUNTERS,
            max_ext_len=0,
            ext_hook=_no_extension,
        )
    except msgpack.exceptions.StackError:
        raise DecodeError("too_deep", "nested without end; arrays within one array are accepted") from None
    except (ValueError, TypeError, OverflowError) as error:
        reason = "too_long" if "exceeds max_" in str(error) else "not_msgpack"
        raise DecodeError(reason, f"{str(error) or 'a reserved byte'}; one msgpack array is accepted") from None


def _checked(values: Any) -> tuple[Kind, dict[str, Any]]:
    """The kind and the record's content of an unpacked payload; ``DecodeError`` where anything is amiss."""
    if not isinstance(values, tuple | list) or len(values) < 2:
        check.refuse("wrong_shape", "the payload", values, "an array [schema_version, kind, ...]")
    version, code = values[0], values[1]
    if type(version) is not int or type(code) is not int:
        check.refuse("wrong_type", "[schema_version, kind]", [version, code], "a pair of whole numbers")
    if version != SCHEMA_VERSION:
        check.refuse("unknown_version", "schema_version", version, f"{SCHEMA_VERSION}")
    if code not in KIND_BY_CODE:
        check.refuse("unknown_kind", "kind", code, kind_names())
    kind, checks = KIND_BY_CODE[code], _CHECKS[code]
    least, most = _LEAST[code], len(checks) + 2
    if not least <= len(values) <= most:
        accepted = f"{least}" if least == most else f"{least} to {most}"
        check.refuse("wrong_shape", f"the length of a {kind.name} payload", len(values), accepted)
    given = (*values[2:], *(None,) * (most - len(values)))
    content = {name: accept(value, name) for (name, accept), value in zip(checks, given, strict=True)}
    if kind.rule is not None:
        kind.rule(content)
    return kind, content
