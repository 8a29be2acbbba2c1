"""Batch for errors that change: TWO-STEP on a window that slides with time, older samples weighing less.

The newest ``window_s`` of samples are held as sums of blocks (``magnitude_sums``), so that old ones leave the window
whole and nothing has to be taken back out of a sum.  Inside the window a block of age t weighs exp(-t / decay_s): the
re-weighting.  A weighted batch is no longer the most likely one, so its covariance is that of weighted least squares,
P (sum w^2 F_k) P with P = (sum w F_k)^-1; that is what the estimate scatters by.  It says nothing of the lag behind
errors that moved.

Source: Soken 2018, a re-weighted TWO-STEP batch for time-varying magnetometer errors; Alonso & Shuster 2002 for the
batch itself.  Block sums and exponential weights are this project's choice for the re-weighting.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Final

import numpy as np

from magcal_service.config.settings import CraftConfig
from magcal_service.estimators.interface import Method
from magcal_service.estimators.parts.magnitude_sums import MagnitudeSums, scaled, unscaled_information
from magcal_service.estimators.two_step import Solution, TwoStep, TwoStepMemory
from magcal_service.ticks.assembler import Tick

WINDOW_S: Final = 5400.0
"""About one low orbit: shorter ones miss directions of the field, and the nine errors can't be separated."""

DECAY_S: Final = 1800.0
"""Age at which a sample's weight has fallen to 1/e."""

_BLOCK_S: Final = 60.0
"""Length of a block: 90 make up the window, and the weight inside one changes by 3 %.

Choice: shorter blocks cost memory and time in proportion, longer ones make the window's end coarse.
"""


@dataclass(init=False, repr=False, eq=False)
class SlidingBatchMemory(TwoStepMemory):
    """What of ``SlidingBatch`` outlives a restart, saved and restored whole."""

    _blocks: deque[tuple[float, MagnitudeSums]]  # time of the first sample, sums
    _now_s: float


class SlidingBatch(TwoStep, SlidingBatchMemory):
    """One craft's sliding batch.

    Parameters
    ----------
    config: the craft's configuration (sensor, filter's prior and ``start_s``).
    window_s: length of the window [s].
    decay_s: age at which the weight is 1/e [s]; inf: all weigh the same.
    """

    name = "sliding-batch"

    def __init__(self, config: CraftConfig, *, window_s: float = WINDOW_S, decay_s: float = DECAY_S) -> None:
        self.window_s, self.decay_s = window_s, decay_s
        super().__init__(config)

    def _clear(self) -> None:
        super()._clear()
        self._blocks = deque()
        self._now_s = 0.0

    def _take(self, tick: Tick) -> None:
        self._now_s = float(tick.times_s[-1])
        if not self._blocks or self._now_s - self._blocks[-1][0] >= _BLOCK_S:
            self._blocks.append((self._now_s, MagnitudeSums()))
            while self._now_s - self._blocks[0][0] > self.window_s:
                self._blocks.popleft()
        self._blocks[-1][1].add(tick.field_body_nt, tick.reference_magnitude_nt)

    def _weighted(self, power: float) -> MagnitudeSums:
        """The window's sums, each block with a power of its weight."""
        weights = (math.exp(-power * (self._now_s - start_s) / self.decay_s) for start_s, _ in self._blocks)
        return reduce(add, (sums.times(weight) for weight, (_, sums) in zip(weights, self._blocks, strict=True)))

    def _sums(self) -> MagnitudeSums:
        return self._weighted(1.0)

    def _accept(self, solution: Solution) -> None:
        """Take the solution with the covariance of weighted least squares."""
        super()._accept(solution)
        total_nt = self._noise.total_nt
        information = self._weighted(2.0).information(scaled(solution.x), total_nt, corrected=False)  # surely positive
        scatter = unscaled_information(information, total_nt) + np.diag(self._prior**-2.0)
        covariance = solution.covariance @ scatter @ solution.covariance
        self._covariance = 0.5 * (covariance + covariance.T)


METHOD = Method(
    "sliding-batch",
    "TWO-STEP on a sliding, re-weighted window, for errors that change",
    SlidingBatch,
    has_process_noise=False,
)
