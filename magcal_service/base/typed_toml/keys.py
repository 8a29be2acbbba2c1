"""Declarations of dataclass fields that are read from TOML: ``period_s: float = number(60.0, 10.0, 86_400.0)``.

Each function gives a dataclass field (see ``record.Key``).  A first argument that is left out makes the key required.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum
from typing import Any, TypedDict, TypeVar, Unpack

from magcal_service.base.typed_toml.record import REQUIRED, Key, Limits, Reading, declare, read_part, read_record
from magcal_service.base.typed_toml.table import Table

__all__ = [
    "choice",
    "defaulted_section",
    "flag",
    "inline",
    "number",
    "numbers",
    "optional_choice",
    "optional_numbers",
    "optional_whole",
    "section",
    "sections",
    "special",
    "text",
    "texts",
    "whole",
]

E = TypeVar("E", bound=StrEnum)
T = TypeVar("T")


class Options(TypedDict, total=False):
    """What every declaration may add; see ``record.Key``."""

    name: str
    unit: str
    convert: Callable[[Any], Any]
    check: Callable[[Reading, str, Any], None]
    file_only: bool


def _declare(
    read: Callable[[Reading, str], Any], default: Any, limits: Limits | None, options: Options, fallback: Any = None
) -> Any:
    key = replace(Key(read, default, limits=limits), **options)
    return declare(key) if fallback is None else declare(key, fallback)


def _limits(minimum: float, maximum: float) -> Limits | None:
    """None where any finite number is accepted."""
    return None if math.isinf(minimum) and math.isinf(maximum) else Limits(minimum, maximum)


def number(
    default: Any = REQUIRED,
    minimum: float = -math.inf,
    maximum: float = math.inf,
    *,
    fallback: float | None = None,
    **options: Unpack[Options],
) -> Any:
    """A finite number within [minimum, maximum].

    ``fallback`` of a required one: its value where it is refused, and the dataclass's default.
    """
    required = default is REQUIRED
    otherwise = (fallback or 0.0) if required else default

    def read(reading: Reading, name: str) -> float | None:
        return reading.table.number(name, otherwise, required=required, minimum=minimum, maximum=maximum)

    return _declare(read, default, _limits(minimum, maximum), options, fallback)


def whole(default: int, minimum: int, maximum: int, **options: Unpack[Options]) -> Any:
    """A whole number within [minimum, maximum]."""

    def read(reading: Reading, name: str) -> int:
        return reading.table.integer(name, default, minimum=minimum, maximum=maximum)

    return _declare(read, default, Limits(minimum, maximum), options)


def optional_whole(minimum: int, maximum: int, **options: Unpack[Options]) -> Any:
    """A whole number within [minimum, maximum]; None where the key is absent."""

    def read(reading: Reading, name: str) -> int | None:
        table = reading.table
        return table.integer(name, minimum, minimum=minimum, maximum=maximum) if table.has(name) else None

    return _declare(read, None, Limits(minimum, maximum), options)


def flag(default: bool, **options: Unpack[Options]) -> Any:
    """A switch."""
    return _declare(lambda reading, name: reading.table.flag(name, default), default, None, options)


def text(default: Any = REQUIRED, accepted: str = "a string", **options: Unpack[Options]) -> Any:
    """A string."""
    otherwise = None if default is REQUIRED else default

    def read(reading: Reading, name: str) -> str:
        return reading.table.text(name, otherwise, accepted=accepted)

    return _declare(read, default, None, options)


def choice(kind: type[E], default: Any = REQUIRED, **options: Unpack[Options]) -> Any:
    """One of an enumeration's values."""
    otherwise = None if default is REQUIRED else default
    return _declare(lambda reading, name: reading.table.choice(name, kind, otherwise), default, None, options)


def optional_choice(kind: type[E], **options: Unpack[Options]) -> Any:
    """One of an enumeration's values; None where the key is absent."""

    def read(reading: Reading, name: str) -> E | None:
        return reading.table.choice(name, kind) if reading.table.has(name) else None

    return _declare(read, None, None, options)


def numbers(
    count: int,
    default: Any = REQUIRED,
    minimum: float = -math.inf,
    maximum: float = math.inf,
    *,
    fallback: tuple[float, ...] | None = None,
    accepted: str = "numbers from {minimum:g} to {maximum:g} are accepted",
    **options: Unpack[Options],
) -> Any:
    """An array of ``count`` finite numbers, each within [minimum, maximum].

    ``fallback`` of a required one: its value where it is refused, zeros where not given, and the dataclass's default.
    """
    required = default is REQUIRED
    otherwise = (fallback or (0.0,) * count) if required else default

    def read(reading: Reading, name: str) -> tuple[float, ...]:
        values: tuple[float, ...] = reading.table.numbers(name, count, otherwise, required=required) or otherwise
        if not all(minimum <= value <= maximum for value in values):
            reading.table.refuse(name, list(values), accepted.format(minimum=minimum, maximum=maximum))
        return values

    return _declare(read, default, _limits(minimum, maximum), options, fallback)


def optional_numbers(count: int, minimum: float, maximum: float, **options: Unpack[Options]) -> Any:
    """An array of ``count`` numbers, each within [minimum, maximum]; None where the key is absent or refused."""

    def read(reading: Reading, name: str) -> tuple[float, ...] | None:
        values = reading.table.numbers(name, count)
        if values is not None and not all(minimum <= value <= maximum for value in values):
            accepted = f"numbers from {minimum:g} to {maximum:g} are accepted"
            reading.table.refuse(name, list(values), accepted)
        return values

    return _declare(read, None, _limits(minimum, maximum), options)


def texts(count: int, **options: Unpack[Options]) -> Any:
    """A required array of ``count`` strings; empty where it is refused."""

    def read(reading: Reading, name: str) -> tuple[str, ...]:
        return reading.table.texts(name, count, required=True) or ()

    return _declare(read, REQUIRED, None, options)


def section(kind: type[Any], default: Any = REQUIRED, **options: Unpack[Options]) -> Any:
    """A table read into the dataclass ``kind``; a required one that is missing has no further faults of its own."""

    def read(reading: Reading, name: str) -> Any:
        table = reading.table.table(name, required=default is REQUIRED)
        if table is None and default is not REQUIRED:
            return default
        return read_record(table or Table({}, reading.table.file, name, []), kind, context=reading.context)

    return _declare(read, default, None, options)


def defaulted_section(kind: type[T], **options: Unpack[Options]) -> Any:
    """A table read into the dataclass ``kind``; where it is absent every key takes its default."""

    def read(reading: Reading, name: str) -> T:
        table = reading.table.table(name) or Table({}, reading.table.file, name, reading.table.faults)
        return read_record(table, kind, context=reading.context)

    return _declare(read, read_record(Table({}, "", "", []), kind), None, options)


def inline(kind: type[T], **options: Unpack[Options]) -> Any:
    """Several keys of the same table, read into the dataclass ``kind``."""

    def read(reading: Reading, name: str) -> T:
        return read_part(reading.table, kind, context=reading.context)

    return _declare(read, read_part(Table({}, "", "", []), kind), None, options)


def sections(kind: type[Any], **options: Unpack[Options]) -> Any:
    """An array of tables, each read into the dataclass ``kind``; empty where absent."""

    def read(reading: Reading, name: str) -> tuple[Any, ...]:
        return tuple(read_record(one, kind, context=reading.context) for one in reading.table.tables(name))

    return _declare(read, (), None, options)


def special(
    read: Callable[[Reading, str], Any],
    default: Any = REQUIRED,
    *,
    limits: Limits | None = None,
    **options: Unpack[Options],
) -> Any:
    """A value with a reader of its own, which adds its faults to the reading's table."""
    return _declare(read, default, limits, options)
