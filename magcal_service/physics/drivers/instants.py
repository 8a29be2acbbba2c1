"""Changes at several instants: each by an amount of its own, or one thing that is switched on and off.

Steps can imitate anything that is slow.  So a form is only proposed where every one of its instants stands on its own:
without it much would be lost, and drawn out into ramps of every length from a few samples on it would hold less.
Where more instants than a form may have would hold clearly more, what switches is none of these forms.

The search works on sums over stretches of time, from which any choice of instants is evaluated: first on stretches of
a 96th of the recording, then on ever shorter ones around each instant, down to the sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.physics.columns import Columns
from magcal_service.physics.drivers.change import instants
from magcal_service.physics.drivers.temperature import Act
from magcal_service.physics.interface import Block, Hypothesis, Proposals
from magcal_service.physics.saying import AXES
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.segments import Segments, Sums

MOST_INSTANTS: Final = 6
"""More changes than six are a pattern, which a duty or a channel holds, or a course; a choice."""

SHORTEST: Final = 4
"""Samples from one change to the next at least: shorter ones are spikes."""

_STRETCHES: Final = 96
"""Places of a change in the first look; choice: as for one instant.  Pairs of them are tried, 4600."""

_FINER: Final = 12
"""Times finer each further look; from a 96th of 60 000 samples two looks reach the sample."""

_WORTH: Final = 12.5
"""Nats: five sigma.  What the first pair holds, and what every single instant is needed for, at least."""

_SUDDEN: Final = 8
"""Samples of the shortest ramp that a step is held against; each further one is twice as long."""

_QUICK: Final = math.log(2.0)
"""Nats for a sudden change that one over half of all orders of length leaves: quick, and no step.  More counts."""

_SURE: Final = 1.6
"""Nats beyond those: odds of 5 to 1, all instants together, of sudden changes against ramps of any length."""

_DRAWN_OUT: Final = -1.5
"""Nats of one instant below which it is a ramp; where the change hardly shows as it happens, chance makes -1."""

_TREADS: Final = 8
"""Even steps that a ramp is made of in the sums; they differ from it by 1/200 of the change's square."""

_BEYOND: Final = 0.05
"""Of what six instants hold, what two more may hold: of something that switches on, they hold much."""

_MOST_TRIED: Final = 2
"""Numbers of instants that are looked at more closely, the best first; others would need instants that do not stand."""

Rows = NDArray[np.intp]


def several(
    scene: Scene, effect: str, act: Act, switched: Block, steps: Block, as_well: tuple[str, ...] = ()
) -> Iterator[Hypothesis]:
    """Forms with two to six instants, of one amplitude that is there and not there in turn, and of one for each.

    Parameters
    ----------
    act: from a signal to its columns.
    switched: of the amplitude that is switched, first on.
    steps: of what one instant adds.
    as_well: effects that are switched on and off exactly so.
    """
    family, tried = _Family(scene, act), instants(scene)
    for count in range(2, MOST_INSTANTS + 1):
        numbers = tuple(replace(tried, grid=part) for part in np.array_split(tried.grid, count))
        each = tuple(f"instant {index + 1}" for index in range(count))
        own = replace(steps, shape=(count, *steps.shape), labels=(each, *(steps.labels or (AXES,))))
        for together, block, variant in (
            (True, switched, f"switched at {count} instants"),
            (False, own, f"steps at {count} instants"),
        ):
            yield Hypothesis(
                effect,
                "none",
                _columns(scene, act, together),
                (block,),
                variant,
                numbers,
                is_free=True,
                proposals=_proposals(family, together, count),
                as_well=as_well if together else (),
            )


def _columns(scene: Scene, act: Act, together: bool) -> Callable[[Array], Columns]:
    def columns(theta: Array) -> Columns:
        after = (scene.time_s[:, None] >= theta).astype(np.float64)
        return act(after.sum(axis=1) % 2.0 if together else after)

    return columns


def _proposals(family: _Family, together: bool, count: int) -> Proposals:
    def proposals(sums: Sums, _grids: Sequence[Array]) -> Array:
        best = family.best(sums)
        if best is None or (best.together, len(best.rows)) != (together, count):
            return np.zeros((0, count))
        return family.times(best.rows)[None]

    return proposals


@dataclass(frozen=True, slots=True, eq=False)
class _Choice:
    """Instants, as rows (k,) that they come before, and the drop in squares [nT^2] of their form."""

    together: bool
    rows: Rows
    drop: float


@dataclass(eq=False)
class _Family:
    """All forms of one scene: they are searched together, and the best that stands is proposed."""

    scene: Scene
    act: Act
    _searched: tuple[bytes, _Choice | None] = field(default=(b"", None), repr=False)

    def times(self, rows: Rows) -> Array:
        """Instants (k,) [s] halfway between the rows and those before them."""
        time_s = self.scene.time_s
        return np.asarray(0.5 * (time_s[rows] + time_s[rows - 1]))

    def best(self, sums: Sums) -> _Choice | None:
        """The best choice whose instants all stand on their own; None where there is none."""
        count = len(self.scene)
        if count < _STRETCHES * SHORTEST:
            return None
        columns = self.act(np.ones(count))
        firsts = np.linspace(0, count, _STRETCHES, endpoint=False).astype(np.intp)
        firsts = np.unique(np.concatenate([firsts, self.scene.pauses[:_STRETCHES]]))
        coarse = _Sums.of(sums, columns, firsts)
        key = coarse.key
        if key != self._searched[0]:
            self._searched = key, self._best(sums, columns, coarse)
        return self._searched[1]

    def _best(self, sums: Sums, columns: Columns, coarse: _Sums) -> _Choice | None:
        found = [choice for choice in _paths(coarse) if coarse.nats(choice) > 0.0]
        counts = list(dict.fromkeys(len(c.rows) for c in sorted(found, key=lambda choice: -coarse.nats(choice))))
        near = [choice for choice in found if len(choice.rows) in counts[:_MOST_TRIED]]
        fine = [self._finer(sums, columns, choice) for choice in near]
        fine.sort(key=lambda choice: -coarse.nats(choice))
        return next((choice for choice in fine if _stands(sums, columns, choice, len(self.scene))), None)

    def _finer(self, sums: Sums, columns: Columns, choice: _Choice) -> _Choice:
        """The choice with its instants moved to the best samples."""
        count = len(self.scene)
        reach = -(-count // _STRETCHES)
        while reach > 1:
            step = max(reach // _FINER, 1)
            offsets = np.arange(-reach, reach + 1, step)
            around = [_inside(row + offsets, count) for row in choice.rows]
            within = _Sums.of(sums, columns, np.unique(np.concatenate([[0], choice.rows, *around])))
            choice = _descended(within, choice, around)
            reach = step
        return choice


def _inside(rows: Rows, count: int) -> Rows:
    return np.unique(np.clip(rows, SHORTEST, count - SHORTEST))


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """Sums over the first stretches of a recording, which begin at rows ``firsts`` (g,), up to each (g + 1, ...)."""

    firsts: Rows
    running: Segments

    @classmethod
    def of(cls, sums: Sums, columns: Columns, firsts: Rows) -> _Sums:
        """Over stretches that begin at these rows, rising from 0."""
        return cls(firsts, sums(columns, firsts).running)

    @property
    def key(self) -> bytes:
        """What tells one residual from another."""
        key: bytes = self.running.right.tobytes() + self.running.inside[-1].tobytes()
        return key

    def drops(self, rows: Rows, together: bool) -> Array:
        """Drop in squares (m,) [nT^2] by instants before the rows (m, k), rising, each one of ``firsts``."""
        ends = np.searchsorted(self.firsts, rows)
        return self._levels(ends, together).drops

    def weighed(self, rows: Rows, weights: Array) -> float:
        """Drop in squares [nT^2] by signals (k + 1, s) in the stretches between rows (k,)."""
        ends = np.searchsorted(self.firsts, rows)[None]
        normal, inside, right = self._between(ends, 0)
        return float(_signals(normal[0], inside[0], right[0], weights).drops[0])

    def nats(self, choice: _Choice) -> float:
        """Rough evidence for a choice at the noise that it leaves, after what the search and the amplitudes cost."""
        amplitudes = self.running.right.shape[1] * (1 if choice.together else len(choice.rows))
        cost: float = (len(choice.rows) + 0.5 * amplitudes) * math.log(self.running.count)
        return 0.5 * choice.drop / self.left(choice.drop) - cost

    def left(self, drop: float) -> float:
        """Mean square of the residual less a drop [nT^2]."""
        squares = self.running.squares
        return float(max(squares - drop, 1e-9 * squares, 1e-300) / self.running.count)

    def _between(self, ends: Rows, first: int, step: int = 1) -> tuple[Array, Array, Array]:
        """Sums (m, s, ...) between the numbers of stretches (m, k): of every ``step``-th of the k + 1, from one on."""
        shape = (len(ends), 1)
        cuts = np.concatenate([np.zeros(shape, np.intp), ends, np.full(shape, len(self.firsts), np.intp)], axis=1)
        begin, end = cuts[:, :-1][:, first::step], cuts[:, 1:][:, first::step]
        parts = (self.running.normal, self.running.inside, self.running.right)
        normal, inside, right = (part[end] - part[begin] for part in parts)
        return normal, inside, right

    def _levels(self, ends: Rows, together: bool) -> Segments:
        if together:
            return Segments(*(part.sum(axis=1) for part in self._between(ends, 1, 2)))
        return _apart(*self._between(ends, 1))


def _apart(normal: Array, inside: Array, right: Array) -> Segments:
    """Sums (m, k s, ...) of columns that each of k stretches has itself, from theirs (m, k, s, ...)."""
    trials, stretches, size = right.shape
    whole = np.zeros((trials, stretches, size, stretches, size))
    for index in range(stretches):
        whole[:, index, :, index] = normal[:, index]
    wide = stretches * size
    beside = np.moveaxis(inside, 1, 2).reshape(trials, inside.shape[2], wide)
    return Segments(whole.reshape(trials, wide, wide), beside, right.reshape(trials, wide))


def _signals(normal: Array, inside: Array, right: Array, weights: Array) -> Segments:
    """Sums of columns times signals (g, s) that are constant in each of g stretches, from the stretches' own."""
    count = weights.shape[1] * right.shape[1]
    products = np.einsum("ga,gb,gij->aibj", weights, weights, normal).reshape(count, count)
    beside = np.einsum("ga,gpi->pai", weights, inside).reshape(inside.shape[1], count)
    found = np.einsum("ga,gi->ai", weights, right).reshape(count)
    return Segments(products[None], beside[None], found[None])


def _paths(sums: _Sums) -> list[_Choice]:
    """The best choice of each kind and number of instants on the stretches of a first look.

    Empty where nothing switches, or where more than the most instants hold clearly more.
    """
    best: dict[int, _Choice] = {0: _Choice(True, np.zeros(0, np.intp), 0.0)}
    for count in range(MOST_INSTANTS + 1):
        if count not in best:
            continue
        for more in (1, 2):
            trial = _with_more(sums, best[count], more)
            if trial is not None and (count + more not in best or trial.drop > best[count + more].drop):
                best[count + more] = trial
        if count == 0 and not any(0.5 * one.drop > _WORTH * sums.left(one.drop) for one in best.values()):
            return []
    most = max((choice.drop for count, choice in best.items() if count <= MOST_INSTANTS), default=0.0)
    beyond = max((choice.drop for choice in best.values()), default=0.0)
    needed = 2.0 * (2.0 * math.log(sums.running.count) + _WORTH) * sums.left(beyond)
    if beyond - most > max(_BEYOND * most, needed):
        return []
    switched = [choice for count, choice in best.items() if 2 <= count <= MOST_INSTANTS]
    around = sums.firsts[1:]
    steps = [_descended(sums, replace(choice, together=False), [around] * len(choice.rows)) for choice in switched]
    return [*switched, *steps]


def _with_more(sums: _Sums, choice: _Choice, more: int) -> _Choice | None:
    """The switched choice with one or two instants more, where they hold most; None where there is no room."""
    places = sums.firsts[1:]
    free = places[[_far_enough(row, choice.rows) for row in places.tolist()]]
    added = free[:, None] if more == 1 else np.stack([free[index] for index in np.triu_indices(len(free), 1)], axis=1)
    if more == 2:
        added = added[added[:, 1] - added[:, 0] >= SHORTEST]
    if not len(added):
        return None
    rows = np.sort(np.concatenate([np.tile(choice.rows, (len(added), 1)), added], axis=1), axis=1)
    drops = sums.drops(rows, True)
    top = int(np.argmax(drops))
    return _Choice(True, rows[top], float(drops[top]))


def _far_enough(row: int, others: Rows) -> bool:
    return bool((np.abs(others - row) >= SHORTEST).all())


def _descended(sums: _Sums, choice: _Choice, around: list[Rows]) -> _Choice:
    """The choice with each instant in turn moved to the best of the rows around it, twice."""
    rows = np.array(choice.rows)
    drop = float(sums.drops(rows[None], choice.together)[0])
    for index in list(range(len(rows))) * 2:
        low = rows[index - 1] + SHORTEST if index else SHORTEST
        high = rows[index + 1] - SHORTEST if index + 1 < len(rows) else np.iinfo(np.intp).max
        places = around[index][(around[index] >= low) & (around[index] <= high)]
        if not len(places):
            continue
        trials = np.tile(rows, (len(places), 1))
        trials[:, index] = places
        drops = sums.drops(trials, choice.together)
        top = int(np.argmax(drops))
        if drops[top] > drop:
            rows, drop = trials[top], float(drops[top])
    return _Choice(choice.together, rows, drop)


def _stands(sums: Sums, columns: Columns, choice: _Choice, count: int) -> bool:
    """Whether each instant is needed, and is a step rather than a ramp over more than a few samples."""
    rows = choice.rows
    ramps = [_ramps(rows, index, count) for index in range(len(rows))]
    edges = [edge for ramp in ramps for edge in ramp]
    within = _Sums.of(sums, columns, np.unique(np.concatenate([[0], rows, *edges])))
    squares = 2.0 * within.left(choice.drop)
    search = math.log(within.running.count)
    for one in _without(choice):
        gone = len(rows) - len(one)
        left = float(within.drops(one[None], choice.together)[0]) if len(one) else 0.0
        if choice.drop - left < (_WORTH + gone * search) * squares:
            return False
    sudden = []
    for index, ramp in enumerate(ramps):
        drops = [within.weighed(*_drawn_out(rows, index, edge, choice.together)) for edge in ramp]
        likelier = (np.array(drops) - choice.drop) / squares
        most = float(likelier.max())
        sudden.append(-most - math.log(float(np.mean(np.exp(likelier - most)))))
    return min(sudden) > _DRAWN_OUT and sum(sudden) - _QUICK * len(rows) > _SURE


def _without(choice: _Choice) -> Iterator[Rows]:
    """The instants less one; of what is switched less two that follow one another, or the first, or the last."""
    rows = choice.rows
    if not choice.together:
        yield from (np.delete(rows, index) for index in range(len(rows)))
        return
    yield from (rows[1:], rows[:-1])
    yield from (np.delete(rows, [index, index + 1]) for index in range(len(rows) - 1))


def _ramps(rows: Rows, index: int, count: int) -> list[Rows]:
    """Edges (treads,) of ramps around an instant, from a few samples to the nearer neighbour's distance, rising."""
    bounds = np.concatenate([[0], rows, [count]])
    widest = int(min(bounds[index + 1] - bounds[index], bounds[index + 2] - bounds[index + 1]))
    widths = [min(_SUDDEN << power, widest) for power in range(32) if power == 0 or _SUDDEN << power < 2 * widest]
    shares = (np.arange(_TREADS) + 0.5) / _TREADS - 0.5
    return [np.unique(rows[index] + np.rint(width * shares).astype(np.intp)) for width in widths]


def _drawn_out(rows: Rows, index: int, edge: Rows, together: bool) -> tuple[Rows, Array]:
    """Rows at which anything changes, and the signals between them, with one instant drawn out over ``edge``."""
    places = np.unique(np.concatenate([rows, edge]))
    at = np.concatenate([[0], places])
    reached = (at[:, None] >= rows).astype(np.float64)
    reached[:, index] = (at[:, None] >= edge).mean(axis=1)
    if not together:
        return places, reached
    signs = np.where(np.arange(len(rows)) % 2, -1.0, 1.0)
    return places, (reached @ signs)[:, None]
