"""The one interface of all links."""

from __future__ import annotations

import abc
import logging
import threading
import time
from collections import Counter
from collections.abc import Sequence
from enum import StrEnum
from types import TracebackType
from typing import Self

from magcal_service.base.errors import DecodeError
from magcal_service.links.sequence import SequenceTracker, SourceRecord
from magcal_service.links.states import LinkLife, LinkState
from magcal_service.wire.codec import decode, encode
from magcal_service.wire.messages import Command, Message

_log = logging.getLogger("magcal.links")

_MOST_STRANGERS = 4  # reported by name: enough for a mistyped one, and no list that a peer could fill

_STRANGER_S = 60.0
"""How long after its last message a craft that is not served is reported in statuses [s]; its counter stays."""


class Role(StrEnum):
    """Which end of a link this is: it decides what is received and what is sent.

    ``service`` receives samples and commands and sends results; ``node`` sends samples and receives results;
    ``viewer`` sends commands only and receives results, and samples where the link shares them.
    """

    SERVICE = "service"
    NODE = "node"
    VIEWER = "viewer"


class Link(abc.ABC):
    """A two-way stream of messages that never raises for what arrives on it.

    ``counters`` counts by kind: ``received``, ``sent``, ``dropped``, ``overflow``, ``up``, ``down``,
    ``refused.<reason>`` (the reasons of ``wire.messages.REFUSALS`` and ``wire.framing``, and ``unknown_craft``),
    ``unsendable.<reason>``, and the sums of ``sources()``: ``lost``, ``doubled``, ``late``, ``restarted``.  A link
    that dies reconnects by itself with back-off; what is sent meanwhile is counted as ``dropped``.  ``overflows`` has
    ``overflow`` by craft, of those that are served, where the link shares its queue among them.

    Parameters
    ----------
    address: the address as the user wrote it.
    crafts: names of the craft whose messages are received; of all craft where empty.

    ``warnings`` says what this link leaves open to other machines, a line each; ``history`` is how many samples of each
    kind and source a node may send again; ``live`` is False where what arrives was recorded.
    """

    warnings: tuple[str, ...] = ()
    history: int = 0
    live: bool = True

    def __init__(self, address: str, crafts: Sequence[str] = ()) -> None:
        self.address = address
        self.crafts = frozenset(crafts)
        # Names that a link's own thread counts exist from the start, so that reading never meets a changing size.
        self.counters: Counter[str] = Counter(
            dict.fromkeys(("received", "sent", "dropped", "overflow", "up", "down"), 0)
        )
        self.overflows: Counter[str] = Counter(dict.fromkeys(sorted(self.crafts), 0))
        # What a peer can make this end remember: beyond it, invented names are served but not remembered.
        self.most_sources = 1024 + 32 * len(self.crafts)
        self._strangers: dict[str, float] = {}  # when a message of each came last, by the monotonic clock [s]
        self._counting = threading.Lock()
        self._sequences = SequenceTracker(self.counters, self.most_sources)
        self._life = LinkLife(self._count)

    def receive(self, timeout_s: float) -> list[Message]:
        """The messages at hand, in order of arrival; waits at most ``timeout_s`` [s] for the first one.

        A link may give a craft that floods its turns only; what is left comes with the next call.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            polled = self._poll(max(0.0, deadline - time.monotonic()))
            messages = [message for message in polled if self._accepted(message)]
            if messages or self.exhausted or time.monotonic() >= deadline:
                self.counters["received"] += len(messages)
                return messages

    def sources(self) -> tuple[SourceRecord, ...]:
        """What was received, lost, doubled, late and restarted, for each craft, source and kind of message."""
        return self._sequences.records()

    @property
    def state(self) -> LinkState:
        """Where the link itself stands now, whoever is at its other end; ``links.states`` has the table."""
        return self._life.state

    @property
    def alone(self) -> str:
        """Why nobody can be at the other end now; empty where somebody is, or may come by himself."""
        return ""

    @property
    def strangers(self) -> tuple[str, ...]:
        """Craft whose samples came within the last minute and are not served, the first of them."""
        since = time.monotonic() - _STRANGER_S
        return tuple(name for name, last_s in self._strangers.items() if last_s > since)

    def served(self) -> frozenset[str] | None:
        """Craft that daemons at the other ends serve now; None where the link cannot know.  May take a second."""
        return None

    @property
    def exhausted(self) -> bool:
        """True when nothing more can ever arrive (a recording at its end)."""
        return False

    @abc.abstractmethod
    def _poll(self, wait_s: float) -> list[Message]:
        """Messages at hand; may wait up to ``wait_s`` [s] for the first."""

    @abc.abstractmethod
    def send(self, message: Message) -> None:
        """Send one message without blocking on a dead or slow peer (dropped messages are counted)."""

    @abc.abstractmethod
    def close(self) -> None:
        """Release everything; may be called twice."""

    def _count(self, name: str, amount: int = 1) -> None:
        """Count from any thread."""
        with self._counting:
            self.counters[name] += amount

    def _accepted(self, message: Message) -> bool:
        if self.crafts and message.craft not in self.crafts:
            self.counters["refused.unknown_craft"] += 1
            if not isinstance(message, Command):  # who mistypes a command's craft is told so at his own end
                self._note_stranger(message.craft)
            return False
        self._sequences.note(message)
        return True

    def _note_stranger(self, craft: str) -> None:
        """Log the first such craft that is not served, and count its messages by name."""
        if craft not in self._strangers and len(self._strangers) < _MOST_STRANGERS:
            served = ", ".join(sorted(self.crafts))
            _log.warning("%s: messages of craft %r are refused; served: %s", self.address, craft, served)
            self._strangers[craft] = 0.0
        if craft in self._strangers:
            self._strangers[craft] = time.monotonic()
            self.counters[f"refused.unknown_craft.{craft}"] += 1

    def _decoded(self, payload: bytes) -> Message | None:
        """The message of a payload, or None where it is refused (and counted)."""
        try:
            return decode(payload)
        except DecodeError as error:
            self._count(f"refused.{error.reason}")
            return None

    def _encoded(self, message: Message) -> bytes | None:
        """The payload of a message, or None where no receiver would accept it (counted and logged)."""
        try:
            return encode(message)
        except DecodeError as error:
            self._unsendable(message, error)
            return None

    def _unsendable(self, message: Message, error: DecodeError) -> None:
        self._count(f"unsendable.{error.reason}")
        _log.warning("a %s was not sent: %s", type(message).__name__, error)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()
