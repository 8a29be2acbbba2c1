"""One magnetometer of a craft without ``physics.toml``: ticks -> estimator -> trust, with faults and the model's watch.

``compensating`` adds the physics, ``pipeline`` the messages in and out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from magcal_service.base.snapshot import SnapshotError, Stateful, restored
from magcal_service.config.magnetometers import label
from magcal_service.config.settings import CraftConfig, FilterConfig
from magcal_service.daemon.events import Event
from magcal_service.daemon.outbox import SOURCE, Stamp, estimate_message, unsendable
from magcal_service.daemon.sensor_faults import SENSOR_FAULTS
from magcal_service.estimators import find_method
from magcal_service.estimators.interface import Estimator, Phase, StateEstimate, TickOutcome
from magcal_service.model import Array
from magcal_service.ticks.assembler import Tick, TickAssembler
from magcal_service.ticks.rejection import Rejection
from magcal_service.trust.hazards import Hazard
from magcal_service.trust.monitor import TrustMonitor
from magcal_service.trust.reasons import Reason
from magcal_service.trust.verdict import NOT_STARTED, Trust
from magcal_service.watch.residual_watch import ModelWatch
from magcal_service.watch.witness import Witness
from magcal_service.wire.messages import Clock, Estimate, MagnetometerSample, Message, Verdict

WATCHED: Final = {
    Reason.MODEL_DOUBTFUL,
    Reason.INCONSISTENT,
    Reason.STRUCTURED_RESIDUAL,
    Reason.DRIFTING_RESIDUAL,
    Reason.MANY_REJECTED,
    Reason.SPIN_CONTRADICTED,
    Reason.SPIN_DISAGREES,
    Reason.RATE_DISAGREES,
    Reason.HELD_READINGS,
    Reason.NOISE_MISSTATED,
    Reason.UNPROTECTED,
}
"""Reasons under which a window of the watch may begin: it may explain them, or lessen them."""

UNWATCHED: Final = {Reason.STUCK, Reason.AXIS_STUCK, Reason.DRIVER_MISSING}
"""Reasons under which ticks are kept from the watch.  Its window outlives a new start: it fits errors separately."""


def learned(estimator: Estimator, tick: Tick) -> tuple[TickOutcome, StateEstimate]:
    """What a tick did to an estimator, and its estimate; LinAlgError where that is no estimate, or cannot be sent."""
    outcome = estimator.handle(tick)
    state = estimator.estimate()
    too_much = unsendable(state)
    if too_much:
        raise np.linalg.LinAlgError(f"the estimate cannot be sent: {too_much}")
    return outcome, state


@dataclass(init=False, repr=False, eq=False)
class CraftMemory:
    """What of ``Craft`` outlives a restart, saved and restored whole."""

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
    watch: ModelWatch
    witness: Witness


class Craft(Stateful, CraftMemory):
    """What the daemon makes of one craft's ticks.

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
        self.watch = ModelWatch(config.filter.gate_sigma)
        self.witness = Witness()

    @property
    def label(self) -> str:
        """What it is called in logs and tables: the craft, with its source where it is not the craft's own."""
        return label(self.config.name, self.config.source)

    # Events

    def event(self, what: str, cause: str, source: str = SOURCE) -> Event:
        """An event of this craft, now."""
        return Event(self.label, what, cause, source, self.last_time_ns)

    def note(self, what: str, cause: str, source: str = SOURCE) -> None:
        """Record an event for ``take_events``."""
        self._events.append(self.event(what, cause, source))

    @property
    def events_waiting(self) -> int:
        """How many events nobody has taken yet."""
        return len(self._events)

    def take_events(self) -> list[Event]:
        """What has changed since the last call."""
        events, self._events = self._events, []
        return events

    # Estimator and verdict as a whole

    def freeze(self, frozen: bool) -> None:
        """Learn from ticks no more, or again; the verdict says so at once, and not with the next tick."""
        self.frozen = frozen
        self.monitor.observe_freeze(frozen)
        self.trust = self._judged()

    def reset(self) -> None:
        """Begin estimate and verdict anew; samples and counters stay."""
        self.estimator.reset()
        self.monitor.reset()
        self.watch.reset()
        self.witness.reset()
        self._state, self.trust = self.estimator.estimate(), NOT_STARTED
        self._fault, self._learned_s = None, None

    def set_process_noise(self, bias_nt: float, d: float) -> None:
        """An estimator with other process noise, and the state of the one before."""
        settings = _noisier(self.config.filter, bias_nt, d)
        estimator = find_method(settings.method).build(replace(self.config, filter=settings))
        estimator.restore_state(self.estimator.export_state())
        self.estimator, self._process_noise, self._walk = estimator, (bias_nt, d), _walk_of(settings)
        self._state = self.estimator.estimate()
        self.trust = self._judged()

    def _fresh_estimator(self) -> Estimator:
        """Of the craft's configuration, with the process noise that a command has set."""
        settings = self.config.filter
        if self._process_noise is not None:
            settings = _noisier(settings, *self._process_noise)
        return find_method(settings.method).build(replace(self.config, filter=settings))

    def restore_state(self, saved: object, where: str = "state", given: Mapping[Any, Any] | None = None) -> None:
        """Restore an exported state, with the verdict that follows from it."""
        noise = saved.get("_process_noise") if isinstance(saved, dict) else None
        if noise is not None:
            self.set_process_noise(*restored(noise, tuple[float, float], f"{where}._process_noise"))
        super().restore_state(saved, where, given)
        self._refresh_estimate()

    def _take_estimate(self, saved: Craft) -> None:
        """Take estimate and verdict of another of this craft; samples, what they show of the sensor, ticks stay."""
        senses = self.monitor.senses
        self.estimator, self._process_noise = saved.estimator, saved._process_noise
        self._go_on_with(saved.monitor)
        self.monitor.senses = senses  # axes that have changed since are not as they were again
        self.watch, self.witness = saved.watch, saved.witness
        self._learned_s, self._walk, self._thawed = saved._learned_s, saved._walk, True

    def _go_on_with(self, monitor: TrustMonitor) -> None:
        """Take another monitor, and tell it the fault that the sensor has now."""
        self.monitor = monitor
        monitor.observe_fault(None if self._fault is None else SENSOR_FAULTS[self._fault][0])

    def take_commands(self, other: Craft) -> None:
        """Be as commands have made another: frozen or not, with its process noise."""
        if other._process_noise is not None:
            self.set_process_noise(*other._process_noise)
        self.freeze(other.frozen)

    def _refresh_estimate(self) -> None:
        """Read the estimate from the estimator, check that its covariance is positive definite, and judge it."""
        self._state = self.estimator.estimate()
        sigma = np.sqrt(np.maximum(np.diagonal(self._state.covariance), 1e-300))
        if np.linalg.eigvalsh(self._state.covariance / np.outer(sigma, sigma))[0] <= 0.0:
            raise SnapshotError("the covariance is not positive definite")
        too_much = unsendable(self._state)
        if too_much:
            raise SnapshotError(f"the estimate cannot be sent: {too_much}")
        self.trust = self._judged()

    def _judged(self) -> Trust:
        """The verdict on the estimate as it stands."""
        return self.monitor.judge(self._state)

    # Ticks

    def _tick(self, tick: Tick) -> Estimate:
        """Process a tick that has closed; its estimate."""
        if not tick.times_s.size:
            self.monitor.observe_skipped(1.0)
        elif self.frozen:
            self.counters["ticks_frozen"] += 1
            self.monitor.observe_frozen()
            self.monitor.senses.observe(tick, self._state)
            self._thawed = True
        else:
            if self._thawed:  # what lies before the freeze is as far away as after a gap
                self._thawed, tick = False, replace(tick, after_gap=True)
            self._learn(tick)
        self.monitor.observe_held(self.ticks.held_factor)
        self.trust = self._judged()
        return self._estimate(tick.time_ns, tick.clock)

    def _learn(self, tick: Tick) -> None:
        """Give a tick to the estimator; where its arithmetic fails it is reset, and the other craft continue."""
        try:
            outcome, state = learned(self.estimator, tick)
        except np.linalg.LinAlgError as error:
            self.counters["estimator_failed"] += 1
            senses = self.monitor.senses
            self.reset()
            self.monitor.senses = senses  # of the samples, whatever the estimate
            self.note("estimator_failed", f"{error}; it starts anew")
            return
        self._note_phase(self._state, state)
        self._state, self._learned_s = state, float(tick.times_s[-1])
        self._learned_from(tick)
        seen = self.monitor.protector.seen
        self.monitor.observe(tick, outcome, state)
        self._note_hazard(seen, self.monitor.protector.seen)
        self.witness.push(tick, outcome, state, trusted=self.trust.verdict is Verdict.TRUSTED)
        self._watch_model(tick)
        self._count(outcome)

    def _learned_from(self, tick: Tick) -> None:
        """A tick was learned from: for those who derive from this class."""

    def _note_phase(self, before: StateEstimate, now: StateEstimate) -> None:
        if now.restarts != before.restarts:
            self.note("restarted", "the samples contradicted the estimate")
        if before.phase is Phase.STARTING and now.phase is Phase.RUNNING:
            self.note("started", f"the start passed every gate after {now.samples} samples")

    def _note_hazard(self, before: Hazard | None, now: Hazard | None) -> None:
        if now is not None and before is None:
            self.note("hazard_seen", f"the residual goes as with {now}, beyond chance")
        elif now is None and before is not None:
            self.note("hazard_gone", "no hazard is seen any more")

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

    def compare(self, others: Iterable[Craft]) -> None:
        """Judge whether a disturbance is near this magnetometer alone, beside the craft's others."""
        if not self.witness.judge(one.witness for one in others):
            return
        self.monitor.observe_local(self.witness.local)
        self.trust = self._judged()
        if self.witness.local:
            self.note("local_disturbance", "the craft's other magnetometers do not see it")
        else:
            self.note("local_over", "it agrees with the reference again")

    def _count(self, outcome: TickOutcome) -> None:
        self.counters["rejected"] += outcome.rejected
        self.counters["spin_windows"] += outcome.spin_squared_innovation is not None
        self.counters["spin_windows_rejected"] += outcome.spin_rejected

    # Samples between ticks

    def _rejected(self, sample: MagnetometerSample, rejection: Rejection) -> list[Message]:
        """Only a fault of the sensor that has just begun is worth an extra estimate: its verdict has changed."""
        if rejection not in SENSOR_FAULTS:
            return []
        fault, self._fault_left = SENSOR_FAULTS[rejection]
        if rejection is self._fault:
            return []
        self._fault = rejection
        self.monitor.observe_fault(fault)
        self.trust = self._judged()
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
            self.trust = self._judged()

    def _age_s(self) -> float:
        """How much newer the newest sample is than the newest one learned from [s]."""
        return 0.0 if self._learned_s is None else max(0.0, self.ticks.newest_s - self._learned_s)

    # What is published of it

    def _covariance(self) -> Array:
        """The estimate's, with the random walk since the newest sample that it learned from (9, 9)."""
        if self._walk is None or self._state.phase is not Phase.RUNNING:
            return self._state.covariance
        return self._state.covariance + self._walk * self._age_s()

    def _estimate(self, time_ns: int, clock: Clock) -> Estimate:
        ticks, rms_nt = self.ticks.counters["ticks"], self.monitor.residual_rms_nt
        stamp, name = self._stamp(time_ns, clock), self.estimator.name
        return estimate_message(stamp, name, ticks, self._state, self._covariance(), self.trust, rms_nt)

    def _stamp(self, time_ns: int, clock: Clock) -> Stamp:
        """Craft, next sequence number and time of a message that it publishes."""
        number, self._sequence = self._sequence, (self._sequence + 1) % (1 << 32)
        return Stamp(self.config.name, number, time_ns, clock, self.config.source or SOURCE)


def _noisier(settings: FilterConfig, bias_nt: float, d: float) -> FilterConfig:
    """The settings with another random walk of bias [nT/sqrt(s)] and D [1/sqrt(s)]."""
    return replace(settings, process_noise_bias_nt=(bias_nt,) * 3, process_noise_D=(d,) * 6)


def _walk_of(settings: FilterConfig) -> Array | None:
    """Covariance that the random walk adds per second (9, 9); None where there is none, or the method has none."""
    walk = np.array(settings.process_noise_bias_nt + settings.process_noise_D)
    return np.diag(walk**2) if walk.any() and find_method(settings.method).has_process_noise else None
