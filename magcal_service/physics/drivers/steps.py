"""How far the field turns from one sample to the next, told by the samples themselves where no rate is known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.scene.smooth import quintic_slope, smooth_course

_BRIDGED: Final = 4.5
"""Sample periods from which on a stretch ends: over fewer, the turn is that of the samples around them; choice: three
samples that are lost in a row."""

_FEWEST: Final = 64
"""Samples from which on a stretch has a course whose steps are told from noise."""

_NEXT: Final = 1.5
"""Sample periods up to which a sample follows the one before; a longer time has others between that are not there."""

_MOST_STEPS: Final = 30  # to either side: a craft that hardly turns loses nothing by its turn

LEAST_STEPS: Final = 3  # to either side: its six numbers are then from seven samples

_EITHER_SIDE: Final = 1.0
"""Turn [rad] to either side of a sample that a polynomial of degree five is laid through.  Where the field turns by so
much in 18 samples, its slope has 6.8 % of one sample's noise; where the craft turns twice as fast as the field in it,
a cubic's would be 3.1 % short, this one's 0.1 %."""


def steps2(scene: Scene, period_s: float) -> Array | None:
    """Square (n,) [nT^2] of the step from a sample to the next: the chord of the turn in one sample period.

    Of a craft that turns little from one to the next, it follows from the slope of a quintic over a radian to either
    side; else how fast the field turns changes slowly against its noise, which is smoothed away.  What the noise adds
    in the mean is a constant, which the nine errors take up.  Over a few samples that are missing the turn goes on as
    evenly as around them.  None where the samples do not follow one another.
    """
    after_s = np.concatenate([[np.inf], np.diff(scene.time_s)])
    begins = np.flatnonzero(after_s >= _BRIDGED * period_s)
    if len(scene) < _FEWEST or len(begins) * _FEWEST > len(scene):
        single = _steps(scene.calibrated_nt, np.flatnonzero(after_s >= _NEXT * period_s))
        return single if scene.is_given else None
    placed = np.rint(scene.time_s / period_s)
    parts = [_Stretch.of(*part) for part in _split(begins, scene.calibrated_nt, placed)]
    half = either_side(scene, np.sqrt(np.concatenate([part.steps2[part.place] for part in parts])))
    found: Array = np.concatenate([part.smoothed(half) for part in parts])
    return found


def _split(begins: NDArray[np.intp], *each: Array) -> Iterator[tuple[Array, ...]]:
    """Parts of arrays (n, ...) by the rows at which stretches begin, row 0 among them."""
    yield from zip(*(np.split(one, begins[1:]) for one in each), strict=True)


@dataclass(frozen=True, slots=True, eq=False)
class _Stretch:
    """Vectors (m, 3) at every sample period of a stretch, between few that are missing too; the places (n,) of those
    that are there; and the squares (m,) of the steps from one to the next [nT^2]."""

    vectors: Array
    place: NDArray[np.intp]
    steps2: Array

    @classmethod
    def of(cls, there: Array, placed: Array) -> _Stretch:
        """Of the vectors (n, 3) that are there, and the sample periods (n,) that they are nearest to."""
        rows = np.arange(len(placed))
        place = (np.maximum.accumulate(placed - placed[0] - rows) + rows).astype(np.intp)  # no two at one place
        steps2 = _steps(there, np.zeros(1, dtype=np.intp))
        if len(there) == place[-1] + 1:
            return cls(there, place, steps2)
        every = np.arange(place[-1] + 1)
        length = np.interp(every, place, np.linalg.norm(there, axis=1))
        between = np.stack([np.interp(every, place, component) for component in there.T], axis=1)
        between *= (length / np.maximum(np.linalg.norm(between, axis=1), 1e-9))[:, None]
        follow = np.concatenate([[False], np.diff(place) == 1])
        if not follow.any():
            return cls(between, place, _steps(between, np.zeros(1, dtype=np.intp)))
        return cls(between, place, np.interp(every, place[follow], steps2[follow]))

    def smoothed(self, half: int) -> Array:
        """(n,) squares of the steps with little of the noise; ``half``: rows to either side, as of ``either_side``."""
        even = np.maximum(smooth_course(self.steps2), 0.0) if half < LEAST_STEPS else _even_steps2(self.vectors, half)
        return np.asarray(even[self.place])


def either_side(scene: Scene, steps: Array) -> int:
    """Rows to either side of a sample within which the field turns by a radian, of the steps (n,) between samples."""
    turn = float(np.median(steps)) / float(np.mean(np.linalg.norm(scene.calibrated_nt, axis=1)))
    return int(min(_EITHER_SIDE / max(turn, 1e-9), _MOST_STEPS))


def _even_steps2(vectors: Array, half: int) -> Array:
    """Square (n,) of the chord to each of vectors (n, 3) from the one before, by slopes of quintics over so many rows
    to either side."""
    slope2 = (quintic_slope(vectors, half) ** 2).sum(axis=1)
    middle = 0.5 * (slope2 + np.concatenate([slope2[:1], slope2[:-1]]))
    length2 = (vectors**2).sum(axis=1)
    return np.asarray(4.0 * length2 * np.sin(0.5 * np.sqrt(middle / length2)) ** 2)


def _steps(vectors: Array, begins: NDArray[np.intp]) -> Array:
    """Square (n,) of the step to each of vectors (n, 3), that of the next one where a stretch begins."""
    steps2 = np.concatenate([[0.0], (np.diff(vectors, axis=0) ** 2).sum(axis=1)])
    ends = np.append(begins[1:], len(vectors))
    steps2[begins] = np.where(ends - begins > 1, np.append(steps2, 0.0)[begins + 1], 0.0)
    return steps2
