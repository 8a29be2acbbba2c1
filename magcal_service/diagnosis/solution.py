"""The joint solution of nine errors, amplitudes and nonlinear numbers: damped steps to the zero of the score.

The score is C'r with the columns C taken at noise-free vectors (``problem.evaluate``).  Its zero is where the noise in
the measured vectors pulls no unknown; the least sum of squares lies several sigma beside it (errors in variables).
So a step is judged by both: far from the solution the cost has to fall, near it the score.

The normal matrix C'C leaves out how the columns change with the unknowns; where that counts, its steps creep.  So near
the end what it leaves out is learned from the steps themselves.

Source: Marquardt 1963 for the damping; Dennis & Schnabel 1996, chapter 6, for judging a step by the norm of the
equations in the metric of their own derivative; Dennis, Gay & Welsch 1981 (NL2SOL) for learning only that part of the
derivative that is left out, here by Broyden's update 1965, since the score is no gradient.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.problem import Fit, Problem, Term, evaluate, free_numbers
from magcal_service.model import Array
from magcal_service.physics.interface import Hypothesis

_ITERATIONS: Final = 60
"""Steps, taken or refused; a sound start takes 3 to 8, a far one on real recordings up to 40."""

_PATIENCE: Final = 10
"""Steps after which the cost has to have fallen by what noise pulls, or half of the way to be gone: at a kink of the
model, or at the edge of what a number may be, none gets anywhere."""

_CONVERGED: Final = 1e-4
"""Square of the step still to go, in sigmas of the solution: it ends a hundredth of a sigma from the zero."""

ON_THE_WAY: Final = 1e-2
"""The same of what is only compared with others, or solved again before anything is said of it: a tenth of a sigma."""

_AT_A_KINK: Final = 0.1
"""The same where the model bends sharply with a number, as with the width of a hysteresis, and no step leads nearer: a
third of a sigma.  Of 18 faint ones two stalled at an eighth and a fourth of one, however they were sought."""

_FIRST_DAMPING: Final = 1e-3  # of the diagonal: shortens the step hardly, Marquardt's own
_LEAST_DAMPING: Final = 1e-9  # below it the step is that of Gauss and Newton
_MOST_DAMPING: Final = 1e9  # above it a step moves nothing in double precision

_EASED, _TIGHTENED = 0.1, 10.0
"""Factors on the damping after a step that was taken, and one that was refused; the customary ones."""

_BENDS: Final = 100.0
"""Square of the way that is left, in sigmas, below which steps tell what the normal matrix leaves out of the score's
derivative: ten sigma, as ``_MAY_COST``."""

_MOST_STRAYED, _STRAYS = 4, 10.0
"""Steps by such a derivative one after another that may lead no nearer, and times the way left that they may leave: of
122 solutions 111 arrived so, in half the steps of 98 by the normal matrix alone; 104 where each had to lead nearer."""

_NEAR: Final = 4.0
"""Square of the way that is left, in sigmas, up to which a fit has stalled near its end, not far from it."""

_NO_LESS: Final = 0.25
"""Noise variances by which the cost may be less to either side of a number that the model jumps with: half a sigma.
No slope leads to its best value, at which many jumps may meet, as where a duty is a whole number of samples."""

_SIDES: Final = (0.02, 0.005)
"""Shares of a cycle that the last of a duty's cycles is moved by to either side; the first is that of its slope."""

_MOST_ASIDE: Final = 8  # moves to a better side; the search before ends within one or two

_WIDEST, _NARROWEST = 0.2, 0.005
"""Steps of such a number, as shares of it, at first and at the last; what is left to go changes with their square."""

_REACH: Final = 12
"""Steps of ``_WIDEST`` in which a zero is looked for: a factor of nine, from one end of a grid to near the other."""

_MAY_COST: Final = 100.0
"""Noise variances by which the cost may rise on the way to the zero of the score: ten sigma of what the noise in the
vectors pulls, which is 4 to 6 sigma on recordings of a few orbits."""


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """The equations of one point: scaled normal matrix (p, p), score (p,), scale (p,), and what is left to go."""

    fit: Fit
    normal: Array
    score: Array
    scale: Array
    free: NDArray[np.bool_]
    cost: float
    sigma2: float
    to_go: float

    @classmethod
    def of(cls, fit: Fit, sigma2: float) -> _Step:
        scale, products, with_residual = fit.normal_equations
        tie = fit.tie * sigma2
        normal = products + np.diag(tie / scale**2)
        score = with_residual - tie * fit.unknowns / scale
        whole = np.linalg.lstsq(normal, score, rcond=1e-13)[0]
        free = ~_blocked(fit, whole / scale)
        cost = fit.squares + float(tie @ fit.unknowns**2)
        step = cls(fit, normal, score, scale, free, cost, sigma2, 0.0)
        full = whole if free.all() else step.damped(0.0)
        return replace(step, to_go=float(full @ normal @ full))

    def damped(self, damping: float, bend: Array | None = None) -> Array:
        """The scaled step (p,) with so much of the diagonal added, and a bend (p, p); what is blocked stays."""
        free = np.ix_(self.free, self.free)
        normal = self.normal[free] + damping * np.diag(np.diagonal(self.normal)[self.free])
        if bend is not None:
            normal += (bend / np.outer(self.scale, self.scale))[free]
        step = np.zeros(len(self.scale))
        step[self.free] = np.linalg.lstsq(normal, self.score[self.free], rcond=1e-13)[0]
        return step

    def bent(self, before: _Step, step: Array, bend: Array | None) -> Array:
        """What the score falls by with each unknown beside the normal matrix (p, p): a bend changed by the least, in
        the metric of that matrix, that tells how the score fell over a step (p,) of the unknowns from ``before``."""
        normal = self.normal * np.outer(self.scale, self.scale)
        along = normal @ step
        was = np.zeros_like(normal) if bend is None else bend
        missed = before.score * before.scale - self.score * self.scale - along - was @ step
        return np.asarray(was + np.outer(missed, along) / max(float(step @ along), 1e-300))


def solve(problem: Problem, start: Array, terms: Sequence[Term] = (), enough: float = _CONVERGED) -> Fit:
    """All unknowns jointly, from ``start`` (9,) or (12,); the nonlinear numbers move along inside their searched range.

    ``Fit.converged`` says whether the square of the step still to go, in sigmas, was below ``enough`` at the end.
    """
    start_fit = evaluate(problem, start, terms)
    here = best = mark = _Step.of(start_fit, _variance(start_fit))
    damping, bend, aside = 0.0, None, 0
    for iteration in range(_ITERATIONS):
        if iteration % _PATIENCE == _PATIENCE - 1:
            if not _is_nearer(mark, best):
                break
            mark = best
        if here.to_go < enough * here.sigma2:
            return replace(here.fit, converged=True)
        step = here.damped(damping, bend) / here.scale
        there = _tried(here, step)
        is_better = there is not None and _is_better(best, there)
        may_stray = bend is not None and aside < _MOST_STRAYED
        if there is not None and (is_better or (may_stray and _is_near(best, there))):
            if here.to_go < _BENDS * here.sigma2:
                bend = there.bent(here, step, bend)
            damping = damping * _EASED if damping > _LEAST_DAMPING else 0.0
            here = _Step.of(there.fit, _variance(there.fit))
            best, aside = (here, 0) if is_better else (best, aside + 1)
        elif bend is not None:
            here, bend, aside = best, None, 0
        else:
            damping = max(damping * _TIGHTENED, _FIRST_DAMPING)
            if damping > _MOST_DAMPING:
                break
    return replace(best.fit, converged=best.to_go < enough * best.sigma2)


def _tried(here: _Step, step: Array) -> _Step | None:
    """Where a step (p,) of the unknowns leads; None where there is no sensor, or far more is left."""
    problem, trial = here.fit.problem, _moved(here.fit, step)
    if problem.is_collapsed(trial[0]) and not problem.is_collapsed(here.fit.x):
        return None
    fit = evaluate(problem, *trial, most_nt2=here.cost + _MAY_COST * here.sigma2)
    return _Step.of(fit, here.sigma2) if _has_derivatives(fit) else None


def exchanged(problem: Problem, fit: Fit, index: int, term: Term, enough: float = _CONVERGED) -> Fit:
    """The joint solution from where a fit is, with another term in the place of its ``index``-th; as ``solve``."""
    terms = list(fit.terms)
    terms[index] = term
    return solve(problem, fit.x, terms, enough)


def ended(fit: Fit) -> Fit:
    """A fit that has stalled near its end, taken there along its least known number.

    Where two unknowns hardly differ in what they do, as an amplitude and a long time constant, or the delay of an axis
    and a skew at a steady spin, no step leads nearer.  So the number known least is held at values to either side, all
    others solved for, and the one with the least left to go is taken.  The period of a duty, at which the model jumps,
    has to leave least instead.  Where a model bends sharply with a number, a third of a sigma is near enough.
    """
    fit = _between_jumps(fit, _variance(fit))
    here = _Step.of(fit, _variance(fit))
    if fit.converged or here.to_go > _NEAR * here.sigma2:
        return fit
    numbers = [(index, number) for index, term in enumerate(fit.terms) for number in free_numbers(term)]
    if not numbers:
        return fit
    sigma = np.sqrt(np.diagonal(fit.covariance))[fit.linear_size :]
    values = np.array([float(fit.terms[index].theta[number]) for index, number in numbers])
    index, number = numbers[int(np.argmax(sigma / np.maximum(np.abs(values), 1e-300)))]
    own = fit.terms[index].hypothesis
    held = own.holding(number)

    def at(value: float) -> _Held:
        terms = [_with(term, held, number, value) if k == index else term for k, term in enumerate(fit.terms)]
        rest = solve(fit.problem, fit.x, terms)
        whole = [replace(term, hypothesis=own) if k == index else term for k, term in enumerate(rest.terms)]
        found = evaluate(fit.problem, rest.x, whole)
        step = _Step.of(found, here.sigma2)
        to_go = step.to_go / here.sigma2
        way = float(step.damped(0.0)[fit.linear_size + numbers.index((index, number))])
        return _Held(value, to_go, way, replace(found, converged=to_go < _CONVERGED))

    def inside(value: float) -> float:
        return _inside(own, number, value)

    start = float(fit.terms[index].theta[number])
    best, width = _Held(start, here.to_go / here.sigma2, 0.0, fit), _WIDEST
    while width > _NARROWEST and not best.fit.converged:
        sides = [inside(best.value * factor) for factor in (1.0 / (1.0 + width), 1.0 + width)]
        nearest = min((at(side) for side in sides if side != best.value), key=lambda one: one.to_go, default=best)
        if nearest.to_go < best.to_go:
            best = nearest
        else:
            width *= 0.5
    found = best.fit if best.fit.converged else _where_it_turns(at, inside, best)
    return found if found.converged or best.to_go > _AT_A_KINK else replace(best.fit, converged=True)


def _between_jumps(fit: Fit, sigma2: float) -> Fit:
    """The fit with the periods of duties, which the model jumps with, where no side is better, all else solved for."""
    own = [term.hypothesis for term in fit.terms]
    periods = [[i for i, number in enumerate(one.nonlinear) if number.role == "period"] for one in own]
    if fit.converged or not any(periods):
        return fit

    def solved(start: Fit, terms: Sequence[Term]) -> Fit:
        held = [replace(term, hypothesis=one.holding(*its)) for term, one, its in zip(terms, own, periods, strict=True)]
        rest = solve(start.problem, start.x, held)
        whole = [replace(term, hypothesis=one) for term, one in zip(rest.terms, own, strict=True)]
        return replace(evaluate(start.problem, rest.x, whole), converged=rest.converged)

    found = solved(fit, fit.terms)
    for _ in range(_MOST_ASIDE):
        sides = [evaluate(found.problem, found.x, terms) for terms in _to_either_side(found, periods)]
        best = min(sides, key=lambda side: side.squares)
        if best.squares > found.squares - _NO_LESS * sigma2:
            return found if found.converged else fit
        found = solved(best, best.terms)
    return fit


def _to_either_side(fit: Fit, periods: Sequence[Sequence[int]]) -> Iterator[list[Term]]:
    """The terms with one period after another a little shorter and longer."""
    span_s = max(float(np.ptp(fit.problem.scene.time_s)), 1.0)
    for index, (term, its) in enumerate(zip(fit.terms, periods, strict=True)):
        for number in its:
            value = float(term.theta[number])
            for share in (sign * size for size in _SIDES for sign in (-1.0, 1.0)):
                moved = _with(term, term.hypothesis, number, value + share * value**2 / span_s)
                yield [*fit.terms[:index], moved, *fit.terms[index + 1 :]]


@dataclass(frozen=True, slots=True, eq=False)
class _Held:
    """A number held at a value, all others solved for: what is left to go, in sigmas squared, and which way."""

    value: float
    to_go: float
    way: float
    fit: Fit


def _where_it_turns(at: Callable[[float], _Held], inside: Callable[[float], float], near: _Held) -> Fit:
    """The fit at the zero of the score that the score itself points to, over a hump of what is left to go."""
    if near.value == 0.0:
        return near.fit  # steps are shares of the number
    first = last = at(near.value)
    for _ in range(_REACH):
        outwards = first.way * first.value > 0.0
        last = at(inside(first.value * (1.0 + _WIDEST if outwards else 1.0 / (1.0 + _WIDEST))))
        if last.fit.converged or last.to_go > _NEAR:
            return last.fit if last.fit.converged else near.fit
        if last.way * first.way < 0.0:
            break
        first = last
    else:
        return near.fit
    while abs(last.value / first.value - 1.0) > _NARROWEST * _NARROWEST:
        middle = at(0.5 * (first.value + last.value))
        if middle.fit.converged:
            return middle.fit
        first, last = (middle, last) if middle.way * first.way > 0.0 else (first, middle)
    return near.fit


def _with(term: Term, hypothesis: Hypothesis, number: int, value: float) -> Term:
    theta = np.array(term.theta)
    theta[number] = value
    return replace(term, hypothesis=hypothesis, theta=theta)


def _variance(fit: Fit) -> float:
    return max(fit.white_rms_nt**2, 1e-12)


def _has_derivatives(fit: Fit) -> bool:
    """Whether a fit was evaluated with them, and they are numbers."""
    return fit.tie.size > 0 and bool(np.isfinite(fit.normal_equations[1]).all())


def _is_better(here: _Step, there: _Step) -> bool:
    """Whether a step is taken: the cost falls, or it hardly rises and the zero of the score is nearer."""
    if not np.isfinite(there.cost):
        return False
    if there.cost < here.cost - _CONVERGED * here.sigma2 and here.to_go > _MAY_COST * here.sigma2:
        return True
    return there.cost < here.cost + _MAY_COST * here.sigma2 and there.to_go < here.to_go


def _is_near(best: _Step, there: _Step) -> bool:
    """Whether a step that does not lead nearer leaves little more than the best has."""
    return there.cost < best.cost + _MAY_COST * best.sigma2 and there.to_go < _STRAYS * best.to_go


def _is_nearer(before: _Step, now: _Step) -> bool:
    """Whether steps are getting anywhere: the cost has fallen by more than noise, or less than half is left to go."""
    return now.cost < before.cost - _MAY_COST * now.sigma2 or now.to_go < 0.5 * before.to_go


def _moved(fit: Fit, step: Array) -> tuple[Array, tuple[Term, ...]]:
    size = fit.problem.size
    x = fit.x + step[:size]
    terms, at, free = [], size, fit.linear_size
    for term in fit.terms:
        count = term.hypothesis.size
        theta = np.array(term.theta)
        for index in free_numbers(term):
            theta[index] = _inside(term.hypothesis, index, float(theta[index] + step[free]))
            free += 1
        terms.append(replace(term, amplitudes=term.amplitudes + step[at : at + count], theta=theta))
        at += count
    return x, tuple(terms)


def _blocked(fit: Fit, step: Array) -> NDArray[np.bool_]:
    """Which unknowns (p,) are nonlinear numbers that the step would take out of their range.

    They stay for this step: amplitudes that were to go along with them would be wrong.
    """
    blocked, at = np.zeros(len(step), dtype=bool), fit.linear_size
    for term in fit.terms:
        for index in free_numbers(term):
            value = float(term.theta[index] + step[at])
            blocked[at] = _inside(term.hypothesis, index, value) != value
            at += 1
    return blocked


def _inside(hypothesis: Hypothesis, index: int, value: float) -> float:
    """The value kept within the range that the grid spans; lines are free."""
    number = hypothesis.nonlinear[index]
    if number.role or len(number.grid) < 2:
        return value
    low, high = float(number.grid.min()), float(number.grid.max())
    return float(np.clip(value, low, high))
