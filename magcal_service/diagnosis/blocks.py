"""Evidence counted in blocks: what a change of the model gains where, and how far that scatters beyond the model's own.

Two models' residuals r and q at a noise of sigma differ in log-likelihood by d_b = sum (r^2 - q^2) / (2 sigma^2) in a
block.  If the second is the truth, d_b has the mean e_b = sum (r - q)^2 / (2 sigma^2) and the variance 2 e_b; the ratio
of the scatter about e_b to that variance is the dispersion.  Where the noise is not what it was taken for, or the
second model only resembles the truth, it is more than 1, and evidence counts that many times less.

Source: the dispersion of quasi-likelihood, McCullagh & Nelder 1989, section 9.2; contiguous blocks instead of samples
after Kunsch 1989, because a residual that remembers makes neighbours tell the same thing twice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array

_MOST_BLOCKS: Final = 50  # as those that are held out
_FEWEST_BLOCKS: Final = 8  # a scatter over fewer is known to half of itself only
"""Blocks of a recording: as many as its residual's memory leaves independent, within these."""

_MEMORIES: Final = 5.0
"""Lengths of the memory in one block: what reaches over its edge is a fifth then."""

_LEAST_SEEN_NATS: Final = 0.5
"""A block is expected to see an effect that has more than one noise variance's worth of squares in it."""


_GAP_S: Final = 600.0
"""Without samples, what separates passes [s]: a tenth of an orbit, over which heat and attitude go on."""

_MOST_PASSES: Final = 12  # passes: of more there are data enough for a slow course, within an orbit each
_COVERED: Final = 0.5
"""Share of the time from first to last that passes hold less than; else there are gaps in a recording."""


@dataclass(frozen=True, slots=True)
class Gain:
    """What a change of the model gains over blocks.

    Parameters
    ----------
    nats: over all of them, as if samples were independent.
    dispersion: scatter over blocks by the model's own, at least 1.
    seen: blocks in which it gains, of those in which it should.
    expected: blocks in which it should.
    """

    nats: float
    dispersion: float
    seen: int
    expected: int

    @property
    def tempered(self) -> float:
        """Evidence that survives the scatter [nats]."""
        return self.nats / self.dispersion


def numbered(residual: Array, per_sample: int = 1) -> NDArray[np.intp]:
    """Block number (m,) of each row, contiguous and as long as the residual (m,) remembers; rows in time order."""
    count = len(residual) // per_sample
    memory = correlation_samples(residual[::per_sample])
    blocks = int(np.clip(count / (_MEMORIES * memory), _FEWEST_BLOCKS, _MOST_BLOCKS))
    return np.repeat(np.arange(count) * blocks // max(count, 1), per_sample)


def correlation_samples(residual: Array) -> float:
    """Samples that a residual (n,) remembers itself over: 1 + 2 sum of its correlations until they fade."""
    centred = residual - residual.mean()
    size = 1 << int(np.ceil(np.log2(2 * len(centred))))
    power = np.abs(np.fft.rfft(centred, size)) ** 2
    covariance = np.fft.irfft(power, size)[: len(centred) // 4]
    if not covariance[0] > 0.0:
        return 1.0
    correlation = covariance / covariance[0]
    faded = np.flatnonzero(correlation < 2.0 / np.sqrt(len(centred)))
    last = int(faded[0]) if len(faded) else len(correlation)
    return max(1.0, 1.0 + 2.0 * float(correlation[1:last].sum()))


def gain_over(before: Array, after: Array, number: NDArray[np.intp], sigma2: float) -> Gain:
    """The gain of the residual ``after`` (m,) over ``before`` (m,), in the blocks ``number`` (m,) [nT, nT^2]."""
    return _gain_of(*_in_blocks(before, after, number, sigma2))


def steady_gain(before: Array, after: Array, number: NDArray[np.intp], sigma2: float) -> Gain:
    """As ``gain_over``, without the block whose gain is furthest from what is expected, if it gains.

    What acts at the largest fields only, or once, has most of its evidence in one block, and of a held-out one its size
    is foretold from all others: to a fifth, of 3000 nats, that scatters more than all blocks together would.  What the
    others bear out by themselves is there.
    """
    gained, expected = _in_blocks(before, after, number, sigma2)
    furthest = int(np.argmax(np.abs(gained - expected)))
    others = np.arange(len(gained)) != furthest
    return _gain_of(gained[others], expected[others]) if gained[furthest] > 0.0 else _gain_of(gained, expected)


def _in_blocks(before: Array, after: Array, number: NDArray[np.intp], sigma2: float) -> tuple[Array, Array]:
    """(b,) what is gained in each block, and (b,) what would be if the second model were the truth [nats]."""
    each = ((before**2 - after**2) / (2.0 * sigma2), (before - after) ** 2 / (2.0 * sigma2))
    gained, expected = (np.bincount(number, one).astype(np.float64) for one in each)
    return gained, expected


def _gain_of(gained: Array, expected: Array) -> Gain:
    scatter = float(((gained - expected) ** 2).sum())
    dispersion = max(1.0, scatter / max(2.0 * float(expected.sum()), 1e-300))
    should = expected > _LEAST_SEEN_NATS
    return Gain(
        float(gained.sum()), dispersion, int(np.count_nonzero(gained[should] > 0.0)), int(np.count_nonzero(should))
    )


def pass_numbers(time_s: Array) -> NDArray[np.intp] | None:
    """(n,) number of each sample's pass; None where a recording is no few passes."""
    ends = np.flatnonzero(np.diff(time_s) > _GAP_S)
    count = len(ends) + 1
    held_s = float(time_s[-1] - time_s[0]) - float(np.diff(time_s)[ends].sum())
    if not 2 <= count <= _MOST_PASSES or held_s > _COVERED * float(time_s[-1] - time_s[0]):
        return None
    return np.searchsorted(ends, np.arange(len(time_s)), side="left").astype(np.intp)
