"""What no effect explains: the family of shapes that holds most of a residual, how much, and its form."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.cycle import CYCLE, cycle
from magcal_service.diagnosis.explain import Search
from magcal_service.diagnosis.groups import Groups
from magcal_service.diagnosis.linear import Products, Workspace
from magcal_service.diagnosis.lines import Spectrum, body_spectrum, strongest
from magcal_service.diagnosis.problem import Fit, Problem
from magcal_service.diagnosis.screen import ACCEPTED_NATS
from magcal_service.diagnosis.shapes import Shape, body_shape, in_groups, plain_shape, products_of_two, shapes
from magcal_service.diagnosis.signals import Followed, strongest_signal
from magcal_service.diagnosis.sweeps import tracks
from magcal_service.diagnosis.wander import (
    TWO_LEVELS,
    Blocks,
    Course,
    first_samples,
    of_every_axis,
    shown_in,
    two_levels,
    wandering,
)
from magcal_service.model import Array
from magcal_service.physics.columns import along_axes, oscillation

SIGNIFICANT_NATS: Final = 6.0
"""Evidence for a family, after their number, from which on it is no noise: about a dozen are tried."""

_MOST_TERMS: Final = 5
"""Terms of a family that are named; choice: enough for a product on three axes and two others, few enough to read."""

_TAIL: Final = 3.5
"""Of the noise, what a single sample counts for at the most where stretches are looked for: one far out is none, but
would be found in the shortest of them.  What lasts is there in all its samples."""

_FAR: Final = 5.0
"""Of the residual, the same for every other family: powers of the field follow a sample far out where it points as it
seldom does.  Noise comes so far once in two million; what bends only at the largest fields is four sigma there."""

_TRANSIENTS_S: Final = (30.0, 90.0, 240.0)
"""Widths of a stretch that is tried [s]: a manoeuvre, a heater, a pass over a station.

Choice: factors of about three, since a stretch half or twice as long as the cause still finds most of it; more widths
cost evidence by their number.
"""

_COLUMNS_AT_ONCE: Final = 54  # made, or made white, together: those of a line's courses would be 46 MB at 20 000 rows

_FAINT: Final = 0.02
"""Of the square of what a whitening leaves, up to which a family may be a part of the noise's memory: a seventh of its
size.  Of 1 / f noise that remembers for minutes the coefficients of some hours leave 0.005 to 0.011."""

_MOST_TRANSIENTS: Final = 40
"""Stretches in one family; choice: 40 of 90 s are an hour, and what fills half of a recording is no transient."""


@dataclass(frozen=True, eq=False)
class Structure:
    """Structure of one family in a residual.

    Parameters
    ----------
    shape: the family.
    nats: evidence for it, after the number of families tried.
    squares: sum of squares that it holds, less what noise alone would give it [nT^2].
    fitted: works out its fitted value (m,) in each row [nT]; the columns are made again for it.
    """

    shape: Shape
    nats: float
    squares: float
    fitted: Callable[[], Array]

    @cached_property
    def signal(self) -> Array:
        """(m,) its fitted value in each row [nT]."""
        return self.fitted()


@dataclass(frozen=True, slots=True, eq=False)
class _Beside:
    """A fit, its residual with the model's columns out, without its tails and whole, and the search as it was there:
    itself it goes on elsewhere.  ``white_whole``: the residual through a symmetric whitening once more."""

    search: Search
    fit: Fit
    space: Workspace
    whole: Workspace
    white_whole: Array | None = None

    def products(self, shape: Shape) -> tuple[Products, Products]:
        """Of a family's columns, which are not kept, with the residual without its tails, and with all of it."""
        if self.white_whole is not None and shape.groups is not None:
            return self._of_groups(shape.groups, shape.own(self.fit.unit), self.white_whole)
        rows = shape.columns(self.fit.unit)
        if self.white_whole is not None:
            held = self.space.products_before(rows, self.search.problem)
            return held, replace(held, right=rows.T @ self.white_whole / held.scale)
        columns = self._white(rows)
        held = self.space.products(columns)
        return held, replace(held, right=columns.T @ self.whole.residual / held.scale)

    def _of_groups(self, groups: Groups, own: Array, white_whole: Array) -> tuple[Products, Products]:
        """The same of columns ``own`` (m, a) in each group's rows alone: those of a few groups are made at a time."""
        problem, beside, right = self.search.problem, [], []
        some = max(_COLUMNS_AT_ONCE // own.shape[1], 1)
        for first in range(0, groups.count, some):
            rows = groups.columns(own, slice(first, first + some))
            beside.append(self.space.beside(rows, problem))
            right.append(rows.T @ white_whole)
        held = self.space.products_of(problem.white_products(own, groups), np.concatenate(beside, axis=1))
        return held, replace(held, right=np.concatenate(right) / held.scale)

    def _white(self, rows: Array) -> Array:
        """Rows (m, k) made white, a few columns at a time: a whitening needs room for several times as many."""
        found = np.empty(rows.shape[::-1]).T  # each in one piece
        for first in range(0, rows.shape[1], _COLUMNS_AT_ONCE):
            some = slice(first, first + _COLUMNS_AT_ONCE)
            found[:, some] = self.search.white(rows[:, some])
        return found

    def signal(self, shape: Shape, amplitudes: Array) -> Array:
        """(m,) what amplitudes of a family add to the residual [nT]."""
        return self.space.projected(self.search.white(shape.columns(self.fit.unit) @ amplitudes))


def _beside(search: Search, fit: Fit, floor_nt: float) -> tuple[_Beside, float]:
    """A fit's residual without its tails, and the noise that evidence in it is counted in first [nT]."""
    space = search.workspace(fit)
    sigma = max(math.sqrt(space.squares / space.count), floor_nt)
    white_whole = search.white(space.residual) if search.is_symmetric else None
    return _Beside(replace(search, hypotheses=()), fit, space.clipped(_FAR * sigma), space, white_whole), sigma


def structures(search: Search, fit: Fit, phase: Array | None, floor_nt: float) -> list[Structure]:
    """Every family's part in the residual of a fit, the best first."""
    beside, sigma = _beside(search, fit, floor_nt)
    space = beside.space
    spectrum = body_spectrum(search.problem.scene, space.residual, fit.unit)
    line_hz = _line(search, fit, space, spectrum, sigma)
    families = [(shape, beside.products(shape), 0.0) for shape in shapes(search.problem, phase, line_hz)]
    families += _repeating(beside, spectrum, sigma) if line_hz is not None else []
    cost = math.log(max(len(families), 1))
    found = []
    for _ in range(2):
        found = [_structure(shape, products, beside, sigma, cost + own) for shape, products, own in families]
        found.sort(key=lambda structure: -structure.nats)
        left = (beside.whole.squares - found[0].squares) / space.count
        better = max(math.sqrt(max(left, 0.0)), floor_nt)
        if better > 0.98 * sigma:
            break
        sigma = better
    sudden = _transients(beside, sigma, cost)
    return found if sudden is None else sorted([*found, sudden], key=lambda structure: -structure.nats)


def _repeating(
    beside: _Beside, spectrum: Spectrum, sigma: float
) -> list[tuple[Shape, tuple[Products, Products], float]]:
    """A course that repeats, with its products and what its search costs [nats]."""
    search, problem = beside.search, beside.search.problem
    rows = search.seen(along_axes(np.ones(len(problem.scene))), beside.fit)
    found = cycle(problem.scene, rows, beside.space.residual, spectrum, sigma, search.spin_hz)
    if found is None:
        return []
    shape = in_groups(problem, CYCLE, found.says, found.levels)
    return [(shape, beside.products(shape), found.cost)]


def _transients(beside: _Beside, sigma: float, cost: float) -> Structure | None:
    """Stretches, at no regular times, in which a field fixed in the body is present.

    Each stretch of three widths that gains more than choosing it among all costs counts by what it gains; of those
    that overlap the best.  Where most of the recording would count, it is no transient.
    """
    search, space = beside.search, beside.space.clipped(_TAIL * sigma)
    scene, each = search.problem.scene, search.problem.rows_per_sample
    rows = search.seen(along_axes(np.ones(len(scene))), beside.fit)
    trials: list[tuple[float, int, int]] = []
    for width_s in _TRANSIENTS_S:
        step = max(round(0.5 * width_s / scene.period_s), 3)
        firsts = np.arange(0, len(scene) - 2 * step, step)
        if len(firsts) < 4:
            continue
        gains = (
            0.5 * space.segments(rows, each * firsts).pairs.drops / sigma**2
            - 1.5 * math.log(2.0 * step)
            - math.log(len(firsts) * 3.0)
        )
        trials += [
            (gain, int(first), int(first) + 2 * step) for gain, first in zip(gains.tolist(), firsts, strict=False)
        ]
    chosen: list[tuple[float, int, int]] = []
    for gain, first, last in sorted(trials, reverse=True):
        if gain <= 0.0 or len(chosen) >= _MOST_TRANSIENTS:
            break
        if all(last <= other[1] or first >= other[2] for other in chosen):
            chosen.append((gain, first, last))
    if not chosen or sum(last - first for _, first, last in chosen) > 0.5 * len(scene):
        return None
    signals = np.zeros((len(scene), len(chosen)))
    for column, (_, first, last) in enumerate(chosen):
        signals[first:last, column] = 1.0
    shape = body_shape(
        search.problem, "transients", "a body-fixed field that comes and goes at no regular times", signals
    )
    found = _structure(shape, beside.products(shape), beside, sigma, cost)
    return replace(found, nats=sum(gain for gain, _, _ in chosen) - cost)


def with_courses(search: Search, fit: Fit, found: list[Structure], floor_nt: float) -> list[Structure]:
    """The structures of a residual, and in their order tones whose frequency wanders, courses at no regular times and
    what follows a signal of a channel: those are sought once only, beside what stands."""
    beside, sigma = _beside(search, fit, floor_nt)
    cost = math.log(len(found) + 3.0)
    followed = _following(beside, sigma, strongest_signal(search, fit, floor_nt))
    blocks = _blocks(beside, sigma)
    if blocks is not None and len(search.whitening):
        remembered = max(of_every_axis(blocks), 0.0)
        faint = _FAINT * sigma**2 * beside.space.count
        found = [replace(one, nats=one.nats - remembered) if one.squares < faint else one for one in found]
    return sorted(
        [*found, *_sweeping(beside, sigma, cost), *_wandering(beside, blocks, sigma, cost), *followed],
        key=lambda structure: -structure.nats,
    )


def _blocks(beside: _Beside, sigma: float) -> Blocks | None:
    """What short blocks of a residual say of a field fixed in the body; None of a recording too short for them."""
    search, problem = beside.search, beside.search.problem
    first = first_samples(problem.scene)
    if not len(first):
        return None
    rows = search.seen(along_axes(np.ones(len(problem.scene))), beside.fit)
    sums = beside.space.clipped(_TAIL * sigma).segments(rows, problem.rows_per_sample * first)
    return Blocks.of(problem.scene, first, rows, sums, sigma)


def _sweeping(beside: _Beside, sigma: float, cost: float) -> Iterator[Structure]:
    """Tones whose frequency wanders."""
    search, fit = beside.search, beside.fit
    if search.problem.is_vector:
        return
    for one in tracks(search.problem.scene, beside.space.clipped(_TAIL * sigma).residual, fit.unit, search.spin_hz):
        between = f"{one.from_hz:.3g} and {one.to_hz:.3g} Hz"
        says = f"a body-fixed oscillation whose frequency wanders between {between}"
        shape = plain_shape("wandering", says, one.rows)
        yield _structure(shape, beside.products(shape), beside, sigma, cost + one.cost)


def _wandering(beside: _Beside, blocks: Blocks | None, sigma: float, cost: float) -> Iterator[Structure]:
    """A course at no regular times along one direction: between two levels, where it rather is, or any."""
    search, problem = beside.search, beside.search.problem
    course = None if blocks is None else wandering(blocks)
    if blocks is None or course is None or course.nats < SIGNIFICANT_NATS:
        return
    levels = two_levels(blocks, course.direction)
    if len(search.whitening) and of_every_axis(blocks) > max(course.nats, levels.nats):
        return  # what the whitening leaves of noise with a memory
    if levels.nats > course.nats:
        says = f"a body-fixed field that goes between two levels, {levels.switches} times"
        course, shape = levels, body_shape(problem, TWO_LEVELS, says, levels.share[:, None], ("the rarer level",))
    else:
        says = f"a body-fixed field along one direction that wanders, within about {course.each_s:.0f} s"
        shape = Shape("course", says, partial(_course_columns, problem, shown_in(problem.scene, course), course))
    found = _structure(shape, beside.products(shape), beside, sigma, cost)
    yield replace(found, nats=course.nats - cost)


def _following(beside: _Beside, sigma: float, followed: Followed | None) -> Iterator[Structure]:
    """What follows a signal of a channel, which may be a gain, and made of its values."""
    if followed is None:
        return
    hypothesis, problem = followed.hypothesis, beside.search.problem

    def columns(unit: Array) -> Array:
        rows = problem.rows(hypothesis.columns(np.zeros(0)), unit)
        assert rows is not None, "a signal acts in every form"
        return rows

    shape = Shape(f"{hypothesis.driver.replace(':', ' ')}, {hypothesis.variant}", followed.says, columns)
    found = _structure(shape, beside.products(shape), beside, sigma, 0.0)
    yield replace(found, nats=followed.nats)


def _course_columns(problem: Problem, number: NDArray[np.intp], course: Course, unit: Array) -> Array:
    """(m, k) a field along a course's direction in each of its stretches."""
    rows = problem.rows(along_axes(np.ones(len(number))), unit)
    assert rows is not None, "a field fixed in the body is seen in every form"
    inside = number[:, None] == np.arange(number.max() + 1)
    return np.asarray((rows @ course.direction)[:, None] * np.repeat(inside, problem.rows_per_sample, axis=0))


def largest_product(search: Search, fit: Fit, floor_nt: float, axes: int = 1) -> float:
    """Drop in squares [nT^2] by the best product of two components of the field, alone, on an axis or in a direction.

    Parameters
    ----------
    axes: 1, or 3 for a direction, whose three amplitudes are free.
    """
    if search.problem.is_vector:
        return 0.0
    space = search.workspace(fit)
    sigma = max(math.sqrt(space.squares / space.count), floor_nt)
    rows = search.white(products_of_two(search.problem).along(fit.unit))
    return max(space.gain(rows[:, at : at + axes], sigma).squares for at in range(0, rows.shape[1], axes))


def _line(search: Search, fit: Fit, space: Workspace, spectrum: Spectrum, sigma: float) -> float | None:
    """The strongest line, where it is one [Hz]; its neighbourhood may hold more than a steady tone."""
    scene = search.problem.scene
    found = strongest(scene, spectrum, 1, search.spin_hz)
    if not len(found):
        return None
    rows = search.seen(oscillation(scene.time_s, float(found[0])), fit)
    return float(found[0]) if space.gain(rows, sigma).nats > 0.5 * SIGNIFICANT_NATS else None


def _structure(
    shape: Shape, products: tuple[Products, Products], beside: _Beside, sigma: float, cost: float
) -> Structure:
    """A family's evidence by what single samples count for at the most, and its size by all that they hold."""
    held, whole = (each.gain(sigma) for each in products)
    squares = max(whole.squares - whole.effective * sigma**2, 0.0)
    return Structure(shape, held.nats - cost, squares, lambda: beside.signal(shape, whole.amplitudes))


def significant(structure: Structure) -> bool:
    """Whether a structure is more than noise."""
    return structure.nats > SIGNIFICANT_NATS


def unexplained_share(before: Fit, after: Fit, left: Sequence[Structure]) -> float:
    """Share of the mismatch in the best of the structures that are left, 0 where it may be noise; all of it where no
    effect explains any: nine errors that were fitted again explain nothing.

    ``before`` is the fit of the nine errors alone, ``after`` the one with effects.
    """
    if not left or not significant(left[0]):
        return 0.0
    if not after.terms:
        return 1.0
    explained = max(float(before.residual @ before.residual) - float(after.residual @ after.residual), 0.0)
    return left[0].squares / max(left[0].squares + explained, 1e-12)


def fitted_terms(structure: Structure, search: Search, fit: Fit) -> list[tuple[str, float]]:
    """The few terms of a family with names that hold most of its structure, with their amplitudes [nT rms].

    Chosen one after another by what each still explains, refitted together.
    """
    names = structure.shape.terms
    if not names:
        return []
    space = search.workspace(fit)
    columns = space.projected(search.white(structure.shape.columns(fit.unit)))
    labels = [f"{name} on {axis}" for name in names for axis in "xyz"]
    scale = np.sqrt(np.mean(columns**2, axis=0))
    chosen: list[int] = []
    residual = space.residual
    for _ in range(_MOST_TERMS):
        scores = (columns.T @ residual) ** 2 / np.maximum((columns**2).sum(axis=0), 1e-12)
        scores[chosen] = 0.0
        best = int(np.argmax(scores))
        sigma2 = float(residual @ residual) / len(residual)
        if scores[best] < (2.0 * ACCEPTED_NATS) * sigma2:
            break
        chosen.append(best)
        part = columns[:, chosen]
        residual = space.residual - part @ np.linalg.lstsq(part, space.residual, rcond=1e-9)[0]
    if not chosen:
        return []
    part = columns[:, chosen]
    amplitudes = np.linalg.lstsq(part, space.residual, rcond=1e-9)[0]
    return [(labels[i], float(a * scale[i])) for i, a in zip(chosen, amplitudes.tolist(), strict=True)]
