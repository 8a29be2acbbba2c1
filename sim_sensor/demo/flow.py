"""Flow control for a sensor node that runs faster than real time: no more samples on the way than can be kept."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import takewhile

from magcal_service.links.base import Link
from magcal_service.links.states import LinkState
from magcal_service.wire.messages import CalibratedVector, MagnetometerSample, Message

__all__ = ["WindowedLink"]

_POLL_S = 0.05  # one wait for an answer; so long a dead daemon goes unnoticed


class WindowedLink(Link):
    """A link that lets at most ``window`` magnetometer samples be on the way without an answer.

    A real magnetometer sends one sample a second and cannot be asked to wait.  A simulated one that sends hundreds
    can, and does: the daemon answers every accepted sample with its calibrated vector, so the samples on the way are
    those sent after the newest one answered.  A sample overtaken by the answer to a later one of its source was
    refused or lost; it counts as ``unanswered``, and so does everything on the way when no answer came for
    ``patience_s``.

    Parameters
    ----------
    link: where everything goes; closed by its owner, not here.
    window: samples that may be on the way.
    patience_s: wall time without any answer after which the samples on the way are given up [s].
    on_message: called for everything that arrives, at once, also while ``send`` waits.
    check: called while waiting; raises where waiting has become pointless.
    on_send: called for everything that is sent, before it is.

    ``counters`` adds to those of every link: ``samples`` (sent), ``answered``, ``unanswered``, ``waits``.
    """

    def __init__(
        self,
        link: Link,
        window: int,
        on_message: Callable[[Message], None],
        patience_s: float = 5.0,
        check: Callable[[], None] = lambda: None,
        on_send: Callable[[Message], None] = lambda _: None,
    ) -> None:
        if window < 1:
            raise ValueError(f"window is {window}; at least 1 sample has to be on the way")
        super().__init__(link.address)
        self.link = link
        self.window = window
        self.patience_s = patience_s
        self._on_message, self._check, self._on_send = on_message, check, on_send
        self._on_the_way: dict[tuple[str, str, int], None] = {}

    @property
    def state(self) -> LinkState:
        """Where the link stands that everything goes to."""
        return self.link.state

    @property
    def exhausted(self) -> bool:
        """Whether nothing more can arrive."""
        return self.link.exhausted

    def send(self, message: Message) -> None:
        """Send; a magnetometer sample waits for room in the window first."""
        if isinstance(message, MagnetometerSample):
            self.wait_for_room(self.window - 1)
            self._on_the_way[(message.craft, message.source, message.sequence)] = None
            self.counters["samples"] += 1
        self._on_send(message)
        self.link.send(message)
        self.counters["sent"] += 1

    def wait_for_room(self, remaining: int = 0) -> None:
        """Return once at most ``remaining`` samples are on the way, or when ``patience_s`` passed without an answer."""
        if len(self._on_the_way) <= remaining:
            return
        self.counters["waits"] += 1
        deadline_s = time.monotonic() + self.patience_s
        while len(self._on_the_way) > remaining:
            before = len(self._on_the_way)
            self._settle(self.link.receive(_POLL_S))
            self._check()
            if len(self._on_the_way) < before:
                deadline_s = time.monotonic() + self.patience_s
            elif time.monotonic() >= deadline_s:
                self.counters["unanswered"] += len(self._on_the_way)
                self._on_the_way.clear()

    def close(self) -> None:
        """Nothing: the wrapped link belongs to whoever opened it."""

    def _poll(self, wait_s: float) -> list[Message]:
        return self._settle(self.link.receive(wait_s))

    def _settle(self, messages: list[Message]) -> list[Message]:
        for message in messages:
            if isinstance(message, CalibratedVector):
                self._settle_one(message)
            self._on_message(message)
        return messages

    def _settle_one(self, answer: CalibratedVector) -> None:
        answered = (answer.craft, answer.source, answer.sequence)
        if answered not in self._on_the_way:
            return
        for before in list(takewhile(lambda one: one != answered, self._on_the_way)):
            if before[:2] == answered[:2]:  # those of other sources have an order of their own
                del self._on_the_way[before]
                self.counters["unanswered"] += 1
        del self._on_the_way[answered]
        self.counters["answered"] += 1
