"""Which ends of a link are present: its liveliness tokens, as zenoh reports them."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from typing import NamedTuple

from magcal_service.links.base import Role
from magcal_service.wire.keys import ROOT

_ROLES = "|".join(role.value for role in Role)
_TOKEN = re.compile(rf"{ROOT}/([A-Za-z0-9_-]{{1,32}})/alive/({_ROLES})-([A-Za-z0-9_-]{{1,32}})")
MAX_PRESENT = 65_536  # bounds the memory that invented tokens can take


class Presence(NamedTuple):
    """One end of a link that is alive: for which craft, in which role, and its name."""

    craft: str
    role: Role
    name: str

    @property
    def key(self) -> str:
        """The token's key."""
        return f"{ROOT}/{self.craft}/alive/{self.role}-{self.name}"


def presence_of(key: str) -> Presence | None:
    """Whose token a key is; None for keys of other forms, which are not ours."""
    match = _TOKEN.fullmatch(key)
    return None if match is None else Presence(match[1], Role(match[2]), match[3])


class PresenceBoard:
    """The ends that are present, kept up to date by ``change`` from any thread.

    ``count`` is called with ``joined`` or ``left`` for each end that appears or disappears.
    """

    def __init__(self, count: Callable[[str], None]) -> None:
        self._count = count
        self._present: set[Presence] = set()
        self._lock = threading.Lock()

    def change(self, key: str, alive: bool) -> Presence | None:
        """Record that a token appeared (``alive``) or disappeared; the end that is newly present, or None.

        Keys of other forms are not ours and are ignored.
        """
        presence = presence_of(key)
        if presence is None:
            return None
        with self._lock:
            known = presence in self._present
            if alive and not known and len(self._present) < MAX_PRESENT:
                self._present.add(presence)
                self._count("joined")
                return presence
            if not alive and known:
                self._present.remove(presence)
                self._count("left")
        return None

    def clear(self) -> None:
        """Count every end as ``left``: the session that showed them is gone."""
        with self._lock:
            gone = len(self._present)
            self._present.clear()
        for _ in range(gone):
            self._count("left")

    def present(self) -> frozenset[Presence]:
        """The ends that are present now."""
        with self._lock:
            return frozenset(self._present)
