"""Which physics would explain the residual of a calibration?  Evidence from running sums alone.

A row of the sums is the scalar residual e = |(I + D) B - b| - |H| of one sample, its nine sensitivities J, and one
column for each thing that may have been left out, all at a reference state that is held over the window:

    e = J dx + X c + noise,      gain of X = n/2 ln(RSS without X / RSS with X)   [nats]

The nine errors dx are fitted again each time, so only what they cannot absorb counts, and the noise level is that
of the residual.  Where X is not needed, twice the gain is chi-squared with as many degrees as X has columns.  What is
faster than a chunk of samples is detected in the spectrum of the chunks' residuals, by Whittle's likelihood.

Source: Wilks 1938 (likelihood ratios); Whittle 1953; Schwarz 1978 (what a column costs).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import BIAS, D_SCALE, STATE_SIZE, Array
from magcal_service.physics.acting import Watched
from magcal_service.physics.catalogue import watched_as
from magcal_service.residuals import log_tail

FALSE_PER_YEAR: Final = 0.1
"""False alarms expected in a year of ticks where the model is right: the sum over all tests."""

CLASS_NATS: Final = 3.0
"""Odds of 20 to 1: what is closer than that to the best is named beside it, as in a diagnosis."""

UNKNOWN: Final = "unknown"

_LEAST_SEEN: Final = 1e-4  # of a column's square has to be left, else the nine errors have absorbed it
_NULL: Final = 1e-9  # directions of the nine errors with less than this share of the information are not fitted
_CORRELATIONS: Final = np.array([-0.9, -0.75, -0.6, -0.45, -0.3, -0.15, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 0.95])


@dataclass(frozen=True, slots=True)
class Explanation:
    """One thing that may have been left out, and what it would explain.

    Parameters
    ----------
    effects: names of the catalogue with this signature; ``unknown`` where none does.
    driver: what it follows, in words; empty where nothing.
    gain: of log likelihood [nats].
    columns: how many numbers were fitted for it.
    tries: among how many of its kind it was chosen.
    """

    effects: tuple[str, ...]
    driver: str
    gain: float
    columns: int
    tries: int = 1

    def score(self, samples: int) -> float:
        """Evidence [nats]: the gain less what its numbers and its choice cost."""
        return self.gain - 0.5 * self.columns * math.log(max(samples, 2)) - math.log(self.tries)

    def significance(self) -> float:
        """-ln of the probability that noise alone gains as much."""
        return -log_tail(2.0 * self.gain, self.columns)


def inverse_root(squares: Array) -> Array:
    """R (k, r) with R R' the inverse of a matrix of squares and products (k, k); weak directions are left out."""
    scale = np.sqrt(np.maximum(np.diagonal(squares), 1e-300))
    values, vectors = np.linalg.eigh(squares / np.outer(scale, scale))
    good = values > _NULL * values[-1]
    root: Array = vectors[:, good] / np.sqrt(values[good]) / scale[:, None]
    return root


def without(sums: Array, count: int = STATE_SIZE) -> Array:
    """Sums of squares and products (k, k) of columns after the first ``count`` of them have been fitted to the others.

    A column of which nothing is left becomes zero; the last one is the residual.
    """
    half = inverse_root(sums[:count, :count]).T @ sums[:count, count:]
    return _seen(sums[count:, count:] - half.T @ half, np.diagonal(sums)[count:])


def _seen(rest: Array, before: Array) -> Array:
    hidden = np.diagonal(rest) <= _LEAST_SEEN * before
    hidden[-1] = False
    rest[hidden] = rest[:, hidden] = 0.0
    return rest


def gain(sums: Array, samples: int) -> float:
    """Of the columns in front of the last one, which is the residual, with the nine errors out already [nats]."""
    before, after = float(sums[-1, -1]), float(without(sums, len(sums) - 1)[0, 0])
    return 0.0 if before <= 0.0 else 0.5 * samples * math.log(before / max(after, 1e-12 * before))


def of_columns(rest: Array, columns: list[int], samples: int) -> float:
    """Gain of some of the columns of ``rest``, whose last is the residual [nats]."""
    chosen = [*columns, len(rest) - 1]
    return gain(rest[np.ix_(chosen, chosen)], samples)


def of_course(
    blocks: Array, part: slice, basis: Array, samples: int, total: Array | None = None, root: Array | None = None
) -> float:
    """Gain of letting some of the nine errors follow a course over the blocks [nats].

    Parameters
    ----------
    blocks: sums of J and e of each block (m, 10, 10).
    part: which of the nine errors.
    basis: values of the course's functions in each block (m, q).
    samples: how many in all.
    total, root: sum of the blocks, and ``inverse_root`` of the nine errors' part of it, where they are known.
    """
    count, functions = len(blocks), basis.shape[1]
    total = blocks.sum(axis=0) if total is None else total
    root = inverse_root(total[:STATE_SIZE, :STATE_SIZE]) if root is None else root
    size = functions * (part.stop - part.start)
    cross = (basis.T @ blocks[:, part, :].reshape(count, -1)).reshape(size, STATE_SIZE + 1)
    products = (basis[:, :, None] * basis[:, None, :]).reshape(count, -1).T @ blocks[:, part, part].reshape(count, -1)
    own = products.reshape(functions, functions, size // functions, -1).transpose(0, 2, 1, 3).reshape(size, size)
    sums = np.empty((size + 1, size + 1))
    sums[:size, :size], sums[:size, size] = own, cross[:, STATE_SIZE]
    sums[size] = [*cross[:, STATE_SIZE].tolist(), float(total[STATE_SIZE, STATE_SIZE])]
    with_nine = np.empty((STATE_SIZE, size + 1))
    with_nine[:, :size], with_nine[:, size] = cross[:, :STATE_SIZE].T, total[:STATE_SIZE, STATE_SIZE]
    half = root.T @ with_nine
    return gain(_seen(sums - half.T @ half, np.diagonal(sums)), samples)


def courses(blocks: Array, times: Array, samples: int) -> list[Explanation]:
    """What a drift or a step of bias or scale would explain, and a separate bias in each block.

    ``times`` (m,) are the blocks' middles, in any unit.
    """
    count, number = len(blocks), np.arange(len(blocks))
    phase = (times - times.mean()) / max(float(np.ptp(times)), 1e-9)
    total = blocks.sum(axis=0)
    root = inverse_root(total[:STATE_SIZE, :STATE_SIZE])

    def following(part: slice, basis: Array) -> float:
        return of_course(blocks, part, basis, samples, total, root)

    found = []
    for part, course, step in (
        (BIAS, Watched.BIAS_COURSE, Watched.BIAS_STEP),
        (D_SCALE, Watched.SCALE_COURSE, Watched.SCALE_STEP),
    ):
        line = following(part, phase[:, None])
        found.append(Explanation(watched_as(course), "", line, 3))
        if count >= 8:
            curve = following(part, np.stack([phase, phase**2, phase**3], axis=1))
            found.append(Explanation(watched_as(course), "", curve, 9))
        steps = [following(part, (number >= k)[:, None] * 1.0) for k in range(1, count)]
        found.append(Explanation(watched_as(step), "", max(steps), 3, count - 1))
        # within a block, which then has a separate value
        steps = [following(part, _apart(number, k)) for k in range(1, count - 1)]
        found.append(Explanation(watched_as(step), "", max(steps), 6, count - 2))
    free = following(BIAS, np.eye(count)[:, 1:])
    found.append(Explanation((UNKNOWN,), "slow", free, 3 * (count - 1)))
    return found


def _apart(number: NDArray[np.intp], at: int) -> Array:
    """A course that is 1 after a block, and one that is 1 in it (m, 2)."""
    return np.stack([number > at, number == at], axis=1) * 1.0


def spectral(power: Array, share: Array) -> tuple[list[Explanation], float]:
    """What a line, or noise with a memory, would explain of the chunks' spectrum.

    Parameters
    ----------
    power: the residual's in each bin (m,), summed over the chunks, nine errors fitted to each chunk taken out.
    share: what white noise of variance 1 would have there (m,).

    Returns the explanations, and by what factor the noise's memory raises the power of what is slow.
    """
    weight = np.maximum(share, 1e-9)
    weight = np.where(share < 0.2 * share.max(), 0.0, weight)
    level = power / np.maximum(weight, 1e-9)
    count = len(power)

    def likelihood(shape: Array) -> float:
        scale = float((weight * level / shape).sum() / weight.sum())
        return -float((weight * np.log(shape * scale)).sum()) - float(weight.sum())

    white = likelihood(np.ones(count))
    angle = np.pi * np.arange(count) / (count - 1)
    memory = [likelihood(1.0 / (1.0 - 2.0 * r * np.cos(angle) + r * r)) for r in _CORRELATIONS.tolist()]
    best = int(np.argmax(memory))
    found = [Explanation(watched_as(Watched.MEMORY), "", memory[best] - white, 1, len(memory))]
    lines = [_line(weight, weight * level, at) - white for at in range(1, count - 1) if weight[at] > 0.0]
    found.append(Explanation(watched_as(Watched.LINE), "", max(lines, default=0.0), 3, max(len(lines), 1)))
    filled = np.where(weight > 0.0, np.maximum(level, 1e-30), 1.0)
    free = -float((weight * (np.log(filled) + 1.0)).sum()) - white
    found.append(Explanation((UNKNOWN,), "fast", free, int((weight > 0.0).sum()) - 1))
    correlation = float(_CORRELATIONS[best]) if memory[best] - white > 10.0 else 0.0
    return found, max(1.0, (1.0 + correlation) / (1.0 - correlation))


def _line(weight: Array, power: Array, at: int) -> float:
    """Likelihood with three bins' powers free, and one for all others."""
    near = slice(at - 1, at + 2)
    total = sum(map(_alone, weight[near].tolist(), power[near].tolist()))
    others = np.ones(len(weight), dtype=bool)
    others[near] = False
    return total + _alone(float(weight[others].sum()), float(power[others].sum()))


def _alone(share: float, power: float) -> float:
    """Likelihood of bins that have one power to themselves; 0 where white noise has no share in them."""
    return 0.0 if share <= 0.0 else -share * (math.log(max(power / share, 1e-30)) + 1.0)
