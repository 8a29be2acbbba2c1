"""A change from one level to another that takes a while: what is no step, and no drift that lasts.

Even, or relaxing to its end from an instant on.  The search works on sums over stretches of time, from which a change
between any two of them is evaluated at its mean level in each: first on a 96th of the recording, then on finer ones
around the best, down to the sample.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.columns import Columns
from magcal_service.physics.drivers.change import RELAXATION_SHARES, instants
from magcal_service.physics.drivers.instants import Rows
from magcal_service.physics.drivers.temperature import Act
from magcal_service.physics.interface import Block, Hypothesis, Nonlinear
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.segments import Segments, Sums

_STRETCHES: Final = 96
"""Stretches of the first look, and of each further one; choice: as for instants.  All pairs are tried, 4600."""

_CONSTANTS: Final = 3.0
"""Time constants in which the search takes a change that relaxes for done: 5 % of it are still to come."""

_SHORTEST: Final = 32
"""Samples of the shortest ramp: what is quicker is called a jump.  Shorter ones hold what a faint jump holds."""

_FEWEST: Final = 4 * _SHORTEST  # samples of a recording: of fewer there is not as much before and after it


Level = Callable[[Array, Array, Array], Array]
"""Of the whole change, how much has come about at times, between two others that it begins and ends at [s]."""


def ramp(scene: Scene, effect: str, act: Act, block: Block, at_once: str) -> Hypothesis:
    """Nothing before one instant, a constant from another one on, and evenly from the one to the other between them.

    ``at_once``: effect of the same change at an instant.
    """
    first, last = np.array_split(instants(scene).grid, 2)
    numbers = Nonlinear("from_s", "s", first, role="edge"), Nonlinear("to_s", "s", last, role="edge")

    def columns(theta: Array) -> Columns:
        return act(_evenly(scene.time_s, theta[0], theta[1]))

    def proposals(sums: Sums, _grids: Sequence[Array]) -> Array:
        best = _best(scene, act, sums, _evenly)
        return np.zeros((0, 2)) if best is None else best[None]

    return Hypothesis(
        effect,
        "none",
        columns,
        (block,),
        "over a while",
        numbers,
        is_free=True,
        proposals=proposals,
        in_place=True,
        at_once=at_once,
        samples_in=lambda theta: _between(scene, theta[0], theta[1]),
    )


def relaxing_from(scene: Scene, effect: str, act: Act, block: Block, at_once: str) -> Hypothesis:
    """Nothing before an instant, from then on relaxing to an end; ``at_once`` as in ``ramp``."""
    span_s = max(float(np.ptp(scene.time_s)), 1.0)
    shortest = _SHORTEST * scene.period_s / _CONSTANTS
    longest = max(span_s / _CONSTANTS, 2.0 * shortest)
    tau = Nonlinear("time_constant_s", "s", np.geomspace(shortest, longest, len(RELAXATION_SHARES)))
    numbers = Nonlinear("from_s", "s", instants(scene).grid, role="edge"), tau

    def columns(theta: Array) -> Columns:
        return act(_relaxing(scene.time_s, theta[0], theta[0] + _CONSTANTS * theta[1]))

    def proposals(sums: Sums, _grids: Sequence[Array]) -> Array:
        best = _best(scene, act, sums, _relaxing)
        return np.zeros((0, 2)) if best is None else np.array([[best[0], (best[1] - best[0]) / _CONSTANTS]])

    return Hypothesis(
        effect,
        "none",
        columns,
        (block,),
        "relaxing from an instant",
        numbers,
        is_free=True,
        proposals=proposals,
        in_place=True,
        at_once=at_once,
        samples_in=lambda theta: _between(scene, theta[0], theta[0] + _CONSTANTS * theta[1]),
    )


def _between(scene: Scene, from_s: float, to_s: float) -> int:
    """Samples from one time to another [s]."""
    first, last = np.searchsorted(scene.time_s, [from_s, to_s])
    return int(last - first)


def _evenly(time_s: Array, from_s: Array, to_s: Array) -> Array:
    return np.asarray(np.clip((time_s - from_s) / np.maximum(to_s - from_s, 1e-9), 0.0, 1.0))


def _relaxing(time_s: Array, from_s: Array, to_s: Array) -> Array:
    constants = _CONSTANTS * (time_s - from_s) / np.maximum(to_s - from_s, 1e-9)
    return np.asarray(-np.expm1(-np.maximum(constants, 0.0)))


def _best(scene: Scene, act: Act, sums: Sums, level: Level) -> Array | None:
    """First and last time (2,) [s] of the change that holds most; None where the recording is too short for any."""
    count = len(scene)
    if count < _FEWEST:
        return None
    columns = act(np.ones(count))
    low, high = 0, count
    while True:
        places = np.unique(np.linspace(low, high, _STRETCHES + 1).astype(np.intp))
        firsts = np.unique(np.concatenate([[0], places[places < count]]))
        pairs = _pairs(places)
        segments = sums(columns, firsts)
        begins, ends = pairs[int(np.argmax(_drops(scene.time_s, firsts, segments, pairs, level)))]
        width = int(places[1] - places[0])
        if width <= 1:
            break
        low, high = max(int(begins) - 2 * width, 0), min(int(ends) + 2 * width, count)
        if high - low >= places[-1] - places[0]:
            break  # over all of it: nothing is finer
    last = min(int(ends), count - 1)
    return np.array([scene.time_s[begins], scene.time_s[last]]) if scene.time_s[last] > scene.time_s[begins] else None


def _pairs(places: Rows) -> Rows:
    """Rows (m, 2) that a change may begin and end at."""
    first, last = np.triu_indices(len(places), 1)
    pairs = np.stack([places[first], places[last]], axis=1)
    return np.asarray(pairs[pairs[:, 1] - pairs[:, 0] >= _SHORTEST])


def _drops(time_s: Array, firsts: Rows, segments: Segments, pairs: Rows, level: Level) -> Array:
    """Drop in squares (m,) [nT^2] by changes between rows (m, 2), each at its mean level in every stretch."""
    ends = np.append(firsts[1:], len(time_s))
    middle = 0.5 * (time_s[firsts] + time_s[ends - 1])
    since = time_s[np.minimum(pairs, len(time_s) - 1)]
    return segments.weighted(level(middle, since[:, :1], since[:, 1:])).drops
