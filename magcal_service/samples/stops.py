"""Where an axis stops at the end of its range: by how often the end comes, or by what is missing of the field there."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.residuals import white_floor
from magcal_service.samples.ellipsoid import SPIKE, Ellipsoid, fitted

_FEWEST: Final = 8
"""Samples at the largest value from which it is a stop; choice: fewer are met by a coarse converter."""

_BESIDE: Final = 5
"""Values beside the end that its count is compared with; an axis with fewer stays within the steps of its lattice."""

_FEWEST_ALIKE: Final = 3
"""Different samples with one value at the end, on a lattice so fine that none would come twice; choice: two may be a
sample that was sent again."""

_BY_CHANCE: Final = 1e-5
"""Probability of so many by chance, below which they are a stop: six ends of ten thousand recordings have one."""

_NEXT: Final = 30
"""Samples beside the end whose distances tell how often a level of the lattice comes there; choice: to a fifth."""

_NEAR_END: Final = 0.25
"""Share of an axis' values' range, from the end on, in which the closest two values are a step of the lattice apart;
choice.  Elsewhere it may be finer: a log of five digits, or a sensor that changes its range."""

_FLAT_TO_NEXT: Final = 5.0
"""Factor by which the largest value has to repeat more often than any of those beside it.

A turning field has its largest value on a lattice 1 / (sqrt 2 - 1) = 2.4 times as often as the next; twice that is
clear of it.
"""

_SHARED: Final = 3.0
"""The same for ends of two or more axes or sides at one value, but for its sign: a turning field's are clear of it by a
quarter, and seldom at one value."""

_LEAST_CHANGE: Final = 0.01  # of the field: a room's changes by less, an orbit's by a fifth and more

_ROUNDS: Final = 4  # fits without what is near a stop; choice: two agree as a rule

_COURSE: Final = 10
"""Levels beside the end that foretell what is missing at it; choice: fewer leave a bend's course unsure on a fine
lattice, and more are far from the end on a coarse one."""

_SURE: Final = 5.0
"""Standard errors that more is missing at the end than the levels beside it foretell; an end without a stop is long,
for noise that points outwards leads there."""

_OFTEN: Final = 2.0
"""Factor by which an end comes more often than those beside it, to which a lattice's noise leaves none: it thins out
towards the end.  Noise that is small beside the lattice's steps does not."""

_SURE_IF_OFTEN: Final = 3.0
"""Standard errors that are enough at an end that comes so often; choice: the two are independent of one another."""

_MORE: Final = 0.1
"""Steps of the lattice by which more is missing at the end; choice: a bend that takes two fifths of the field's growth
is foretold to that."""

_ZONES: Final = 6
"""Stretches beside an end, each as wide as the noise reaches, that foretell what is missing there; choice: as for
``_COURSE``, and no further than a bend's course is straight."""

_ROUNDED: Final = 0.5
"""Steps that a reading is off by at the most by its rounding, and the mean of many where no noise spreads them."""

_LEAST_SLOPE: Final = 0.1
"""Growth of |B| along the axis, per growth of the component, below which the magnitude says nothing of it; choice: the
field lies 84 deg off the axis, or the ellipsoid has collapsed on a short arc."""

_ROUNDING: Final = 1e-9  # of a range; a value in another unit becomes nT more exactly

_FEWEST_FITTED: Final = 100  # samples; ten numbers are fitted

_REACH: Final = 3.0
"""Noise sigmas before a stop at which a sample may be stopped, too: of the samples there those are kept whose noise
points inwards, and what is kept is short by their mean."""


@dataclass(frozen=True, slots=True, eq=False)
class Stop:
    """An end of an axis at which the readings stop.

    Parameters
    ----------
    axis: 0 to 2.
    side: 1.0 at the largest value, -1.0 at the least.
    at_nt: the value [nT].
    rows: (n,) samples at it.
    near: (n,) further samples that without their noise would be within three sigma of it, or beyond.
    """

    axis: int
    side: float
    at_nt: float
    rows: NDArray[np.bool_]
    near: NDArray[np.bool_]

    @property
    def spoiled(self) -> NDArray[np.bool_]:
        """(n,) samples that no fit should use."""
        return self.rows | self.near


def stops(field_nt: Array, magnitude_nt: Array, range_nt: float | None = None) -> tuple[Stop, ...]:
    """Every stop among samples, axis by axis.

    Parameters
    ----------
    field_nt: (n, 3) B as measured [nT], in the order of their times.
    magnitude_nt: (n,) |H| [nT]; NaN where it is not known.
    range_nt: full scale of each axis as it is stated [nT]: whatever reaches it is at a stop; None: not stated.

    An end that comes five times as often as the values beside it is a stop, and so is one that comes three times where
    each value comes once.  On a lattice that is not much finer than the noise it may come less often; there the
    magnitude tells: at a stop the readings are short, by more than the levels beside it foretell.  It tells nothing of
    an axis that lies across the field, and little of one that is clipped by less than two steps of its lattice.  An end
    that comes eight times at the value of another's stop, or at its negative, is one, too: the axes of a sensor have
    one range.  So two ends at one value are stops by a count of three times the values beside them; both where the
    field's size changes.  What stops before the noise comes to it ends in all values that the noise reaches: there an
    end that comes twice as often as those beside it is a stop, if readings that far from it are short by more than
    those further inside foretell.
    """
    ends = [_end(field_nt, axis, side, range_nt) for axis in range(3) for side in (1.0, -1.0)]
    stated = [one for one in ends if abs(one.at_nt) == range_nt]
    unsaid = [one for one in ends if one not in stated]
    seldom = [one for one in unsaid if _is_seldom(field_nt, one)]
    often = [one for one in unsaid if np.count_nonzero(one.rows) >= _FEWEST and not one.rows.all()]
    flown = _changes(magnitude_nt)
    times = {one: _oftener(field_nt, one) for one in often}
    flat = [one for one in often if times[one] > _SHARED]
    found = [one for one in flat if times[one] > _FLAT_TO_NEXT or (flown and _is_shared(one, flat))]
    found += [*stated, *(one for one in seldom if one not in found)]
    doubtful = [one for one in often if one not in found]
    samples = _Samples(field_nt, magnitude_nt, ~np.any([one.rows for one in ends], axis=0))
    told = bool(often or found) and np.count_nonzero(samples.inner) >= _FEWEST_FITTED
    if told:
        found += _short(samples, found, {one: times[one] for one in doubtful})
        found += _stopped_before_noise(samples, found, [one for one in doubtful if times[one] > _OFTEN])
    found += [one for one in doubtful if flown and one not in found and _is_shared(one, found)]
    if not told or not found:
        return tuple(one for one in ends if one in found)
    clipped = np.any([one.rows for one in found], axis=0)
    samples = _without_near(samples, found)
    return tuple(replace(one, near=samples.near(one) & ~clipped) for one in ends if one in found)


def _changes(magnitude_nt: Array) -> bool:
    """Whether the field's size changes, as along an orbit: on a turntable in one room axes end at one value again and
    again, held there, and the magnitude tells nothing of what is missing."""
    known = magnitude_nt[np.isfinite(magnitude_nt)]
    return bool(len(known)) and float(np.ptp(known)) > _LEAST_CHANGE * float(np.mean(known))


def _is_shared(end: Stop, among: list[Stop]) -> bool:
    """Whether another end among these is at the same value, but for its sign."""
    return any(math.isclose(abs(end.at_nt), abs(one.at_nt)) for one in among if one is not end)


def _without_near(samples: _Samples, found: list[Stop]) -> _Samples:
    """Samples beside nine errors of those that are not near a stop either, which are short and bend the ellipsoid."""
    for _ in range(_ROUNDS):
        sound = samples.no_end & ~np.any([samples.near(one) for one in found], axis=0)
        if np.array_equal(sound, samples.no_end) or np.count_nonzero(samples.known & sound) < _FEWEST_FITTED:
            break
        samples = replace(samples, no_end=sound)
    return samples


def _short(samples: _Samples, stopped: list[Stop], ends: dict[Stop, float]) -> list[Stop]:
    """Of ends, and how much oftener they come than the values beside them, those that lack something, the surest first:
    what its samples lack is missing at no other end."""
    found: list[Stop] = []
    while len(found) < len(ends):
        sound = samples.known.copy()
        for one in (*stopped, *found):
            sound &= ~one.rows
        excess, surest = max(
            ((samples.excess(one, sound, times), one) for one, times in ends.items() if one not in found),
            key=lambda pair: pair[0],
        )
        if excess < 1.0:
            break
        found.append(surest)
    return found


def _stopped_before_noise(samples: _Samples, stopped: list[Stop], ends: list[Stop]) -> list[Stop]:
    """Of ends that come often, those about which readings are short as far as the noise reaches, the surest first."""
    found: list[Stop] = []
    while len(found) < len(ends):
        beside = [one for one in ends if one not in found and one not in stopped]
        usable = samples.known & ~np.any([samples.reached(one) for one in (*stopped, *found)], axis=0)
        inner = usable & samples.no_end & ~np.any([samples.reached(one) for one in beside], axis=0)
        if not beside or np.count_nonzero(inner) < _FEWEST_FITTED:
            break
        sound = replace(samples, no_end=inner)
        excess, surest = max(((sound.excess_in_reach(one, usable), one) for one in beside), key=lambda pair: pair[0])
        if excess < 1.0:
            break
        found.append(surest)
    return found


def _end(field_nt: Array, axis: int, side: float, range_nt: float | None) -> Stop:
    """The samples at the largest value of a side; where that reaches a stated range, all that do."""
    outwards = side * field_nt[:, axis]
    end, near = float(outwards.max()), np.zeros(len(field_nt), dtype=bool)
    if range_nt is not None and end >= range_nt * (1.0 - _ROUNDING):
        return Stop(axis, side, side * range_nt, outwards >= range_nt * (1.0 - _ROUNDING), near)
    return Stop(axis, side, side * end, outwards == end, near)


def _oftener(field_nt: Array, end: Stop) -> float:
    """How many times as often it comes as any of the values beside it; 0 where there are few."""
    _, counts = np.unique(np.abs(field_nt[~end.rows, end.axis] - end.at_nt), return_counts=True)
    return float(np.count_nonzero(end.rows) / counts[:_BESIDE].max()) if len(counts) >= _BESIDE else 0.0


def _is_seldom(field_nt: Array, end: Stop) -> bool:
    """Whether its value would hardly come so often by chance, on a lattice of many more levels than samples there."""
    others = ~end.rows
    alike = len(np.unique(field_nt[end.rows], axis=0))
    away = np.sort(np.abs(field_nt[others, end.axis] - end.at_nt))
    inside = away[:_NEXT]
    if alike < _FEWEST_ALIKE or len(np.unique(inside)) < _NEXT:
        return False
    beside = away[away <= max(_NEAR_END * float(away[-1]), float(inside[-1]))]
    step_nt = float(np.diff(np.unique(beside)).min())
    expected = _NEXT * step_nt / float(inside[-1])
    # of the first sample there nothing is said: it makes the end; Poisson's tail by its first term
    return (alike - 1) * math.log(max(expected, 1e-300)) - math.lgamma(alike) < math.log(_BY_CHANCE)


@dataclass(frozen=True, eq=False)
class _Samples:
    """Samples beside the nine errors of those that are at no end.

    Parameters
    ----------
    field_nt: (n, 3) B as measured [nT].
    magnitude_nt: (n,) |H| [nT].
    no_end: (n,) samples that are at no end of an axis, nor near a stop.
    """

    field_nt: Array
    magnitude_nt: Array
    no_end: NDArray[np.bool_]

    @cached_property
    def known(self) -> NDArray[np.bool_]:
        """(n,) samples with a reference."""
        return np.isfinite(self.magnitude_nt) & (self.magnitude_nt > 0.0)

    @cached_property
    def inner(self) -> NDArray[np.bool_]:
        """(n,) samples with a reference that are at no end."""
        return self.known & self.no_end

    @cached_property
    def shape(self) -> Ellipsoid:
        """The nine errors of the inner samples."""
        return fitted(self.field_nt, self.magnitude_nt, self.inner)

    @cached_property
    def residual_nt(self) -> Array:
        """(n,) |B_cal| - |H| [nT]; NaN without a reference."""
        return self.shape.residual(self.field_nt, np.where(self.known, self.magnitude_nt, np.nan))

    @cached_property
    def slope(self) -> Array:
        """(n, 3) derivative of the residual by B [-]."""
        return self.shape.gradient(self.field_nt, np.where(self.known, self.magnitude_nt, np.nan))

    @cached_property
    def bounded_nt(self) -> Array:
        """(n,) the residual, what stands out of it and what is not known brought within the limit of a spike."""
        limit = SPIKE * self.shape.sigma_nt
        return np.clip(np.where(self.known, self.residual_nt, 0.0), -limit, limit)

    @cached_property
    def slow_nt(self) -> float:
        """What of the residual lasts from one sample to the next, 1 sigma, at the most by 2 sigma of it [nT]."""
        pairs = np.flatnonzero(self.inner[1:] & self.inner[:-1])
        count = max(len(pairs), 1)
        shared = float(self.bounded_nt[pairs] @ self.bounded_nt[pairs + 1]) / count
        return math.sqrt(max(shared, 0.0) + 2.0 * self.shape.sigma_nt**2 / math.sqrt(count))

    @cached_property
    def noise_nt(self) -> float:
        """What of it is white, 1 sigma [nT]."""
        return min(self.shape.sigma_nt, white_floor(self.bounded_nt[self.inner]))

    def near(self, stop: Stop) -> NDArray[np.bool_]:
        """(n,) samples within reach of a stop, brought to the known magnitude: no radial noise is left."""
        axis = stop.axis
        radial = self.slope[:, axis] / np.maximum(np.sum(self.slope**2, axis=1), _LEAST_SLOPE**2)
        clean = self.field_nt[:, axis] - self.residual_nt * radial
        return np.asarray(self.known & (stop.side * (clean - stop.at_nt) > -_REACH * self.noise_nt))

    def excess(self, end: Stop, sound: NDArray[np.bool_], times: float) -> float:
        """What is missing at an end beyond what the levels beside it foretell, over what makes it a stop; ``times``: as
        often as any of those it comes."""
        inside = np.abs(self.field_nt[:, end.axis] - end.at_nt)
        levels = np.unique(inside)[: _COURSE + 1]
        if len(levels) <= _COURSE:
            return 0.0
        at_end, *others = (self._missing(end, np.flatnonzero(sound & (inside == level))) for level in levels)
        beside = [(level, *one) for level, one in zip(levels[1:], others, strict=True) if one is not None]
        if at_end is None or not beside or np.count_nonzero(sound & end.rows) < _FEWEST:
            return 0.0
        step_nt = float(np.diff(levels[1:]).min())  # the end itself may lie between two steps
        sure = _SURE_IF_OFTEN if times > _OFTEN and self._undithered(step_nt) < _MORE else _SURE
        return _beyond(at_end, beside, self._rounded(step_nt), sure)

    def reached(self, end: Stop) -> NDArray[np.bool_]:
        """(n,) readings that may be at an end, but for noise that comes after it."""
        return np.asarray(np.abs(self.field_nt[:, end.axis] - end.at_nt) <= _REACH * self.noise_nt)

    def excess_in_reach(self, end: Stop, sound: NDArray[np.bool_]) -> float:
        """As ``excess``, of all readings that noise takes away from an end, beside stretches as wide further inside."""
        if self.noise_nt <= 0.0:  # then all of them are at it
            return 0.0
        inside = np.abs(self.field_nt[:, end.axis] - end.at_nt)
        zone = np.floor(inside / (_REACH * self.noise_nt))
        at_end, *others = (self._missing(end, np.flatnonzero(sound & (zone == number))) for number in range(_ZONES + 1))
        beside = [(number + 1.0, *one) for number, one in enumerate(others) if one is not None]
        if at_end is None or not beside:
            return 0.0
        return _beyond(at_end, beside, self.noise_nt, _SURE)

    def _rounded(self, step_nt: float) -> float:
        """What may be missing in the mean of many readings on a lattice that stop nowhere [nT]."""
        return step_nt * (_MORE + _ROUNDED * self._undithered(step_nt))

    def _undithered(self, step_nt: float) -> float:
        """What noise leaves of the rounding's mean: exp(-2 pi^2 sigma^2 / q^2) (Widrow & Kollar 2008)."""
        noise = max(self.noise_nt**2 - step_nt**2 / 12.0, 0.0)
        return math.exp(-2.0 * math.pi**2 * noise / step_nt**2)

    def _missing(self, end: Stop, rows: NDArray[np.intp]) -> tuple[float, float] | None:
        """What is missing along the axis in some rows, outwards, in the mean, and 1 sigma of it [nT].

        What lasts is the same in rows that follow one another.
        """
        slope = end.side * self.slope[rows, end.axis]
        rows, slope = rows[slope > _LEAST_SLOPE], slope[slope > _LEAST_SLOPE]
        if not len(rows):
            return None
        visits = np.flatnonzero(np.diff(rows, prepend=-2) > 1)
        together = float(np.sum(np.add.reduceat(slope, visits) ** 2))
        squares = float(np.sum(slope**2))
        sigma = math.sqrt(self.shape.sigma_nt**2 * squares + self.slow_nt**2 * together) / squares
        return -float(slope @ self.bounded_nt[rows]) / squares, sigma


def _beyond(
    at_end: tuple[float, float], beside: list[tuple[float, float, float]], least_nt: float, sure: float
) -> float:
    """What is missing at an end, given with its sigma, beyond what is foretold beside it (``_foretold``), over what has
    to be: so much [nT], and so many standard errors."""
    here, sigma = at_end
    foretold, uncertain, rough = _foretold(np.array(beside))
    return (here - foretold) / max(least_nt, sure * rough * math.hypot(sigma, uncertain))


def _foretold(beside: Array) -> tuple[float, float, float]:
    """What levels (k, 3), rows of distance, value and sigma, make of the end by their mean, or by their course where
    that grows towards it; 1 sigma of that; and how many of their sigmas they scatter by, at least 1."""
    x, y, sigma = beside.T
    weight = 1.0 / sigma**2
    mean, variance = float(np.average(y, weights=weight)), float(1.0 / weight.sum())
    if len(x) < 3:
        return mean, math.sqrt(variance), 1.0
    centre = float(np.average(x, weights=weight))
    spread = float(np.sum(weight * (x - centre) ** 2))
    slope = float(np.sum(weight * (x - centre) * y)) / spread
    rough = math.sqrt(max(1.0, float(np.sum(weight * (y - mean - slope * (x - centre)) ** 2)) / (len(x) - 2)))
    if slope > 0.0:
        return mean, math.sqrt(variance), rough
    return mean - slope * centre, math.sqrt(variance + centre**2 / spread), rough
