"""The spin estimator: nine errors, attitude and rate of a steadily turning craft, from the reference *vector*.

It beats every scalar method because it uses three components of each sample where they use the magnitude, and it needs
no attitude: a craft that turns freely carries its own.  A scalar ``ukf`` runs beside it.  That one provides the safe
start, and its estimate is what is published whenever the craft does not turn as assumed or the reference is not an
inertial vector; ``fallback`` says why.

Where a spin axis is configured, it is taken at its word, as equation (6) does, for as long as the samples agree: the
estimate is conditioned on it.  A craft that turns about another axis contradicts it, and the axis stays free.

Source: Cetin, Soken, Tekinalp 2020, equation (1), and Lefferts, Markley & Shuster 1982; the combination is this
project.  ``docs/spin-estimator.md`` holds the reasons and the figures.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.config.settings import CraftConfig
from magcal_service.estimators.interface import InformationSet, Method, Phase, StateEstimate, TickOutcome
from magcal_service.estimators.parts.spin_window import across_axis
from magcal_service.estimators.steady_spin.fit import AxisTie, Prior
from magcal_service.estimators.steady_spin.search import SpinSearch, SpinStart
from magcal_service.estimators.steady_spin.state import ERRORS, SPIN_STATE_SIZE, SpinEstimate, SpinState, spin_estimate
from magcal_service.estimators.steady_spin.watch import SpinGate, SpinWatch
from magcal_service.estimators.ukf import Ukf
from magcal_service.model import Array
from magcal_service.ticks.assembler import Tick

_PHASE_LOST_RAD: Final = 0.3
"""1 sigma of the attitude beyond which a gap has cost the phase: the update is no longer near linear."""

SMALLEST_AXIS_SIGMA_RAD: Final = 1e-6
"""An axis known better than this is known exactly; the arithmetic stays sound."""

_NOISE_MEMORY: Final = 600
"""Samples over which an unknown noise level is averaged."""

_LONGEST_SILENCE_S: Final = 60.0
"""Without a reference vector for longer than this, the scalar estimate is published, which still learns."""


def configured_tie(config: CraftConfig, sigma_rad: float) -> AxisTie | None:
    """The configured spin axis, known to ``sigma_rad``; None where none is configured."""
    if config.spin is None:
        return None
    return AxisTie(across_axis(np.array(config.spin.axis)), max(sigma_rad, SMALLEST_AXIS_SIGMA_RAD))


@dataclass(init=False, repr=False, eq=False)
class SpinTrackerMemory:
    """What of ``SpinTracker`` outlives a restart, saved and restored whole."""

    state: SpinState
    time_s: float
    noise_variance: float
    _noise_samples: int
    _rate_walk: float
    _watch: SpinWatch
    lost: SpinGate | None


class SpinTracker(Stateful, SpinTrackerMemory):
    """The running filter with its noise level and its watch.

    Parameters
    ----------
    config: the craft's configuration.
    start: where it begins.
    error_walk: variance that the nine errors gain per second (9,), or None.
    time_s: sample time of the start [s].
    """

    def __init__(self, config: CraftConfig, start: SpinStart, error_walk: Array | None, time_s: float) -> None:
        self.state = start.state
        self.time_s = time_s
        self.noise_variance = start.noise_nt**2
        self._learning = config.sensor.noise_nt is None
        self._noise_samples = min(start.samples, _NOISE_MEMORY)
        self._limit = config.filter.gate_sigma**2 + 3.0
        self._error_walk, self._rate_walk = error_walk, start.rate_walk
        self._watch = SpinWatch()
        self.lost = None

    def handle(self, tick: Tick, reference_eci_nt: Array) -> TickOutcome:
        """Update with the samples of a tick; ``lost`` says whether the spin is still what it was."""
        if tick.after_gap:
            self._watch.gap()
        residuals, squared, used = np.empty(len(tick.times_s)), 0.0, 0
        for i, time_s in enumerate(tick.times_s.tolist()):
            self.state.predict(time_s - self.time_s, self._error_walk, self._rate_walk)
            self.time_s = time_s
            if tick.after_gap and i == 0 and self.state.attitude_sigma_rad() > _PHASE_LOST_RAD:
                self.lost = SpinGate.PHASE_LOST
            innovation = self.state.innovation(tick.field_body_nt[i], reference_eci_nt[i], self.noise_variance)
            w = innovation.value + innovation.field_body_nt
            residuals[i] = math.sqrt(float(w @ w)) - float(tick.reference_magnitude_nt[i])
            norm = innovation.squared_norm()
            if norm > self._limit:
                self.lost = self._watch.rejected() or self.lost
                continue
            self.state.apply(innovation)
            self.lost = self._watch.accepted(innovation, self.state.body_from_eci) or self.lost
            squared, used = squared + norm, used + 1
            if self._learning:
                self._learn_noise(norm)
        return TickOutcome(Phase.RUNNING, residuals, used, len(residuals) - used, squared, 3 * used)

    def _learn_noise(self, squared_norm: float) -> None:
        """Follow an unknown noise level by the normalised innovation; the covariance follows, so all samples weigh the
        same."""
        self._noise_samples = min(self._noise_samples + 1, _NOISE_MEMORY)
        factor = 1.0 + (squared_norm / 3.0 - 1.0) / self._noise_samples
        self.noise_variance *= factor
        self.state.covariance = self.state.covariance * factor


@dataclass(init=False, repr=False, eq=False)
class SpinFilterMemory:
    """What of ``SpinFilter`` outlives a restart, saved and restored whole."""

    _scalar: Ukf
    _search: SpinSearch
    _tracker: SpinTracker | None
    _silent_s: float
    _samples: int
    _rejected: int
    _restarts: int
    _scalar_restarts: int
    fallbacks: int


class SpinFilter(Stateful, SpinFilterMemory):
    """One craft's spin estimator with its scalar fallback.

    Parameters
    ----------
    config: the craft's configuration (sensor, spin, filter); without a spin the whole range of rates is searched.
    axis_sigma_rad: how well the configured axis is known [rad]; 0: exactly, until the samples contradict it.
    rate_walk: random walk of the body rate to begin with [rad/s/sqrt(s)]; it is raised where the spin changes.
    """

    name = "spin"

    def __init__(self, config: CraftConfig, axis_sigma_rad: float = 0.0, rate_walk: float = 0.0) -> None:
        self.config = config
        self._axis = configured_tie(config, axis_sigma_rad)
        self._rate_walk = rate_walk
        self._scalar = Ukf(replace(config, spin=None))
        self.reset()

    def reset(self) -> None:
        """Back to the prior, before any sample."""
        self._scalar.reset()
        self._search = SpinSearch(self.config, self._rate_walk, self._axis)
        self._tracker = None
        self._silent_s = 0.0
        self._samples = self._rejected = self._restarts = 0
        self._scalar_restarts = 0
        self.fallbacks = 0

    def restore_state(self, saved: object, where: str = "state", given: Mapping[Any, Any] | None = None) -> None:
        """Take over an exported state; a running filter is made first, for the state to be put into."""
        if isinstance(saved, dict) and saved.get("_tracker") is not None:
            blank = SpinState(np.zeros(9), np.eye(3), np.zeros(3), np.eye(SPIN_STATE_SIZE))
            start = SpinStart(blank, 1.0, self._rate_walk, 0)
            self._tracker = SpinTracker(self.config, start, self._search.error_walk, 0.0)
        super().restore_state(saved, where, given)

    @property
    def fallback(self) -> SpinGate | None:
        """Why the estimate is the scalar filter's; None while it is that of the spin."""
        if self._tracker is None:
            return self._search.gate
        return SpinGate.NO_VECTOR if self._silent_s > _LONGEST_SILENCE_S else None

    @property
    def spin(self) -> SpinEstimate | None:
        """The spin as the filter knows it, or else what the last attempt at a start saw; None before any."""
        if self._tracker is None:
            return self._search.seen
        return spin_estimate(self._tracker.state, self._tracker.time_s, consistent=True)

    def handle(self, tick: Tick) -> TickOutcome:
        """Take one tick: the scalar filter always, then the spin's, or an attempt to start it."""
        scalar = self._scalar.handle(tick)
        self._follow_scalar()
        outcome = self._track(tick) if self._tracker is not None else self._collect(tick)
        if outcome is None or self.fallback is not None:
            outcome = scalar
        self._samples += outcome.used
        self._rejected += outcome.rejected
        return outcome

    def _follow_scalar(self) -> None:
        """Where the scalar filter has restarted, the search restarts as well; a running spin filter is not affected."""
        restarts = self._scalar.estimate().restarts
        if restarts == self._scalar_restarts:
            return
        self._scalar_restarts = restarts
        if self._tracker is None:
            self._restarts += 1
            self._search.begin(None, SpinGate.NO_SCALAR_START)

    def _track(self, tick: Tick) -> TickOutcome | None:
        tracker = self._tracker
        if tracker is None:
            return None
        if tick.reference_eci_nt is None:
            self._silent_s = float(tick.times_s[-1]) - tracker.time_s
            return None
        self._silent_s = 0.0
        outcome = tracker.handle(tick, tick.reference_eci_nt)
        if tracker.lost is None and not outcome.rejected:
            refined = self._search.refine(tick, tracker.state, math.sqrt(tracker.noise_variance))
            if isinstance(refined, SpinGate):
                tracker.lost = refined
            elif refined is not None:
                tracker.state = refined
        if tracker.lost is not None:
            self._lose(tracker, tracker.lost)
            return None
        return outcome

    def _lose(self, tracker: SpinTracker, why: SpinGate) -> None:
        """Back to the scalar estimate; after a gap the errors keep their covariance, else that of the scalar filter."""
        self.fallbacks += 1
        self._tracker = None
        if why is SpinGate.PHASE_LOST:
            state = tracker.state
            self._search.begin(Prior(state.x, state.covariance[ERRORS, ERRORS]), why)
            return
        scalar = self._scalar.estimate()
        known = scalar.phase is Phase.RUNNING
        self._search.demand_longer_proof(tracker.time_s)
        self._search.begin(Prior(scalar.x, scalar.covariance) if known else None, why)

    def _collect(self, tick: Tick) -> TickOutcome | None:
        if tick.reference_eci_nt is None:
            self._search.gate = SpinGate.NO_VECTOR
            return None
        self._search.add(tick)
        start = self._search.attempt(self._scalar.estimate())
        if start is not None:
            self._tracker = SpinTracker(self.config, start, self._search.error_walk, float(tick.times_s[-1]))
            self._silent_s = 0.0
        return None

    def estimate(self) -> StateEstimate:
        """The estimate after the last tick."""
        scalar = self._scalar.estimate()
        counted = replace(scalar, samples=self._samples, rejected=self._rejected, restarts=self._restarts)
        tracker = self._tracker
        if tracker is None or self.fallback is not None:
            return counted
        return replace(
            counted,
            x=tracker.state.x,
            covariance=tracker.state.covariance[ERRORS, ERRORS],
            phase=Phase.RUNNING,
            noise_nt=math.sqrt(tracker.noise_variance),
            waiting_for=None,
        )


METHOD: Final = Method(
    "spin",
    "nine errors with attitude and rate of a free spin, from the reference vector",
    SpinFilter,
    bound=InformationSet.VECTOR_SPIN,
)
