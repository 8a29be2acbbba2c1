"""``recording:FILE.toml`` or ``recording:FILE.mcap``: a recorded log arrives as if its craft were on the line.

Options: ``speed`` (times real time; 0, the default, is as fast as it goes), ``craft`` (the name its messages carry; of
several craft in a session the one of that name is played),
``telemetry`` (``no`` leaves the channels out).  Needs numpy, and the extra ``sim`` where the reference is a model.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from urllib.parse import unquote

from magcal_service.config.address import LinkAddress, parse_address
from magcal_service.links.base import Link
from magcal_service.links.states import LinkEvent
from magcal_service.recordings.messages import messages
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from magcal_service.wire.fields import NAME
from magcal_service.wire.messages import Message

_BATCH = 256  # messages per poll: small against memory, large against the cost of a call


class RecordingLink(Link):
    """Plays a recording once, in file order, and is then exhausted.

    Parameters
    ----------
    address: ``recording:FILE.toml?speed=0&craft=craft&telemetry=yes``, or its parsed form.
    crafts: as for every link; where it names just one, that is the default of ``craft``.
    recording: the recording itself where it has been read already; the address' file is not opened then.
    sink: is called with every message sent; without one, messages sent are only counted.

    Attributes
    ----------
    driving: the channels that it plays by name, each with whether it has a value.

    Raises ``LinkAddressError`` for the address, ``RecordingError`` for the recording.
    """

    live = False

    def __init__(
        self,
        address: LinkAddress | str,
        crafts: Sequence[str] = (),
        *,
        recording: Recording | None = None,
        sink: Callable[[Message], None] | None = None,
    ) -> None:
        parsed = parse_address(address) if isinstance(address, str) else address
        super().__init__(parsed.text, crafts)
        self._speed = parsed.real("speed", 0.0, 0.0, 1e6)
        default = crafts[0] if len(crafts) == 1 else "craft"
        craft = parsed.text_of("craft", default, NAME.pattern, "1 to 32 characters of A-Z a-z 0-9 _ -")
        telemetry = parsed.flag("telemetry", True)
        parsed.finish()
        if not parsed.rest:
            parsed.refuse("file", parsed.rest, "recording:FILE.toml or recording:FILE.mcap is accepted")
        if recording is None:
            recording = read_recording(Path(unquote(parsed.rest)), prefer=craft)
        self.recording = recording
        self._sink = sink
        self.driving = recording.driving if telemetry else {}
        self._stream = messages(self.recording, craft, telemetry=telemetry)
        self._life.happens(LinkEvent.OPENED)
        self._next = self._following()
        self._first_ns = self._next.time_ns if self._next is not None else 0
        self._started_s: float | None = None

    @property
    def exhausted(self) -> bool:
        """True after the last message, and after ``close``."""
        return not self._life.is_open

    def _following(self) -> Message | None:
        """The next message of the recording; None at its end, which is noted."""
        message = next(self._stream, None)
        if message is None:
            self._life.happens(LinkEvent.ENDED)
        return message

    def _poll(self, wait_s: float) -> list[Message]:
        if self._speed == 0.0:
            return self._take_next()
        now_s = time.monotonic()
        if self._started_s is None:
            self._started_s = now_s
        batch = self._take_due(now_s)
        if not batch and self._next is not None and wait_s > 0.0:
            time.sleep(min(wait_s, self._due_s(self._next) - now_s))
            batch = self._take_due(time.monotonic())
        return batch

    def _due_s(self, message: Message) -> float:
        """When a message is to arrive, on the monotonic clock [s]; one that lies in the past arrives at once."""
        return (self._started_s or 0.0) + (message.time_ns - self._first_ns) / 1e9 / self._speed

    def _take_due(self, now_s: float) -> list[Message]:
        return self._take(lambda message: self._due_s(message) <= now_s)

    def _take_next(self) -> list[Message]:
        if self._next is None:
            return []
        batch = [self._next, *itertools.islice(self._stream, _BATCH - 1)]
        self._next = self._following()
        return batch

    def _take(self, wanted: Callable[[Message], bool]) -> list[Message]:
        batch: list[Message] = []
        while self._next is not None and len(batch) < _BATCH and wanted(self._next):
            batch.append(self._next)
            self._next = self._following()
        return batch

    def send(self, message: Message) -> None:
        """Count one message, and hand it to the sink where there is one; a recording cannot answer."""
        if self._life.is_closed:
            self._count("dropped")
            return
        if self._sink is not None:
            self._sink(message)
        self.counters["sent"] += 1  # by one thread alone: a recording has none of its own

    def close(self) -> None:
        """Play no more; what is sent afterwards is dropped."""
        self._life.happens(LinkEvent.CLOSE)
        self._next = None
