"""One craft, pure: a message in, messages out.  Ticks -> estimator -> trust; no link, file or clock inside.

Live links, recordings and the simulator all use it, so what is verified on one holds for the others.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from magcal_service.config.settings import CraftConfig, FilterConfig
from magcal_service.daemon.command_table import unknown
from magcal_service.daemon.craft_commands import CRAFT_COMMANDS
from magcal_service.daemon.events import Event
from magcal_service.daemon.outbox import (
    SOURCE,
    Stamp,
    calibrated_vector,
    command_reply,
    estimate_message,
    status_message,
)
from magcal_service.daemon.plain_branch import PlainBranch, learned, newest_of
from magcal_service.daemon.sensor_faults import SENSOR_FAULTS
from magcal_service.daemon.settling import Settling
from magcal_service.errors import DecodeError, InputRefusedError
from magcal_service.estimators import find_method
from magcal_service.estimators.interface import Estimator, Phase, StateEstimate
from magcal_service.model import Array
from magcal_service.physics.apply.compensation import Compensation
from magcal_service.physics.apply.model_file import parse_model
from magcal_service.snapshot import SnapshotError, Stateful, restored
from magcal_service.ticks.assembler import Tick, TickAssembler
from magcal_service.ticks.rejection import Rejection
from magcal_service.ticks.time_window import is_usable
from magcal_service.trust.monitor import NOT_STARTED, TrustMonitor
from magcal_service.trust.reasons import Reason
from magcal_service.watch.residual_watch import ModelWatch
from magcal_service.wire.codec import encode
from magcal_service.wire.kinds import kind_of
from magcal_service.wire.messages import (
    Clock,
    Command,
    CommandReply,
    Estimate,
    MagnetometerSample,
    Message,
    PositionSample,
    ReferenceSample,
    Status,
    TelemetrySample,
)

WATCHED: Final = {
    Reason.MODEL_DOUBTFUL,
    Reason.INCONSISTENT,
    Reason.STRUCTURED_RESIDUAL,
    Reason.DRIFTING_RESIDUAL,
    Reason.MANY_REJECTED,
    Reason.SPIN_CONTRADICTED,
}
"""Reasons under which a window of the watch may begin: it may explain them."""

log = logging.getLogger("magcal")

UNWATCHED: Final = {Reason.STUCK, Reason.AXIS_STUCK, Reason.DRIVER_MISSING}
"""Reasons under which ticks are kept from the watch.  Its window outlives a new start: it fits errors separately."""

CarriedOut = Callable[[Command, "Pipeline"], CommandReply | None]
"""Carries out a command of the daemon's for a craft; None where the craft does."""


@dataclass(init=False, repr=False, eq=False)
class PipelineMemory:
    """What of ``Pipeline`` outlives a restart, saved and restored whole."""

    ticks: TickAssembler
    estimator: Estimator
    monitor: TrustMonitor
    frozen: bool
    counters: Counter[str]
    _sequence: int
    last_time_ns: int
    _clock: Clock
    first_time_ns: int
    _fault: Rejection | None
    _fault_left: int
    _learned_s: float | None
    _thawed: bool
    _process_noise: tuple[float, float] | None
    _physics: str
    compensation: Compensation | None
    stopped: str
    plain: PlainBranch | None
    settling: Settling | None
    watch: ModelWatch


class Pipeline(Stateful, PipelineMemory):
    """Everything the daemon does for one craft.

    Parameters
    ----------
    config: the craft's configuration.
    """

    worked_out = ("_events", "_state", "_walk", "trust")
    """Events leave with the message that caused them; the others follow from estimator, monitor and configuration."""

    def __init__(self, config: CraftConfig) -> None:
        self.config = config
        self.ticks = TickAssembler(config.ticks, config.sensor)
        self.estimator = find_method(config.filter.method).build(config)
        self.monitor = TrustMonitor(config)
        self.trust = NOT_STARTED
        self.frozen = False
        self.counters = Counter()
        self._sequence = 0
        self._state: StateEstimate = self.estimator.estimate()
        self.first_time_ns = self.last_time_ns = 0
        self._clock = Clock.ELAPSED
        self._fault = None  # the fault of the sensor that the newest rejected sample shows
        self._fault_left = 0  # accepted samples until that is over
        self._learned_s = None  # elapsed time of the newest sample learned from
        self._walk = _walk_of(config.filter)
        self._thawed = False  # ticks have passed unused since the estimator's last one
        self._process_noise = None  # of bias [nT/sqrt(s)] and D [1/sqrt(s)], where a command has set it
        self._events: list[Event] = []
        self._physics = ""
        self.compensation = None
        self.stopped = ""  # why compensation was stopped
        self.plain = None  # the craft without compensation, beside one that compensates
        self.settling = None  # what is to be compensated once its start is known
        self.watch = ModelWatch(config.filter.gate_sigma)
        if config.physics is not None:
            self._compensate_by(config.physics.text)

    def _compensate_by(self, physics: str) -> None:
        """Load the text of a ``physics.toml``; raises InputRefusedError where it is none.

        A warning is logged where the file says that it should not be acted on.
        """
        model = parse_model(physics.encode())
        if model.doubts:
            log.warning(
                "%s: physics.toml is not to be acted on, says its diagnosis: %s", self.config.name, model.doubts
            )
        self.compensation = Compensation(model)
        self._physics = physics
        self.ticks.wait_longer(self.compensation.wait_s)
        self._compare()

    def _compare(self, raw: TickAssembler | None = None) -> None:
        """Compensate, and hold that from now on against the craft without it, which begins anew with its samples.

        ``raw``: the tick stage of samples as they came, where it is not that of the craft beside or its own.
        """
        assert self.compensation is not None
        plain = PlainBranch(self.config, self.compensation.model.x)
        raw = raw or (self.ticks if self.plain is None else self.plain.ticks)
        plain.ticks.restore_state(raw.export_state())
        self.plain, self.settling, self.stopped = plain, None, ""

    @property
    def compensates(self) -> bool:
        """Whether samples are corrected by ``physics.toml``: its start is known, and it was not found to harm."""
        return self.compensation is not None and not self.stopped and self.settling is None

    def _settle(self) -> None:
        """Be a craft without compensation until what is compensated has a start."""
        assert self.compensation is not None
        assert self.plain is not None
        self.compensation.free_start()
        self.settling = Settling(self.config, self.compensation)
        self.settling.ticks.restore_state(self.plain.ticks.export_state())
        self.ticks, self.plain = self.plain.ticks, None

    def load_physics(self, physics: str) -> None:
        """Compensate by another model from now on; what was estimated under the one before is discarded."""
        self._compensate_by(physics)
        self.reset()

    def restore_state(self, saved: object, where: str = "state", given: Mapping[Any, Any] | None = None) -> None:
        """Restore an exported state, with the verdict that follows from it."""
        noise = saved.get("_process_noise") if isinstance(saved, dict) else None
        if noise is not None:
            self.set_process_noise(*restored(noise, tuple[float, float], f"{where}._process_noise"))
        physics = saved.get("_physics") if isinstance(saved, dict) else None
        if isinstance(physics, str) and physics != self._physics:
            try:
                self._compensate_by(physics)
            except InputRefusedError as error:
                raise SnapshotError(f"{where}._physics: {error}") from None
        if isinstance(saved, dict) and saved.get("settling") is not None and self.settling is None:
            self._settle()
        super().restore_state(saved, where, given)
        self._refresh_estimate()
        self._check_publishable(where)

    def _check_publishable(self, where: str) -> None:
        """Reject a state whose estimate or status no receiver would accept."""
        number = self._sequence
        try:
            for message in (self._estimate(self.last_time_ns, self._clock), self.status(0.0, Counter())):
                encode(message)
        except DecodeError as error:
            raise SnapshotError(f"{where}: what it would publish is refused: {error}") from None
        self._sequence = number

    def _refresh_estimate(self) -> None:
        """Read the estimate from the estimator, check that its covariance is positive definite, and judge it."""
        self._state = self.estimator.estimate()
        sigma = np.sqrt(np.maximum(np.diagonal(self._state.covariance), 1e-300))
        if np.linalg.eigvalsh(self._state.covariance / np.outer(sigma, sigma))[0] <= 0.0:
            raise SnapshotError("the covariance is not positive definite")
        self.trust = self.monitor.judge(self._state)

    def restore_estimate(self, saved: Pipeline) -> None:
        """Restore estimate and verdict from a checkpoint's pipeline of this craft; samples, ticks and counters stay."""
        self.estimator, self.monitor, self._process_noise = saved.estimator, saved.monitor, saved._process_noise
        self.watch = saved.watch
        self._restore_compensation(saved)
        self._thawed, self._fault = True, None
        self._learned_s, self._walk = saved._learned_s, saved._walk
        self._refresh_estimate()

    def _restore_compensation(self, saved: Pipeline) -> None:
        """Compensate as the checkpoint's pipeline did, where both have a model: its estimate is of such samples."""
        if self.compensation is None or saved.compensation is None:
            return
        raw = self.ticks if self.plain is None else self.plain.ticks
        if saved.plain is None:
            self.ticks, self.plain, self.settling, self.stopped = raw, None, None, saved.stopped
            if saved.settling is not None:
                self._compare()
                self._settle()
            return
        if self.settling is not None:
            self.ticks = self.settling.ticks
            self.compensation.take_start(saved.compensation)
        self._compare(raw)
        if self.plain is not None:
            self.plain.take_over(saved.plain)

    def set_process_noise(self, bias_nt: float, d: float) -> None:
        """Estimators with other process noise, and the state of those before."""
        settings = replace(self.config.filter, process_noise_bias_nt=(bias_nt,) * 3, process_noise_D=(d,) * 6)

        def rebuilt(before: Estimator) -> Estimator:
            estimator = find_method(settings.method).build(replace(self.config, filter=settings))
            estimator.restore_state(before.export_state())
            return estimator

        self.estimator, self._process_noise, self._walk = rebuilt(self.estimator), (bias_nt, d), _walk_of(settings)
        if self.plain is not None:
            self.plain.replace_estimator(rebuilt(self.plain.estimator))

    def event(self, what: str, cause: str, source: str = SOURCE) -> Event:
        """An event of this craft, now."""
        return Event(self.config.name, what, cause, source, self.last_time_ns)

    def note(self, what: str, cause: str, source: str = SOURCE) -> None:
        """Record an event for ``take_events``."""
        self._events.append(self.event(what, cause, source))

    def take_events(self) -> list[Event]:
        """What has changed since the last call."""
        events, self._events = self._events, []
        return events

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

    def answer(self, message: Message) -> list[Message]:
        """Take one message; what is published at once: a sample's vector, a command's reply."""
        match message:
            case MagnetometerSample():
                return self._sample(message)
            case ReferenceSample() | PositionSample() | TelemetrySample() if not is_usable(message.time_ns):
                self.counters[f"{kind_of(message).name}_time_out_of_range"] += 1
            case ReferenceSample():
                self._reference(message)
            case PositionSample():
                self.counters["position"] += 1
                self.watch.drivers.position(message)
                if self.compensation is not None:
                    self.compensation.position(message)
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
        self._advance_settling()
        self._advance_plain()
        return estimates

    def flush(self) -> list[Message]:
        """Close every open tick: the end of the stream."""
        estimates: list[Message] = [self._tick(tick) for tick in self.ticks.flush()]
        self._advance_settling(flush=True)
        self._advance_plain(flush=True)
        return estimates

    def _advance_plain(self, *, flush: bool = False) -> None:
        """Let the craft without compensation follow; where it is better off, go on as that."""
        if self.plain is None:
            return
        self.plain.advance(frozen=self.frozen, flush=flush)
        harm = self.plain.harm.harm()
        if harm:
            self._stop_compensation(harm)

    def _advance_settling(self, *, flush: bool = False) -> None:
        """Let what is to be compensated follow; where its start is known, compensate from now on."""
        if self.settling is None or self.compensation is None:
            return
        if self.settling.advance(frozen=self.frozen, flush=flush):
            self._try_start(self.settling, self.compensation)
        if self.settling is not None and self.settling.is_late:
            self.settling = None
            self._say_stopped("with no temperature at the start does it fit better than none")

    def _try_start(self, settling: Settling, compensation: Compensation) -> None:
        """Give an estimator all ticks so far, compensated; it takes over where it has a start."""
        fit = settling.settled()
        if fit is None:
            return
        estimator, monitor = self._fresh_estimator(), TrustMonitor(self.config)
        plain = PlainBranch(self.config, compensation.model.x)
        for tick, raw in settling.compensated(fit.amplitudes):
            try:
                outcome, state = learned(estimator, tick)
            except np.linalg.LinAlgError:
                return
            monitor.observe(tick, outcome, state)
            plain.harm.compensated(*newest_of(tick))
            plain.harm.plain(*newest_of(replace(tick, field_body_nt=raw)))
        if estimator.estimate().phase is not Phase.RUNNING:
            return
        compensation.give_start(fit.amplitudes, fit.covariance)
        plain.go_on(self.ticks, self.estimator, self.monitor, self._learned_s)
        self.ticks, self.estimator, self.monitor = settling.ticks, estimator, monitor
        self.plain, self.settling = plain, None
        self.watch.reset()
        self._state = estimator.estimate()
        self.trust = monitor.judge(self._state)
        sigma = np.sqrt(np.diagonal(fit.covariance))
        start = ", ".join(f"{y:.3f} +- {one:.3f}" for y, one in zip(fit.amplitudes, sigma, strict=True))
        self.note("start_known", f"the temperature at the start was {start} of its swing off its mean; compensates")

    def _fresh_estimator(self) -> Estimator:
        """Of the craft's configuration, with the process noise that a command has set."""
        settings = self.config.filter
        if self._process_noise is not None:
            bias_nt, d = self._process_noise
            settings = replace(settings, process_noise_bias_nt=(bias_nt,) * 3, process_noise_D=(d,) * 6)
        return find_method(settings.method).build(replace(self.config, filter=settings))

    def _stop_compensation(self, why: str) -> None:
        """Publish from now on what a craft without ``physics.toml`` would, and say so."""
        assert self.plain is not None
        plain, self.plain = self.plain, None
        self.ticks, self.estimator, self.monitor = plain.ticks, plain.estimator, plain.monitor
        self._state, self._learned_s, self._thawed = plain.state, plain.learned_s, plain.thawed
        self.monitor.observe_fault(None if self._fault is None else SENSOR_FAULTS[self._fault][0])
        self.watch.reset()
        self._say_stopped(why)

    def _say_stopped(self, why: str) -> None:
        self.stopped = why
        self.monitor.observe_driver(False)
        self.monitor.observe_compensation(stopped=True)
        self.trust = self.monitor.judge(self._state)
        self.counters["compensation_stopped"] += 1
        self.note("compensation_stopped", why)

    def _reference(self, sample: ReferenceSample) -> None:
        if self.plain is not None:
            self.plain.reference(sample)
        if self.settling is not None:
            self.settling.reference(sample)
        compensation = self.compensation if self.compensates else None
        self.ticks.add_reference(sample if compensation is None else compensation.reference(sample))

    def _sample(self, sample: MagnetometerSample) -> list[Message]:
        if self.plain is not None and self.compensation is not None and self.compensation.begins_elsewhere(sample):
            self._settle()
        rejection = self.ticks.rejection(sample)
        if rejection is not None:
            return self._rejected(sample, rejection)
        measured, sample = sample, self._corrected(sample)
        self.ticks.take(measured, sample)
        if self.plain is not None:
            self.plain.sample(measured)
        if self.settling is not None:
            self.settling.sample(measured)
        self._recover()
        self.first_time_ns = self.first_time_ns or sample.time_ns
        self.last_time_ns, self._clock = sample.time_ns, sample.clock
        unknown = self.compensation.start_variance if self.compensation is not None and self.compensates else None
        return [calibrated_vector(sample, self._state, self._covariance(), self.trust.verdict, unknown)]

    def _corrected(self, sample: MagnetometerSample) -> MagnetometerSample:
        """Subtract the disturbances that ``physics.toml`` models; those without a driver are counted and named."""
        if self.compensation is None or self.stopped:
            return sample
        if self.settling is not None:
            self.counters.update(f"uncompensated.{effect}" for effect in self.compensation.start_terms)
            self.monitor.observe_driver(True)
            return sample
        corrected = self.compensation.correct(sample)
        missing = self.compensation.missing
        self.counters.update(f"uncompensated.{effect}" for effect in missing)
        self.monitor.observe_driver(bool(missing) or self._start_is_vague(self.compensation))
        return corrected

    def _start_is_vague(self, compensation: Compensation) -> bool:
        """Whether what is not known of a temperature at the start still moves a vector by more than the noise."""
        unknown = compensation.start_variance
        return unknown is not None and float(np.trace(unknown)) > 3.0 * self._state.noise_nt**2

    def _rejected(self, sample: MagnetometerSample, rejection: Rejection) -> list[Message]:
        """Only a fault of the sensor that has just begun is worth an extra estimate: its verdict has changed."""
        if rejection not in SENSOR_FAULTS:
            return []
        fault, self._fault_left = SENSOR_FAULTS[rejection]
        if rejection is self._fault:
            return []
        self._fault = rejection
        self.monitor.observe_fault(fault)
        self.trust = self.monitor.judge(self._state)
        self.note("sensor_fault", f"{fault}: {self.trust.verdict}")
        return [self._estimate(sample.time_ns, sample.clock)]

    def _recover(self) -> None:
        """A sample was accepted: a fault ends with it, or some later; without updates, an estimate becomes stale."""
        if self._fault is not None:
            self._fault_left -= 1
            if self._fault_left <= 0:
                self.note("sensor_recovered", self._fault.value)
                self._fault = None
                self.monitor.observe_fault(None)
        if self._state.phase is Phase.RUNNING and self.monitor.observe_unchecked(self._age_s()):
            self.trust = self.monitor.judge(self._state)

    def _age_s(self) -> float:
        """How much newer the newest sample is than the newest one learned from [s]."""
        return 0.0 if self._learned_s is None else max(0.0, self.ticks.newest_s - self._learned_s)

    def _covariance(self) -> Array:
        """The estimate's, with the random walk since the newest sample that it learned from (9, 9)."""
        if self._walk is None or self._state.phase is not Phase.RUNNING:
            return self._state.covariance
        return self._state.covariance + self._walk * self._age_s()

    def _tick(self, tick: Tick) -> Estimate:
        if not tick.times_s.size:
            self.monitor.observe_skipped(1.0)
        elif self.frozen:
            self.counters["ticks_frozen"] += 1
            self.monitor.observe_frozen()
            self._thawed = True
        else:
            if self._thawed:  # what lies before the freeze is as far away as after a gap
                self._thawed, tick = False, replace(tick, after_gap=True)
            self._learn(tick)
        self.trust = self.monitor.judge(self._state)
        return self._estimate(tick.time_ns, tick.clock)

    def _learn(self, tick: Tick) -> None:
        """Give a tick to the estimator; where its arithmetic fails it is reset, and the other craft continue."""
        try:
            outcome, state = learned(self.estimator, tick)
        except np.linalg.LinAlgError as error:
            self.counters["estimator_failed"] += 1
            self.reset()
            self.note("estimator_failed", f"{error}; it starts anew")
            return
        self._note_phase(self._state, state)
        if self.compensation is not None and self.plain is not None and not self.compensation.missing:
            self.plain.harm.compensated(*newest_of(tick))
        self._state, self._learned_s = state, float(tick.times_s[-1])
        self.monitor.observe(tick, outcome, state)
        self._watch_model(tick)
        self._count(outcome.rejected, outcome.spin_squared_innovation is not None, outcome.spin_rejected)

    def _watch_model(self, tick: Tick) -> None:
        """Give a tick to the watch once the estimate has settled; a finding that comes, goes or changes is reported."""
        reasons = set(self.trust.reasons)
        if not self.config.trust.watch or reasons & UNWATCHED or not (self.watch.is_open or reasons <= WATCHED):
            return
        if not self.watch.push(tick, self._state, walks=self._walk is not None):
            return
        finding = self.watch.finding
        self.monitor.observe_model(finding is not None)
        if finding is None:
            self.note("model_agrees", "a whole window of the watch has found nothing")
        else:
            self.note("model_doubtful", str(finding))

    def _note_phase(self, before: StateEstimate, now: StateEstimate) -> None:
        if now.restarts != before.restarts:
            self.note("restarted", "the samples contradicted the estimate")
        if before.phase is Phase.STARTING and now.phase is Phase.RUNNING:
            self.note("started", f"the start passed every gate after {now.samples} samples")

    def reset(self) -> None:
        """Begin estimate and verdict anew; samples and counters stay."""
        self.estimator.reset()
        self.monitor.reset()
        self.watch.reset()
        if self.plain is not None:
            self.plain.reset()
        self.monitor.observe_compensation(stopped=bool(self.stopped))
        self._state, self.trust = self.estimator.estimate(), NOT_STARTED
        self._fault, self._learned_s = None, None

    def _count(self, rejected: int, window: bool, window_rejected: bool) -> None:
        self.counters["rejected"] += rejected
        self.counters["spin_windows"] += window
        self.counters["spin_windows_rejected"] += window_rejected

    def _estimate(self, time_ns: int, clock: Clock) -> Estimate:
        stamp = Stamp(self.config.name, self._number(), time_ns, clock)
        ticks, rms_nt = self.ticks.counters["ticks"], self.monitor.residual_rms_nt
        return estimate_message(stamp, self.estimator.name, ticks, self._state, self._covariance(), self.trust, rms_nt)

    def _number(self) -> int:
        """The next sequence number of what this craft publishes."""
        number, self._sequence = self._sequence, (self._sequence + 1) % (1 << 32)
        return number

    def _command(self, command: Command) -> CommandReply:
        """Carry out a command of the craft; an unknown one is refused."""
        work = CRAFT_COMMANDS.get(command.name)
        return self.reply(command, unknown(command.name) if work is None else work(self, command))

    def reply(self, command: Command, refusal: str = "") -> CommandReply:
        """The answer to a command that was carried out, or refused for a reason; it is counted."""
        self.counters["commands_refused" if refusal else "commands"] += 1
        stamp = Stamp(self.config.name, self._number(), self.last_time_ns, self._clock)
        return command_reply(stamp, command, refusal, self.summary())

    def summary(self) -> str:
        """One line: verdict, reasons, ticks."""
        reasons = f" ({', '.join(self.trust.reasons)})" if self.trust.reasons else ""
        state = "frozen, " if self.frozen else ""
        if self.stopped:
            state += f"physics.toml is not compensated any more: {self.stopped}; "
        elif self.settling is not None:
            state += "not compensated yet: the temperature at the start is being estimated; "
        elif self.compensation is not None and self.compensation.missing:
            state += f"not compensated for want of a driver: {', '.join(self.compensation.missing)}; "
        if self.model_doubt:
            state += f"{self.model_doubt}; "
        return f"{state}{self.trust.verdict}{reasons}, {self.ticks.counters['ticks']} ticks"

    @property
    def model_doubt(self) -> str:
        """What the model seems to leave out, and the command to run; empty where nothing is found."""
        found = self.watch.finding
        return "" if found is None else f"model doubtful: {found}; run: magcal diagnose RECORDING"

    def status(self, uptime_s: float, counters: Counter[str]) -> Status:
        """Health of this craft; ``counters`` are the link's, added to the craft's."""
        own = Counter({"running": int(self._state.phase is Phase.RUNNING), "restarts": self._state.restarts})
        if self.compensation is not None:
            own["compensating"] = int(self.compensates)
        stamp = Stamp(self.config.name, self._number(), self.last_time_ns, self._clock)
        counted = self.ticks.counters + self.counters + own + counters
        return status_message(stamp, uptime_s, self.trust, counted, self.summary())


def _walk_of(settings: FilterConfig) -> Array | None:
    """Covariance that the random walk adds per second (9, 9); None where there is none, or the method has none."""
    walk = np.array(settings.process_noise_bias_nt + settings.process_noise_D)
    return np.diag(walk**2) if walk.any() and find_method(settings.method).has_process_noise else None
