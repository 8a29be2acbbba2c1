"""A daemon's service in this process, driven over a link, and the promises that it has to keep.

``World`` holds both ends.  After each step it takes what has come out and asserts: nothing was raised; what was sent
has arrived; all that came out is a message; each accepted sample was answered once; the calm craft publishes what it
would alone, bit for bit.
"""

from __future__ import annotations

import itertools
import math
import shutil
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from magcal_service.config.daemon_settings import OutputConfig, RecordConfig, StateConfig
from magcal_service.config.settings import Config, CraftConfig
from magcal_service.daemon.checkpoints.store import Checkpoints
from magcal_service.daemon.estimate_csv import EstimateCsv
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.daemon.service import Service
from magcal_service.recordings.recorder import Recorder
from magcal_service.wire.kinds import FIRST_RESULT, kind_of
from magcal_service.wire.messages import CalibratedVector, Command, CommandReply, Estimate, Message
from tests.fuzz.inputs import folder
from tests.fuzz.rules.crafts import CALM, OTHER, WILD, calm, crafts, flown
from tests.fuzz.rules.lines import LINES, await_that

_CRAFTS: Final = (WILD, OTHER, CALM)
_MARK: Final = "world"
"""Source of the messages that say that all before them has come through."""

_AGAIN_S: Final = 1.0
"""After which such a message is sent again [s]: zenoh drops what is put before it knows of an end that is back."""


class PlantedError(Exception):
    """A defect that a rule has planted: nothing in the daemon knows it."""


class World:
    """A service with three craft, its checkpoints, and a node.

    Parameters
    ----------
    craft: configuration of the craft that is driven.
    flown_s: how long it has flown when the world begins [s].
    writes: whether rows and a recording are written too.
    line: over which link.
    """

    def __init__(self, craft: CraftConfig, *, flown_s: int, writes: bool, line: str = "loop") -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="world-", dir=folder()))
        self.line = LINES[line](_CRAFTS)
        other = replace(crafts("ukf")[2], name=OTHER)
        state = StateConfig(self.folder / "state")
        record = RecordConfig(self.folder / "record", flush_s=0.1, min_free_mb=0.0) if writes else None
        output = OutputConfig(csv=self.folder / "rows.csv" if writes else None)
        self.config = Config(self.line.address(), (craft, other, calm()), output, record, state)
        self.done: Counter[str] = Counter({"worlds": 1})
        self._shadow = Pipeline(calm())
        self._saved: dict[str, Any] | None = None
        self._saved_accepted = -1
        self._expected: list[Message] = []
        self._sent: Counter[tuple[object, ...]] = Counter()  # what the daemon has not received yet
        self._marks = itertools.count()
        self.node = self.line.node
        self.begin()
        if flown_s:
            self.service.pipelines[WILD].restore_state(flown(craft, flown_s))
            self._answered = self._accepted()

    def begin(self) -> None:
        """Start a daemon: it takes up what the checkpoints hold."""
        self.link = self.line.open()
        config = self.config
        self._csv = None if config.output.csv is None else EstimateCsv(config.output.csv, append=True)
        self._recorder = None if config.record is None else Recorder(config.record, config.crafts)
        assert config.state is not None
        self.checkpoints = Checkpoints(config.state, config.crafts)
        self.service = Service(config, self.link, self._csv, self._recorder, self.checkpoints)
        self.service.restore()
        self._causes: list[str] = []
        for pipeline in self.service.pipelines.values():
            self._overhear(pipeline)
        self._failed_now, self._answered = False, self._accepted()
        self._shadow = Pipeline(calm())
        if self._saved is not None:
            self._shadow.restore_state(self._saved)
        self._saved_accepted = -1
        self.done["starts"] += 1

    def _accepted(self) -> int:
        return sum(one.ticks.counters["accepted"] for one in self.service.pipelines.values())

    def send(self, messages: Iterable[Message]) -> None:
        """Let the node send, and the daemon work it off."""
        for message in messages:
            to_service = kind_of(message).code < FIRST_RESULT or isinstance(message, Command)
            if not (to_service or self.line.takes_results):
                continue
            self.done["messages"] += 1
            self.node.send(message)
            if message.craft in _CRAFTS and to_service:
                self._sent[_mark_of(message)] += 1
        self.settle()

    def inject(self, data: bytes) -> None:
        """Let bytes arrive that are no message, or one."""
        self.done["messages"] += 1
        self.line.inject(data)
        self.settle()

    def settle(self) -> None:
        """Work off what was sent, and hold what goes out against the promises."""
        published: list[Message] = []

        def worked_off() -> bool:
            for message in self.link.receive(0.0):
                self._arrived(_mark_of(message))
                self.service.handle(message)
                self._count_failures()
                if message.craft == CALM:
                    self._expected += self._shadow.handle(message)
            published.extend(self.node.receive(0.0))
            return not self._sent

        await_that(worked_off, "what was sent has not arrived")
        self.check(published)

    def _arrived(self, mark: tuple[object, ...]) -> None:
        """What a node's history brings again after a restart has arrived before."""
        if self._sent[mark] > 1:
            self._sent[mark] -= 1
        else:
            del self._sent[mark]

    def _come_out(self, published: list[Message]) -> list[Message]:
        """All that the daemon has published since the last step: what has come, and what is on its way."""
        mark = CommandReply(
            craft=CALM,
            source=_MARK,
            sequence=next(self._marks),
            time_ns=0,
            name="mark",
            command_source=_MARK,
            command_sequence=0,
            accepted=True,
        )
        sent_s = -math.inf

        def come() -> bool:
            nonlocal sent_s
            if time.monotonic() - sent_s > _AGAIN_S:
                sent_s = time.monotonic()
                self.link.send(mark)
            published.extend(self.node.receive(0.0))
            return mark in published and len(self._of_calm(published)) >= len(self._expected)

        await_that(come, "what was published has not come out")
        return [one for one in published if one.source != _MARK]

    def check(self, published: list[Message] | None = None) -> None:
        """Assert what has to hold after each step."""
        published = self._come_out([] if published is None else published)
        for counters, what in ((self.link.counters, "unsendable"), (self.node.counters, "refused")):
            assert not [name for name, count in counters.items() if count and name.startswith(what)], counters
        self._count_failures()
        vectors, accepted = sum(isinstance(one, CalibratedVector) for one in published), self._accepted()
        if not self._failed_now:
            assert vectors == accepted - self._answered
        self._answered, self._failed_now = accepted, False
        self._check_calm(published)

    def _count_failures(self) -> None:
        """Each craft that has begun anew has done so for a defect that was planted in it."""
        for cause in self._causes:
            assert cause.startswith("PlantedError"), f"a craft failed by itself: {cause}"
        self._failed_now |= bool(self._causes)
        self.done["contained"] += len(self._causes)
        self._causes.clear()

    def _overhear(self, pipeline: Pipeline) -> None:
        """Note each cause for which a craft begins anew."""
        begin_anew = pipeline.begin_anew

        def noted(cause: str, message: Message | None = None) -> None:
            self._causes.append(cause)
            begin_anew(cause, message)

        vars(pipeline)["begin_anew"] = noted

    def _check_calm(self, published: list[Message]) -> None:
        found = self._of_calm(published)
        assert [_unnumbered(one) for one in found] == [_unnumbered(one) for one in self._expected]
        self._expected = []

    @staticmethod
    def _of_calm(published: list[Message]) -> list[Message]:
        return [one for one in published if one.craft == CALM and isinstance(one, CalibratedVector | Estimate)]

    def save(self) -> None:
        """Write the checkpoints that are due."""
        self.service.save()
        self._note_saved()
        self.check()

    def _note_saved(self) -> None:
        accepted = self._shadow.ticks.counters["accepted"]
        if accepted != self._saved_accepted:
            self._saved, self._saved_accepted = self._shadow.export_state(), accepted
        self.done["checkpoints"] += 1

    def status(self) -> None:
        """Everything that is said of the daemon's health."""
        self.service.publish_status()
        self.service.feed_watchdog()
        crafts = list(self.service.pipelines.values())
        self.service.health.summary(crafts)
        self.service.health.metrics(crafts, Counter())
        self.check()

    def kill(self) -> None:
        """End the daemon where it stands and start another."""
        self._close()
        self.begin()
        self.check()

    def stop(self) -> None:
        """End the daemon as a signal does, and start another."""
        stop = threading.Event()
        stop.set()
        self.service.run(stop)
        self._note_saved()
        self._expected += self._shadow.flush()
        self.check()
        self.kill()

    def plant(self, craft: str, place: Callable[[Pipeline], tuple[object, str]]) -> None:
        """Let a method of a craft's part raise once."""
        part, name = place(self.service.pipelines[craft])

        def fail(*_: object, **__: object) -> None:
            vars(part).pop(name, None)
            raise PlantedError(f"planted in {name}")

        setattr(part, name, fail)

    def spoil_newest(self, craft: str, change: Callable[[bytes], bytes]) -> None:
        """Change the newest checkpoint of a craft on disk."""
        newest = max((self.folder / "state" / craft).glob("*.state"), default=None)
        if newest is not None:
            newest.write_bytes(change(newest.read_bytes()))

    def _close(self) -> None:
        self.link.close()
        for part in (self._recorder, self._csv):
            if part is not None:
                part.close()

    def close(self) -> None:
        """End it all."""
        self._close()
        self.line.close()
        shutil.rmtree(self.folder, ignore_errors=True)


def _mark_of(message: Message) -> tuple[object, ...]:
    return type(message), message.craft, message.source, message.sequence, message.time_ns


def _unnumbered(message: Message) -> Message:
    """Estimates are numbered with replies and status, which the shadow does not send."""
    return replace(message, sequence=0) if isinstance(message, Estimate) else message
