"""Where the messages of a view come from: a live link or a recording, each read by a thread of its own."""

from __future__ import annotations

import abc
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from magcal_service.base.errors import MagcalError
from magcal_service.config.settings import CraftConfig
from magcal_service.links.base import Link
from magcal_service.recordings.inspect.inspection import Inspection
from magcal_service.views.result import Replayed
from magcal_service.views.state import Views
from magcal_service.wire.messages import CalibratedVector, Command, MagnetometerSample, Message

COMMANDS: Final = ("freeze", "resume", "reset")
"""Commands that a view may give, where it is allowed to give any."""

_SOURCE: Final = "view"


@dataclass(frozen=True, slots=True)
class Origin:
    """Where messages come from: ``kind`` is ``live`` or ``recording``, ``note`` what there is to say of it now."""

    kind: str
    address: str
    note: str = ""
    has_ended: bool = False


class Source(abc.ABC):
    """Messages taken into ``views`` by a thread; ``views`` is read and written with ``lock`` held."""

    def __init__(self, views: Views) -> None:
        self.views, self.lock = views, threading.Lock()
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="magcal-view", daemon=True)

    @property
    @abc.abstractmethod
    def origin(self) -> Origin:
        """Where the messages come from, and how that is."""

    def give(self, craft: str, name: str) -> bool:
        """Give a command; False where nobody is there to carry it out."""
        return False

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def stop(self) -> None:
        """Read no more; a recording that is replayed as fast as it goes is left to the end of the process."""
        self._stopped.set()
        if self._thread.is_alive():
            self._thread.join(1.0)

    def take(self, message: Message) -> None:
        """Take one message into the views."""
        with self.lock:
            self.views.take(message, time.monotonic())

    @abc.abstractmethod
    def _run(self) -> None:
        """Read until ``stop``, in the thread."""


class LiveSource(Source):
    """A link as a viewer has it; the link reconnects by itself."""

    def __init__(self, link: Link) -> None:
        super().__init__(Views())
        self._link = link
        self._commands: queue.Queue[tuple[str, str]] = queue.Queue(maxsize=16)

    @property
    def origin(self) -> Origin:
        """The link's address and state, and why nobody answers where the link knows."""
        state = self._link.state
        note = self._link.alone if state == "open" else f"the link is {state}"
        return Origin("live", self._link.address, note)

    def give(self, craft: str, name: str) -> bool:
        """Queue a command for the link; its answer is one of the craft's events."""
        try:
            self._commands.put_nowait((craft, name))
        except queue.Full:
            return False
        return True

    def _run(self) -> None:
        number = 0
        while not self._stopped.is_set():
            for message in self._link.receive(0.2):
                self.take(message)
            while not self._commands.empty():
                craft, name = self._commands.get_nowait()
                now_ns = time.time_ns()
                self._link.send(Command(craft=craft, source=_SOURCE, sequence=number, time_ns=now_ns, name=name))
                number = (number + 1) % (1 << 32)


@dataclass(frozen=True, slots=True)
class Flight:
    """One craft of a recording: what was found on it, and the configuration it is replayed under."""

    inspection: Inspection
    craft: CraftConfig


class ReplaySource(Source):
    """A recording, replayed through the daemon's own path.

    Parameters
    ----------
    path: of the recording, as it was given.
    flights: its craft, of different names; they are replayed side by side.
    speed: times real time; 0 as fast as it goes.
    """

    def __init__(self, path: str, flights: Sequence[Flight], speed: float) -> None:
        defects = {one.craft.name: tuple(found.says for found in one.inspection.open) for one in flights}
        super().__init__(Views({name: Replayed(path, found) for name, found in defects.items()}))
        self._path, self._flights, self._speed = path, tuple(flights), speed
        self._notes: list[str] = []
        self._has_ended = False

    @property
    def origin(self) -> Origin:
        """The recording, and whether its end has come."""
        return Origin("recording", self._path, "; ".join(self._notes), self._has_ended)

    def _run(self) -> None:
        replays = [threading.Thread(target=self._replay, args=(one,), daemon=True) for one in self._flights]
        for one in replays:
            one.start()
        for one in replays:
            one.join()
        self._has_ended = True

    def _replay(self, flight: Flight) -> None:
        from magcal_service.offline.replay import as_played, replay
        from magcal_service.recordings.messages import messages

        inspection, craft = flight.inspection, flight.craft
        heard = heard_until(messages(as_played(inspection, craft), craft.name, telemetry=False), self.take)

        def sink(message: Message) -> None:
            if isinstance(message, CalibratedVector):
                heard(message)
            self.take(message)

        try:
            done = replay(inspection.recording, craft, self._speed, sink=sink, as_recorded=True, inspection=inspection)
        except MagcalError as error:
            self._notes.append(f"the replay of {craft.name} ended early: {error}")
            return
        self._notes += filter(None, [done.remark])
        self.take(done.pipeline.status(0.0, Counter()))  # those of the daemon come by the wall's clock


def heard_until(inputs: Iterator[Message], take: Callable[[Message], None]) -> Callable[[CalibratedVector], None]:
    """What gives ``take`` the inputs up to the sample that a calibrated vector answers, of which each comes once."""
    given = set[tuple[str, int]]()

    def until(vector: CalibratedVector) -> None:
        wanted = vector.source, vector.sequence
        while wanted not in given:
            message = next(inputs, None)
            if message is None:
                return
            if isinstance(message, MagnetometerSample):
                given.add((message.source, message.sequence))
            take(message)
        given.discard(wanted)

    return until
