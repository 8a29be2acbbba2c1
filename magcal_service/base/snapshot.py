"""Live objects to plain data and back, by the fields of the dataclass that holds their memory.

Numbers, texts and arrays alone are written; what is read has to fit the hints to the last element, and no number may be
a NaN or an infinity.  Nothing in the data chooses a class or runs code: the object that is restored was built from its
configuration before, and tells what it accepts.
"""

from __future__ import annotations

import math
import types
import typing
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from enum import StrEnum
from functools import cache
from typing import Any, ClassVar, Final, NamedTuple, NoReturn, TypeVar, cast, get_args, get_origin

import numpy as np
from numpy.typing import NDArray

from magcal_service.base.errors import MagcalError

_MOST_ELEMENTS: Final = 1_000_000
"""Elements of an array; the largest that is saved has 4096 samples of 7."""

_FLOATS: Final = NDArray[np.floating[Any]]
_BOOLS: Final = NDArray[np.bool_]

_SCALARS: Final = frozenset((bool, int, float, str))


class SnapshotError(MagcalError):
    """Data that do not fit the object they are to be restored into; names where, and what is accepted there."""


class Stateful:
    """An object with a memory: a dataclass that it also derives from, whose fields are all that outlives a restart.

    ``class Ukf(Stateful, UkfMemory)``: the fields of ``UkfMemory`` are attributes of the filter, they are saved and
    restored whole, and what else is set after the construction is named in ``worked_out``, because it follows from
    them.  ``tests/base/test_stateful.py`` holds every class to that.
    """

    worked_out: ClassVar[tuple[str, ...]] = ()
    """Attributes that are set after the construction and follow from the memory."""

    def export_state(self) -> dict[str, Any]:
        """The memory as plain data: maps, arrays, numbers, texts and bytes."""
        return {name: plain(getattr(self, name)) for name in _memory(type(self))}

    def restore_state(self, saved: object, where: str = "state", given: Mapping[Any, Any] | None = None) -> None:
        """Take over an exported state.

        Parameters
        ----------
        saved: what ``export_state`` gave, of an object built from the same configuration.
        where: what to call it in an error.
        given: types that stand for the class's type variables.

        Raises SnapshotError; the object is of no use then and has to be built anew.
        """
        hints = _memory(type(self))
        if not isinstance(saved, dict) or set(saved) != set(hints):
            _refuse(where, saved, f"a map of {', '.join(hints)}")
        for name, hint in hints.items():
            setattr(self, name, restored(saved[name], hint, f"{where}.{name}", getattr(self, name), given))


def _read_hints(kind: type) -> dict[str, Any]:
    """The attributes that a class declares, with their types."""
    return typing.get_type_hints(kind)


_hints: Final = cast("Callable[[type], dict[str, Any]]", cache(_read_hints))


def _read_memory(kind: type) -> dict[str, Any]:
    """The fields of a class's memory, with their types."""
    hints = _hints(kind)
    return {part.name: hints[part.name] for part in fields(kind)} if is_dataclass(kind) else {}


_memory: Final = cast("Callable[[type], dict[str, Any]]", cache(_read_memory))


def _refuse(where: str, value: object, accepted: str) -> NoReturn:
    raise SnapshotError(f"{where} is {type(value).__name__}; {accepted} is accepted")


def plain(value: Any) -> Any:
    """Plain data of any value that a saved attribute may have."""
    if type(value) in _SCALARS:
        return value
    if isinstance(value, Stateful):
        return value.export_state()
    if isinstance(value, np.ndarray):
        return [list(value.shape), value.astype(value.dtype.newbyteorder("<")).tobytes()]
    if isinstance(value, StrEnum):
        return str(value)
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return float(value)
    if isinstance(value, Counter):
        return dict(value)
    if isinstance(value, dict):
        return [[plain(key), plain(item)] for key, item in value.items()]
    if isinstance(value, list | tuple | deque):
        return [item if type(item) in _SCALARS else plain(item) for item in value]
    if is_dataclass(value):
        return [plain(getattr(value, field.name)) for field in fields(value)]
    raise TypeError(f"{type(value).__name__} cannot be saved")


class _Shape(NamedTuple):
    """A type hint taken apart."""

    optional: bool
    kind: Any  # without the None
    origin: Any  # of a generic kind, None of others


def _read_shape(hint: Any) -> _Shape:
    options = get_args(hint) if get_origin(hint) in (typing.Union, types.UnionType) else (hint,)
    kinds = [option for option in options if option is not type(None)]
    return _Shape(len(kinds) < len(options), kinds[0], get_origin(kinds[0]))


_shape: Final = cast("Callable[[Any], _Shape]", cache(_read_shape))


def restored(data: Any, hint: Any, where: str, template: Any = None, given: Mapping[Any, Any] | None = None) -> Any:
    """The value that plain data stand for; SnapshotError where they don't fit.

    Parameters
    ----------
    data: plain data.
    hint: type of the value.
    where: what to call it in an error.
    template: the value in its place now, or None; an array has to have its shape.
    given: types that stand for type variables.
    """
    given = given or {}
    optional, kind, origin = _shape(given.get(hint, hint))
    if optional and data is None:
        return None
    if isinstance(template, Stateful):
        template.restore_state(data, where, _arguments(kind))
        return template
    if kind in (_FLOATS, _BOOLS):
        return _array(data, np.dtype(np.float64 if kind == _FLOATS else np.bool_), where, template)
    if kind in _SCALARS:
        return _scalar(data, kind, where)
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        return _choice(data, kind, where)
    if origin is Counter:
        return _counter(data, template, where)
    if origin in (list, tuple, deque, dict):
        return _collection(data, kind, template, where, given)
    if isinstance(kind, type) and is_dataclass(kind):
        return _record(data, kind, where)
    return _refuse(where, data, "nothing")


def _is_sound(data: Any, hint: Any) -> bool:
    """Whether data are a scalar of this type, as they stand: most of a state's items are, so these are told quickly."""
    return type(data) is hint and hint in _SCALARS and (hint is not float or math.isfinite(data))


def _arguments(kind: Any) -> dict[Any, Any]:
    """What stands for the type variables of a generic class such as ``Buffer[Tick]``."""
    origin = get_origin(kind)
    parameters: tuple[TypeVar, ...] = getattr(origin, "__parameters__", ()) if origin is not None else ()
    return dict(zip(parameters, get_args(kind), strict=False))


def _scalar(data: Any, kind: type, where: str) -> Any:
    if type(data) is not kind:
        _refuse(where, data, kind.__name__)
    if isinstance(data, float) and not math.isfinite(data):
        raise SnapshotError(f"{where} is {data}; a finite number is accepted")
    return data


def _choice(data: Any, kind: type[StrEnum], where: str) -> StrEnum:
    try:
        return kind(data)
    except ValueError:
        return _refuse(where, data, f"one of {', '.join(kind)}")


def _array(data: Any, dtype: np.dtype[Any], where: str, template: Any) -> NDArray[Any]:
    if not isinstance(data, list) or len(data) != 2 or not isinstance(data[0], list):
        _refuse(where, data, "an array")
    shape, raw = data
    if not all(type(size) is int and 0 <= size <= _MOST_ELEMENTS for size in shape) or len(shape) > 3:
        _refuse(where, shape, "an array of up to 3 axes")
    if not isinstance(raw, bytes) or len(raw) != math.prod(shape) * dtype.itemsize:
        _refuse(where, raw, "as many bytes as the shape says")
    values = np.frombuffer(raw, dtype.newbyteorder("<")).astype(dtype).reshape(shape)
    if isinstance(template, np.ndarray) and template.shape != values.shape:
        raise SnapshotError(f"{where} has the shape {values.shape}; {template.shape} is accepted")
    if not np.isfinite(values).all():
        raise SnapshotError(f"{where} holds a NaN or an infinity; finite numbers are accepted")
    return values


def _counter(data: Any, template: Any, where: str) -> Counter[str]:
    if not isinstance(data, dict) or not all(type(k) is str and type(v) is int for k, v in data.items()):
        _refuse(where, data, "a map of names to counts")
    counter: Counter[str] = template if isinstance(template, Counter) else Counter()
    counter.clear()  # in place: others may count in it too
    counter.update(data)
    return counter


def _collection(data: Any, kind: Any, template: Any, where: str, given: Mapping[Any, Any]) -> Any:
    if not isinstance(data, list):
        _refuse(where, data, "an array")
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is dict:
        return dict(_items(pair, arguments, where, given) for pair in data)
    if origin is tuple and arguments[-1] is not Ellipsis:
        return tuple(_items(data, arguments, where, given))
    hint = arguments[0]
    items = [
        item if _is_sound(item, hint) else restored(item, hint, f"{where}[{i}]", given=given)
        for i, item in enumerate(data)
    ]
    if origin is deque:
        return deque(items, maxlen=template.maxlen if isinstance(template, deque) else None)
    return items if origin is list else tuple(items)


def _items(data: Any, hints: tuple[Any, ...], where: str, given: Mapping[Any, Any]) -> list[Any]:
    if not isinstance(data, list) or len(data) != len(hints):
        _refuse(where, data, f"an array of {len(hints)}")
    return [
        item if _is_sound(item, hint) else restored(item, hint, f"{where}[{i}]", given=given)
        for i, (item, hint) in enumerate(zip(data, hints, strict=True))
    ]


def _record(data: Any, kind: type, where: str) -> Any:
    names = [field.name for field in fields(kind)]
    hints = _hints(kind)
    values = _items(data, tuple(hints[name] for name in names), where, {})
    try:
        return kind(**dict(zip(names, values, strict=True)))
    except ValueError as error:
        raise SnapshotError(f"{where}: {error}") from None
