"""Reads TOML tables into typed values, collecting every fault instead of stopping at the first.

``open_toml`` gives a ``Table``; its methods read one key each and remember it; ``finish`` refuses every key that
nobody read, naming the nearest one that is known.  The caller raises once, with all faults.
"""

from __future__ import annotations

import difflib
import itertools
import math
import sys
import tomllib
from collections.abc import Iterable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any, TypeVar

from magcal_service.errors import Fault, InputRefusedError

E = TypeVar("E", bound=StrEnum)

_MAX_FILE_BYTES = 1 << 20
_MOST_BITS = 1024  # a little more than a float holds: what is less has its field's own refusal
_MOST_LEVELS = 32
_MOST_DOTS = 500
_FEW_LEVELS = "valid TOML of a few levels is accepted"


def nearest(value: str, known: Iterable[str]) -> str:
    """Say which known name is meant: ``"did you mean 'unit'? known: ..."``."""
    names = sorted(known)
    by_lower = {name.lower(): name for name in names}
    close = difflib.get_close_matches(value.lower(), by_lower, n=1)
    listing = ", ".join(names) if names else "none"
    return f"did you mean {by_lower[close[0]]!r}? known: {listing}" if close else f"known: {listing}"


def open_toml(path: Path, error: type[InputRefusedError]) -> Table:
    """Read a TOML file of at most 1 MiB into a ``Table``; raise ``error`` where it cannot be read or parsed."""
    try:
        raw = path.read_bytes()
    except OSError as exc:
        raise error([Fault(str(path), exc.strerror or str(exc), "give a readable TOML file")]) from None
    if len(raw) > _MAX_FILE_BYTES:
        raise error([Fault(str(path), f"{len(raw)} bytes", f"a file of at most {_MAX_FILE_BYTES} bytes is accepted")])
    return parse_toml(raw, str(path), path.name, error)


def parse_toml(raw: bytes, where: str, file: str, error: type[InputRefusedError]) -> Table:
    """The same of a file's content; ``where`` it is from, and the name of the ``file`` in the faults of its keys."""
    if _has_endless_key(raw):
        raise error([Fault(where, "nested too deeply", _FEW_LEVELS)])
    try:
        content = tomllib.loads(raw.decode("utf-8"))
    except RecursionError:
        raise error([Fault(where, "nested too deeply", _FEW_LEVELS)]) from None
    except ValueError as exc:  # not TOML, not UTF-8, or an integer too long to be one
        raise error([Fault(where, str(exc), "valid TOML in UTF-8 is accepted")]) from None
    strange = _strange(content)
    if strange:
        raise error([Fault(where, *strange)])
    return Table(content, file, "", [])


def _has_endless_key(raw: bytes) -> bool:
    """Whether a key has hundreds of dots: the time that its parsing takes goes with their square."""
    for line in raw.split(b"\n"):
        parts = line.split(b"=")
        keys = parts if line.lstrip().startswith(b"[") else parts[:-1]
        if any(key.count(b".") > _MOST_DOTS for key in keys):
            return True
    return False


def _strange(content: object) -> tuple[str, str] | None:
    """What no file of ours can mean, and Python itself stumbles over: values without end, and what is accepted."""
    level, depth = [content], 0
    while level:
        if any(isinstance(value, int) and value.bit_length() > _MOST_BITS for value in level):
            return "an integer of hundreds of digits", "an integer of at most 64 bits is accepted"
        lists = [
            value.values() if isinstance(value, dict) else value for value in level if isinstance(value, dict | list)
        ]
        level, depth = list(itertools.chain.from_iterable(lists)), depth + 1
        if depth > _MOST_LEVELS:
            return "nested too deeply", _FEW_LEVELS
    return None


def _is_number(value: object) -> bool:
    """Whether a TOML value is a finite number that fits a float (a boolean is not one)."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


class Table:
    """One TOML table being read.

    Parameters
    ----------
    content: the parsed table.
    file: file name, for the faults.
    name: dotted name of this table within the file, empty at the top.
    faults: the list that every fault of this file is added to, shared with sub-tables.
    """

    def __init__(self, content: Mapping[str, Any], file: str, name: str, faults: list[Fault]) -> None:
        self.content, self.file, self.name, self.faults = content, file, name, faults
        self._known: set[str] = set()

    def where(self, key: str) -> str:
        """``file: table.key`` for a fault's text."""
        return f"{self.file}: {self.name}.{key}" if self.name else f"{self.file}: {key}"

    def refuse(self, key: str, value: object, accepted: str) -> None:
        """Add a fault about ``key``."""
        self.faults.append(Fault(self.where(key), value, accepted))

    def has(self, key: str) -> bool:
        """Whether the key stands in the file (it still has to be read by a typed method)."""
        self._known.add(key)
        return key in self.content

    def keys(self) -> tuple[str, ...]:
        """All keys of this table, in the order of the file."""
        return tuple(self.content)

    def _get(self, key: str, accepted: str, required: bool) -> Any:
        self._known.add(key)
        if key not in self.content:
            if required:
                self.faults.append(Fault(self.where(key), "missing", f"required: {accepted}"))
            return None
        return self.content[key]

    def text(self, key: str, default: str | None = None, *, accepted: str = "a string") -> str:
        """A string; required where ``default`` is None.  Empty when refused."""
        value = self._get(key, accepted, default is None)
        if value is None:
            return default or ""
        if not isinstance(value, str):
            self.refuse(key, value, f"{accepted} is accepted")
            return default or ""
        return value

    def choice(self, key: str, kind: type[E], default: E | None = None) -> E:
        """One of an enumeration's values; required where ``default`` is None.  Its first member when refused."""
        members = [str(member.value) for member in kind]
        value = self._get(key, "one of " + ", ".join(members), default is None)
        if value is None:
            return default if default is not None else next(iter(kind))
        if value not in members:
            self.refuse(key, value, nearest(str(value), members))
            return default if default is not None else next(iter(kind))
        return kind(value)

    def number(
        self,
        key: str,
        default: float | None = None,
        *,
        required: bool = False,
        minimum: float = -math.inf,
        maximum: float = math.inf,
    ) -> float | None:
        """A finite number within [minimum, maximum]; ``default`` when absent or refused."""
        accepted = "a finite number"
        if minimum > -math.inf or maximum < math.inf:
            accepted += f" from {minimum:g} to {maximum:g}"
        value = self._get(key, accepted, required)
        if value is None:
            return default
        if not _is_number(value) or not minimum <= value <= maximum:
            self.refuse(key, value, f"{accepted} is accepted")
            return default
        return float(value)

    def real(self, key: str, default: float, *, minimum: float = -math.inf, maximum: float = math.inf) -> float:
        """Like ``number`` with a default, so never None."""
        value = self.number(key, default, minimum=minimum, maximum=maximum)
        return default if value is None else value

    def integer(self, key: str, default: int, *, minimum: int, maximum: int) -> int:
        """A whole number within [minimum, maximum]; ``default`` when absent or refused."""
        value = self._get(key, "", False)
        if value is None:
            return default
        if isinstance(value, bool) or not isinstance(value, int) or not minimum <= value <= maximum:
            self.refuse(key, value, f"a whole number from {minimum} to {maximum} is accepted")
            return default
        return value

    def flag(self, key: str, default: bool) -> bool:
        """A boolean."""
        value = self._get(key, "", False)
        if value is None:
            return default
        if not isinstance(value, bool):
            self.refuse(key, value, "true or false is accepted")
            return default
        return value

    def numbers(
        self, key: str, count: int, default: tuple[float, ...] | None = None, *, required: bool = False
    ) -> tuple[float, ...] | None:
        """An array of exactly ``count`` finite numbers."""
        accepted = f"an array of {count} finite numbers"
        value = self._get(key, accepted, required)
        if value is None:
            return default
        good = isinstance(value, list) and len(value) == count
        if not good or not all(map(_is_number, value)):
            self.refuse(key, value, f"{accepted} is accepted")
            return default
        return tuple(float(v) for v in value)

    def texts(self, key: str, count: int | None = None, *, required: bool = False) -> tuple[str, ...] | None:
        """An array of strings, of exactly ``count`` where given."""
        accepted = "an array of strings" if count is None else f"an array of {count} strings"
        value = self._get(key, accepted, required)
        if value is None:
            return None
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value) or count not in (None, len(value)):
            self.refuse(key, value, f"{accepted} is accepted")
            return None
        return tuple(value)

    def table(self, key: str, *, required: bool = False) -> Table | None:
        """A sub-table, or None where absent or refused."""
        value = self._get(key, f"a table [{key}]", required)
        if value is None:
            return None
        if not isinstance(value, dict):
            self.refuse(key, value, f"a table [{key}] is accepted")
            return None
        return Table(value, self.file, f"{self.name}.{key}" if self.name else key, self.faults)

    def tables(self, key: str) -> list[Table]:
        """An array of tables ``[[key]]``, empty where absent."""
        value = self._get(key, f"an array of tables [[{key}]]", False)
        if value is None:
            return []
        if not isinstance(value, list) or not all(isinstance(v, dict) for v in value):
            self.refuse(key, value, f"an array of tables [[{key}]] is accepted")
            return []
        prefix = f"{self.name}.{key}" if self.name else key
        return [Table(v, self.file, f"{prefix}[{i}]", self.faults) for i, v in enumerate(value)]

    def finish(self) -> None:
        """Refuse every key that no method has asked for."""
        for key in self.content:
            if key not in self._known:
                self.refuse(key, self.content[key], f"unknown key; {nearest(key, self._known)}")
