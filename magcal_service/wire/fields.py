"""Checks of single wire values, built once per field and called for every message.

A check takes a value as msgpack gave it and the field's name; it returns the value the record holds, or raises
``DecodeError`` with one of ``messages.REFUSALS``.  Integers pass as numbers (firmware sends what is shortest), booleans
do not.  Encoding runs the same checks, so what can be sent is exactly what can be received.
"""

from __future__ import annotations

import math
import re
import reprlib
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Any, NoReturn

from magcal_service.base.errors import DecodeError, printable

Check = Callable[[Any, str], Any]

# Lengths are in characters for names (ASCII by their alphabet) and in UTF-8 bytes for texts.
NAME_LENGTH = 32
COUNTER_NAME_LENGTH = 64  # characters; twice a name, for counters whose parts are joined by dots
TEXT_BYTES = 512  # some lines on a terminal; a status of 128 counters and a text stays within one payload
NAME = re.compile(rf"[A-Za-z0-9_-]{{1,{NAME_LENGTH}}}")
COUNTER_NAME = re.compile(rf"[A-Za-z0-9_.:/-]{{1,{COUNTER_NAME_LENGTH}}}")

INT64 = (-(1 << 63), (1 << 63) - 1)  # signed nanoseconds: 292 years on both sides of the epoch
UINT32 = (0, (1 << 32) - 1)  # what a counter of a small processor holds: 136 years at 1 Hz
COUNT = (0, (1 << 53) - 1)  # exact in a double, so readers in any language agree


def shown(value: object) -> str:
    """A short text of any value, safe for values of any size or depth."""
    if isinstance(value, int) and value.bit_length() > 64:
        return f"an integer of {value.bit_length()} bits"
    return reprlib.repr(value)


def refuse(reason: str, name: str, value: object, accepted: str) -> NoReturn:
    """Raise ``DecodeError`` for the field ``name``."""
    raise DecodeError(reason, f"{name} is {shown(value)}; {accepted} is accepted")


def _refuse_type(name: str, value: object, accepted: str) -> NoReturn:
    nested = isinstance(value, list | tuple | Mapping)
    refuse("too_deep" if nested else "wrong_type", name, value, accepted)


def integer(low: int, high: int) -> Check:
    """A whole number from ``low`` to ``high``."""

    def check(value: Any, name: str) -> int:
        if type(value) is int and low <= value <= high:
            return value
        if isinstance(value, bool) or not isinstance(value, int):
            _refuse_type(name, value, f"a whole number from {low} to {high}")
        if not low <= value <= high:
            refuse("out_of_range", name, value, f"a whole number from {low} to {high}")
        return int(value)

    return check


def real(low: float, high: float) -> Check:
    """A finite number from ``low`` to ``high``, as a float."""

    def check(value: Any, name: str) -> float:
        if type(value) is float and low <= value <= high:
            return value
        if isinstance(value, bool) or not isinstance(value, int | float):
            _refuse_type(name, value, f"a number from {low:g} to {high:g}")
        if isinstance(value, float) and not math.isfinite(value):
            refuse("not_finite", name, value, f"a finite number from {low:g} to {high:g}")
        if not low <= value <= high:
            refuse("out_of_range", name, value, f"a number from {low:g} to {high:g}")
        return float(value)

    return check


def array(item: Check, shortest: int, longest: int) -> Check:
    """An array of ``shortest`` to ``longest`` items, as a tuple."""

    def check(value: Any, name: str) -> tuple[Any, ...]:
        if not isinstance(value, tuple | list):
            refuse("too_deep" if isinstance(value, Mapping) else "wrong_type", name, value, "an array")
        if not shortest <= len(value) <= longest:
            lengths = f"{shortest}" if shortest == longest else f"{shortest} to {longest}"
            refuse("wrong_shape", name, value, f"an array of {lengths} values")
        return tuple([item(element, name) for element in value])

    return check


def vector(limit: float) -> Check:
    """Three numbers whose length is at most ``limit``."""
    check_items = array(real(-limit, limit), 3, 3)

    square = limit * limit

    def check(value: Any, name: str) -> tuple[float, float, float]:
        if type(value) is tuple and len(value) == 3:  # the common case, three times faster; also false for NaN
            x, y, z = value
            if type(x) is type(y) is type(z) is float and x * x + y * y + z * z <= square:
                return x, y, z
        x, y, z = check_items(value, name)
        if x * x + y * y + z * z > square:
            refuse("out_of_range", name, value, f"a vector of length up to {limit:g}")
        return x, y, z

    return check


def covariance(size: int, limit: float) -> Check:
    """The upper triangle, row by row, of a ``size`` x ``size`` covariance; no variance may be negative."""
    count = size * (size + 1) // 2
    check_items = array(real(-limit, limit), count, count)
    diagonal = [row * size - row * (row - 1) // 2 for row in range(size)]

    def check(value: Any, name: str) -> tuple[float, ...]:
        items: tuple[float, ...] = check_items(value, name)
        for index in diagonal:
            if items[index] < 0.0:
                refuse("out_of_range", f"{name}[{index}]", items[index], "a variance of 0 or more")
        return items

    return check


def name_like(pattern: re.Pattern[str] = NAME) -> Check:
    """A string that matches ``pattern`` entirely."""

    def check(value: Any, name: str) -> str:
        if not isinstance(value, str):
            _refuse_type(name, value, f"a string like {pattern.pattern}")
        if pattern.fullmatch(value) is None:
            refuse("bad_name", name, value, f"a string like {pattern.pattern}")
        return value

    return check


def text(longest: int = TEXT_BYTES) -> Check:
    """One line of printable Unicode of at most ``longest`` UTF-8 bytes; no control characters reach a terminal."""

    def check(value: Any, name: str) -> str:
        if not isinstance(value, str):
            _refuse_type(name, value, "a string")
        if not value.isprintable() or len(value.encode()) > longest:
            refuse("bad_text", name, value, f"one line of printable text of up to {longest} bytes")
        return value

    return check


def fitting(line: str) -> str:
    """As much of a text as ``text`` accepts: its lines as one, and what is not printable as an escape."""
    return printable("; ".join(line.splitlines())).encode()[:TEXT_BYTES].decode(errors="ignore")


def flag(value: Any, name: str) -> bool:
    """A boolean."""
    if not isinstance(value, bool):
        _refuse_type(name, value, "true or false")
    return value


def optional(check_present: Check) -> Check:
    """nil, or what ``check_present`` accepts."""

    def check(value: Any, name: str) -> Any:
        return None if value is None else check_present(value, name)

    return check


def mapping(key: Check, item: Check, longest: int) -> Check:
    """A map of at most ``longest`` entries, as a dict."""

    def check(value: Any, name: str) -> dict[str, Any]:
        if not isinstance(value, dict):
            refuse("too_deep" if isinstance(value, list | tuple) else "wrong_type", name, value, "a map")
        if len(value) > longest:
            refuse("wrong_shape", name, f"a map of {len(value)} entries", f"a map of up to {longest} entries")
        return {key(k, name): item(v, f"{name}.{k}") for k, v in value.items()}

    return check


_ARGUMENT_TEXT = text(256)
_ARGUMENT_INTEGER = integer(*INT64)
_ARGUMENT_REAL = real(-1.7976931348623157e308, 1.7976931348623157e308)


def argument(value: Any, name: str) -> str | int | float | bool:
    """One argument of a command: true, false, a 64-bit whole number, a finite number, or a text of up to 256 bytes."""
    if isinstance(value, bool):
        return value
    if isinstance(value, str):
        return str(_ARGUMENT_TEXT(value, name))
    if isinstance(value, int):
        return int(_ARGUMENT_INTEGER(value, name))
    return float(_ARGUMENT_REAL(value, name))


def choice(members: type[StrEnum], allowed: tuple[StrEnum, ...] | None = None) -> Check:
    """A small integer that stands for a member: its place in the order in which ``members`` declares them."""
    order = tuple(members)
    by_code = {code: member for code, member in enumerate(order) if allowed is None or member in allowed}
    accepted = "one of " + ", ".join(f"{code} ({member.value})" for code, member in by_code.items())

    def check(value: Any, name: str) -> StrEnum:
        if type(value) is not int:
            _refuse_type(name, value, accepted)
        if value not in by_code:
            refuse("unknown_choice", name, value, accepted)
        return by_code[value]

    return check


def code_of(members: type[StrEnum]) -> Callable[[Any], Any]:
    """The way back of ``choice``; what is no member stays a text, which ``choice`` then refuses."""
    codes: dict[Any, int | None] = {member.value: code for code, member in enumerate(members)}
    codes[None] = None

    def dump(value: Any) -> Any:
        try:
            return codes[value]
        except (KeyError, TypeError):
            return shown(value)

    return dump
