"""The craft as it would be without ``physics.toml``: what compensation is held against, and what replaces it.

It has a tick stage, an estimator and a verdict of its own and is given samples and references as they came, so that
what is published after compensation was stopped is what a daemon without the file would publish, bit for bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.config.settings import CraftConfig
from magcal_service.daemon.craft import learned
from magcal_service.estimators import find_method
from magcal_service.estimators.interface import Estimator
from magcal_service.model import Array
from magcal_service.ticks.assembler import Tick, TickAssembler
from magcal_service.trust.harm import HarmWatch
from magcal_service.trust.monitor import TrustMonitor
from magcal_service.wire.messages import MagnetometerSample, ReferenceSample, TelemetrySample


def newest_of(tick: Tick) -> tuple[float, Array, float]:
    """Time [s], B (3,) and |H| of a tick's newest sample [nT]."""
    return float(tick.times_s[-1]), tick.field_body_nt[-1], float(tick.reference_magnitude_nt[-1])


@dataclass(init=False, repr=False, eq=False)
class PlainBranchMemory:
    """What of ``PlainBranch`` outlives a restart, saved and restored whole."""

    ticks: TickAssembler
    estimator: Estimator
    monitor: TrustMonitor
    learned_s: float | None
    thawed: bool
    harm: HarmWatch
    _waiting: list[MagnetometerSample]


class PlainBranch(Stateful, PlainBranchMemory):
    """One craft without compensation.

    Parameters
    ----------
    config: the craft's configuration.
    x: nine errors (9,) of the model that it is held against.
    """

    worked_out = ("state",)  # the estimator's

    def __init__(self, config: CraftConfig, x: Array) -> None:
        self.config = config
        self.ticks = TickAssembler(config.ticks, config.sensor)
        self.estimator = find_method(config.filter.method).build(config)
        self.monitor = TrustMonitor(config)
        self.state = self.estimator.estimate()
        self.learned_s = None
        self.thawed = False
        self.harm = HarmWatch(x)
        self._waiting = []

    def reset(self) -> None:
        """Estimate and verdict begin anew; samples stay."""
        self.estimator.reset()
        self.monitor.reset()
        self.harm.reset()
        self.state, self.learned_s = self.estimator.estimate(), None

    def take_over(self, saved: PlainBranch) -> None:
        """Estimate and verdict of a checkpoint's; samples stay."""
        self.estimator, self.monitor, self.state = saved.estimator, saved.monitor, saved.state
        self.learned_s, self.thawed = saved.learned_s, True

    def go_on(self, ticks: TickAssembler, estimator: Estimator, monitor: TrustMonitor, learned_s: float | None) -> None:
        """Go on with what a craft without compensation has had so far."""
        self.ticks, self.estimator, self.monitor, self.learned_s = ticks, estimator, monitor, learned_s
        self.state = estimator.estimate()

    def replace_estimator(self, estimator: Estimator) -> None:
        """Go on with another estimator, which has the state of this one or of a checkpoint."""
        self.estimator, self.state = estimator, estimator.estimate()

    def restore_state(self, saved: object, where: str = "state", given: Mapping[Any, Any] | None = None) -> None:
        """Restore an exported state."""
        super().restore_state(saved, where, given)
        self.state = self.estimator.estimate()

    def reference(self, sample: ReferenceSample) -> None:
        """Take a reference as it came."""
        self.ticks.add_reference(sample)

    def rate(self, sample: TelemetrySample) -> None:
        """Take the craft's angular rate."""
        self.ticks.add_rate(sample)

    def sample(self, sample: MagnetometerSample) -> None:
        """Take a sample as it was measured; it is worked through in ``advance``, after its vector has left."""
        self._waiting.append(sample)

    def advance(self, *, frozen: bool, flush: bool = False) -> None:
        """Process what has come."""
        waiting, self._waiting = self._waiting, []
        for sample in waiting:
            self.ticks.add(sample)
        for tick in self.ticks.flush() if flush else self.ticks.ready():
            self._tick(tick, frozen=frozen)

    def _tick(self, tick: Tick, *, frozen: bool) -> None:
        if not tick.times_s.size:
            self.monitor.observe_skipped(1.0)
        elif frozen:
            self.monitor.observe_frozen()
            self.thawed = True
        else:
            if self.thawed:
                self.thawed, tick = False, replace(tick, after_gap=True)
            self._learn(tick)

    def _learn(self, tick: Tick) -> None:
        try:
            outcome, self.state = learned(self.estimator, tick)
        except np.linalg.LinAlgError:
            self.reset()
            return
        self.learned_s = float(tick.times_s[-1])
        self.monitor.observe(tick, outcome, self.state)
        self.harm.plain(*newest_of(tick))
