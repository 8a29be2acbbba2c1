"""When a change comes about, by joint solutions: to first order it is sought where the last one has led.

Where the field points in few directions, the nine errors move far with the instant, and columns made at one are wrong
at another.  On a craft that looks down a step was found 1270 s late so, and every round came back there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from magcal_service.diagnosis.linear import Workspace
from magcal_service.diagnosis.plausible import all_within_physics
from magcal_service.diagnosis.problem import Fit, Term
from magcal_service.diagnosis.solution import exchanged, solve
from magcal_service.diagnosis.squares import inside_nt2
from magcal_service.model import Array
from magcal_service.physics.interface import Hypothesis

if TYPE_CHECKING:
    from magcal_service.diagnosis.screen import Candidate, Screen

_FIRST: Final = 0.05
"""Share of the recording by which an instant is first moved to either side; a choice."""

_LAST: Final = 0.01  # of the same: nearer the linear search tells instants apart by itself
_LOOKS: Final = 3  # at each of two jumps in turn; choice: each look finds one beside the other, and two agree as a rule
_MOST_STEPS: Final = 6  # to either side, from where one of the first was better; a choice


def timed(search: Screen, fit: Fit, index: int) -> Fit:
    """A fit with a term's instants and lines, which no solution moves, where joint solutions leave least.

    They are sought to first order where the fit has led; one single instant also a way off to either side.

    Parameters
    ----------
    search: whose forms and noise they are.
    fit: with the term; ``index``: its number.
    """
    own = fit.terms[index].hypothesis
    if not any(number.role for number in own.nonlinear):
        return fit
    found = search.screen(search.workspace(fit, index), fit, fit.white_rms_nt, among=[own])
    if found:
        fit = _better(fit, [_at(fit, index, found[0].theta, found[0].gain.amplitudes)])
    if any(number.role == "edge" for number in own.nonlinear):
        return _better(fit, [_moved(course, index) for course in (fit, *_other_courses(search, fit, index))])
    if len(own.nonlinear) != 1 or own.nonlinear[0].role != "instant":
        return fit
    span_s = float(np.ptp(fit.problem.scene.time_s))
    low, high = float(own.nonlinear[0].grid.min()), float(own.nonlinear[0].grid.max())
    step_s, before_s = _FIRST * span_s, math.inf
    for _ in range(_MOST_STEPS):
        if step_s <= _LAST * span_s:
            break
        term, here_s = fit.terms[index], float(fit.terms[index].theta[0])
        sides = [here_s + side for side in (-step_s, step_s)]
        # where the last step came from is known to be worse
        sides = [side for side in sides if low <= side <= high and abs(side - before_s) > 0.5 * step_s]
        best = _better(fit, [_at(fit, index, np.array([side]), term.amplitudes) for side in sides])
        step_s, before_s = (0.5 * step_s, math.inf) if best is fit else (step_s, here_s)
        fit = best
    return fit


def in_stages(search: Screen, fit: Fit, index: int, space: Workspace, sigma_nt: float) -> list[Candidate]:
    """Two jumps in place of a term that is a change over a while, to first order; none where it is none.

    Two that follow one another soon are an even change to a sensor of some noise, and each is drawn out by the other:
    no form of several instants is proposed for them.

    Parameters
    ----------
    search: whose forms and noise they are.
    fit: with the term; ``index``: its number; ``space``: the residual as if it had never been fitted.
    sigma_nt: noise that evidence is counted in [nT].
    """
    mine = fit.terms[index].hypothesis
    jumps = mine.at_once
    forms = [form for form in search.beside(mine) if jumps and form.effect == jumps]
    single = [form for form in forms if _is_of(form, 1)]
    pair = [form for form in forms if _is_of(form, 2)]
    labels = {form.label for form in forms}
    if not single or not pair or any(term.hypothesis.label in labels for term in fit.terms):
        return []
    found, beside = search.screen(space, fit, sigma_nt, among=single), []
    for _ in range(_LOOKS):
        if not found:
            return []
        first = found[0]
        alone = exchanged(fit.problem, fit, index, Term(single[0], first.theta, first.gain.amplitudes))
        found = search.screen(search.workspace(alone), alone, sigma_nt, among=single)
        beside = [float(first.theta[0]), *(float(one.theta[0]) for one in found[:1])]
    theta = np.unique(beside)
    return search.at(pair[0], theta, space, fit, sigma_nt) if len(theta) == 2 else []


def _is_of(form: Hypothesis, count: int) -> bool:
    """Whether a form has so many instants, each with a vector of its own."""
    shape = (3,) if count == 1 else (count, 3)
    return _count(form) == count and [block.shape for block in form.blocks] == [shape]


def jumps_instead(search: Screen, fit: Fit, floor_nt: float) -> Fit:
    """A fit whose change over a while stands beside jumps of the same kind, with one jump more in place of both.

    A change over a while takes up what two jumps leave to one.  Once the other has a term, no jump is a rival of it any
    more, for the effect of jumps is there.

    Parameters
    ----------
    search: whose forms and noise they are.
    fit: at its end; ``floor_nt``: least noise that evidence is counted in [nT].
    """
    for term in fit.terms:
        jumps = term.hypothesis.at_once
        forms = [form for form in search.beside(term.hypothesis) if form.effect == jumps]
        labels = {form.label for form in forms}
        beside = next((other for other in fit.terms if other.hypothesis.label in labels), None)
        if beside is None:
            continue
        without = solve(search.problem, fit.x, [other for other in fit.terms if other is not term])
        space, sigma = search.workspace(without), max(without.white_rms_nt, floor_nt)
        single = [form for form in forms if _is_of(form, 1)]
        for one in search.screen(space, without, sigma, among=single)[:1]:
            theta = np.sort(np.concatenate([beside.theta, one.theta]))
            rest = [other for other in fit.terms if other is not term and other is not beside]
            each = [form for form in forms if _is_of(form, len(theta))]
            terms = [Term(form, theta, np.zeros(form.size)) for form in each]
            trials = [solve(search.problem, fit.x, [*rest, two]) for two in terms]
            return _better(fit, [trial for trial in trials if all_within_physics(trial)])
    return fit


def _count(form: Hypothesis) -> int:
    """Number of its instants."""
    return len(form.nonlinear)


def _other_courses(search: Screen, fit: Fit, index: int) -> Iterator[Fit]:
    """The fit with each other course of a change that takes a while in a term's place, at its best to first order."""
    own = fit.terms[index].hypothesis
    courses = [h for h in search.hypotheses if h.in_place and h.effect == own.effect and h.label != own.label]
    space = search.workspace(fit, index)
    for form in courses:
        found = search.screen(space, fit, fit.white_rms_nt, among=[form])
        for one in found[:1]:
            other = exchanged(fit.problem, fit, index, Term(form, one.theta, one.gain.amplitudes))
            if not form.is_quickest(other.terms[index].theta):
                yield other


def has_other_course(term: Term, ranked: Sequence[Candidate], within_nats: float) -> bool:
    """Whether another course holds about as much in a change that takes a while: it begins and ends elsewhere then.

    Parameters
    ----------
    term: the change.
    ranked: all candidates for its place.
    within_nats: by how much less the other may hold.
    """
    mine = term.hypothesis
    courses = [c for c in ranked if c.hypothesis.in_place and c.hypothesis.effect == mine.effect]
    own = next((c.nats for c in courses if c.hypothesis is mine), math.inf)
    return any(c.hypothesis is not mine and c.nats > own - within_nats for c in courses)


def _moved(fit: Fit, index: int) -> Fit:
    """The fit with a term's edges where a joint solution leaves them that moves them along with all else.

    Those that would close about a jump stay where they are.
    """
    term = fit.terms[index]
    loose = exchanged(fit.problem, fit, index, replace(term, hypothesis=term.hypothesis.loosened()))
    time_s = fit.problem.scene.course_at(float(term.theta[0]))
    moved = np.array(loose.terms[index].theta)
    is_edge = np.array([number.role == "edge" for number in term.hypothesis.nonlinear])
    moved[is_edge] = np.sort(np.clip(moved[is_edge], time_s[0], time_s[-1]))
    return fit if term.hypothesis.is_quickest(moved) else _better(fit, [_at(fit, index, moved, term.amplitudes)])


def _better(fit: Fit, trials: Sequence[Fit]) -> Fit:
    """The one of all that leaves least; those that do not converge are none."""
    return min((fit, *(trial for trial in trials if trial.converged)), key=inside_nt2)


def _at(fit: Fit, index: int, theta: Array, amplitudes: Array) -> Fit:
    """The joint solution with a term's nonlinear numbers there."""
    return exchanged(fit.problem, fit, index, replace(fit.terms[index], theta=theta, amplitudes=amplitudes))
