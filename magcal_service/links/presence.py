"""Who is there: the liveliness tokens of one link, as zenoh tells them."""

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


class PresenceBoard:
    """The set of those who are alive, kept up by ``change`` from any thread.

    ``count`` is told ``joined`` and ``left`` for each that comes and goes.
    """

    def __init__(self, count: Callable[[str], None]) -> None:
        self._count = count
        self._present: set[Presence] = set()
        self._lock = threading.Lock()

    def change(self, key: str, alive: bool) -> Presence | None:
        """Take one token's coming or going in; who has come with it, if anybody.

        Keys of other forms are not ours and are passed over.
        """
        match = _TOKEN.fullmatch(key)
        if match is None:
            return None
        presence = Presence(match[1], Role(match[2]), match[3])
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
        """Nobody can be seen any more: the session is gone."""
        with self._lock:
            gone = len(self._present)
            self._present.clear()
        for _ in range(gone):
            self._count("left")

    def present(self) -> frozenset[Presence]:
        """All that are alive now."""
        with self._lock:
            return frozenset(self._present)
