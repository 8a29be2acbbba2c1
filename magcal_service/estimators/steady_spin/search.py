"""From samples to a spin that the filter can start from: the buffer, and when an attempt is made and passes.

No sample is used twice.  The batch fit that starts the filter rests on the samples in the buffer and on what was known
*before the first of them*: the configured prior, or the scalar estimate as it stood then.  The scalar estimate of the
same samples serves only as the point to linearise about, and its covariance as the tie of the first, short fits.

The fit is repeated over everything since, ever more seldom, for as long as the buffer lasts.  A filter that starts on
a few minutes of samples linearises about points that differ along the direction it knows least, and takes the
difference for information: near the orbit normal it claimed half the sigma it had.  A fit has one such point.

An attempt that holds only for the newest stretch, not for the whole buffer, means that the spin changes slowly: the
next filter is given a random walk of its rate, the more the shorter it held (``RATE_WALKS``).  A short stretch proves
little, though: each time the spin is lost, the next has to hold for twice as long.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.config.settings import CraftConfig
from magcal_service.estimators.interface import Phase, StateEstimate
from magcal_service.estimators.parts.start import prior_sigma
from magcal_service.estimators.steady_spin.candidates import Candidate, Candidates
from magcal_service.estimators.steady_spin.fit import AxisTie, Prior, Samples, SpinFit, contradiction, fit_spin
from magcal_service.estimators.steady_spin.handover import failed_gate
from magcal_service.estimators.steady_spin.sample_buffer import SampleBuffer
from magcal_service.estimators.steady_spin.start import find_spin
from magcal_service.estimators.steady_spin.state import (
    SPIN_STATE_SIZE,
    SpinEstimate,
    SpinState,
    spin_estimate,
    walk_variance,
)
from magcal_service.estimators.steady_spin.watch import SpinGate, fit_quality
from magcal_service.model import Array
from magcal_service.ticks.assembler import Tick

RATE_WALKS: Final = (0.0, 1e-8, 1e-7, 1e-6, 1e-5)
"""Random walk of the body rate [rad/s/sqrt(s)], from free of torque to a despin that doubles the noise in minutes."""

_SHORTEST_S: Final = 120.0
"""Sample time before the first attempt.

Choice: 15 turns of the paper's spin, and H has turned by 7 to 15 degrees; shorter, more attempts are for nothing;
longer, it starts later.
"""

_LONGEST_PROOF_S: Final = 3600.0
"""The longest stretch that is asked for after the spin has been lost again and again."""

_NOTICED_RAD: Final = 5e-3
"""Error of the attitude at which a spin is lost, roughly."""

_CHANGING: Final = 4.0
"""A spin that was not steady throughout has to be for so many times longer than one that was."""

_RETRY: Final = 1.15
"""Each attempt or fit waits until there is this much more sample time than at the one before."""

_PAUSE_S: Final = 30.0
"""Least sample time between two attempts; below 200 s it exceeds 15 %. Choice: an attempt costs milliseconds."""

_AXIS_LIMIT: Final = 11.8
"""Squared norm (expectation 2) beyond which the configured axis is not accepted: 1 in 370 by chance."""


@dataclass(frozen=True, slots=True)
class SpinStart:
    """What the filter starts with: the state, per-axis noise [nT] of its covariance, the walk of its rate, samples."""

    state: SpinState
    noise_nt: float
    rate_walk: float
    samples: int


def retry_at(seconds: float) -> float:
    """Sample time at which to try again after an attempt, or a fit, at a sample time [s]."""
    return max(seconds * _RETRY, seconds + _PAUSE_S)


@dataclass(init=False, repr=False, eq=False)
class SpinSearchMemory:
    """What of ``SpinSearch`` outlives a restart, saved and restored whole."""

    seen: SpinEstimate | None
    gate: SpinGate
    _walks: list[float]
    _required_s: float
    _prior: Prior
    _buffer: SampleBuffer
    _refining: bool
    _seconds: float
    _last_s: float | None
    _began_s: float
    _attempt_at_s: float


class SpinSearch(Stateful, SpinSearchMemory):
    """Collects samples and tries for a start.

    Parameters
    ----------
    config: the craft's configuration.
    rate_walk: smallest random walk of the body rate [rad/s/sqrt(s)], for a spin known to change.
    axis: the configured axis; it is used as long as the samples agree with it.
    """

    def __init__(self, config: CraftConfig, rate_walk: float = 0.0, axis: AxisTie | None = None) -> None:
        self.config = config
        self._candidates = Candidates(config)
        self._axis = axis
        self._walks = [walk for walk in RATE_WALKS if walk > rate_walk]
        self._walks.insert(0, rate_walk)
        walk = np.array(config.filter.process_noise_bias_nt + config.filter.process_noise_D)
        self.error_walk: Array | None = walk**2 if walk.any() else None
        self.seen = None
        self._required_s = _SHORTEST_S
        self.begin(None, SpinGate.COLLECTING)

    @property
    def configured_prior(self) -> Prior:
        """What is known before any sample."""
        sigma = prior_sigma(self.config.filter)
        return Prior(np.zeros(len(sigma)), np.diag(sigma**2))

    @property
    def rate_walk(self) -> float:
        """The walk that the next start is given [rad/s/sqrt(s)]."""
        return self._walks[0]

    def begin(self, prior: Prior | None, why: SpinGate) -> None:
        """Restart collecting; ``prior`` is what is known without the samples to come (None: what is configured)."""
        self.gate = why
        self._prior = prior or self.configured_prior
        self._buffer = SampleBuffer()
        self._refining = False
        self._seconds = 0.0
        self._last_s = None
        self._began_s = 0.0
        self._attempt_at_s = self._required_s

    @property
    def first_attempt_s(self) -> float:
        """Sample time before which no start is tried [s]."""
        return self._required_s

    def demand_longer_proof(self, now_s: float) -> None:
        """The spin was not as steady as the last start assumed: allow process noise, and require a longer stretch."""
        self._required_s = min(2.0 * self._required_s, _LONGEST_PROOF_S)
        self._allow_more_walk(now_s - self._began_s)

    def _allow_more_walk(self, held_s: float) -> None:
        """At least a step more, and as much as turns the attitude noticeably in the time that the spin held [s]."""
        needed = _NOTICED_RAD * math.sqrt(3.0) / held_s**1.5
        while len(self._walks) > 1:
            del self._walks[0]
            if self._walks[0] >= needed:
                break

    def add(self, tick: Tick) -> None:
        """Take a tick's samples; what lay before a gap is joined to them by the spin alone, so it has to go."""
        if tick.after_gap and self._buffer.count:
            self.begin(self._prior, SpinGate.PHASE_LOST if self.gate is SpinGate.PHASE_LOST else SpinGate.COLLECTING)
        self._take(tick)

    def _take(self, tick: Tick) -> None:
        if tick.reference_eci_nt is None:
            return
        now_s = float(tick.times_s[-1])
        if self._last_s is not None:
            self._seconds += now_s - self._last_s
        else:
            self._began_s = now_s
        self._last_s = now_s
        self._buffer.add(tick.times_s, tick.field_body_nt, tick.reference_eci_nt)

    def refine(self, tick: Tick, state: SpinState, noise_nt: float) -> SpinState | SpinGate | None:
        """After a start: take a tick's samples, and when it is time a new fit to everything, from the filter's state.

        A fit that fails, or is not steady over all of it, means that the spin is lost: it sees what is too slow for the
        watch over the running filter.  With a full buffer the fits end.
        """
        if not self._refining:
            return None
        self._take(tick)
        if self._seconds < self._attempt_at_s and not self._buffer.full:
            return None
        self._attempt_at_s = retry_at(self._seconds)
        refitted = self.refit(self._buffer.samples(), state, noise_nt)
        if self._buffer.full:
            self._refining = False
            self._buffer = SampleBuffer()
        return refitted

    def refit(self, samples: Samples, state: SpinState, noise_nt: float) -> SpinState | SpinGate:
        """A new fit to samples from the filter's state at the last of them, or why there is none."""
        fit = fit_spin(samples, state, self._prior, noise_nt)
        if fit is None or not self._candidates.is_sound(fit_quality(fit)):
            return SpinGate.INCONSISTENT
        return self._with_axis(fit, samples, noise_nt)

    def attempt(self, scalar: StateEstimate) -> SpinStart | None:
        """A start, when it is time for an attempt and the attempt succeeds; ``gate`` says why not."""
        if self._seconds < self._attempt_at_s or self._last_s is None:
            return None
        if scalar.phase is not Phase.RUNNING:
            self.gate = SpinGate.NO_SCALAR_START
            return None
        self._attempt_at_s = retry_at(self._seconds)
        result = self.start_of(self._buffer.samples(), scalar, self._last_s)
        if isinstance(result, SpinGate):
            self.gate = result
            return None
        return result

    def start_of(self, samples: Samples, scalar: StateEstimate, now_s: float) -> SpinStart | SpinGate:
        """A start from samples up to now and a scalar estimate that is running, or the gate that stops it."""
        ranges = self._candidates.rate_ranges(samples.period_s())
        samples = self._candidates.within_gate(samples, scalar)
        gate = SpinGate.NO_AXIS
        for lowest, highest in ranges:
            first = samples.newest(self._candidates.first_span_s())
            guesses = find_spin(first, scalar.x, lowest, highest)
            if guesses and guesses[0].mirrored:
                gate = SpinGate.MIRRORED
                continue
            found = [self._candidates.first_fit(first, guess, scalar) for guess in guesses]
            candidates = [candidate for candidate in found if candidate is not None]
            if not candidates:
                gate = SpinGate.INCONSISTENT if guesses else gate
                continue
            nearest = min(candidates, key=lambda candidate: candidate.quality.residual_nt)
            self._record_spin(nearest, self._candidates.noise_nt(scalar), now_s)
            steady = [candidate for candidate in candidates if self._candidates.is_sound(candidate.quality)]
            if steady:
                grown = [self._candidates.grow(samples, one, scalar) for one in steady]
                best = self._candidates.chosen(grown, scalar)
                return SpinGate.POOR_COVERAGE if best is None else self._hand_over(samples, best, scalar)
            gate = SpinGate.INCONSISTENT
        return gate

    def _hand_over(self, samples: Samples, longest: Candidate, scalar: StateEstimate) -> SpinStart | SpinGate:
        """The fit that counts: with the prior that knows nothing of these samples."""
        steady_throughout = longest.span_s >= samples.span_s
        if not steady_throughout and longest.span_s < _CHANGING * self._required_s:
            return SpinGate.INCONSISTENT
        samples = samples.newest(longest.span_s)
        noise_nt = self.config.sensor.noise_nt or longest.quality.residual_nt
        fit = fit_spin(samples, longest.fit.state, self._prior, noise_nt)
        if fit is None or not self._candidates.is_sound(fit_quality(fit)):
            return SpinGate.POOR_COVERAGE
        gate = failed_gate(fit, samples, scalar)
        if gate is not None:
            return gate
        if not steady_throughout:
            self._allow_more_walk(longest.span_s)
        self._refining = not self.rate_walk and self.error_walk is None
        if not self._refining:
            self._buffer = SampleBuffer()
        gained = walk_variance(samples.span_s, self.error_walk, self.rate_walk)
        state = self._with_axis(fit, samples, noise_nt)
        state.covariance[np.diag_indices(SPIN_STATE_SIZE)] += gained
        return SpinStart(state, noise_nt, self.rate_walk, len(samples.times_s))

    def _with_axis(self, fit: SpinFit, samples: Samples, noise_nt: float) -> SpinState:
        """The fit's state, or that of a fit about the configured axis where the samples agree with it.

        The tie goes into the fit and so into the filter that runs on from it: one that runs on without the axis
        linearises about points that differ along the direction it knows least, and near the orbit normal takes the
        difference for information.
        """
        if self._axis is None or contradiction(fit.state, self._axis) > _AXIS_LIMIT:
            return fit.state
        tied = fit_spin(samples, fit.state, self._prior, noise_nt, self._axis)
        return tied.state if tied is not None and self._candidates.is_sound(fit_quality(tied)) else fit.state

    def _record_spin(self, candidate: Candidate, noise_nt: float, now_s: float) -> None:
        """Record the spin of the newest stretch, whether or not it is accepted."""
        state, level = candidate.fit.state, candidate.quality.residual_nt / noise_nt
        scaled = state.covariance * max(level, 1.0) ** 2
        seen = SpinState(state.x, state.body_from_eci, state.rate_rad_s, scaled)
        self.seen = spin_estimate(seen, now_s, consistent=self._candidates.is_sound(candidate.quality))
