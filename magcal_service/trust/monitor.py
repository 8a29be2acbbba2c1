"""Can this estimate be trusted?  Running statistics of the residual -> a verdict with reasons and remedies.

A small residual proves nothing (a collapsed solution has one), nor does a filter's covariance (it is right
only if the model is).  So the verdict combines several independent tests; each that fails is a ``Reason``.

Levels beyond which a test fails are in ``_Levels`` with their false-alarm rate on good data.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.config.settings import CraftConfig
from magcal_service.estimators.interface import Phase, StateEstimate, TickOutcome
from magcal_service.model import BIAS, D_ALL, Array, d_matrix, largest_variance
from magcal_service.residuals import white_floor
from magcal_service.ticks.assembler import Tick
from magcal_service.trust.protector import UNLOOKED_S, Protector
from magcal_service.trust.reasons import REMEDIES, Reason, reason_of
from magcal_service.trust.senses import DOUBTS, Senses
from magcal_service.trust.verdict import Trust
from magcal_service.wire.fields import fitting
from magcal_service.wire.kinds import MAX_REASONS
from magcal_service.wire.messages import Verdict


class _Levels:
    """Thresholds.  "Seldom" is below once a year of ticks on simulated good data."""

    memory_ticks: Final = 300  # ticks over which innovations are averaged
    innovation: Final = 1.6  # mean normalised innovation squared; 300 independent ones have 1 +- 0.08: seldom
    block_samples: Final = 100  # residuals in one block mean
    blocks: Final = 40  # 4000 samples, over an hour at 1 Hz: what drifts more slowly is followed
    block_ratio: Final = 4.0  # mean of (block mean / its sigma)^2; 40 independent ones have at most 1 +- 0.22: seldom
    spectrum_samples: Final = 512  # of the newest residuals: the white-noise level is known to 4 %
    spectrum_every: Final = 64  # ticks between two evaluations of it: an eighth of the samples is new
    rejected_share: Final = 0.15  # the gate stops 2e-9 of noise; choice: one in seven is more than single spikes
    sudden_samples: Final = 10  # samples over which a sudden fault shows
    sudden_share: Final = 0.5  # most are rejected: the errors jumped or the sensor fails; one in ten may be a spike
    stale_s: Final = 6000.0  # an orbit
    eigenvalues: Final = (0.5, 2.0)  # of I + D
    aliasing_turn: Final = 0.04  # of a turn, distance of the phase step from 0 or a half
    noise_share: Final = 0.05  # noise over |H|; the covariance is found short beyond it
    magnitude_spread: Final = 0.005  # of |H| over its median, by ``ReferenceSense``
    noise_ratio: Final = (0.6, 1.6)  # of the noise seen to the noise stated; 300 residuals give it to 4 %: seldom
    held_factor: Final = 1.1  # samples to a reading; one repeat in ten is no sensor that holds its readings
    followed_ticks: Final = 600  # two memories: one jump taken for another was followed anew after 224 and 448
    silent_s: Final = 60.0  # without a reference or with a stuck sensor
    coverage_ticks: Final = 12_000  # two orbits: by then every direction has occurred that will


_MANY_SPIKES: Final = 0.02
"""Share of the samples stopped by the gate from which on the residual's width says nothing of the noise."""


def _is_collapsed(x: Array) -> bool:
    """Whether an eigenvalue of I + D is out of bounds; for small elements of D without computing any."""
    low, high = _Levels.eigenvalues
    if 3.0 * max(map(abs, x[D_ALL].tolist())) < min(1.0 - low, high - 1.0):  # Gershgorin's discs
        return False
    eigenvalues = np.linalg.eigvalsh(np.eye(3) + d_matrix(x))
    return bool(eigenvalues[0] < low or eigenvalues[-1] > high)


@dataclass(init=False, repr=False, eq=False)
class TrustMonitorMemory:
    """What of ``TrustMonitor`` outlives a restart, saved and restored whole."""

    _innovation: float
    _rejected_share: float
    _ticks: int
    _since_start: int
    _restarts: int
    _followed: int
    _since_jump: int
    _residuals: deque[float]
    _floor_nt: float
    _block: list[float]
    _block_spread_nt2: float
    _blocks: deque[float]
    _block_ratio: float
    senses: Senses
    _square: float
    _last_sample_s: float | None
    _aliased: float
    _unpaired_s: float
    _fault: Reason | None
    _driver_missing: bool
    _compensation_stopped: bool
    _model_doubtful: bool
    _local: bool
    _sudden_share: float
    _frozen: bool
    _unchecked_s: float
    protector: Protector
    _held_factor: float


class TrustMonitor(Stateful, TrustMonitorMemory):
    """Monitors one craft's ticks.

    Parameters
    ----------
    config: the craft's configuration.
    """

    def __init__(self, config: CraftConfig) -> None:
        self.config = config
        self.protector = Protector(config)
        self.reset()

    def reset(self) -> None:
        """Back to the initial state, as after a reset of the estimator."""
        self._innovation = self._rejected_share = 0.0
        self._ticks = self._since_start = self._restarts = self._followed = 0
        self._since_jump = _Levels.followed_ticks
        self._residuals = deque(maxlen=_Levels.spectrum_samples)
        self._floor_nt = 0.0
        self._block = []
        self._block_spread_nt2 = 0.0  # what the estimate's error may add to the present block's mean
        self._blocks = deque(maxlen=_Levels.blocks)
        self._block_ratio = 0.0
        self.senses = Senses(self.config)
        self._square = 0.0
        self._last_sample_s = None
        self._aliased = 0.0
        self._unpaired_s = 0.0
        self._fault = None
        self._driver_missing = False
        self._compensation_stopped = False
        self._model_doubtful = False
        self._local = False
        self._sudden_share = 0.0
        self._frozen, self._unchecked_s = False, 0.0
        self.protector.reset()
        self._held_factor = 1.0

    @property
    def residual_rms_nt(self) -> float:
        """Running rms of the scalar residual [nT]; one beyond the filter's gate counts as if at the gate."""
        return math.sqrt(self._square)

    @property
    def innovation(self) -> float:
        """Running mean of the normalised innovation squared; 1 where the covariance is right."""
        return self._innovation

    @property
    def rejected_share(self) -> float:
        """Running share of samples that the gate stopped."""
        return self._rejected_share

    @property
    def white_noise_nt(self) -> float:
        """White-noise level of the newest residuals [nT], 0 while there are too few."""
        return self._floor_nt

    @property
    def seen(self) -> dict[Reason, str]:
        """What was seen of each reason that has figures of its own, in words."""
        seen = dict(self.senses.said)
        if self._held_factor > _Levels.held_factor:
            seen[Reason.HELD_READINGS] = f"each reading comes {self._held_factor:.1f} times"
        noise_nt = self._misstated_noise_nt()
        if noise_nt:
            seen[Reason.NOISE_MISSTATED] = f"noise is {noise_nt:.0f} nT, stated are {self.config.sensor.noise_nt:g} nT"
        return seen

    def _misstated_noise_nt(self) -> float:
        """What the noise is, where ``sensor.noise_nt`` is stated far too small or too large [nT]; 0 where it is not.

        Too small by the white part of the residual, which no missing physics raises; too large by all of it.
        """
        stated_nt, (low, high) = self.config.sensor.noise_nt, _Levels.noise_ratio
        if stated_nt is None or self._since_start < _Levels.memory_ticks or not self._floor_nt:
            return 0.0
        if self._rejected_share > _MANY_SPIKES:  # those that pass the gate widen the rest
            return 0.0
        if self._floor_nt > high * stated_nt:
            return self._floor_nt
        return self.residual_rms_nt if self.residual_rms_nt < low * stated_nt else 0.0

    def observe(self, tick: Tick, outcome: TickOutcome, estimate: StateEstimate) -> None:
        """Update the statistics with one tick."""
        if estimate.restarts != self._restarts:
            self._restarts, self._since_start = estimate.restarts, 0
            self._block.clear()
            self._blocks.clear()
            self._residuals.clear()
        self.protector.observe(tick, estimate)
        self._ticks += 1
        self._unpaired_s = self._unchecked_s = 0.0
        self._frozen = False
        self.senses.observe(tick, estimate)
        self._observe_sampling(tick)
        if outcome.phase is not Phase.RUNNING or not outcome.used + outcome.rejected:
            return
        self._since_start += 1
        self._since_jump = 0 if estimate.followed > self._followed else self._since_jump + 1
        self._followed = estimate.followed
        memory = 1.0 / min(self._since_start, _Levels.memory_ticks)
        total = outcome.used + outcome.rejected
        self._rejected_share += memory * (outcome.rejected / total - self._rejected_share)
        weight = min(1.0, total / _Levels.sudden_samples)
        self._sudden_share += weight * (outcome.rejected / total - self._sudden_share)
        if outcome.degrees:
            self._innovation += memory * (outcome.squared_innovation / outcome.degrees - self._innovation)
        gate_nt = self.config.filter.gate_sigma * max(estimate.noise_nt, 1e-9)
        # a single outlier is no structure
        residual_nt = [min(max(value, -gate_nt), gate_nt) for value in outcome.residual_nt.tolist()]
        self._square += memory * (math.fsum([value * value for value in residual_nt]) / total - self._square)
        self._observe_residual(residual_nt, tick, estimate)

    def _observe_sampling(self, tick: Tick) -> None:
        """How far the phase step of the spin is from a whole or half turn, averaged."""
        times = tick.times_s.tolist()
        if self.config.spin is not None and self._last_sample_s is not None and not tick.after_gap:
            turns = (times[0] - self._last_sample_s) * abs(self.config.spin.rate_rpm) / 60.0
            near = abs(2.0 * turns - round(2.0 * turns)) / 2.0 < _Levels.aliasing_turn and turns > 0.25
            self._aliased += (float(near) - self._aliased) / min(self._ticks, _Levels.memory_ticks)
        self._last_sample_s = times[-1]

    def _observe_residual(self, residual_nt: list[float], tick: Tick, estimate: StateEstimate) -> None:
        for value in residual_nt:
            if not self._block:
                self._block_spread_nt2 = largest_variance(estimate.covariance, tick.field_body_nt[0])
            self._residuals.append(value)
            self._block.append(value)
            if len(self._block) == _Levels.block_samples:
                variance = max(estimate.noise_nt, 1e-9) ** 2 / _Levels.block_samples + self._block_spread_nt2
                self._blocks.append((math.fsum(self._block) / _Levels.block_samples) ** 2 / variance)
                self._block_ratio = math.fsum(self._blocks) / len(self._blocks)
                self._block.clear()
        if self._since_start % _Levels.spectrum_every == 0 and len(self._residuals) >= _Levels.spectrum_samples // 2:
            self._floor_nt = white_floor(np.array(self._residuals))

    def observe_skipped(self, seconds: float) -> None:
        """A tick was skipped: samples have had no reference for so long [s]."""
        self._unpaired_s += seconds

    def observe_frozen(self) -> None:
        """A tick had its reference, but it was not used for the estimate."""
        self._unpaired_s = 0.0
        self._frozen = True

    def observe_freeze(self, frozen: bool) -> None:
        """Ticks are not used for the estimate from now on, or they are again."""
        self._frozen = frozen

    def observe_held(self, factor: float) -> None:
        """How many samples there are to a reading of the sensor."""
        self._held_factor = factor

    def observe_driver(self, missing: bool) -> None:
        """Whether an effect that is to be compensated could not be, for want of its driver."""
        self._driver_missing = missing

    def observe_compensation(self, *, stopped: bool) -> None:
        """Whether ``physics.toml`` is loaded and not compensated, because it made the residual worse."""
        self._compensation_stopped = stopped

    def observe_model(self, doubtful: bool) -> None:
        """Whether the residual follows something that the model leaves out (``model_watch``)."""
        self._model_doubtful = doubtful

    def observe_local(self, local: bool) -> None:
        """Whether a disturbance is seen by this magnetometer of the craft alone (``watch.witness``)."""
        self._local = local

    def observe_fault(self, fault: Reason | None) -> None:
        """The sensor's fault from now on; None: none any more."""
        self._fault = fault

    def observe_unchecked(self, seconds: float) -> bool:
        """The newest sample is so much newer than those learned from [s]; whether a verdict depends on the change."""
        before = self._is_stale(), self._is_unlooked()
        self._unchecked_s = seconds
        return (self._is_stale(), self._is_unlooked()) != before

    def _is_stale(self) -> bool:
        return self._unchecked_s > _Levels.stale_s

    def _is_unlooked(self) -> bool:
        return self._unchecked_s > UNLOOKED_S

    def judge(self, estimate: StateEstimate) -> Trust:
        """The verdict on an estimate as it stands."""
        if estimate.phase is Phase.STARTING and not estimate.restarts:
            return self._before_start(estimate)
        reasons = tuple(self._doubts(estimate))
        waiting = tuple(self._unfinished(estimate))
        everything = (reasons + waiting)[:MAX_REASONS]
        if reasons and set(reasons) - self._information():
            verdict = Verdict.DOUBTFUL
        elif waiting:
            verdict = Verdict.CONVERGING
        else:
            verdict = Verdict.TRUSTED
        return self._trust(verdict, everything, estimate)

    def _trust(self, verdict: Verdict, reasons: tuple[Reason, ...], estimate: StateEstimate) -> Trust:
        level = self.protector.level_of(estimate, self._unchecked_s)
        remedy = self._remedy(reasons[0]) if reasons else ""
        if reasons and reasons[0] is Reason.UNPROTECTED:
            remedy = self.protector.remedy(estimate, level) or remedy
        if level is None:
            return Trust(verdict, reasons, remedy, no_level=self.protector.why_none(estimate, self._unchecked_s))
        return Trust(verdict, reasons, remedy, level.nt, str(level.by))

    def _before_start(self, estimate: StateEstimate) -> Trust:
        reasons = self._silence()  # first: while nothing is learned, waiting helps against nothing else
        if self._is_aliased():
            reasons.append(Reason.SPIN_ALIASING)
        if estimate.waiting_for:
            reasons.append(reason_of(estimate.waiting_for))
        reasons += [*self._sensed(), Reason.COLLECTING]
        return Trust(Verdict.NOT_STARTED, tuple(reasons), self._remedy(reasons[0]))

    def _information(self) -> set[Reason]:
        """Reasons that are reported but do not make the estimate doubtful by themselves."""
        short = {Reason.NO_REFERENCE} if self._unpaired_s <= _Levels.silent_s else set()
        remarks = {Reason.HELD_READINGS, Reason.NOISE_MISSTATED}
        return {Reason.SPIN_CONTRADICTED, Reason.FROZEN, Reason.COMPENSATION_STOPPED} | remarks | short

    def _silence(self) -> list[Reason]:
        silent = [Reason.NO_REFERENCE] if self._unpaired_s > 0.0 else []
        frozen = [Reason.FROZEN] if self._frozen else []
        stopped = [Reason.COMPENSATION_STOPPED] if self._compensation_stopped else []
        return [*silent, *([] if self._fault is None else [self._fault]), *frozen, *stopped]

    def _sensed(self) -> list[Reason]:
        return [reason for reason in DOUBTS if reason in self.senses.said]

    def _remarks(self) -> list[Reason]:
        held = [Reason.HELD_READINGS] if self._held_factor > _Levels.held_factor else []
        return [*held, Reason.NOISE_MISSTATED] if self._misstated_noise_nt() else held

    def _remedy(self, reason: Reason) -> str:
        """What to do about a reason, with what was seen where that is more than the reason says."""
        seen = self.seen.get(reason, "")
        return fitting(f"{seen}: {REMEDIES[reason]}" if seen else REMEDIES[reason])

    def _is_aliased(self) -> bool:
        return self._aliased > 0.5 and self._ticks >= 30

    def _doubts(self, estimate: StateEstimate) -> list[Reason]:
        levels, noise_nt = _Levels, max(estimate.noise_nt, 1e-9)
        settled = self._since_start >= levels.memory_ticks // 3
        floor_nt = self.config.sensor.noise_nt or self._floor_nt or noise_nt
        questions = (
            (Reason.LOCAL_DISTURBANCE, self._local),
            (Reason.COLLAPSED, _is_collapsed(estimate.x)),
            (Reason.RESTARTED, bool(estimate.restarts) and self._since_start < self.config.trust.min_ticks),
            (Reason.INCONSISTENT, settled and self._innovation > levels.innovation),
            (
                Reason.STRUCTURED_RESIDUAL,
                settled and self.residual_rms_nt > self.config.trust.residual_ratio * floor_nt,
            ),
            (Reason.DRIFTING_RESIDUAL, len(self._blocks) >= 10 and self._block_ratio > levels.block_ratio),
            (Reason.MODEL_DOUBTFUL, self._model_doubtful or self.protector.seen is not None),
            (
                Reason.MANY_REJECTED,
                (settled and self._rejected_share > levels.rejected_share) or self._sudden_share > levels.sudden_share,
            ),
            (Reason.STALE, self._is_stale()),
            (Reason.DRIVER_MISSING, self._driver_missing),
            (Reason.SPIN_ALIASING, self._is_aliased()),
            (Reason.SPIN_CONTRADICTED, estimate.spin_given_up),
            (Reason.NOISE_TOO_HIGH, floor_nt > levels.noise_share * self.senses.reference.mean_nt),
            (
                Reason.CONSTANT_REFERENCE,
                self.senses.reference.spread_nt < levels.magnitude_spread * self.senses.reference.mean_nt
                and self._ticks >= levels.memory_ticks,
            ),
        )
        return self._sensed() + [reason for reason, bad in questions if bad] + self._silence() + self._remarks()

    def _unfinished(self, estimate: StateEstimate) -> list[Reason]:
        settings = self.config.trust
        variances = estimate.covariance.diagonal().tolist()
        unfinished = []
        if estimate.phase is Phase.STARTING:
            unfinished.append(Reason.COLLECTING)
        if max(variances[BIAS]) > settings.sigma_bias_nt**2 or max(variances[D_ALL]) > settings.sigma_D**2:
            late = self._ticks > _Levels.coverage_ticks
            unfinished.append(Reason.POOR_COVERAGE if late else Reason.NOT_SETTLED)
        elif self._since_start < settings.min_ticks or self._since_jump < _Levels.followed_ticks:
            unfinished.append(Reason.NOT_SETTLED)
        if estimate.phase is Phase.RUNNING and self.protector.applies_to(estimate):
            level = self.protector.level_of(estimate, self._unchecked_s)
            if level is None or level.nt > settings.protection_nt:
                unfinished.append(Reason.UNPROTECTED)
        return unfinished
