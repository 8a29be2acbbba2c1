"""Torquers that nobody recorded, on a regular beat: a new dipole in each pulse, none between the pulses.

A controller measures while its coils are off, then drives them for the rest of its cycle, with another dipole each
time.  No course in time fits that, and each pulse needs three numbers of its own; but where in a cycle the field is
disturbed, and that it is not elsewhere, shows in the evidence for all pulses together.  The rows between pulses are
sound; those in them carry a field that nothing else in the recording tells.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.physics.interface import UNLISTED, Finding, value_of
from magcal_service.physics.scene.view import View

_CYCLES_S: Final = np.arange(20.0, 601.0)
"""Cycles in whole seconds, as controllers have them; shorter ones hold too few samples for a dipole in each pulse."""

_BIN_S: Final = 10.0
"""Stretches whose fields are estimated to find the cycle; choice: half of the shortest."""

_BEST: Final = 6
"""Cycles whose pulses are looked for: the right one, multiples of it, and a few for chance."""

_LEAST_BEAT: Final = 6.0
"""Sigmas by which the strength has to vary over the best cycle: of 581 cycles one has 4 by chance."""

_SHARES: Final = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.75)
"""Shares of a cycle for which coils are on; a share between leaves a tenth of its field in the gaps at most."""

_STEPS: Final = 40
"""Places in a cycle where pulses may begin, and shares of it in the end."""

_NEAR: Final = 2
"""Places around the best beginning and length that are tried in the end: as far as to the next of ``_SHARES``."""

_SIZES: Final = (0.02, 0.1, 0.5, 2.0, 10.0)
"""Variances of a pulse's field in units of the noise's, 1 sigma of 0.14 to 3.2 times the noise per axis."""

_FEWEST: Final = 20
"""Pulses from which on a beat is one: fewer are steps."""

_ACTIVE: Final = 0.3
"""Share of the pulses that have to be there, counted by their squares; choice: coils that rest two thirds of the time.
A few bursts that begin at multiples of some cycle have less."""

_LEAST_NATS: Final = 50.0
"""Evidence for pulses over their absence, beside what the search costs, and over fields that fill whole cycles; and for
more than one direction over one."""

_OF_WHOLE_CYCLES: Final = 0.9
"""Of the evidence for pulses, what fields that fill whole cycles may have: of coils on for 0.7 of a cycle they had
0.88, of a magnet that flips at random, and was taken for pulses, 0.92 to 0.99."""

_AS_MUCH: Final = 0.9
"""Of the best evidence, what a multiple of its cycle needs to be the cycle: a multiple that leaves out every second
pulse has half."""

_LOUDER: Final = 1.3
"""Times the noise between pulses, from sample to sample, that it may have in them: with true coils it had 1.05, where
a transmitter made noise on a schedule 4 to 7."""

_BOTH_WAYS: Final = 0.2
"""Share of the squares that pulses have to have with either sign, along what they have in common, to be those of coils:
loads that are switched on have one sign each, a dipole both.  Choice: of pulses that are noise half have either."""

_OF_A_GAIN: Final = 0.5
"""Of the evidence for pulses, what one gain and bias for all of them may have; choice: fields that are drawn anew for
each have a few hundredths of it, those of a gain nearly all."""

_STEADY: Final = 0.5
"""Correlation of a pulse's field with the next one's from which on it follows something, and is another effect."""

_ENDS: Final = 0.15
"""Share of a pulse at each end that is held against its middle; choice: wider than its edges are uncertain."""

_SWELLS: Final = 0.15
"""Of the middle's field, what the ends may lack: coils that are on lacked up to 0.07, what passed through none between
two of its waves 0.24."""

_SWELLS_SIGMA: Final = 3.0
"""Sigmas by which the ends have to lack it: one in 700 by chance."""

_MARGIN: Final = 2
"""Samples around a pulse that are left out with it: a coil decays, and edges are known to a fortieth of a cycle."""

_MOST_OF_PAUSES: Final = 0.5
"""Share of the rows between pulses that are left out with them at the most: the rest has to hold the nine errors."""

_CLIPPED: Final = 99.0
"""Percentile at which the strength of a stretch is cut, so that one outlier makes no cycle."""

UNRECORDED: Final = "inferred:pulses"
"""Driver of a finding."""

_DOUBT: Final = (UNLISTED, 0.03)
"""What is left to something else on a beat of its own: as to an effect whose driver was not recorded."""

_OF_ONE_WAY: Final = 0.03
"""What is left beside that to a load where the pulses may all have one direction, for a wheel's motor and a
battery have currents of both signs; choice: as much again, so that the name is not acted on."""


@dataclass(frozen=True, slots=True)
class Beat:
    """Pulses that begin ``first_s`` after the first row and every ``period_s``, and last ``on_share`` of that."""

    period_s: float
    first_s: float
    on_share: float

    def rows(self, time_s: Array, margin_s: float = 0.0) -> NDArray[np.bool_]:
        """(n,) rows within a pulse or ``margin_s`` around it."""
        since = (time_s - time_s[0] - self.first_s + margin_s) % self.period_s
        return np.asarray(since < self.on_share * self.period_s + 2.0 * margin_s)

    def places(self, time_s: Array, count: int) -> tuple[NDArray[np.bool_], NDArray[np.intp], Array]:
        """Rows (n,) within one of so many whole pulses, number of each row's pulse (n,), and how far in it a row is, in
        shares of a pulse (n,)."""
        since = (time_s - time_s[0] - self.first_s) / self.period_s
        pulse = np.floor(since).astype(np.intp)
        within = (since - pulse) / self.on_share
        return (pulse >= 0) & (pulse < count) & (within < 1.0), pulse, within


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """u u' and u r over the rows before each row, u the field's direction, r the residual in units of the noise."""

    time_s: Array
    squares: Array
    products: Array

    @classmethod
    def of(cls, time_s: Array, unit: Array, residual: Array) -> _Sums:
        zero = np.zeros((1, 3, 3))
        squares = np.concatenate([zero, np.cumsum(unit[:, :, None] * unit[:, None, :], axis=0)])
        products = np.concatenate([zero[0, :1], np.cumsum(unit * residual[:, None], axis=0)])
        return cls(time_s - time_s[0], squares, products)

    def over(self, begin_s: Array, end_s: Array) -> tuple[Array, Array]:
        """The sums (k, 3, 3) and (k, 3) of stretches of time (k,)."""
        first, last = np.searchsorted(self.time_s, begin_s), np.searchsorted(self.time_s, end_s)
        return self.squares[last] - self.squares[first], self.products[last] - self.products[first]

    def pulses(self, beat: Beat) -> tuple[Array, Array]:
        """The sums of each pulse."""
        begins = self._begins(beat)
        return self.over(begins, begins + beat.on_share * beat.period_s)

    def gaps(self, beat: Beat) -> tuple[Array, Array]:
        """The sums of each pause between two pulses."""
        begins = self._begins(beat)
        return self.over(begins + beat.on_share * beat.period_s, begins + beat.period_s)

    def of_whole_cycles(self, beat: Beat) -> float:
        """Evidence [nats] for a field in each whole cycle, without any pause, of the best variance."""
        begins = self._begins(beat)
        return float(_evidences(*self.over(begins, begins + beat.period_s), _SIZES).sum(axis=1).max())

    def _begins(self, beat: Beat) -> Array:
        count = int((self.time_s[-1] - beat.first_s) // beat.period_s)
        return beat.first_s + beat.period_s * np.arange(max(count, 0))


def pulses(view: View, as_well: tuple[str, ...]) -> Finding | None:
    """Torquers on a beat in a residual, with the rows that they spoil; None where there are none, or a record of them.

    Parameters
    ----------
    as_well: effects that pulses of one direction may be.

    Source: the evidence is the marginal likelihood of random fields of one variance against none (a random-effects
    model; MacKay 2003, Information Theory, chapter 28), its parts summed over pulses.
    """
    scene = view.scene
    span_s = float(scene.time_s[-1] - scene.time_s[0]) if len(scene) else 0.0
    if not scene.in_orbit or scene.of_quantity("magnetic moment") or span_s < _FEWEST * _CYCLES_S[0]:
        return None
    sums = _Sums.of(scene.time_s, scene.unit, view.residual_nt / view.noise_nt)
    found = [_best(sums, period) for period in _cycles(sums, scene.period_s)]
    if not found:
        return None
    nats, beat, size = _without_empty(found)
    squares, products = sums.pulses(beat)
    fields = _fields(squares, products, size)
    off_nats = float(_evidences(*sums.gaps(beat), (size,)).sum())
    follows = float((fields[1:] * fields[:-1]).sum()) / max(float((fields**2).sum()), 1e-300)
    turns = nats - _of_one_direction(squares, products, fields) > _LEAST_NATS
    strength = (fields**2).sum(axis=1)
    active = float(strength.sum() ** 2 / max(float(strength @ strength), 1e-300))
    many = len(fields) >= _FEWEST and active > _ACTIVE * len(fields)
    whole = sums.of_whole_cycles(beat)  # what wanders or switches at random fills the pauses, too
    pauses = nats - whole > _LEAST_NATS and whole < _OF_WHOLE_CYCLES * nats
    clear = many and nats > _LEAST_NATS and pauses and off_nats < 0.0 and abs(follows) < _STEADY
    if not clear or not _goes_both_ways(fields) or _swells(view, beat, fields) or _is_louder(view, beat, fields):
        return None
    near = (other for its_nats, other, _ in found if its_nats > _OF_A_GAIN * nats)  # multiples of its cycle, and parts
    if any(_nats_of_a_gain(view, other) > _OF_A_GAIN * nats for other in near):
        return None
    return _finding(view, beat, fields, () if turns else as_well, nats, _nats_of_absence(squares, size))


def _without_empty(found: list[tuple[float, Beat, float]]) -> tuple[float, Beat, float]:
    """The beat with most evidence, or a multiple of its cycle that has nearly as much: in the shorter one half of the
    pulses, or two thirds, would be empty."""
    best = max(found, key=_nats)
    times = [
        (one, one[1].period_s / best[1].period_s) for one in found if one is best or one[0] > _AS_MUCH * best[0] > 0.0
    ]
    return max((one for one, multiple in times if multiple == round(multiple) > 0), key=lambda one: one[1].period_s)


def _is_louder(view: View, beat: Beat, fields: Array) -> bool:
    """Whether the noise itself is larger in the pulses than between them: means of louder rows vary more, and look like
    fields in any direction.

    Parameters
    ----------
    fields: of each pulse (k, 3), in units of the noise.
    """
    on, pulse, _ = beat.places(view.scene.time_s, len(fields))
    left = view.residual_nt / view.noise_nt
    left[on] -= np.einsum("ni,ni->n", view.scene.unit[on], fields[pulse[on]])
    steps, inside = np.diff(left), on[1:] & on[:-1]
    outside = ~on[1:] & ~on[:-1]
    if min(int(inside.sum()), int(outside.sum())) < _FEWEST:
        return False
    return float(np.mean(steps[inside] ** 2)) > _LOUDER**2 * float(np.mean(steps[outside] ** 2))


def _swells(view: View, beat: Beat, fields: Array) -> bool:
    """Whether what acts in a pulse is less at its ends than in its middle: a wave that passes through none, no coil.

    Parameters
    ----------
    fields: of each pulse (k, 3), in units of the noise.
    """
    on, pulse, within = beat.places(view.scene.time_s, len(fields))
    expected = np.einsum("ni,ni->n", view.scene.unit[on], fields[pulse[on]])
    seen, at_ends = view.residual_nt[on] / view.noise_nt, np.abs(within[on] - 0.5) > 0.5 - _ENDS
    ends, middle = (_share(expected[rows], seen[rows]) for rows in (at_ends, ~at_ends))
    if middle[0] <= 0.0:  # too few rows to tell
        return False
    lacks, sigma = 1.0 - ends[0] / middle[0], float(np.hypot(ends[1], middle[1])) / abs(middle[0])
    return lacks > max(_SWELLS, _SWELLS_SIGMA * sigma)


def _nats_of_a_gain(view: View, beat: Beat) -> float:
    """Evidence [nats] for a gain and a bias that change for every pulse by the same, against none.

    While a transmitter is on, a sensor's supply and its gain may drop; to a craft that turns from pulse to pulse that
    is another field each time.
    """
    w, unit = view.scene.calibrated_nt, view.scene.unit
    on = beat.rows(view.scene.time_s)
    products = np.stack([unit[:, i] * w[:, j] + unit[:, j] * w[:, i] for i in range(3) for j in range(i, 3)], axis=1)
    columns = np.concatenate([products, unit], axis=1)[on]
    columns = columns / np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    residual = view.residual_nt[on] / view.noise_nt
    left: Array = residual - columns @ np.linalg.lstsq(columns, residual, rcond=1e-9)[0]
    drop = float(residual @ residual) - float(left @ left)
    cost: float = columns.shape[1] * math.log(max(len(residual), 2))
    return 0.5 * (drop - cost)


def _share(expected: Array, seen: Array) -> tuple[float, float]:
    """Of what is expected, the share that is seen (n,) in units of the noise, and its sigma."""
    square = max(float(expected @ expected), 1e-300)
    return float(expected @ seen) / square, square**-0.5


def _nats(found: tuple[float, Beat, float]) -> float:
    return found[0]


def _finding(
    view: View, beat: Beat, fields: Array, as_well: tuple[str, ...], nats: float, absent_nats: float
) -> Finding:
    """What was found.

    Parameters
    ----------
    fields: of each pulse (k, 3), in units of the noise.
    as_well: effects that these pulses may be, too.
    nats, absent_nats: evidence for the pulses, and what is expected against them of as many places without any.
    """
    scene = view.scene
    tried = [beat.rows(scene.time_s, margin * scene.period_s) for margin in range(_MARGIN, -1, -1)]
    most = 1.0 - (1.0 - float(tried[-1].mean())) * (1.0 - _MOST_OF_PAUSES)
    rows = next((rows for rows in tried if rows.mean() <= most), tried[-1])
    size_nt = view.noise_nt * np.sqrt((fields**2).sum(axis=1))
    rms_nt = float(np.sqrt(np.mean(size_nt**2)))
    sigma_nt = float(np.std(size_nt**2) / (2.0 * rms_nt * np.sqrt(len(fields))))
    return Finding(
        {
            "period_s": value_of(beat.period_s, 0.5 * beat.period_s / len(fields), "s"),
            "on_share": value_of(beat.on_share, 1.0 / _STEPS, "1"),
            "pulse_nt": value_of(rms_nt, sigma_nt, "nT"),
        },
        nats,
        1.0,
        spoiled=rows,
        driver=UNRECORDED,
        rivals=(*((name, _OF_ONE_WAY) for name in as_well), _DOUBT),
        off_nats=min(nats, absent_nats),
    )


def _cycles(sums: _Sums, period_s: float) -> list[float]:
    """Cycles over which the strength of the field rises and falls most, best first."""
    edges = np.arange(0.0, sums.time_s[-1], max(_BIN_S, 4.0 * period_s))
    if len(edges) < 2 * _FEWEST:
        return []
    squares, products = sums.over(edges[:-1], edges[1:])
    strength = np.einsum("ki,ki->k", products, _fields(squares, products, max(_SIZES)))
    strength = np.minimum(strength, np.percentile(strength, _CLIPPED))
    middle, held = 0.5 * (edges[:-1] + edges[1:]), np.flatnonzero(strength)  # between passes there is nothing
    mean, variance = strength.mean(), max(float(strength.var()), 1e-300)
    scores = []
    for cycle_s in _CYCLES_S:
        places = int(max(2, min(cycle_s // _BIN_S, 24)))
        turn = middle / cycle_s
        place = np.minimum((turn - np.floor(turn)) * places, places - 1).astype(np.intp)
        sizes = np.bincount(place, minlength=places)
        totals = np.bincount(place[held], strength[held], minlength=places) - mean * sizes
        varied = float((totals**2 / np.maximum(sizes, 1)).sum()) / variance
        scores.append((varied - (places - 1)) / np.sqrt(2.0 * (places - 1)))
    if max(scores) < _LEAST_BEAT:
        return []
    return [float(_CYCLES_S[index]) for index in np.argsort(scores)[::-1][:_BEST]]


def _best(sums: _Sums, period_s: float) -> tuple[float, Beat, float]:
    """Evidence, place and length of pulses in a cycle, and the variance of their fields."""
    step_s = period_s / _STEPS
    coarse = [Beat(period_s, number * step_s, share) for share in _SHARES for number in range(_STEPS)]
    nats, beat, size = max((found for one in coarse for found in _tried(sums, one, _SIZES)), key=_nats)
    near = range(-_NEAR, _NEAR + 1)
    fine = [
        Beat(period_s, (beat.first_s + begin * step_s) % period_s, beat.on_share + length / _STEPS)
        for begin in near
        for length in near
        if 0.0 < beat.on_share + length / _STEPS < 1.0
    ]
    nats, beat, size = max((found for one in fine for found in _tried(sums, one, (size,))), key=_nats)
    return nats - math.log((len(coarse) * len(_SIZES) + len(fine)) * len(_CYCLES_S)), beat, size


def _tried(sums: _Sums, beat: Beat, sizes: Sequence[float]) -> list[tuple[float, Beat, float]]:
    """Evidence for a beat whose fields have each of some variances."""
    each = _evidences(*sums.pulses(beat), sizes).sum(axis=1)
    return [(nats, beat, size) for nats, size in zip(each.tolist(), sizes, strict=True)]


def _fields(squares: Array, products: Array, size: float) -> Array:
    """Most probable fields (k, 3) of stretches, in units of the noise, under fields of a variance."""
    return np.asarray(np.linalg.solve(squares + np.eye(3) / size, products[..., None])[..., 0])


def _evidences(squares: Array, products: Array, sizes: Sequence[float]) -> Array:
    """(s, k) ln of the odds for a field of each variance (s,) over none in each stretch [nats]."""
    values, axes = np.linalg.eigh(squares)
    values, along2 = np.maximum(values, 0.0), np.einsum("kij,ki->kj", axes, products) ** 2
    size = np.array(sizes)[:, None, None]
    return np.asarray(0.5 * (along2 / (values + 1.0 / size) - np.log1p(size * values)).sum(axis=2))


def _nats_of_absence(squares: Array, size: float) -> float:
    """Evidence [nats] that as many stretches without a field are expected to give against fields of a variance."""
    inverse = np.linalg.solve(squares + np.eye(3) / size, squares)
    determinants = np.linalg.slogdet(np.eye(3) + size * squares)[1]
    return 0.5 * float((determinants - np.trace(inverse, axis1=1, axis2=2)).sum())


def _goes_both_ways(fields: Array) -> bool:
    """Whether fields (k, 3), in units of the noise, have both signs along what they have in common, as no load has."""
    along = fields @ np.linalg.eigh(fields.T @ fields)[1][:, -1]
    forward = float((np.maximum(along, 0.0) ** 2).sum()) / max(float(along @ along), 1e-300)
    return min(forward, 1.0 - forward) > _BOTH_WAYS


def _of_one_direction(squares: Array, products: Array, fields: Array) -> float:
    """Evidence [nats] for pulses along the direction that the fields have most in common, of the best variance."""
    along = np.linalg.eigh(fields.T @ fields)[1][:, -1]
    square, product = np.einsum("i,kij,j->k", along, squares, along), products @ along
    each = [0.5 * (size * product**2 / (1.0 + size * square) - np.log1p(size * square)) for size in _SIZES]
    return float(max(one.sum() for one in each))
