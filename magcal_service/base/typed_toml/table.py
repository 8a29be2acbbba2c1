"""One TOML table being read key by key; every fault is added to a list that the whole file shares."""

from __future__ import annotations

import difflib
import math
import sys
from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Any, Final, TypeVar

from magcal_service.base.errors import MISSING, Fault, Lacking

E = TypeVar("E", bound=StrEnum)


_MOST_NAMES: Final = 60
"""Known names listed in a fault; choice: some lines of a terminal."""

_LONGEST_NAME: Final = 60
"""Characters of a name that are shown; choice: half a line."""


_MICRO: Final = str.maketrans("\u00b5\u03bc", "uu")
"""The sign for micro and the Greek letter, as units here have it: ``uT``."""


def nearest(value: str, known: Iterable[str]) -> str:
    """Name the known name that is probably meant: ``"did you mean 'unit'? known: ..."``."""
    names = sorted(map(str, filter(None, known)))
    by_lower = {name.lower(): name for name in names}
    plain = value.translate(_MICRO).lower()
    close = [plain] if plain in by_lower else difflib.get_close_matches(plain, by_lower, n=1)
    listing = _listed(names)
    return f"did you mean {by_lower[close[0]]!r}? known: {listing}" if close else f"known: {listing}"


def _listed(names: list[str]) -> str:
    """The first of them, however many and however long they are: some lines on a terminal; quoted where a name has
    what stands between them."""
    shown = [name if len(name) <= _LONGEST_NAME else f"{name[:_LONGEST_NAME]}..." for name in names[:_MOST_NAMES]]
    shown = [repr(name) for name in shown] if any(", " in name for name in shown) else shown
    more = [f"and {len(names) - _MOST_NAMES} more"] if len(names) > _MOST_NAMES else []
    return ", ".join(shown + more) or "none"


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

    def refuse_or_lack(self, key: str, accepted: str) -> None:
        """Add a fault about the value of ``key``, or about its absence."""
        if key in self.content:
            self.refuse(key, self.content[key], accepted)
        else:
            self.lack(key, accepted)

    def lack(self, key: str, accepted: str) -> None:
        """Add a fault about a ``key`` that is not there."""
        self.faults.append(Lacking(self.where(key), MISSING, accepted))

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
                self.lack(key, f"required: {accepted}")
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
