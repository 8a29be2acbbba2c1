"""Spins that samples may show: where rates are searched, fits to the newest stretch, and how far each holds.

``search`` decides when one is tried and whether the filter may start from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.config.settings import CraftConfig
from magcal_service.estimators.interface import StateEstimate
from magcal_service.estimators.steady_spin.fit import Prior, Samples, SpinFit, fit_spin
from magcal_service.estimators.steady_spin.start import SpinGuess
from magcal_service.estimators.steady_spin.state import SPIN_STATE_SIZE, SpinState
from magcal_service.estimators.steady_spin.watch import FitQuality, fit_quality
from magcal_service.model import scalar_residual
from magcal_service.residuals import MEDIAN_TO_SIGMA

_FIRST_S: Final = 240.0
"""The first fit takes the newest so many seconds: H turns by 15 to 30 degrees meanwhile, which attitude rests on."""

_TURNS: Final = 2.0
"""Turns of a configured slow spin in the first fit: ``find_axis`` needs one.

Choice: the second is for a configured rate that is too high, and so too short a turn; more turns delay the start.
"""

_SLOWEST_RAD_S: Final = 0.3 * 2.0 * math.pi / 60.0
"""Slowest rate that is searched, 0.3 rpm: 1.2 turns in the first fit's 240 s; what is slower shows no whole turn."""

_FASTEST_RAD_S: Final = 35.0 * 2.0 * math.pi / 60.0
"""Fastest rate that is searched, 35 rpm.

Choice: the grid over 240 s has 873 rates either way, and the search's time grows in proportion; a faster craft has to
be configured.
"""

_AROUND: Final = (0.8, 1.25)
"""Factors on a configured rate between which it is searched first: a quarter off either way."""

_BAD_FIT: Final = 3.0
"""Residual over the given noise beyond which a fit is no fit."""

_CLEARLY_WORSE: Final = 30.0
"""Squares of the noise that a fit has to be worse by to be ruled out; by chance once in 10^6."""

_SAME_TURN_RAD: Final = 0.05
"""Two fits whose rates differ by less than this over their span are the same fit."""

_GROWTH: Final = 2.0
"""Factor by which a fit's span grows.

Choice: a fit gives the rate well enough to carry its phase over twice its span; a smaller factor takes more fits, a
larger one steps over the place where the spin stops being steady more often.
"""

_SMALLEST_GROWTH: Final = 1.1
"""Growth below which the longest steady stretch is found; 2, 1.41 and 1.19 are tried.

Choice: the end of the steady stretch is then known to a fifth of its length; finer, more fits.
"""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A fit to the newest samples, how good it is, and the span of the samples [s]."""

    fit: SpinFit
    quality: FitQuality
    span_s: float


class Candidates:
    """Finds and compares spins in samples, beside a scalar estimate of the same samples.

    Parameters
    ----------
    config: the craft's configuration.
    """

    def __init__(self, config: CraftConfig) -> None:
        self.config = config

    def rate_ranges(self, period_s: float) -> list[tuple[float, float]]:
        """Around the configured rate first, then everywhere samples so far apart allow."""
        nyquist = 0.98 * math.pi / period_s
        ranges = [(_SLOWEST_RAD_S, min(nyquist, _FASTEST_RAD_S))]
        if self.config.spin is not None:
            configured = abs(self.config.spin.rate_rpm) * 2.0 * math.pi / 60.0
            ranges.insert(0, (_AROUND[0] * configured, _AROUND[1] * configured))
        return [(lowest, highest) for lowest, highest in ranges if highest > lowest]

    def within_gate(self, samples: Samples, scalar: StateEstimate) -> Samples:
        """Without those that the scalar filter would have stopped at its gate."""
        magnitude_nt = np.linalg.norm(samples.reference_eci_nt, axis=1)
        residual = np.abs(scalar_residual(scalar.x, samples.field_nt, magnitude_nt))
        level = max(MEDIAN_TO_SIGMA * float(np.median(residual)), self.noise_nt(scalar))
        return samples.where(residual < self.config.filter.gate_sigma * level)

    def first_span_s(self) -> float:
        """A configured spin may be slow: the first fit needs its turns."""
        if self.config.spin is None:
            return _FIRST_S
        return max(_FIRST_S, _TURNS * 60.0 / abs(self.config.spin.rate_rpm))

    def _tie(self, scalar: StateEstimate) -> Prior:
        return Prior(scalar.x, self.config.filter.start_inflation**2 * scalar.covariance)

    def first_fit(self, samples: Samples, guess: SpinGuess, scalar: StateEstimate) -> Candidate | None:
        """The fit to a stretch from a guess; None where it does not arrive."""
        nothing = np.zeros((SPIN_STATE_SIZE, SPIN_STATE_SIZE))
        start = SpinState(scalar.x, guess.body_from_eci, guess.rate_rad_s, nothing)
        fit = fit_spin(samples, start, self._tie(scalar), self.noise_nt(scalar))
        return None if fit is None else Candidate(fit, fit_quality(fit), samples.span_s)

    def grow(self, samples: Samples, candidate: Candidate, scalar: StateEstimate) -> Candidate:
        """The longest stretch over which the spin is steady: longer by a factor each time, a smaller one on failure."""
        factor = _GROWTH
        while candidate.span_s < samples.span_s and factor > _SMALLEST_GROWTH:
            longer = samples.newest(min(factor * candidate.span_s + 1.0, samples.span_s))
            fit = fit_spin(longer, candidate.fit.state, self._tie(scalar), self.noise_nt(scalar))
            trial = None if fit is None else Candidate(fit, fit_quality(fit), longer.span_s)
            if trial is None or not self.is_sound(trial.quality):
                factor = math.sqrt(factor)
            else:
                candidate = trial
        return candidate

    def chosen(self, candidates: list[Candidate], scalar: StateEstimate) -> Candidate | None:
        """The candidate that holds for longest; of two that hold equally long the clearly better one, or none."""
        span_s = max(candidate.span_s for candidate in candidates)
        best, *rivals = sorted(
            (candidate for candidate in candidates if candidate.span_s == span_s),
            key=lambda candidate: candidate.quality.residual_nt,
        )
        noise_nt = self.noise_nt(scalar)
        for rival in rivals:
            worse = rival.quality.squared_sum_nt2 - best.quality.squared_sum_nt2
            apart = float(np.abs(rival.fit.state.rate_rad_s - best.fit.state.rate_rad_s).max()) * best.span_s
            if worse < _CLEARLY_WORSE * noise_nt**2 and apart > _SAME_TURN_RAD:
                return None
        return best

    def noise_nt(self, scalar: StateEstimate) -> float:
        """Noise that fits are weighted with, 1 sigma per axis [nT]: what is configured, else the scalar filter's."""
        return self.config.sensor.noise_nt or max(scalar.noise_nt, 1e-3)

    def is_sound(self, quality: FitQuality) -> bool:
        """Whether a fit is steady throughout and leaves no more than some times the noise that is configured."""
        given = self.config.sensor.noise_nt
        return quality.steady and (given is None or quality.residual_nt < _BAD_FIT * given)
