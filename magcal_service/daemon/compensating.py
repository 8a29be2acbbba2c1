"""One craft that is compensated by ``physics.toml``: samples and references corrected, and whether that does good.

It is in one of four states:

- none is configured: ``compensation`` is None, and it is a ``Craft``;
- compensating: beside it runs the same craft without (``plain``), by which it is judged;
- settling: what it would compensate has a start that is not known yet (``settling``); until then it is a ``Craft``;
- stopped: compensation did harm, or fits with no start (``stopped`` says why); it goes on as a ``Craft``.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from magcal_service.base.errors import InputRefusedError
from magcal_service.base.snapshot import SnapshotError
from magcal_service.config.settings import CraftConfig
from magcal_service.daemon.craft import Craft, CraftMemory, learned
from magcal_service.daemon.plain_branch import PlainBranch, newest_of
from magcal_service.daemon.settling import Settling
from magcal_service.estimators.interface import GoesOn, Phase
from magcal_service.estimators.parts.magnitude_fit import MagnitudeFit
from magcal_service.model import Array
from magcal_service.physics.apply.advice import doubts_of
from magcal_service.physics.apply.compensation import Compensation
from magcal_service.physics.apply.model_file import PhysicsModel, parse_model
from magcal_service.ticks.assembler import Tick, TickAssembler
from magcal_service.trust.doubted import doubted_by_physics
from magcal_service.trust.monitor import TrustMonitor
from magcal_service.trust.verdict import Trust
from magcal_service.wire.messages import MagnetometerSample, ReferenceSample

log = logging.getLogger("magcal")


@dataclass(init=False, repr=False, eq=False)
class CompensatingMemory(CraftMemory):
    """What of ``CompensatingCraft`` outlives a restart, saved and restored whole."""

    _physics: str
    compensation: Compensation | None
    stopped: str
    plain: PlainBranch | None
    settling: Settling | None


class CompensatingCraft(Craft, CompensatingMemory):
    """A craft with the ``physics.toml`` of its configuration, or of a command.

    Parameters
    ----------
    config: the craft's configuration.
    """

    def __init__(self, config: CraftConfig) -> None:
        super().__init__(config)
        self._physics = ""
        self.compensation = None
        self.stopped = ""  # why compensation was stopped
        self.plain = None  # the craft without compensation, beside one that compensates
        self.settling = None  # what is to be compensated once its start is known
        if config.physics is not None:
            self._compensate_by(config.physics.text, config.physics.name)

    @property
    def compensates(self) -> bool:
        """Whether samples are corrected by ``physics.toml``: its start is known, and it was not found to harm."""
        return self.compensation is not None and not self.stopped and self.settling is None

    # From one state to another

    def load_physics(self, physics: str, name: str = "physics.toml") -> PhysicsModel:
        """Compensate by another model from now on, of a file of a name; what was estimated before is discarded."""
        model = self._compensate_by(physics, name)
        self.reset()
        return model

    def _compensate_by(self, physics: str, name: str) -> PhysicsModel:
        """Load the text of a ``physics.toml`` that is called ``name``; raises InputRefusedError where it is none.

        Each reason for which the file says that it should not be acted on is logged as a warning.
        """
        model = parse_model(physics.encode(), name)
        for doubt in doubts_of(model.doubts):
            log.warning("%s: %s is subtracted all the same: %s", self.config.name, name, doubt)
        if model.craft and model.craft != self.config.name:
            of = (self.config.name, name, model.craft)
            log.warning("%s: %s is of craft %s; it is subtracted all the same", *of)
        self.compensation = Compensation(model)
        self._physics = physics
        self.ticks.wait_longer(self.compensation.wait_s)
        self._compare()
        return model

    def _compare(self, raw: TickAssembler | None = None) -> None:
        """Compensate, and hold that from now on against the craft without it, which begins anew with its samples.

        ``raw``: the tick stage of samples as they came, where it is not that of the craft beside or its own.
        """
        assert self.compensation is not None
        plain = PlainBranch(self.config, self.compensation.model.x)
        plain.replace_estimator(self._fresh_estimator())
        raw = raw or (self.ticks if self.plain is None else self.plain.ticks)
        plain.ticks.restore_state(raw.export_state())
        self.plain, self.settling, self.stopped = plain, None, ""

    def _settle(self) -> None:
        """Be a craft without compensation until what is compensated has a start."""
        assert self.compensation is not None
        assert self.plain is not None
        self.compensation.free_start()
        self.settling = Settling(self.config, self.compensation)
        self.settling.ticks.restore_state(self.plain.ticks.export_state())
        self.ticks, self.plain = self.plain.ticks, None

    def _try_start(self, settling: Settling, compensation: Compensation) -> None:
        """Let an estimator take over that goes on from the start's fit, or that all ticks so far have started."""
        estimator, monitor = self._fresh_estimator(), TrustMonitor(self.config)
        settled = settling.settled(goes_on=isinstance(estimator, GoesOn))
        if settled is None:
            return
        fit = settled.fit
        plain = PlainBranch(self.config, compensation.model.x)
        goes_on = isinstance(estimator, GoesOn) and settled.is_sure
        if isinstance(estimator, GoesOn) and goes_on:
            estimator.begin_with(fit.x, fit.x_covariance, self.config.sensor.noise_nt or fit.sigma_nt)
        for tick, raw in settling.compensated(fit.amplitudes):
            if not goes_on:
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
        self.ticks, self.estimator = settling.ticks, estimator
        self._go_on_with(monitor)
        self.plain, self.settling = plain, None
        self.watch.reset()
        self._state = estimator.estimate()
        self.trust = self._judged()
        self.note("start_known", f"the temperature at the start was {_in_words(fit)}; compensates")

    def _stop(self, why: str) -> None:
        """Publish from now on what a craft without ``physics.toml`` would, and say so."""
        assert self.plain is not None
        plain, self.plain = self.plain, None
        self.ticks, self.estimator = plain.ticks, plain.estimator
        self._go_on_with(plain.monitor)
        self._state, self._learned_s, self._thawed = plain.state, plain.learned_s, plain.thawed
        self.watch.reset()
        self._say_stopped(why)

    def _say_stopped(self, why: str) -> None:
        self.stopped = why
        self.monitor.observe_driver(False)
        self.monitor.observe_compensation(stopped=True)
        self.trust = self._judged()
        self.counters["compensation_stopped"] += 1
        self.note("compensation_stopped", why)

    def _judged(self) -> Trust:
        """The verdict; no trust is left where samples are corrected by a file that is not to be acted on."""
        trust = super()._judged()
        if self.compensation is None or not self.compensates or not self.compensation.model.doubts:
            return trust
        return doubted_by_physics(trust)

    # Beside the craft

    def _advance_beside(self, *, flush: bool = False) -> None:
        """Let what settles and the craft without compensation follow; go on as what is better off."""
        if self.settling is not None and self.compensation is not None:
            if self.settling.advance(frozen=self.frozen, flush=flush):
                self._try_start(self.settling, self.compensation)
            if self.settling is not None and self.settling.is_late:
                self.settling = None
                self._say_stopped("with no temperature at the start does it fit better than none")
        if self.plain is not None:
            self.plain.advance(frozen=self.frozen, flush=flush)
            harm = self.plain.harm.harm()
            if harm:
                self._stop(harm)

    def _learned_from(self, tick: Tick) -> None:
        if self.compensation is not None and self.plain is not None and not self.compensation.missing:
            self.plain.harm.compensated(*newest_of(tick))

    def reset(self) -> None:
        """Begin estimate and verdict anew; samples and counters stay."""
        super().reset()
        if self.plain is not None:
            self.plain.reset()
        self.monitor.observe_compensation(stopped=bool(self.stopped))

    def set_process_noise(self, bias_nt: float, d: float) -> None:
        """Estimators with other process noise, and the state of those before."""
        super().set_process_noise(bias_nt, d)
        if self.plain is not None:
            estimator = self._fresh_estimator()
            estimator.restore_state(self.plain.estimator.export_state())
            self.plain.replace_estimator(estimator)

    # Samples and references

    def _reference(self, sample: ReferenceSample) -> None:
        """Take a reference, as the model corrects it where it compensates."""
        if self.plain is not None:
            self.plain.reference(sample)
        if self.settling is not None:
            self.settling.reference(sample)
        compensation = self.compensation if self.compensates else None
        self.ticks.add_reference(sample if compensation is None else compensation.reference(sample))

    def _take_beside(self, sample: MagnetometerSample) -> None:
        """Give a sample, as it was measured, to what runs beside."""
        if self.plain is not None:
            self.plain.sample(sample)
        if self.settling is not None:
            self.settling.sample(sample)

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
        if missing:
            self.counters.update(f"uncompensated.{effect}" for effect in missing)
        self.monitor.observe_driver(bool(missing) or self._start_is_vague(self.compensation))
        return corrected

    def _start_is_vague(self, compensation: Compensation) -> bool:
        """Whether what is not known of a temperature at the start still moves a vector by more than the noise."""
        unknown = compensation.start_variance
        return unknown is not None and float(np.trace(unknown)) > 3.0 * self._state.noise_nt**2

    def _unknown(self) -> Array | None:
        """Covariance (3, 3) [nT^2] of a corrected sample by what is not known of a start; None: none."""
        return self.compensation.start_variance if self.compensation is not None and self.compensates else None

    # Restoring

    def restore_state(self, saved: object, where: str = "state", given: Mapping[Any, Any] | None = None) -> None:
        """Restore an exported state, with the model that it was compensated by."""
        physics = saved.get("_physics") if isinstance(saved, dict) else None
        if isinstance(physics, str) and physics != self._physics:
            try:
                self._compensate_by(physics, "physics.toml")
            except InputRefusedError as error:
                raise SnapshotError(f"{where}._physics: {error}") from None
        if isinstance(saved, dict) and saved.get("settling") is not None and self.settling is None:
            if self.compensation is None or self.plain is None:
                raise SnapshotError(f"{where}.settling: there is no physics.toml whose start could be waited for")
            self._settle()
        super().restore_state(saved, where, given)

    def restore_estimate(self, saved: CompensatingCraft) -> None:
        """Restore estimate and verdict from a checkpoint's craft, this one; samples, ticks and counters stay."""
        self._take_estimate(saved)
        self._take_compensation(saved)
        self._refresh_estimate()

    def _take_compensation(self, saved: CompensatingCraft) -> None:
        """Compensate as the checkpoint's craft did, where both have a model: its estimate is of such samples."""
        if self.compensation is None or saved.compensation is None:
            return
        raw = self.ticks if self.plain is None else self.plain.ticks
        senses = self.monitor.senses if self.plain is None else self.plain.monitor.senses
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
            self.plain.monitor.senses = senses


def _in_words(fit: MagnitudeFit) -> str:
    """A start and its 1 sigma."""
    sigma = np.sqrt(np.diagonal(fit.covariance))
    start = ", ".join(f"{y:.3f} +- {one:.3f}" for y, one in zip(fit.amplitudes, sigma, strict=True))
    return f"{start} of its swing off its mean"
