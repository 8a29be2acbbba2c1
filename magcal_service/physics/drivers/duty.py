"""A constant dipole on for the same part of every cycle: a controller's duty, a heater's or a beacon's.

Its cycle is sought beside the lines of a residual, by sums over short stretches that are folded over it.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.physics.columns import Columns, along_axes
from magcal_service.physics.interface import Block, Hypothesis, Nonlinear
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.segments import Sums

SLOTS: Final = 24
"""Places in a duty's cycle, and in an interval of dumping: 10 to 67 s each. Choice: twice as many, twice the trials.
What is on for more than half of a cycle is off for less: the bias takes up the difference."""

_MOST_LINES: Final = 2  # lines near which a duty is sought; choice: of one whose second line is stronger, both

_BESIDE: Final = np.arange(-4, 5) / 8.0
"""Places near a line that are tried [1 / duration]: a line is known to half of that, and from one place to the next a
duty's edges move by a sixteenth of a cycle at either end."""

_MOST_STRETCHES: Final = 20_000
"""Stretches of time that a duty is folded from at the most; choice: 50 ms of sums."""

_CLEAR: Final = 200.0
"""Drop in squares [variances of the residual] from which on a duty's edges are sought beyond its slots: a slot's half
holds a fiftieth of it."""

_ASIDE: Final = 4
"""Steps to either side that the cycle and each edge of a duty are moved by at once: a slot, at the first."""

_FINEST: Final = 1.0 / 16.0
"""Steps of a duty's edges at the last [samples]: between the same two the many edges of one duty lie anywhere."""

_MOST: Final = 6
"""Best duties of the sums that are evaluated by columns; choice: the sums rank well, and each costs a fit."""


def regular(scene: Scene, effect: str, as_well: tuple[str, ...]) -> Hypothesis:
    """A constant dipole, on and off."""
    duty = (
        Nonlinear("period_s", "s", np.empty(0), "period"),
        Nonlinear("on_share", "1", np.arange(1, SLOTS // 2 + 1) / SLOTS, role="held"),
        Nonlinear("phase", "1", np.arange(SLOTS) / SLOTS, role="held"),
    )

    def columns(theta: Array) -> Columns:
        period_s, share, phase = (float(value) for value in theta)
        on = np.mod(scene.time_s / period_s - phase, 1.0) < share
        return along_axes(on.astype(np.float64))

    return Hypothesis(
        effect,
        "inferred:duty",
        columns,
        (Block("on_nt", "nT"),),
        "regular duty",
        duty,
        as_well=as_well,
        proposals=lambda sums, grids: _duty_tried(scene, grids[0], sums),
    )


def _duty_tried(scene: Scene, periods: Array, sums: Sums) -> Array:
    """Numbers (q, 3) of the duties near each period that lower the squares most.

    A line is known to a part of 1 / duration, over which a duty's edges move by as much of a cycle; so the periods near
    the best lines are tried as well, all from sums over short stretches.
    """
    width = max(float(periods.min()) / SLOTS, scene.period_s, float(np.ptp(scene.time_s)) / _MOST_STRETCHES)
    firsts = np.unique(np.searchsorted(scene.time_s, np.arange(scene.time_s[0], scene.time_s[-1], width)))
    folds = sums(along_axes(np.ones(len(scene))), firsts).folds
    times = scene.time_s[firsts] + 0.5 * (width - scene.period_s)

    def best(period_s: float) -> tuple[float, list[float]]:
        drops = folds.folded(cuts(times, period_s)).drop(_DUTIES)
        top = int(np.argmax(drops))
        share, slot = _DUTY_NUMBERS[top]
        return float(drops[top]), [period_s, share / SLOTS, slot / SLOTS]

    lines = sorted((best(period_s) for period_s in periods.tolist()), reverse=True)[:_MOST_LINES]
    beside = [1.0 / period[0] + _BESIDE / float(np.ptp(scene.time_s)) for _, period in lines]
    near = [best(1.0 / frequency) for frequency in np.concatenate(beside).tolist() if frequency > 0.0]
    found = sorted([*lines, *near], reverse=True)[:_MOST]
    if found[0][0] > _CLEAR * folds.squares / max(folds.count, 1):
        found.insert(0, _sharpened(scene, found[0], sums))
    return np.array([numbers for _, numbers in found])


def _sharpened(scene: Scene, found: tuple[float, list[float]], sums: Sums) -> tuple[float, list[float]]:
    """A duty whose cycle and edges are moved together, by ever smaller steps, to where the squares drop most.

    Edges that are off by a part of a slot leave as much as they would of a field that is strong, and one number moved
    alone gets nowhere: a longer cycle moves every edge.
    """
    span_s, middle_s = float(np.ptp(scene.time_s)), float(scene.time_s.mean())
    firsts = np.arange(0, len(scene), max(1, -(-len(scene) // _MOST_STRETCHES)))
    folds = sums(along_axes(np.ones(len(scene))), firsts).folds
    times = scene.time_s[firsts] - middle_s

    def around(period_s: float, begin: float, end: float, step: float) -> tuple[float, tuple[float, float, float]]:
        """The largest drop, and the duty that has it, of those of a cycle [s] whose edges at the middle of the
        recording are within some steps of these [cycles]."""
        moves = step * np.arange(-_ASIDE, _ASIDE + 1)
        edges = np.concatenate([begin + moves, end + moves])
        if end - begin <= 2.0 * moves[-1] or end + moves[-1] >= begin + moves[0] + 1.0:
            return 0.0, (period_s, begin, end)
        cycles = np.unique(np.floor(times / period_s - edges[0]))[:, None] + np.append(edges, edges[0] + 1.0)
        drops = folds.folded(np.searchsorted(times, period_s * cycles)).drop(_BETWEEN)
        first, last = np.divmod(int(np.argmax(drops)), len(moves))
        return float(drops.max()), (period_s, begin + float(moves[first]), end + float(moves[last]))

    best, (period_s, share, phase) = 0.0, found[1]  # what whole slots hold is not of the same rows
    begin = float(np.mod(phase - middle_s / period_s, 1.0))
    duty, step = (period_s, begin, begin + share), 0.25 / SLOTS
    while step > _FINEST * scene.period_s / period_s:
        wider = step * duty[0] ** 2 / (0.5 * span_s) * np.arange(-_ASIDE, _ASIDE + 1)
        drop, top = max(around(duty[0] + float(more), duty[1], duty[2], step) for more in wider)
        if drop > best:
            best, duty = drop, top
        else:
            step *= 0.5
    period_s, begin, end = duty
    return best, [period_s, end - begin, float(np.mod(begin + middle_s / period_s, 1.0))]


def cuts(times_s: Array, period_s: float) -> NDArray[np.intp]:
    """Where the slots of each interval begin, and the last ends, among rising times (g,): (intervals, slots + 1).

    Intervals without any of the times are left out: between passes days apart nearly all are.
    """
    first, last = (float(np.floor(times_s[end] / period_s)) for end in (0, -1))
    if last - first < len(times_s):
        number = np.arange(first, last + 2.0)
    else:
        own = np.floor(times_s / period_s)
        number = np.unique(np.concatenate([own, own + 1.0]))
    begin = number * period_s  # of one more than there are times in, where a quotient was rounded down
    found: NDArray[np.intp] = np.searchsorted(times_s, begin[:, None] + np.arange(SLOTS + 1) / SLOTS * period_s)
    return found[found[:, -1] > found[:, 0]]


def patterns_of(numbers: list[tuple[int, int]]) -> Array:
    """(m, slots): which slots are on, of so many that follow one another from one on, round the end."""
    return np.array([[float((at - slot) % SLOTS < share) for at in range(SLOTS)] for share, slot in numbers])


_DUTY_NUMBERS: Final = [(share, slot) for share in range(1, SLOTS // 2 + 1) for slot in range(SLOTS)]
_DUTIES: Final = patterns_of(_DUTY_NUMBERS)

_BETWEEN: Final = np.array(
    [
        [float(i <= at < 2 * _ASIDE + 1 + j) for at in range(4 * _ASIDE + 2)]
        for i, j in np.ndindex((2 * _ASIDE + 1,) * 2)
    ]
)
"""(m, 2 x 9) which stretches between the tried places of two edges are on, of each place of either."""
