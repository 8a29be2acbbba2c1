"""One magnetometer, pure: a message in, messages out.  Ticks -> estimator -> trust; no link, file or clock inside.

Live links, recordings and the simulator all use it, so what is verified on one holds for the others.
"""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from magcal_service.base.errors import DecodeError
from magcal_service.base.snapshot import SnapshotError
from magcal_service.config.settings import CraftConfig, ReferenceModel
from magcal_service.daemon.command_table import unknown
from magcal_service.daemon.compensating import CompensatingCraft, CompensatingMemory
from magcal_service.daemon.craft_commands import CRAFT_COMMANDS
from magcal_service.daemon.events import BY_COMMAND, Event
from magcal_service.daemon.outbox import calibrated_vector, command_reply, status_message
from magcal_service.daemon.own_reference import NOT_USED, reference_at, watch_height
from magcal_service.estimators.interface import Phase
from magcal_service.ticks.time_window import is_usable
from magcal_service.trust.vector_gate import strays
from magcal_service.watch.diagnosing import doubt
from magcal_service.wire.codec import encode
from magcal_service.wire.kinds import kind_of
from magcal_service.wire.messages import (
    CalibratedVector,
    Command,
    CommandReply,
    MagnetometerSample,
    Message,
    PositionSample,
    ReferenceSample,
    Status,
    TelemetrySample,
    Verdict,
)

CarriedOut = Callable[[Command, "Pipeline"], CommandReply | None]
"""Carries out a command of the daemon's for a craft; None where the craft does."""


_MOST_LEFT_OUT: Final = 64
"""Messages that are known to make a craft fail, the newest: what a node's history may bring back at once is 128."""


@dataclass(init=False, repr=False, eq=False)
class PipelineMemory(CompensatingMemory):
    """What of ``Pipeline`` outlives a restart, saved and restored whole."""

    failure: str
    heard: str
    _left_out: list[str]


class Pipeline(CompensatingCraft, PipelineMemory):
    """Everything the daemon does for one magnetometer of a craft.

    Parameters
    ----------
    config: the magnetometer's configuration (``config.magnetometers``).

    Attributes
    ----------
    heard: the source of its samples; empty until one was accepted, where the configuration names none.
    failure: why it last began anew by itself; empty where it never did.
    failures: how often it did since the daemon has started, by kind of error and what was being done.
    """

    def __init__(self, config: CraftConfig) -> None:
        super().__init__(config)
        self.failure = ""
        self.failures: Counter[str] = Counter()
        self.heard = config.hears
        self._left_out = []  # digests of messages at which it failed

    def handle(self, message: Message) -> list[Message]:
        """Take one message; every message to be published because of it, in order; events wait for ``take_events``."""
        return [*self.answer(message), *self.advance()]

    def outputs(self, message: Message, carried_out: CarriedOut | None = None) -> Iterator[Message | Event]:
        """Take one message; the messages it causes, in the order in which they are published.

        A sample's vector or a command's reply first, computed before any tick is: a caller that publishes each output
        as it is yielded sends the vector before the tick is processed.  Then the estimates of ticks that have closed,
        then the events.

        Parameters
        ----------
        message: any message of this craft.
        carried_out: gives the reply to a command that the daemon carries out, None for one that the craft carries out.
        """
        reply = carried_out(message, self) if carried_out is not None and isinstance(message, Command) else None
        yield from self.answer(message) if reply is None else [reply]
        yield from self.advance()
        yield from self.take_events()

    def begin_anew(self, cause: str, message: Message | None = None) -> None:
        """Discard all that a defect may have spoilt: estimate, verdict, ticks, references, channels, loaded physics.

        Counters and numbers of messages go on, a freeze and a process noise that was set stay, and samples that were
        accepted are known again as doubled.  It is counted as ``failed``.

        Parameters
        ----------
        cause: what failed, in words.
        message: at which it failed: it is left out where it comes again, as from a node's history after a restart.
        """
        fresh = type(self)(self.config)
        fresh.ticks.go_on_from(self.ticks)
        fresh.counters.update(self.counters)
        fresh.take_commands(self)
        fresh._sequence, fresh._events = self._sequence, self._events
        fresh.heard, fresh.failures = self.heard, self.failures
        fresh.first_time_ns, fresh.last_time_ns, fresh._clock = self.first_time_ns, self.last_time_ns, self._clock
        fresh._left_out = self._left_out if message is None else [*self._left_out, _digest(message)][-_MOST_LEFT_OUT:]
        vars(self).update(vars(fresh))
        self.failure = cause
        self.counters["failed"] += 1
        self.note("failed", f"{cause}; it begins anew")

    def leaves_out(self, message: Message) -> bool:
        """Whether the craft has failed at this message before; it is counted as ``left_out`` then."""
        if not self._left_out or _digest(message) not in self._left_out:
            return False
        self.counters["left_out"] += 1
        return True

    def answer(self, message: Message) -> list[Message]:
        """Take one message; what is published at once: a sample's vector, a command's reply."""
        match message:
            case MagnetometerSample():
                return self._sample(message)
            case ReferenceSample() | PositionSample() | TelemetrySample() if not is_usable(message.time_ns):
                self.counters[f"{kind_of(message).name}_time_out_of_range"] += 1
            case ReferenceSample() if self.config.reference.model is ReferenceModel.IGRF:
                self.counters[NOT_USED] += 1
            case ReferenceSample():
                self._reference(message)
            case PositionSample():
                self.counters["position"] += 1
                self.watch.drivers.position(message)
                if self.compensation is not None:
                    self.compensation.position(message)
                if self.config.reference.model is ReferenceModel.IGRF:
                    self._own_reference(message)
            case TelemetrySample():
                self.counters["telemetry"] += 1
                self.watch.drivers.telemetry(message)
                if self.compensation is not None:
                    self.compensation.telemetry(message)
                self.counters["rate"] += self.ticks.add_rate(message)
                if self.plain is not None:
                    self.plain.rate(message)
            case Command():
                return [self._command(message)]
            case _:
                self.counters["unexpected"] += 1
        return []

    def advance(self) -> list[Message]:
        """Process the ticks that have closed; their estimates."""
        estimates: list[Message] = [self._tick(tick) for tick in self.ticks.ready()]
        self._advance_beside()
        return estimates

    def flush(self) -> list[Message]:
        """Close every open tick: the end of the stream.

        A tick whose reference has not come yet says nothing about it: the estimate is published as it stands.
        """
        estimates: list[Message] = [
            self._tick(tick) if tick.times_s.size else self._estimate(tick.time_ns, tick.clock)
            for tick in self.ticks.flush()
        ]
        self._advance_beside(flush=True)
        return estimates

    def _own_reference(self, position: PositionSample) -> None:
        """Take the main field at a position as the reference; where there is none, it is counted why."""
        found = reference_at(position)
        if isinstance(found, str):
            self.counters[found] += 1
        else:
            self._reference(found)
            watch_height(self.monitor.senses.height, position)

    def _sample(self, sample: MagnetometerSample) -> list[Message]:
        if self.plain is not None and self.compensation is not None and self.compensation.begins_elsewhere(sample):
            self._settle()
        rejection = self.ticks.rejection(sample)
        if rejection is not None:
            return self._rejected(sample, rejection)
        measured, sample = sample, self._corrected(sample)
        self.ticks.take(measured, sample)
        self._take_beside(measured)
        self._recover()
        self.heard = self.heard or sample.source
        self.first_time_ns = self.first_time_ns or sample.time_ns
        self.last_time_ns, self._clock = sample.time_ns, sample.clock
        return [self._gated(calibrated_vector(sample, self._state, self._covariance(), self.trust, self._unknown()))]

    def _gated(self, vector: CalibratedVector) -> CalibratedVector:
        """A trusted vector as it is; doubtful where it is an old reading, or not as long as the field was just now."""
        if vector.verdict is not Verdict.TRUSTED:
            return vector
        if not self.ticks.repeats:
            newest = self.ticks.references.newest(vector.clock)
            if newest is None or not strays(vector, newest[1], abs(vector.time_ns - newest[0]) * 1e-9):
                return vector
            self.counters["strayed"] += 1
        return replace(vector, verdict=Verdict.DOUBTFUL)

    def _command(self, command: Command) -> CommandReply:
        """Carry out a command of the craft; an unknown one is refused."""
        work, before = CRAFT_COMMANDS.get(command.name), self.events_waiting
        return self.reply(command, unknown(command.name) if work is None else work(self, command), before)

    def reply(self, command: Command, refusal: str = "", before: int | None = None) -> CommandReply:
        """The answer to a command that was carried out, or refused for a reason; it is counted.

        One that was carried out says what has changed, by the events it has caused, and how the craft is now.

        Parameters
        ----------
        command: what was asked.
        refusal: why it was not carried out; empty where it was.
        before: how many events were waiting before it was; None where none is to be told.
        """
        self.counters["commands_refused" if refusal else "commands"] += 1
        stamp = self._stamp(self.last_time_ns, self._clock)
        now = self.summary()
        caused = [
            one.what if one.cause == BY_COMMAND else f"{one.what}: {one.cause}"
            for one in self._events[self.events_waiting if before is None else before :]
        ]
        changed = "".join(f"{one}; " for one in caused if not now.startswith(one))
        return command_reply(stamp, command, refusal, changed + now)

    def turn_away(self, command: Command, refusal: str) -> CommandReply:
        """The answer to a command that the craft was not given; it is not among those that the craft counts."""
        return command_reply(self._stamp(self.last_time_ns, self._clock), command, refusal, "")

    def summary(self) -> str:
        """One line: verdict, reasons, ticks."""
        reasons = f" ({', '.join(self.trust.reasons)})" if self.trust.reasons else ""
        state = "frozen, " if self.frozen else ""
        if self.stopped:
            state += f"physics.toml is not compensated any more: {self.stopped}; "
        elif self.settling is not None:
            state += "not compensated yet: the temperature at the start is being estimated; "
        elif self.compensation is not None and self.compensation.missing:
            state += f"not compensated for want of a driver: {self.compensation.missing_in_words()}; "
        if self.model_doubt:
            state += f"{self.model_doubt}; "
        state += "".join(f"{seen}; " for seen in self.monitor.seen.values())
        return f"{state}{self.trust.verdict}{reasons}{self.trust.protection}, {self.ticks.counters['ticks']} ticks"

    @property
    def model_doubt(self) -> str:
        """What the model seems to leave out, and the command to run; empty where nothing is found."""
        found, hazard = self.watch.finding, self.monitor.protector.seen
        if found is None and hazard is None:
            return ""
        what = f"not named yet, the residual goes as with the hazard {hazard}" if found is None else f"{found}"
        return doubt(what)

    def status(self, uptime_s: float, counters: Counter[str]) -> Status:
        """Health of this craft; ``counters`` are the link's, added to the craft's."""
        own = Counter({"running": int(self._state.phase is Phase.RUNNING), "restarts": self._state.restarts})
        if self.compensation is not None:
            own["compensating"] = int(self.compensates)
        if self.trust.protection_nt is not None:
            own["protection_nt"] = math.ceil(self.trust.protection_nt)
        stamp = self._stamp(self.last_time_ns, self._clock)
        counted = self.ticks.counters + self.counters + own + counters
        return status_message(stamp, uptime_s, self.trust, counted, self.summary())

    def restore_state(self, saved: object, where: str = "state", given: Mapping[Any, Any] | None = None) -> None:
        """Restore an exported state; raises SnapshotError where it does not fit, or no receiver would accept it."""
        super().restore_state(saved, where, given)
        number = self._sequence
        try:
            for message in (self._estimate(self.last_time_ns, self._clock), self.status(0.0, Counter())):
                encode(message)
        except DecodeError as error:
            raise SnapshotError(f"{where}: what it would publish is refused: {error}") from None
        self._sequence = number


def _digest(message: Message) -> str:
    """What a message is known again by."""
    return hashlib.sha256(encode(message)).hexdigest()[:16]
