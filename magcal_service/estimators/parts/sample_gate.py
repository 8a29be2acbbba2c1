"""Beyond which innovation a sample is left out.

A wrong sample within the gate moves the estimate by as many of its sigmas as its innovation has, times that of the
spread over the noise.  Where the estimate hardly spreads that is nothing.  Right after a start, whose sigmas were
inflated for the handover, it would be a dozen, and the estimate, overconfident by then, would be trusted while it still
comes back.  So a sample is judged by what the spread was before the inflation, yet never more strictly than by 3 sigma
of its innovation.  Where a process noise or a jump that was followed widens the spread in flight, nothing tells what of
it was inflated, and it is believed as it is.

Original to this project.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from magcal_service.config.settings import FilterConfig
from magcal_service.model import Array

Share = TypeVar("Share", float, Array)

_ALWAYS_TAKEN: Final = 3.0**2
"""Normalised innovation squared that is never left out: one sound sample in 370 is beyond."""


@dataclass(frozen=True, slots=True)
class SampleGate:
    """The gate of a filter, in normalised innovation squared.

    Parameters
    ----------
    squared: the limit where the estimate hardly spreads, ``filter.gate_sigma`` squared.
    inflation: factor on the covariance at the handover, ``filter.start_inflation`` squared; 1 where it may widen later.
    """

    squared: float
    inflation: float

    @classmethod
    def of(cls, settings: FilterConfig) -> SampleGate:
        """The gate that a configuration asks for."""
        widens = settings.adaptive or any(settings.process_noise_bias_nt + settings.process_noise_D)
        return cls(settings.gate_sigma**2, 1.0 if widens else settings.start_inflation**2)

    def limit(self, variance: float, noise_variance: float) -> float:
        """The limit for an innovation of a variance, of which a part is the sample's own noise (the same unit)."""
        return max(self.squared * self._before(noise_variance / variance), _ALWAYS_TAKEN)

    def limits(self, variance: Array, noise_variance: float) -> Array:
        """``limit`` of many runs (r,)."""
        return np.asarray(np.maximum(self.squared * self._before(noise_variance / variance), _ALWAYS_TAKEN))

    def _before(self, own: Share) -> Share:
        """An innovation's variance before the inflation over that after it, where ``own`` of it is noise."""
        return own + (1.0 - own) / self.inflation
