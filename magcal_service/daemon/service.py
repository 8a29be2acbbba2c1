"""The daemon: loop and publish.  All estimation is in ``pipeline``."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Final

from magcal_service.config.magnetometers import label, label_of
from magcal_service.config.settings import Config
from magcal_service.daemon import notify
from magcal_service.daemon.checkpoints.schedule import Schedule
from magcal_service.daemon.checkpoints.store import Checkpoints
from magcal_service.daemon.command_limit import CommandLimit
from magcal_service.daemon.commands import Commander
from magcal_service.daemon.containment import contained
from magcal_service.daemon.estimate_csv import EstimateCsv
from magcal_service.daemon.events import Event
from magcal_service.daemon.health.metrics_server import MetricsServer
from magcal_service.daemon.health.report import Health, in_words
from magcal_service.daemon.magnetometers import Build, Magnetometers
from magcal_service.daemon.outputs import Outputs
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.daemon.rows import Rows
from magcal_service.daemon.statuses import Statuses
from magcal_service.daemon.timer import Timer
from magcal_service.daemon.turns import Turns
from magcal_service.links import Link
from magcal_service.wire.kinds import KINDS, kind_of
from magcal_service.wire.messages import Command, CommandReply, Estimate, Message, Verdict

if TYPE_CHECKING:
    from magcal_service.recordings.recorder import Recorder

log = logging.getLogger("magcal")
log.addHandler(logging.NullHandler())  # without a handler for logs, the command line prints the error itself

WAIT_S: Final = 0.5
"""Longest wait for a message: how late a status, the watchdog and a request to stop may be."""


_TAKING: Final = {kind.record: f"taking a {kind.name} message" for kind in KINDS}
"""What a craft does with a message, in words, by the message's class."""

_WORTH_KEEPING: Final = ("restored", "started")
"""Events after which a checkpoint does not wait for its period; so it is where a craft has become trusted."""

_STATUSES: Final = 8
"""Statuses that are sent between two looks for messages: 2 ms of work."""

_CHECKPOINTS: Final = 2
"""Checkpoints that are written between two: 6 to 30 ms, of which a few at once would be a vector's wait."""

WATCHDOG_S: Final = 10.0
"""How often ``systemctl status`` gets a new line where no watchdog requires more."""

OVERLOAD_S: Final = 1.0
"""How often it is looked whether the link's queue has shed messages."""


class Service:
    """One link, any number of crafts.

    Parameters
    ----------
    config: the daemon's configuration.
    link: an open link in the role of the service.
    csv: where estimates are written as well.
    recorder: takes everything that comes in and goes out.
    checkpoints: where the state is kept and, at the start, taken from.
    metrics: serves the figures as Prometheus text.
    build: makes the pipeline of a magnetometer.
    outputs: links that take what is published as well.

    Attributes
    ----------
    limit: of the commands; None, as it is at first, where all are taken.
    rows: what is written of ``csv``, and why that ended early, if it did.
    pipelines: by ``config.magnetometers.label``: the craft's name is that of its own magnetometer.
    """

    def __init__(
        self,
        config: Config,
        link: Link,
        csv: EstimateCsv | None = None,
        recorder: Recorder | None = None,
        checkpoints: Checkpoints | None = None,
        metrics: MetricsServer | None = None,
        build: Build = Pipeline,
        outputs: Outputs | None = None,
    ) -> None:
        self.config = config
        self.link = link
        self.rows = Rows(csv)
        self.recorder = recorder
        self.checkpoints, self.metrics, self.outputs = checkpoints, metrics, outputs
        self.pipelines: dict[str, Pipeline] = {}
        self.magnetometers = {craft.name: Magnetometers(craft, self.pipelines, build) for craft in config.crafts}
        self.counters: Counter[str] = Counter()
        self.limit: CommandLimit | None = None
        self._commander = Commander(checkpoints, self.shut_down)
        self._ending = False
        self._alone = ""  # why nobody is at the other end, as it was logged last
        self._verdicts: dict[str, str] = {}
        self._left_out: set[str] = set()  # craft of which it was reported that messages are left out
        self._fed = (0, 0)  # samples accepted and ticks closed at the last watchdog notification
        self.health = Health(link)
        parts = (recorder, checkpoints, outputs)
        self.statuses = Statuses(link, self.health, self.counters, self.magnetometers, self.rows, *parts)
        self._telling, self._saving = Turns(_STATUSES), Turns(_CHECKPOINTS)
        self._saved = False  # whether a checkpoint was written in this round
        self._schedule = Schedule(math.inf if config.state is None else config.state.period_s)

    def shut_down(self) -> None:
        """End ``run`` before it waits for another message."""
        self._ending = True

    def restore(self) -> None:
        """Restore each craft's newest checkpoint where there is one."""
        if self.checkpoints is None:
            return
        for craft, magnetometers in self.magnetometers.items():
            self._restore(magnetometers.own)
            for source in self.checkpoints.sources(craft):
                if label(craft, source) not in self.pipelines and source != magnetometers.own.heard:
                    magnetometers.appear(source)
            for pipeline in magnetometers.all[1:]:
                self._restore(pipeline)

    def _restore(self, pipeline: Pipeline) -> None:
        assert self.checkpoints is not None
        name = pipeline.label
        self.pipelines[name], events = self.checkpoints.restore(pipeline)
        if self.pipelines[name] is not pipeline and self.recorder is not None:
            self.recorder.begin_with(pipeline.config.name, pipeline.config.source, self.pipelines[name].export_state())
        self._report(events)

    def _received(self) -> list[Message]:
        """The messages received; the waiting time is recorded."""
        began_s = time.monotonic()
        messages = self.link.receive(0.0 if self._telling.pending or self._saving.pending else WAIT_S)
        self.health.lateness.polled(began_s)
        return messages

    def _report(self, events: Iterable[Event]) -> None:
        """Log each event, and send a status at once that names it."""
        for event in events:
            self.counters["events"] += 1
            self.statuses.note(event)
            if event.what in _WORTH_KEEPING:
                self._schedule.ask()
            log.info("%s: %s", event.craft, event, extra={"fields": {"event": asdict(event)}})
            self._publish_status(self.pipelines[event.craft])

    def run(self, stop: threading.Event) -> None:
        """Work until ``stop`` is set, a command ends it or the link is exhausted, then close the open ticks.

        The last checkpoint is written before that: what the open ticks wait for may still come to the next daemon.
        """
        summary = Timer(self.config.health.summary_s)
        status = Timer(self.config.output.status_period_s)
        watchdog = Timer(notify.watchdog_period_s() or WATCHDOG_S)
        overload = Timer(OVERLOAD_S)
        self._publish_metrics()
        while not (stop.is_set() or self._ending):
            messages = self._received()
            for message in messages:
                self.handle(message)
            if self.link.exhausted and not messages:
                break
            if status.due():
                self._publish_daemon()
                self._telling.begin(self.pipelines)
            for name in self._telling.take():
                self._publish_status(self.pipelines[name])
            if overload.due():
                self.report_overload()
            if summary.due():
                self.log_health()
            if watchdog.due():
                self.feed_watchdog()
            self._save_in_turns()
        self.save()
        for pipeline in notify.asking_for_time(self.pipelines.values()):
            with contained(pipeline, "closing its ticks"):
                self._publish(pipeline.flush())
        self.publish_status()

    def log_health(self) -> None:
        """Log how the daemon and each craft are."""
        with self._reporting("health"):
            summary = self.health.summary(self.pipelines.values())
            log.info("health: %s", in_words(summary), extra={"fields": {"health": summary}})

    def report_overload(self) -> None:
        """Report for each craft that the link's queue sheds its messages, and that it has stopped."""
        for craft, begun, cause in self.health.overload.changes():
            own = self.magnetometers[craft].own
            self._report([own.event("overloaded" if begun else "overload_over", cause)])

    @contextmanager
    def _reporting(self, what: str) -> Iterator[None]:
        """Within, an error in what only reports on the craft costs that report: logged, and counted as ``untold``."""
        try:
            yield
        except Exception:
            self.counters["untold"] += 1
            log.exception("%s could not be reported; the calibration goes on", what)

    def _save_in_turns(self) -> None:
        """Begin a round of checkpoints where one is due, and write those of the next few craft."""
        if not self._saving.pending:
            if not self._schedule.due():
                return
            self._schedule.begin()
            self._saving.begin(self.pipelines)
        if self.checkpoints is not None:
            self._saved |= self.checkpoints.save(self.pipelines[name] for name in self._saving.take())
        if not self._saving.pending:
            self._schedule.done(self._saved)
            self._saved = False

    def save(self) -> bool:
        """Write a checkpoint of every craft that has taken samples since its last one; whether any was written."""
        pipelines = notify.asking_for_time(self.pipelines.values())
        return self.checkpoints is not None and self.checkpoints.save(pipelines)

    def handle(self, message: Message) -> None:
        """Pass one message to its craft's magnetometers and publish the outputs."""
        magnetometers = self.magnetometers.get(message.craft)
        if magnetometers is None:
            self.counters["unknown_craft"] += 1
            return
        if isinstance(message, Command) and self._limited(magnetometers, message):
            return
        if self.recorder is not None:
            self.recorder.add(message)
        if isinstance(message, Command):
            self._command(magnetometers, message)
        else:
            for pipeline in self._whose(magnetometers, message):
                self._give(pipeline, message)
        if magnetometers.several:
            self._compare(magnetometers)

    def _limited(self, magnetometers: Magnetometers, command: Command) -> bool:
        """Whether a command is one too many; its answer is sent and not recorded, so a replay does not miss it."""
        refusal = "" if self.limit is None else self.limit.refusal(command)
        if refusal and self.limit is not None and self.limit.answers(command.craft):
            self.link.send(magnetometers.own.turn_away(command, refusal))
        return bool(refusal)

    def _whose(self, magnetometers: Magnetometers, message: Message) -> list[Pipeline]:
        """The pipelines that a message is for."""
        with contained(magnetometers.own, "finding the magnetometer of a message", message):
            return magnetometers.of(message)
        return []

    def _compare(self, magnetometers: Magnetometers) -> None:
        """Let each magnetometer of a craft judge beside the others whether a disturbance is near it alone."""
        for pipeline in magnetometers.all:
            with contained(pipeline, "comparing it with the craft's other magnetometers"):
                pipeline.compare(other for other in magnetometers.all if other is not pipeline)
            self._report(pipeline.take_events())

    def _command(self, magnetometers: Magnetometers, command: Command) -> None:
        """Have a command carried out by the magnetometers that it is for, and answer it once."""
        bare, pipelines = magnetometers.commanded(command)
        if not pipelines:
            refusal = magnetometers.unknown(command)
            self._publish([magnetometers.own.reply(command, refusal)])
            return
        if len(pipelines) == 1:
            self._give(pipelines[0], bare)
            return
        replies: list[CommandReply] = []
        for pipeline in pipelines:
            self._give(pipeline, bare, replies)
        self._publish(magnetometers.one_reply(pipelines, replies))

    def _give(self, pipeline: Pipeline, message: Message, replies: list[CommandReply] | None = None) -> None:
        """Have a pipeline work on a message; the replies to a command are kept in ``replies`` where that is given.

        A command at which the craft fails is answered as well: whoever asks is told why nothing was done.
        """
        told = list[CommandReply]() if replies is None else replies
        before = len(told)
        if pipeline.leaves_out(message):
            self._report_left_out(pipeline, message)
        else:
            with contained(pipeline, _TAKING[type(message)], message):
                self._work_off(pipeline, message, told, kept=replies is not None)
            self._report(pipeline.take_events())
        if isinstance(message, Command) and len(told) == before:
            told.append(pipeline.turn_away(message, f"the craft failed at it: {pipeline.failure}"))
            self._publish(told if replies is None else [])

    def _work_off(self, pipeline: Pipeline, message: Message, told: list[CommandReply], *, kept: bool) -> None:
        for output in pipeline.outputs(message, self._commander.carry_out):
            if isinstance(output, Event):
                self._report([output])
                continue
            if isinstance(output, CommandReply):
                told.append(output)
            if not (kept and isinstance(output, CommandReply)):
                self._publish([output])
        if isinstance(message, Command) and message.name == "status":
            self._publish_status(pipeline)

    def _report_left_out(self, pipeline: Pipeline, message: Message) -> None:
        """Report a craft's first message that is left out."""
        if pipeline.label not in self._left_out:
            self._left_out.add(pipeline.label)
            cause = f"a {kind_of(message).name} message at which it failed before has come again, and is skipped"
            self._report([pipeline.event("left_out", cause)])

    def _publish(self, messages: Iterable[Message]) -> None:
        for message in messages:
            self._send(message)
            if isinstance(message, Estimate):
                self.health.lateness.note()
                self._note(message)

    def _send(self, message: Message) -> None:
        self.link.send(message)
        if self.recorder is not None:
            self.recorder.add(message)
        if self.outputs is not None:
            with self._reporting("a message to a further link"):
                self.outputs.send(message)

    def _note(self, estimate: Estimate) -> None:
        """Write the row and log a changed verdict."""
        if not self.rows.add(estimate):
            self.counters["csv_lost"] += 1
        reasons = f" ({', '.join(estimate.reasons)})" if estimate.reasons else ""
        state = f"verdict {estimate.verdict}{reasons}"
        name = label_of(estimate)
        if self._verdicts.get(name) != state:
            self._verdicts[name] = state
            if estimate.verdict is Verdict.TRUSTED:
                self._schedule.ask()
            log.info("%s: %s at tick %d; to do: %s", name, state, estimate.tick, estimate.remedy or "nothing")

    def publish_status(self) -> None:
        """Send each craft's status, and put the rows written so far on disk."""
        for pipeline in notify.asking_for_time(self.pipelines.values()):
            self._publish_status(pipeline)
        self._publish_daemon()

    def _publish_daemon(self) -> None:
        """Renew what is reported once for all craft."""
        self._log_alone()
        self._publish_metrics()
        self.rows.flush()

    def _log_alone(self) -> None:
        """Log once that nobody is at the other end of the link, and that somebody is again."""
        alone = self.link.alone
        if alone and not self._alone:
            log.warning("%s: %s; it is tried again", self.link.address, alone)
        elif self._alone and not alone:
            log.info("%s: connected: somebody is at the other end", self.link.address)
        self._alone = alone

    def _publish_metrics(self) -> None:
        if self.metrics is not None:
            others = sum(self.statuses.parts_counters(), Counter(self.counters))
            with self._reporting("metrics"):
                self.metrics.publish(self.health.metrics(self.pipelines.values(), others))

    def _publish_status(self, pipeline: Pipeline) -> None:
        with contained(pipeline, "publishing its status"):
            self._send(self.statuses.of(pipeline))

    def feed_watchdog(self) -> None:
        """Notify the watchdog: ticks were closed of the samples accepted, or no sample came.

        A daemon that accepts samples and closes no ticks is to be restarted.
        """
        accepted = sum(pipeline.ticks.counters["accepted"] for pipeline in self.pipelines.values())
        closed = sum(pipeline.ticks.closed for pipeline in self.pipelines.values())
        if closed > self._fed[1] or accepted == self._fed[0]:
            text = ""
            with self._reporting("the state of the craft"):
                text = "; ".join(f"{name}: {pipeline.summary()}" for name, pipeline in self.pipelines.items())
            notify.notify(notify.WATCHDOG, notify.status(text))
        self._fed = (accepted, closed)
