"""Activity of torquers that was not recorded: a regular duty, detumbling by the sign of dB/dt, dumping of momentum.

Detumbling fires against dB/dt, seen just before, for part of every cycle, maybe for part of the recording only; dumping
fires along B x h at intervals and holds for a moment.  Their few numbers (cycle, phase, share) jump, so they are
searched by sums over stretches of time rather than by new columns for each.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.physics.columns import Columns, along_axes
from magcal_service.physics.drivers.duty import SLOTS, cuts, patterns_of, regular
from magcal_service.physics.interface import Block, Hypothesis, Nonlinear, Proposals
from magcal_service.physics.saying import AXES
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.segments import Segments, Sums

CYCLES_S: Final = np.array([4.0, 5.0, 6.0, 7.0, 8.0, 10.0, 12.0, 15.0, 20.0, 30.0, 60.0])
"""Controllers measure, fire and pause in whole seconds; slower ones would not detumble."""

LEADS_S: Final = np.array([0.0, 0.5, 1.0, 2.0, 4.0])
"""How long before it fires a controller has seen dB/dt."""

HOLDS_S: Final = np.array([2.0, 4.0, 5.0, 10.0])
"""For how long a dipole is held while momentum is dumped, where it does not follow the field."""

INTERVAL_S: Final = (250.0, 1600.0)
"""From the beginning of one dump of momentum to the next."""

LARGEST_NT: Final = 5000.0
"""rms of a pattern that is only inferred: what is larger would have been recorded, or is something else."""

_SHARES: Final = np.array([0.3, 0.5, 0.75])
"""Shares of a cycle for which coils detumble; choice: a share between is met with about nine tenths of its field."""

_PHASES: Final = 8
"""Places in a cycle where firing may begin; choice: the nearest is a sixteenth of a cycle off at most."""

_PARTS: Final = 24
"""Stretches of a recording in which detumbling may be on or off; choice: begin and end are known to 4 %."""

_SHORTEST_PART: Final = 7
"""Least consecutive stretches that count: 29 % of the recording; shorter ones, besides these 171, fit chance."""

_ON_SLOTS: Final = (3, 5, 7, 10)
"""Lengths of a dump that are tried, in slots: 12 to 42 % of the interval, each about half longer than the last."""

_LONGEST_BEAT_S: Final = 86400.0
"""Length of a recording up to which dumps are taken to keep one beat [s]: a wheel's load and a schedule change daily;
and intervals to be told apart grow with the length, as do the sums for each."""

_SEGMENT_S: Final = 8.0
"""Length of the sums that intervals are folded from [s]; choice: below a slot, few in a long recording."""

_MOST: Final = 6
"""Best patterns of the sums that are evaluated by columns; choice: the sums rank well, and each costs a fit."""

_FULLY, _FEWEST_FULLY = 10, 60
"""One in so many intervals, and the least number of them, whose sums are evaluated with the model's columns beside
them: those that come first without, which costs a third and ranks nearly the same."""

_LONGEST_PERIOD_S: Final = 20.0
"""Sample period beyond which no pattern is searched [s]: most of ``CYCLES_S`` would be sampled less than once."""

_LEAST_SAMPLES: Final = 200
"""Samples from which on a pattern is searched: its nine amplitudes and six numbers need several each."""


_COILS: Final = ("coil x", "coil y", "coil z")
_ALONG: Final = ("field along x", "field along y", "field along z")
"""What the rows of an amplitude belong to."""

_IMITATED: Final = "a gain that changes on the same beat, by a cause in no catalogue"
"""What a dipole along B x h, as it follows the field, leaves as well: parts of the field itself, while it fires."""

_SYMMETRIC: Final = ("xx", "yy", "zz", "xy", "xz", "yz")
"""Elements of a symmetric matrix."""

DETUMBLING: Final = "inferred:detumbling"
DUMPING: Final = "inferred:dumping"
"""Drivers that need the course of the field before a sample."""


def inferred(scene: Scene, effect: str, as_well: tuple[str, ...]) -> Iterator[Hypothesis]:
    """Every pattern, where the samples are close enough to see one; ``as_well``: effects that a regular duty may be."""
    if (scene.period_s > _LONGEST_PERIOD_S or len(scene) < _LEAST_SAMPLES) and not scene.is_given:
        return
    for hypothesis in _patterns(scene, effect, as_well):
        yield replace(hypothesis, is_free=True)


def _patterns(scene: Scene, effect: str, as_well: tuple[str, ...]) -> Iterator[Hypothesis]:
    yield regular(scene, effect, as_well)
    yield _detumbling(scene, effect)
    steady = along_axes(-np.sign(scene.field_slope))
    block = Block("detumbling_nt", "nT", (3, 3), labels=(_COILS, AXES))
    yield Hypothesis(effect, DETUMBLING, lambda _: steady, (block,), "sign of dB/dt", odds=6.0)
    yield from _dumping(scene, effect)


# Detumbling


def _pulsed(scene: Scene, period_s: float, phase: float, lead_s: float) -> tuple[Array, Array]:
    """Dipoles (n, 3) of full coils against dB/dt as seen a lead before each cycle, and each row's place in it (n,)."""
    cycle = scene.time_s / period_s - phase
    begun = np.floor(cycle)
    first = np.append(0, np.flatnonzero(np.diff(begun)) + 1)  # of each cycle, in all of which the dipoles are the same
    seen_s = (begun[first] + phase) * period_s - lead_s
    measured = np.clip(np.searchsorted(scene.time_s, seen_s - 0.5 * scene.period_s), 0, len(scene) - 1)
    dipoles = -np.sign(scene.field_slope[measured])
    return np.repeat(dipoles, np.diff(np.append(first, len(scene))), axis=0), cycle - begun


def _detumbling(scene: Scene, effect: str) -> Hypothesis:
    edges = np.linspace(float(scene.time_s[0]), float(scene.time_s[-1]), _PARTS + 1)
    edges[-1] += scene.period_s
    numbers = (
        Nonlinear("period_s", "s", CYCLES_S * max(1.0, scene.period_s), role="held"),
        Nonlinear("on_share", "1", _SHARES, role="held"),
        Nonlinear("phase", "1", np.linspace(0.0, 1.0, _PHASES, endpoint=False), role="held"),
        Nonlinear("lead_s", "s", LEADS_S, role="held"),
        Nonlinear("from_s", "s", edges[:-1], role="held"),
        Nonlinear("to_s", "s", edges[1:], role="held"),
    )

    def columns(theta: Array) -> Columns:
        period_s, share, phase, lead_s, first_s, last_s = (float(value) for value in theta)
        dipole, into = _pulsed(scene, period_s, phase, lead_s)
        on = (into < share) & (scene.time_s >= first_s) & (scene.time_s < last_s)
        return along_axes(dipole * on[:, None])

    periods = numbers[0].grid
    block = Block("detumbling_nt", "nT", (3, 3), labels=(_COILS, AXES))
    variant = "sign of dB/dt on a duty"
    return Hypothesis(
        effect,
        DETUMBLING,
        columns,
        (block,),
        variant,
        numbers,
        odds=7.0,
        largest_nt=LARGEST_NT,
        proposals=lambda sums, _: _detumbling_tried(scene, periods, edges, sums),
    )


def _detumbling_tried(scene: Scene, periods: Array, edges: Array, sums: Sums) -> Array:
    """Numbers (q, 6) of the patterns that lower the squares most, each for its best part and for all of the time."""
    firsts = np.searchsorted(scene.time_s, edges[:-1])
    lead_s = float(LEADS_S[1])
    tried: list[tuple[float, tuple[float, float, float]]] = []

    def fired(dipole: Array, into: Array, share: float) -> Columns:
        return along_axes(dipole * (into < share)[:, None])

    for period_s in periods.tolist():
        count = int(np.clip(round(period_s / scene.period_s), 2, _PHASES))
        for phase in (np.arange(count) / count).tolist():
            pulsed = _pulsed(scene, period_s, phase, lead_s)
            for share in _SHARES.tolist():
                drop = float(sums(fired(*pulsed, share), firsts[:1]).drops[0])
                tried.append((drop, (period_s, share, phase)))
    tried.sort(key=lambda trial: -trial[0])
    parts = _parts()
    found = []
    for whole, numbers in tried[:_MOST]:
        pulsed = _pulsed(scene, numbers[0], numbers[2], lead_s)
        drops = sums(fired(*pulsed, numbers[1]), firsts).drop(parts)
        best = int(np.argmax(drops))
        used = np.flatnonzero(parts[best]) if drops[best] > whole else np.arange(_PARTS)
        found.append([*numbers, lead_s, edges[used[0]], edges[used[-1] + 1]])
        found.append([*numbers, lead_s, edges[0], edges[-1]])
    return np.array(found)


def _parts() -> Array:
    """Every stretch (m, parts) of consecutive parts that is long enough."""
    pairs = [(i, j) for i in range(_PARTS) for j in range(i + _SHORTEST_PART, _PARTS + 1)]
    number = np.arange(_PARTS)
    return np.array([(number >= i) & (number < j) for i, j in pairs], dtype=np.float64)


# Dumping


def _held(scene: Scene, into_s: Array, hold_s: float) -> NDArray[np.intp]:
    """Rows (n,) whose field the dipole of each row was made for, ``into_s`` (n,) after its interval has begun."""
    rows = np.arange(len(scene))
    if hold_s <= scene.period_s:
        return rows
    made_s = scene.time_s - np.mod(into_s, hold_s)
    return np.minimum(np.searchsorted(scene.time_s, made_s - 0.5 * scene.period_s), rows)


def _dumping(scene: Scene, effect: str) -> Iterator[Hypothesis]:
    """Forms of a dipole along B x h, whose field is some matrix times B.

    A magnitude shows its symmetric part only: matrices that differ by a turn of the pulses' vectors leave one and the
    same.  The rest shows where a dipole is held while the field turns, or in whole vectors.
    """
    span = float(scene.time_s[-1] - scene.time_s[0])
    if not 3.0 * INTERVAL_S[0] <= span <= _LONGEST_BEAT_S and not scene.is_given:
        return
    periods = _intervals(max(span, 3.0 * INTERVAL_S[0]))
    numbers = (
        Nonlinear("period_s", "s", periods, role="held"),
        Nonlinear("on_share", "1", np.array(_ON_SLOTS) / SLOTS, role="held"),
        Nonlinear("phase", "1", np.arange(SLOTS) / SLOTS, role="held"),
    )
    middle_s = scene.constant("middle_s", float(0.5 * (scene.time_s[0] + scene.time_s[-1])))

    def field(theta: Array) -> Array:
        period_s, share, phase, hold_s = (*theta.tolist(), 0.0)[:4]
        into = np.mod((scene.time_s - middle_s) / period_s - phase, 1.0)
        made = _held(scene, into * period_s, hold_s)
        return np.asarray(scene.calibrated_nt[made] * (into < share)[:, None])

    def tried(holds: Array | None = None) -> Proposals:
        return lambda sums, _: _dumping_tried(scene, periods, holds, middle_s, sums)

    variant = "momentum dumped at intervals"
    plain = Hypothesis(
        effect,
        DUMPING,
        lambda theta: Columns(body=_symmetric(field(theta))),
        (Block("dumping", "1", (6,), labels=(_SYMMETRIC,)),),
        variant,
        numbers,
        {"middle_s": middle_s},
        largest_nt=LARGEST_NT,
        proposals=tried(),
        imitated_by=_IMITATED,
    )
    whole = replace(
        plain,
        columns=lambda theta: along_axes(field(theta)),
        blocks=(Block("dumping", "1", (3, 3), labels=(_ALONG, AXES)),),
    )
    holds = HOLDS_S[scene.period_s < HOLDS_S]
    yield plain
    yield replace(whole, variant=f"{variant}, in any direction", needs_vectors=True)
    if len(holds):
        held, name = Nonlinear("hold_s", "s", holds, role="held"), f"{variant}, held"
        yield replace(
            whole,
            variant=name,
            nonlinear=(*numbers, held),
            refines=plain.label,
            proposals=tried(held.grid),
            imitated_by="",
        )


def _symmetric(field_nt: Array) -> Array:
    """(6, n, 3) of vectors (n, 3): what each element of a symmetric matrix adds, in the order of ``_SYMMETRIC``."""
    body = np.zeros((6, *field_nt.shape))
    for number, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
        body[number, :, i] = field_nt[:, j]
        body[number, :, j] = field_nt[:, i]
    return body


def _dumping_tried(scene: Scene, periods: Array, holds: Array | None, middle_s: float, sums: Sums) -> Array:
    """Numbers (q, 3) of the intervals and slots that lower the squares most, or (q, 4) with every hold, if any."""
    body = _symmetric(scene.calibrated_nt)
    width = max(_SEGMENT_S, scene.period_s)
    firsts = np.unique(np.searchsorted(scene.time_s, np.arange(scene.time_s[0], scene.time_s[-1], width)))
    segments = sums(Columns(body=body), firsts)
    times = scene.time_s[firsts] + 0.5 * width - middle_s

    def table(of: Segments, among: NDArray[np.intp]) -> Array:
        folds = of.folds
        return np.array([folds.folded(cuts(times, float(periods[row]))).drop(_ON) for row in among])

    rough = table(segments.alone, np.arange(len(periods))).max(axis=1)
    among = np.argsort(rough)[::-1][: max(len(periods) // _FULLY, _FEWEST_FULLY)]
    drops = table(segments, among)
    best = np.argsort(drops.max(axis=1))[::-1][:_MOST]
    found = []
    for row in best.tolist():
        share, slot = _ON_NUMBERS[int(np.argmax(drops[row]))]
        numbers = [periods[among[row]], share / SLOTS, slot / SLOTS]
        found += [numbers] if holds is None else [[*numbers, hold_s] for hold_s in holds.tolist()]
    return np.array(found)


def _intervals(span_s: float) -> Array:
    """Intervals so close to one another that a dump at either end is met by a seventh of its length."""
    found = [INTERVAL_S[0]]
    while found[-1] < min(INTERVAL_S[1], span_s / 3.0):
        found.append(found[-1] * (1.0 + 0.12 * found[-1] / span_s))
    return np.array(found)


_ON_NUMBERS: Final = [(share, slot) for share in _ON_SLOTS for slot in range(SLOTS)]
_ON: Final = patterns_of(_ON_NUMBERS)
