"""What |B| against |H| cannot show, and something else can: each sense watches one thing beside it.

A swap or flip of axes leaves |B| as it is, and so the residual, the estimate and its covariance.  The vector's own
continuity shows it (``axes_watch``), a stated spin (``spin_sense``) or a gyro (``rate_sense``); the reference's course
shows one that repeats (``reference_sense``), the way of the positions that it is made of one at another height
(``height_sense``).
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.config.settings import CraftConfig
from magcal_service.estimators.interface import Phase, StateEstimate
from magcal_service.model import BIAS, d_matrix
from magcal_service.samples.axes_watch import AxesWatch
from magcal_service.samples.signed_axes import any_of
from magcal_service.ticks.assembler import SECOND_NS, Tick
from magcal_service.trust.height_sense import HeightSense
from magcal_service.trust.rate_sense import RateSense
from magcal_service.trust.reasons import Reason
from magcal_service.trust.reference_sense import ReferenceSense
from magcal_service.trust.spin_sense import SpinSense
from magcal_service.wire.messages import Clock

DOUBTS: Final = (
    Reason.AXES_CHANGED, Reason.RATE_DISAGREES, Reason.SPIN_DISAGREES, Reason.HEIGHT_DISAGREES, Reason.REFERENCE_HELD,
)  # fmt: skip
"""Reasons that a sense gives, the gravest first; each makes an estimate doubtful."""


@dataclass(init=False, repr=False, eq=False)
class SensesMemory:
    """What of ``Senses`` outlives a restart, saved and restored whole."""

    axes: AxesWatch
    spin: SpinSense | None
    rate: RateSense
    reference: ReferenceSense
    height: HeightSense
    said: dict[Reason, str]


class Senses(Stateful, SensesMemory):
    """All senses of one craft.

    Parameters
    ----------
    config: the craft's configuration.

    Attributes
    ----------
    said: each reason of ``DOUBTS`` that stands now, with what was seen, in words with figures.
    """

    def __init__(self, config: CraftConfig) -> None:
        self.axes = AxesWatch()
        self.spin = None if config.spin is None else SpinSense(config.spin)
        self.rate = RateSense()
        self.reference = ReferenceSense()
        self.height = HeightSense()
        self.said = {}

    def observe(self, tick: Tick, estimate: StateEstimate) -> None:
        """Take a tick, in order of time, with the estimate as it stands."""
        if tick.after_gap:
            self._interrupt()
        changes = self.axes.changes
        times_s = tick.times_s.tolist()
        for time_s, field_nt in zip(times_s, map(tuple, tick.field_body_nt.tolist()), strict=True):
            self.axes.push(time_s, field_nt)
            if self.spin is not None:
                self.spin.push(time_s, field_nt)
        self._observe_rate(tick, estimate)
        self.reference.push(times_s[-1], float(tick.reference_magnitude_nt[-1]))
        if self.axes.changes != changes:
            self._say_axes(tick)
        self._say(Reason.RATE_DISAGREES, self.rate.said)
        self._say(Reason.SPIN_DISAGREES, "" if self.spin is None else self.spin.said)
        self._say(Reason.HEIGHT_DISAGREES, self.height.said)
        self._say(Reason.REFERENCE_HELD, self._held(estimate.noise_nt))

    def _interrupt(self) -> None:
        self.axes.interrupt()
        self.rate.interrupt()
        if self.spin is not None:
            self.spin.interrupt()

    def _observe_rate(self, tick: Tick, estimate: StateEstimate) -> None:
        if tick.rate_body_rad_s is None or estimate.phase is not Phase.RUNNING:
            self.rate.interrupt()
            return
        x, field = estimate.x, tick.field_body_nt[-1]
        calibrated = (np.eye(3) + d_matrix(x)) @ field - x[BIAS]
        self.rate.push(float(tick.times_s[-1]), calibrated, tick.rate_body_rad_s[-1])

    def _held(self, noise_nt: float) -> str:
        reference = self.reference
        if reference.held_s:
            return f"the reference has kept one value for {reference.held_s:.0f} s"
        if reference.step_nt > max(noise_nt, 1.0):
            return f"the reference goes on in held steps of about {reference.step_nt:.0f} nT"
        return ""

    def _say_axes(self, tick: Tick) -> None:
        seconds = self.axes.since_s - float(tick.times_s[-1])
        since = _in_words(tick.time_ns + round(seconds * SECOND_NS), tick.clock)
        changes = self.axes.changes
        self._say(Reason.AXES_CHANGED, f"axes look as if {any_of(changes)} since {since}" if changes else "")

    def _say(self, reason: Reason, seen: str) -> None:
        if seen:
            self.said[reason] = seen
        elif reason in self.said:
            del self.said[reason]


def _in_words(time_ns: int, clock: Clock) -> str:
    """A source time for a reader."""
    if clock is Clock.ELAPSED:
        return f"{time_ns * 1e-9:.1f} s"
    try:
        return f"{datetime.fromtimestamp(time_ns // SECOND_NS, UTC):%Y-%m-%d %H:%M:%S} UTC"
    except (ValueError, OverflowError):
        return f"{time_ns * 1e-9:.0f} s of UTC"
