"""``loop:NAME``: both ends in one process, over the same bytes as a real link.

Ends of one name meet in a hub: what the service sends reaches every other end, what the others send reaches the
service, and samples reach viewers too.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence

from magcal_service.base.errors import LinkError
from magcal_service.config.address import LinkAddress
from magcal_service.links.base import Link, Role
from magcal_service.links.inbox import Inbox
from magcal_service.links.states import LinkEvent, LinkLife
from magcal_service.wire.kinds import FIRST_RESULT, kind_of
from magcal_service.wire.messages import Message


class LoopLink(Link):
    """One end of an in-memory link; options: ``queue`` (messages held at most, default 4096)."""

    def __init__(self, address: LinkAddress, role: Role, crafts: Sequence[str] = ()) -> None:
        super().__init__(address.text, crafts)
        limit = address.integer("queue", 4096, 1, 1_000_000)
        address.finish()
        self.role = role
        self.inbox: Inbox[bytes] = Inbox(limit, lambda: self._count("overflow"))
        self._name = address.rest
        self._life = LinkLife()  # ``up`` and ``down`` count the other ends, see the hub
        _join(self._name, self)
        self._life.happens(LinkEvent.OPENED)

    def _poll(self, wait_s: float) -> list[Message]:
        decoded = (self._decoded(payload) for payload in self.inbox.drain(wait_s))
        return [message for message in decoded if message is not None]

    def send(self, message: Message) -> None:
        """Hand one message to every end that listens to it; dropped where there is none."""
        payload = self._encoded(message)
        listeners = [] if payload is None else self._listeners(message)
        for end in listeners:
            end.inbox.put(payload or b"")
        self._count("sent" if listeners else "dropped")

    def close(self) -> None:
        """Leave the hub; the other ends count ``down`` where nobody is left for them."""
        self._life.happens(LinkEvent.CLOSE)
        _leave(self._name, self)

    def inject(self, raw: bytes) -> None:
        """Let arbitrary bytes arrive at the far ends, as a faulty peer would send them."""
        for end in _others(self._name, self):
            end.inbox.put(raw)

    def _listeners(self, message: Message) -> list[LoopLink]:
        sample = kind_of(message).code < FIRST_RESULT
        return [
            end
            for end in _others(self._name, self)
            if Role.SERVICE in (self.role, end.role) or (sample and end.role is Role.VIEWER)
        ]


_hubs: dict[str, list[LoopLink]] = {}
_hubs_lock = threading.Lock()


def _others(name: str, end: LoopLink) -> list[LoopLink]:
    with _hubs_lock:
        ends = _hubs.get(name, [])
        return [other for other in ends if other is not end] if end in ends else []


def _join(name: str, end: LoopLink) -> None:
    with _hubs_lock:
        ends = _hubs.setdefault(name, [])
        if end.role is Role.SERVICE and any(other.role is Role.SERVICE for other in ends):
            raise LinkError(f"link address {end.address!r}: a service already stands at this name; choose another name")
        ends.append(end)
        for other in ends if len(ends) == 2 else ends[-1:] if len(ends) > 2 else ():
            other._count("up")


def _leave(name: str, end: LoopLink) -> None:
    with _hubs_lock:
        ends = _hubs.get(name, [])
        if end not in ends:
            return
        ends.remove(end)
        if len(ends) == 1:
            ends[0]._count("down")
        if not ends:
            del _hubs[name]
