"""Kinds of values that several parts of a scenario share: vectors, directions, the six of D, instants.

Each function declares a dataclass field that is read from the scenario's TOML, as those of
``magcal_service.base.typed_toml.keys``.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any, Final, Unpack

from magcal_service.base.typed_toml import Table
from magcal_service.base.typed_toml.keys import Options, numbers, special
from magcal_service.base.typed_toml.record import REQUIRED, Reading
from magcal_service.wire.messages import Vector

Six = tuple[float, float, float, float, float, float]
"""D11 D22 D33 D12 D13 D23."""

ZERO: Final[Vector] = (0.0, 0.0, 0.0)  # no vector given
NO_D: Final[Six] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # ideal scale and axes
RPM: Final = math.tau / 60.0  # one turn per minute [rad/s]
LONGEST_S: Final = 366.0 * 86400.0  # a leap year: what a TLE or a frozen field epoch is far too old for anyway

_AXES: Final[dict[str, Vector]] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
Z_AXIS: Final = _AXES["z"]

_LENGTHS: Final = (1e-6, 1e6)
"""Accepted lengths of a direction given as a vector: outside, it is rounding or a mistake."""

_YEARS: Final = range(1950, 2030)
"""IGRF-14 ends with 2030; before 1950 no reference here has been checked."""

_NS_PER_S: Final = 10**9  # nanoseconds in a second


def vector(limit: float, **options: Unpack[Options]) -> Any:
    """Three numbers, each from -limit to limit; zeros where absent."""
    accepted = "each number from {minimum:g} to {maximum:g} is accepted"
    return numbers(3, ZERO, -limit, limit, accepted=accepted, **options)


def six(**options: Unpack[Options]) -> Any:
    """The elements of D; zeros where absent."""
    return numbers(6, NO_D, **options)


def per_axis(limit: float, **options: Unpack[Options]) -> Any:
    """One number for all three axes, or three; each from 0 to limit."""

    def read(reading: Reading, name: str) -> Vector:
        table = reading.table
        if not isinstance(table.content.get(name), list):
            value = table.real(name, 0.0, minimum=0.0, maximum=limit)
            return value, value, value
        x, y, z = table.numbers(name, 3, ZERO) or ZERO
        if max(abs(x), abs(y), abs(z)) > limit:
            table.refuse(name, [x, y, z], f"each number from {-limit:g} to {limit:g} is accepted")
        if min(x, y, z) < 0.0:
            table.refuse(name, [x, y, z], "numbers from 0 are accepted")
        return x, y, z

    return special(read, ZERO, **options)


def direction(default: Any = REQUIRED, **options: Unpack[Options]) -> Any:
    """``"x"``, ``"y"``, ``"z"`` or a vector, read as a unit vector; ``default`` by its letter."""
    otherwise = None if default is REQUIRED else default

    def read(reading: Reading, name: str) -> Vector:
        return _read_direction(reading.table, name, otherwise)

    return special(read, default if otherwise is None else _AXES[otherwise], **options)


def _read_direction(table: Table, name: str, default: str | None) -> Vector:
    """The unit vector of a direction given by letter or as a vector; z where it is refused."""
    value = table.content.get(name, default)
    table.has(name)
    if isinstance(value, str) and value in _AXES:
        return _AXES[value]
    if isinstance(value, str) or value is None:
        table.refuse_or_lack(name, '"x", "y", "z" or an array of 3 numbers is accepted')
        return Z_AXIS
    x, y, z = table.numbers(name, 3, Z_AXIS) or Z_AXIS
    length = math.sqrt(x * x + y * y + z * z)
    if not _LENGTHS[0] <= length <= _LENGTHS[1]:
        table.refuse(name, value, "a vector that is not zero is accepted")
        return Z_AXIS
    return x / length, y / length, z / length


def instant(default: str | None, **options: Unpack[Options]) -> Any:
    """A UTC time in whole seconds, from ISO 8601 text or a TOML date-time, read as ns since 1970."""

    def read(reading: Reading, name: str) -> int | None:
        if default is None and not reading.table.has(name):
            return None
        return _read_instant(reading.table, name, default or "")

    return special(read, REQUIRED if default is not None else None, **options)


def _read_instant(table: Table, name: str, default: str) -> int:
    accepted = 'a UTC time such as "2025-06-01T00:00:00Z" from 1950 to 2030 is accepted'
    value = table.content.get(name, default)
    table.has(name)
    try:
        moment = value if isinstance(value, datetime) else datetime.fromisoformat(str(value).replace("Z", "+00:00"))
    except ValueError:
        table.refuse(name, value, accepted)
        return 0
    if moment.tzinfo is None or moment.utcoffset() or moment.year not in _YEARS or moment.microsecond:
        table.refuse(name, value, accepted)
        return 0
    return round(moment.astimezone(UTC).timestamp()) * _NS_PER_S
