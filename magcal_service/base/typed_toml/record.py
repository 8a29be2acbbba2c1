"""A TOML table into a frozen dataclass whose fields declare how they stand in it.

Fields are read in the order of their declaration; a field's check sees those read before it.  Fields that declare
nothing are given by the caller or keep their default.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, TypeVar

from magcal_service.base.typed_toml.table import Table

T = TypeVar("T")

_METADATA: Final = "toml"
REQUIRED: Final = object()
"""In place of a default: the key must stand in the file, and the dataclass has no default either."""


class Limits(NamedTuple):
    """Smallest and largest accepted value, of each element where it is an array."""

    minimum: float
    maximum: float


@dataclass(frozen=True, slots=True)
class Reading:
    """One table on its way into a dataclass.

    Parameters
    ----------
    table: the table.
    values: fields read so far, by name, as the dataclass will hold them.
    context: what the caller knows beside the file, the same for all tables within.
    """

    table: Table
    values: dict[str, Any]
    context: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Key:
    """How one field of a dataclass stands in a TOML table.

    Parameters
    ----------
    read: reads the named key; where it is refused or missing, the fault is added and a usable value comes back.
    default: where the key is absent, as the file would say it; ``REQUIRED``: it must be there.
    name: the key in the file; empty: the field's own name.
    unit: unit of the value in the file; empty where it has none.
    limits: smallest and largest accepted value; None: no such limits.
    convert: from the file's value to the field's.
    check: adds what else is wrong with the field's value, given the fields before it.
    file_only: the default is the file's alone; code that makes the dataclass has to state the value.
    """

    read: Callable[[Reading, str], Any]
    default: Any = REQUIRED
    name: str = ""
    unit: str = ""
    limits: Limits | None = None
    convert: Callable[[Any], Any] | None = None
    check: Callable[[Reading, str, Any], None] | None = None
    file_only: bool = False

    def value(self, reading: Reading, name: str) -> Any:
        """The field's value, checked."""
        value = self.read(reading, name)
        if self.convert is not None:
            value = self.convert(value)
        if self.check is not None:
            self.check(reading, name, value)
        return value


def declare(key: Key, default: Any = REQUIRED) -> Any:
    """A dataclass field that is read as ``key`` says; the file's default is its own unless ``default`` is given."""
    if default is REQUIRED:
        default = key.default
    if default is REQUIRED or key.file_only:
        return field(metadata={_METADATA: key})
    value = default if key.convert is None else key.convert(default)
    if isinstance(value, dict):
        return field(default_factory=lambda: dict(value), metadata={_METADATA: key})
    return field(default=value, metadata={_METADATA: key})


def declared(kind: Any) -> dict[str, Key]:
    """The keys of a dataclass by the name of their field, in the order in which they are read."""
    return {one.name: one.metadata[_METADATA] for one in dataclasses.fields(kind) if _METADATA in one.metadata}


def read_record(
    table: Table, kind: type[T], given: Mapping[str, Any] | None = None, context: Mapping[str, Any] | None = None
) -> T:
    """Read a whole table into the dataclass ``kind``; every fault, unknown keys included, is added to the table's.

    Parameters
    ----------
    given: values of fields that are not read from the table.
    context: what checks may need beside the file.

    What comes back where there were faults is well-typed and meaningless.
    """
    record = read_part(table, kind, given, context)
    table.finish()
    return record


def read_part(
    table: Table, kind: type[T], given: Mapping[str, Any] | None = None, context: Mapping[str, Any] | None = None
) -> T:
    """Like ``read_record``, of a table that holds other keys as well: unknown ones are left to the caller."""
    reading = Reading(table, dict(given or {}), context or {})
    for name, key in declared(kind).items():
        if name not in reading.values:
            reading.values[name] = key.value(reading, key.name or name)
    return kind(**reading.values)
