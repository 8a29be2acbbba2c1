"""Does the craft turn as steadily as the ``spin`` estimator assumes?  Two tests of the vector residual.

A wrong attitude turns the predicted vector and leaves its length alone, while sensor noise has no preference: so what
the residual holds *across* the field is compared with what it holds *along* it.  And an attitude that slowly runs away
(a torque) leaves a residual that stays put in space: so its means over blocks, taken in inertial axes, are compared
with what noise leaves.  Neither test needs the noise level to be known.

Limits are set so that good data fail in less than one of 10^5 blocks; what passes costs an attitude error of some
1e-3 rad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.estimators.steady_spin.fit import SpinFit
from magcal_service.estimators.steady_spin.state import Innovation
from magcal_service.model import Array

MEMORY: Final = 300
"""Samples over which the running ratio of across to along is averaged: 1 +- 0.1."""

RATIO_LIMIT: Final = 1.6
"""Running ratio of across to along beyond which the spin is lost: six times its scatter above 1."""

_FIT_RATIO: Final = 1.2
"""Ratio across to along that a batch fit may have besides what chance explains.

Choice: a fifth more across the field at 300 nT is an attitude error of 130 nT, 3e-3 rad of 50 uT; a stricter limit
would fail long fits, which chance no longer widens, for less than that.
"""

_FIT_DRIFT: Final = 1.5
"""The same of the block means: half more than noise leaves in them. Choice, as above: 20 nT in a block at 300 nT."""

_SIGMAS: Final = 5.0
"""Scatter of ratio and drift by chance that a fit is allowed on top: 5 sigma, 3 in 10^7 to one side."""

BLOCK: Final = 128
"""Samples in a block mean."""

BLOCKS: Final = 8
"""Blocks over which their squares are averaged: 1 +- 0.29."""

DRIFT_LIMIT: Final = 2.8
"""Mean of the blocks' squares beyond which the spin is lost: 24 degrees of freedom exceed it 6 times in 10^6."""

BLOCK_LIMIT: Final = 10.0
"""The same for one block alone, a third of chi-squared with 3 degrees: 1 in 10^6."""

_LONGEST_OUTAGE: Final = 30
"""Samples rejected in a row after which the filter's attitude counts as lost."""

_AFTER_GAP: Final = 3
"""The same right after a gap, where the only thing in doubt is the phase."""


class SpinGate(StrEnum):
    """Why the estimate is the scalar filter's and not that of the spin."""

    COLLECTING = "collecting"
    NO_SCALAR_START = "no_scalar_start"
    NO_VECTOR = "no_reference_vector"
    NO_AXIS = "no_spin_axis"
    MIRRORED = "mirrored"
    INCONSISTENT = "not_a_steady_spin"
    POOR_COVERAGE = "poor_coverage"
    COLLAPSED = "collapsed"
    CONTRADICTS_SCALAR = "contradicts_scalar"
    PHASE_LOST = "phase_lost"


@dataclass(frozen=True, slots=True)
class FitQuality:
    """How a batch fit stands to noise.

    Parameters
    ----------
    residual_nt: rms per axis [nT].
    ratio: mean square across the field, per axis, over that along it [-]; 1 for noise.
    drift: mean square of block means in space over what noise leaves [-]; 1 for noise.
    samples: how many there were.
    """

    residual_nt: float
    ratio: float
    drift: float
    samples: int

    @property
    def squared_sum_nt2(self) -> float:
        """Sum of the squared residuals [nT^2]."""
        return 3.0 * self.samples * self.residual_nt**2

    @property
    def steady(self) -> bool:
        """Whether the vectors agree with a steady spin."""
        blocks = max(self.samples // BLOCK, 1)
        return self.ratio < _FIT_RATIO + _SIGMAS * math.sqrt(
            3.0 / self.samples
        ) and self.drift < _FIT_DRIFT + _SIGMAS * math.sqrt(2.0 / (3.0 * blocks))


def fit_quality(fit: SpinFit) -> FitQuality:
    """Apply both tests to the residuals of a batch fit."""
    y = fit.residual_nt
    unit = fit.field_body_nt / np.linalg.norm(fit.field_body_nt, axis=1)[:, None]
    along = float(np.mean(np.einsum("ni,ni->n", y, unit) ** 2))
    total = float(np.mean((y**2).sum(axis=1)))
    blocks = len(y) // BLOCK
    drift = 1.0
    if blocks:
        space = fit.residual_eci_nt[-blocks * BLOCK :]
        means = space.reshape(blocks, BLOCK, 3).mean(axis=1)
        drift = float((means**2).mean()) * BLOCK / max(along, 1e-12)
    return FitQuality(math.sqrt(total / 3.0), 0.5 * (total - along) / max(along, 1e-12), drift, len(y))


@dataclass(init=False, repr=False, eq=False)
class SpinWatchMemory:
    """What of ``SpinWatch`` outlives a restart, saved and restored whole."""

    _count: int
    _along: float
    _across: float
    _sum: Array
    _sum_variance: float
    _in_block: int
    _blocks: int
    _drift: float
    _rejected_in_row: int
    _since_gap: int


class SpinWatch(Stateful, SpinWatchMemory):
    """Watches the innovations of a running filter."""

    def __init__(self) -> None:
        self._count = 0
        self._along = self._across = 1.0
        self._sum = np.zeros(3)
        self._sum_variance = 0.0
        self._in_block = 0
        self._blocks = 0
        self._drift = 1.0
        self._rejected_in_row = 0
        self._since_gap = _LONGEST_OUTAGE

    def gap(self) -> None:
        """A gap lies before the next sample."""
        self._since_gap = 0
        self._sum, self._sum_variance, self._in_block = np.zeros(3), 0.0, 0

    def rejected(self) -> SpinGate | None:
        """A sample was stopped by the gate; why the spin is lost, if it is."""
        self._rejected_in_row += 1
        self._since_gap += 1
        if self._rejected_in_row == self._since_gap >= _AFTER_GAP and self._since_gap < _LONGEST_OUTAGE:
            return SpinGate.PHASE_LOST
        return SpinGate.INCONSISTENT if self._rejected_in_row >= _LONGEST_OUTAGE else None

    def accepted(self, innovation: Innovation, body_from_eci: Array) -> SpinGate | None:
        """A sample entered the estimate; why the spin is lost, if it is."""
        self._rejected_in_row = 0
        self._since_gap = min(self._since_gap + 1, _LONGEST_OUTAGE)
        return self._compare(innovation) or self._drifts(innovation, body_from_eci)

    def _compare(self, innovation: Innovation) -> SpinGate | None:
        """Across against along, each over its expectation."""
        y, h, covariance = innovation.value, innovation.field_body_nt, innovation.covariance
        square = float(h @ h)
        along, total = float(h @ y) ** 2 / square, float(y @ y)
        along_expected = float(h @ covariance @ h) / square
        trace = float(covariance[0, 0] + covariance[1, 1] + covariance[2, 2])
        self._count = min(self._count + 1, MEMORY)
        self._along += (along / along_expected - self._along) / self._count
        self._across += ((total - along) / (trace - along_expected) - self._across) / self._count
        lost = self._count == MEMORY and self._across > RATIO_LIMIT * self._along
        return SpinGate.INCONSISTENT if lost else None

    def _drifts(self, innovation: Innovation, body_from_eci: Array) -> SpinGate | None:
        """Block means in space; the noise level is that along the field."""
        self._sum += innovation.value @ body_from_eci
        self._sum_variance += float(np.trace(innovation.covariance))
        self._in_block += 1
        if self._in_block < BLOCK:
            return None
        squared = float(self._sum @ self._sum) / (self._sum_variance * max(self._along, 1e-12))
        self._sum, self._sum_variance, self._in_block = np.zeros(3), 0.0, 0
        self._blocks = min(self._blocks + 1, BLOCKS)
        self._drift += (squared - self._drift) / self._blocks
        lost = squared > BLOCK_LIMIT or (self._blocks == BLOCKS and self._drift > DRIFT_LIMIT)
        return SpinGate.INCONSISTENT if lost else None
