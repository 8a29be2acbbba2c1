"""Values as plain data and back: what is kept of a piece, and what it is known by.  Reading runs nothing."""

from __future__ import annotations

import dataclasses
import functools
import sys
from enum import Enum
from pathlib import Path, PurePath
from types import FunctionType
from typing import Any, Final

import msgpack
import numpy as np

from magcal_service.base.errors import MagcalError

_AS_IT_IS: Final = (type(None), bool, float, str, bytes)
_LEAST_INT, _LARGEST_INT = -(2**63), 2**64 - 1  # of msgpack
_SCRIPT: Final = "__main__"


class NotKnownError(MagcalError):
    """Plain data of a record that this process has not loaded, or that has other fields now."""


def pack(value: object) -> bytes:
    """A value as bytes, the same in every process.

    Parameters
    ----------
    value: of dataclasses, enums, numbers, text, paths, arrays, seeds, and lists, tuples, sets, dicts of these;
        functions and classes by their names, which are not read back.

    Raises ``TypeError`` for anything else.
    """
    packed: bytes = msgpack.packb(_plain(value), unicode_errors="surrogatepass")
    return packed


def unpack(content: bytes) -> Any:
    """The value of ``pack``'s bytes; dataclasses and enums of loaded modules alone, made without running their code.

    Raises ``NotKnownError`` for any other, and for one whose fields have changed.
    """
    return _value(msgpack.unpackb(content, unicode_errors="surrogatepass"))


def home_of(named: Any) -> str:
    """The module of a function or class, by its own name where it runs as the main one; ``__main__`` for a script."""
    spec = getattr(sys.modules.get(named.__module__), "__spec__", None)
    if spec is not None:
        return str(spec.name)
    return _SCRIPT if named.__module__ in (_SCRIPT, "__mp_main__") else str(named.__module__)


def _plain(value: Any) -> Any:
    """Plain data, where every list is a tag and what belongs to it."""
    kind = type(value)
    if kind in _AS_IT_IS or (kind is int and _LEAST_INT <= value <= _LARGEST_INT):
        return value
    if kind is int:
        return ["int", str(value)]
    if kind in (list, tuple):
        return [kind.__name__, *map(_plain, value)]
    if kind in (set, frozenset):
        return [kind.__name__, *sorted(map(_plain, value), key=msgpack.packb)]
    if kind is dict:
        return ["dict", *([_plain(key), _plain(each)] for key, each in value.items())]
    if isinstance(value, Enum):
        return ["enum", *_name(kind), value.name]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [[field.name, _plain(getattr(value, field.name))] for field in dataclasses.fields(value)]
        return ["record", *_name(kind), *fields]
    return _other(value)


def _other(value: Any) -> list[Any]:
    match value:
        case PurePath():
            return ["path", str(value)]
        case np.ndarray() | np.generic() if not value.dtype.hasobject:
            tag = "array" if isinstance(value, np.ndarray) else "number"
            return [tag, value.dtype.str, list(value.shape), value.tobytes()]
        case np.random.SeedSequence():
            return ["seed", _plain(value.entropy), list(value.spawn_key), value.pool_size]
        case functools.partial():
            return ["partial", _plain(value.func), _plain(value.args), _plain(value.keywords)]
        case FunctionType() | type():
            return ["named", *_name(value)]
    raise TypeError(f"{type(value).__qualname__} is not plain data")


def _name(named: Any) -> tuple[str, str]:
    return home_of(named), named.__qualname__


def _value(plain: Any) -> Any:
    if not isinstance(plain, list):
        return plain
    tag, *rest = plain
    match tag:
        case "int":
            return int(rest[0])
        case "list" | "tuple" | "set" | "frozenset":
            return {"list": list, "tuple": tuple, "set": set, "frozenset": frozenset}[tag](map(_value, rest))
        case "dict":
            return {_value(key): _value(each) for key, each in rest}
        case "enum":
            return _loaded(rest[0], rest[1], Enum)[rest[2]]
        case "record":
            return _record(rest[0], rest[1], {name: _value(each) for name, each in rest[2:]})
        case "path":
            return Path(rest[0])
        case "array" | "number":
            array = np.frombuffer(rest[2], dtype=np.dtype(rest[0])).reshape(rest[1]).copy()
            return array if tag == "array" else array[()]
        case "seed":
            return np.random.SeedSequence(_value(rest[0]), spawn_key=tuple(rest[1]), pool_size=rest[2])
    raise NotKnownError(f"{tag!r} is not kept as data")


def _record(module: str, name: str, fields: dict[str, Any]) -> Any:
    kind = _loaded(module, name, object)
    known = {field.name for field in dataclasses.fields(kind)} if dataclasses.is_dataclass(kind) else None
    if known != set(fields):
        raise NotKnownError(f"{module}: no record {name} with the fields {', '.join(fields)}")
    record = object.__new__(kind)
    for field, value in fields.items():
        object.__setattr__(record, field, value)
    return record


def _loaded(module: str, name: str, base: type) -> Any:
    """The class of a name in a module that is loaded already; nothing is imported."""
    main = sys.modules[_SCRIPT]
    is_main = module == getattr(getattr(main, "__spec__", None), "name", _SCRIPT)
    found: Any = main if is_main else sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    if not isinstance(found, type) or not issubclass(found, base):
        raise NotKnownError(f"{module}: {name} is not loaded here")
    return found
