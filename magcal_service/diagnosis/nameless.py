"""Names held against families of shapes without a name: a name that merely fits does no better than they would."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from magcal_service.diagnosis.belief import posterior
from magcal_service.diagnosis.cycle import CYCLE
from magcal_service.diagnosis.doubts import stands_out
from magcal_service.diagnosis.explain import Explained, Search
from magcal_service.diagnosis.field_level import is_as_smooth, is_trifle
from magcal_service.diagnosis.grids import OF_LINES
from magcal_service.diagnosis.leftover import Structure, largest_product, significant, structures
from magcal_service.diagnosis.plausible import all_within_physics
from magcal_service.diagnosis.problem import Fit, Term, free_numbers
from magcal_service.diagnosis.rivals import is_recorded
from magcal_service.diagnosis.screen import ACCEPTED_NATS, is_simpler
from magcal_service.diagnosis.signals import against_signals
from magcal_service.diagnosis.solution import ended, exchanged, solve
from magcal_service.model import Array
from magcal_service.physics.interface import UNLISTED

NEEDED_SHARES: Final = (0.75, 0.85, 0.93, 0.97)
"""Of what the best family without a name holds: what one, two, three, four effects have to explain together."""

_LEAST_PROBABLE: Final = 0.05
"""Of the likeliest rival's probability, what a name has to have: below, that one is likelier by more than a class."""

_OF_ATTITUDE: Final = 0.5
"""Of what a line holds, what functions of the attitude may hold in its place: of eleven true lines they held 0.02 at
the most, of three that were the attitude's own 0.7 at the least."""

_CLEARLY: Final = 100.0
"""Nats that a duty has to hold more than functions of the attitude, and leave nothing, to stand whatever share of it
they hold: of a strong one in a few turns they hold more than half by chance, yet far from all.  A tone does not: the
Sun's turn in the body is one, and none of these functions."""

_HARDLY_BENT: Final = 0.9
"""Of what a course that repeats holds, from which on a line or a duty stands for it: a wheel's further waves a third of
its first, edges that take a tenth of a pulse.  A tone held 0.6 to 0.7 of five levels, and what is left is said."""

_BY_REFIT: Final = 0.5
"""Of a name's evidence to first order, what it has to hold by a fit without it: true ones hold 0.98 to 1.06, two false
ones held 0.001 and 0.05."""

_BY_NINE: Final = "a fit without it leaves hardly more, for the nine errors do the same"
BY_SHAPE: Final = "shapes without a name do more in its place"
_BY_CYCLE: Final = "a field that repeats in another shape is likelier in its place"
_BY_ATTITUDE: Final = "functions of the attitude hold half as much or more in its place"
"""Why a family without a name, or none, does as well as a name."""

_WORSE: Final = 1.02
"""Times the held-out rms of the nine errors alone, from which on names are no gain, whatever whitened rows say; faint
effects beneath the field model's errors may move it by less."""


def standing(
    search: Search, baseline: Fit, explained: Explained, phase: Array | None, floor_nt: float, is_left: bool
) -> Explained:
    """The names that stand: each in its own place, all together, beyond the scatter over blocks, in a fit that arrived.

    Parameters
    ----------
    search: as it has explained; it continues at what stands.
    baseline: the nine errors alone.
    phase: of the spin (n,) [rad], for families that follow it.
    floor_nt: least noise that evidence is counted in [nT].
    is_left: whether families without a name hold something beside the names.
    """
    explained = _each_its_own(search, explained, phase, floor_nt, is_left)
    if explained.fit.terms:
        explained = _all_together(search, baseline, explained, phase, floor_nt, is_left)
    explained = against_signals(search, explained, floor_nt)
    if explained.fit.terms and not explained.fit.converged:
        fit = ended(explained.fit)
        fit = fit if fit.converged else _in_a_simpler_form(search, fit, floor_nt)
        before, after = ({term.hypothesis.label for term in one.terms} for one in (explained.fit, fit))
        # a form that has not arrived does not take its place again
        explained = search.compared(fit, floor_nt, frozenset(before - after)) if fit.converged else explained
    while explained.fit.terms:
        failing = _weakest_failing(baseline, explained, floor_nt)
        if failing is None:
            break
        fewer = _Less(solve(search.problem, explained.fit.x, _others(explained.fit, failing[0])), failing[1])
        explained = against_signals(search, _without(search, fewer, floor_nt), floor_nt)
    return explained


def spoken_against(search: Search, baseline: Fit, explained: Explained, phase: Array | None, floor_nt: float) -> str:
    """What speaks against the last name of a search beside what is left, in words; empty where it would stand.

    Parameters as of ``standing``.
    """
    last = len(explained.fit.terms) - 1
    outdone = _first_outdone(search, explained, phase, floor_nt, is_left=True)
    name = explained.fit.terms[last].hypothesis.effect
    if outdone is not None and all(term.hypothesis.effect != name for term in outdone.fit.terms):
        return outdone.why
    if len(_all_together(search, baseline, explained, phase, floor_nt, is_left=True).fit.terms) <= last:
        return BY_SHAPE
    failing = _weakest_failing(baseline, against_signals(search, explained, floor_nt), floor_nt)
    return failing[1] if failing is not None and failing[0] == last else ""


def _in_a_simpler_form(search: Search, fit: Fit, floor_nt: float) -> Fit:
    """A fit that has not arrived with one of its terms in a form of fewer amplitudes, or in the one that it refines by
    a number, if that arrives; else the fit.

    What a form has more may be what nothing tells apart: the level that a coil keeps is a bias where it never changes,
    and a record that is late by less than a sample may as well be none.
    """
    sigma = max(fit.white_rms_nt, floor_nt)
    for index, term in enumerate(fit.terms):
        own = term.hypothesis
        forms = [form for form in search.hypotheses if is_simpler(form, own) or form.label == own.refines]
        for one in search.screen(search.workspace(fit, index), fit, sigma, among=forms) if forms else ():
            if one.nats <= ACCEPTED_NATS:
                break
            trial = exchanged(search.problem, fit, index, Term(one.hypothesis, one.theta, one.gain.amplitudes))
            if trial.converged and all_within_physics(trial):
                return search.refreshed(trial)
    return fit


def _may_be_the_models(explained: Explained, index: int) -> bool:
    """Whether a name that follows no record, and does not happen at an instant, may be the field model's errors."""
    fit = explained.fit
    term = fit.terms[index]
    own = term.hypothesis
    if is_recorded(own) or own.by_samples or any(number.role == "instant" for number in own.nonlinear):
        return False
    squares = 2.0 * max(explained.gains[index].nats, 0.0) * fit.white_rms_nt**2
    if not is_trifle(fit.problem, squares / len(fit.residual)):
        return False
    rows = fit.problem.rows(own.columns(term.theta), fit.unit)
    return rows is not None and is_as_smooth(fit.problem, rows @ term.amplitudes)


def _weakest_failing(baseline: Fit, explained: Explained, floor_nt: float) -> tuple[int, str] | None:
    """A name that the field model's errors may be, or that a rival beats and may not replace; else the weakest, where
    the fit or its gain does not hold; and which of these it is, in words."""
    every = range(len(explained.fit.terms))
    beneath = next((index for index in every if _may_be_the_models(explained, index)), None)
    if beneath is not None:
        return beneath, "the field model may err by as much, as smoothly"
    each = [posterior(explained, index) for index in every]
    beside = [one.own / max((rival for _, rival in one.rivals), default=1e-300) for one in each]
    if min(beside) < _LEAST_PROBABLE:
        index = int(np.argmin(beside))
        rival = max(each[index].rivals, key=lambda pair: pair[1])[0]
        return index, f"{'a cause in no catalogue' if rival == UNLISTED else rival} is far likelier in its place"
    left = [fit.held_out_rms_nt / fit.noise_gain for fit in (explained.fit, baseline)]
    weakest = int(np.argmin(explained.nats))
    if not explained.fit.converged:
        return weakest, "a fit with it does not arrive"
    if left[0] > _WORSE * left[1]:
        return weakest, "held-out blocks are left with more by it"
    if not stands_out(baseline, explained.fit, floor_nt):
        return weakest, "what held-out blocks gain by it does not stand out of their scatter"
    return None


def _all_together(
    search: Search, baseline: Fit, explained: Explained, phase: Array | None, floor_nt: float, is_left: bool
) -> Explained:
    """Without names that a family without a name outdoes: it holds clearly more than they do.

    One product of two components, with one amplitude, is enough to do so if it holds more than all of them, or with one
    direction where no name has a driver; where nothing is left beside the names, nothing else is.
    One name may fall short of the family by a quarter, for it is a model; several have to come close.  Those that came
    first stay if they pass without the later ones.
    """
    fit, before, gain2 = explained.fit, _squares(search, baseline), baseline.noise_gain**2
    nameless = replace(search, problem=baseline.problem)
    undriven = all(term.hypothesis.driver == "none" for term in fit.terms)
    product = largest_product(nameless, baseline, floor_nt, axes=3 if undriven else 1)
    if not is_left and before - _squares(search, fit) > product / gain2:
        return explained
    best = structures(nameless, baseline, phase, floor_nt)[0]
    for count in range(len(fit.terms), 0, -1):
        fewer = (
            fit if count == len(fit.terms) else search.refreshed(solve(search.problem, baseline.x, fit.terms[:count]))
        )
        named = before - _squares(search, fewer)
        needed = max(NEEDED_SHARES[min(count, len(NEEDED_SHARES)) - 1] * best.squares, product)
        if named > needed / gain2:
            return explained if fewer is fit else search.compared(fewer, floor_nt)
    return Explained(search.refreshed(solve(search.problem, baseline.x)))


def _each_its_own(
    search: Search, explained: Explained, phase: Array | None, floor_nt: float, is_left: bool
) -> Explained:
    """Without effects in whose place a family without a name would do better, one after another."""
    while explained.fit.terms:
        outdone = _first_outdone(search, explained, phase, floor_nt, is_left)
        if outdone is None:
            break
        explained, is_left = _without(search, outdone, floor_nt), True
    return explained


@dataclass(frozen=True, slots=True, eq=False)
class _Less:
    """A fit without one of the names, and why; the search and fit that ``refreshed`` leads to, where that was made."""

    fit: Fit
    why: str
    beside: Search | None = None
    refreshed: Fit | None = None

    def on(self, search: Search, fit: Fit) -> Fit:
        """What a search's ``refreshed`` makes of a fit, which may be this one."""
        if fit is not self.fit or self.beside is None or self.refreshed is None:
            return search.refreshed(fit)
        search.look_at(self.beside.problem, self.beside.hypotheses)
        return self.refreshed


def _first_outdone(
    search: Search, explained: Explained, phase: Array | None, floor_nt: float, is_left: bool
) -> _Less | None:
    """Without the faintest name, if a fit without one leaves hardly more; the weakest of several, if a family holds
    more than it does; a free form, if a family is likelier than it; a line or a duty, if a family of the attitude holds
    half as much: a craft's own turning has lines, too.  A duty that clearly holds more and leaves nothing stays."""
    fit, several = explained.fit, len(explained.fit.terms) > 1
    without = [solve(search.problem, fit.x, _others(fit, index)) for index in range(len(fit.terms))]
    held = [_held_by_refit(search, explained, index, one, floor_nt) for index, one in enumerate(without)]
    needed = [max(ACCEPTED_NATS, _BY_REFIT * nats) for nats in explained.nats]
    if any(one < least for one, least in zip(held, needed, strict=True)):
        return _Less(without[int(np.argmin(held))], _BY_NINE)
    weakest = int(np.argmin(explained.nats))
    lines = [index for index, term in enumerate(fit.terms) if _is_of_lines(term)]
    for index, term in enumerate(fit.terms):
        is_weakest = several and index == weakest
        is_line = index in lines
        if not (is_weakest or is_line or term.hypothesis.is_free):
            continue
        beside = replace(search)
        less = beside.refreshed(without[index])
        outdone = _Less(without[index], BY_SHAPE, beside, less)
        families = structures(beside, less, phase, floor_nt)
        best = families[0]
        own = _squares(search, less) - _squares(search, fit)
        turning = max((f.squares for f in families if f.shape.of_attitude and significant(f)), default=0.0)
        turning /= less.noise_gain**2
        clear = _CLEARLY * 2.0 * (max(fit.white_rms_nt, floor_nt) / fit.noise_gain) ** 2
        is_duty = any(number.role == "period" for number in term.hypothesis.nonlinear)
        if is_line and turning > _OF_ATTITUDE * own and (is_left or not is_duty or own - turning < clear):
            return replace(outdone, why=_BY_ATTITUDE)
        if is_weakest and own <= NEEDED_SHARES[0] * best.squares / less.noise_gain**2:
            return outdone
        if is_line and _is_rather_a_cycle(search, explained, [index], less, families):
            return replace(outdone, why=_BY_CYCLE)
        best = next(family for family in families if not (is_line and family.shape.name == CYCLE))
        # to first order beside the nine errors, or by how much more the nine errors alone leave
        likely = max(explained.nats[index], held[index]) * explained.gains[index].dispersion
        if term.hypothesis.is_free and likely < best.nats:
            return outdone
    if len(lines) < 2:
        return None
    # a duty and a tone of its second wave are nearly a saw tooth
    beside, none = replace(search), solve(search.problem, fit.x, [t for t in fit.terms if not _is_of_lines(t)])
    less = beside.refreshed(none)
    is_cycle = _is_rather_a_cycle(search, explained, lines, less, structures(beside, less, phase, floor_nt))
    return _Less(none, _BY_CYCLE, beside, less) if is_cycle else None


def _is_of_lines(term: Term) -> bool:
    """Whether a term is a line or a duty."""
    return any(number.role in OF_LINES for number in term.hypothesis.nonlinear)


def _is_rather_a_cycle(
    search: Search, explained: Explained, lines: Sequence[int], less: Fit, families: Sequence[Structure]
) -> bool:
    """Whether a course that repeats, free within its cycle, is likelier than lines and duties in their place, at the
    noise that it leaves: than one tone by what an effect counts from, for that has a form; of one that hardly bends a
    tone or a duty is told."""
    cycle = next((family for family in families if family.shape.name == CYCLE), None)
    if cycle is None:
        return False
    before, after = _squares(search, less), _squares(search, explained.fit)
    held = cycle.squares / less.noise_gain**2
    if len(lines) == 1 and before - after > _HARDLY_BENT * held:
        return False
    beside_cycle = max(before - held, 1e-300)
    first_order = [explained.nats[index] * explained.gains[index].dispersion for index in lines]
    cost = sum(explained.gains[index].nats for index in lines) - sum(first_order)
    by_refit = (before - after) * len(less.residual) / (2.0 * beside_cycle) - cost
    likely = max(sum(first_order) * max(after / beside_cycle, 1.0), by_refit)
    has_form = len(lines) == 1 and not explained.fit.terms[lines[0]].hypothesis.is_free
    return likely + ACCEPTED_NATS * has_form < cycle.nats


def _others(fit: Fit, index: int) -> list[Term]:
    return [term for number, term in enumerate(fit.terms) if number != index]


def _held_by_refit(search: Search, explained: Explained, index: int, without: Fit, floor_nt: float) -> float:
    """Evidence for a name by a fit without it [nats].

    To first order a name and the nine errors that cancel one another for the most part both hold much; on a craft that
    hardly turns 20 000 nats were seen where refitted nine errors alone left 72 more.
    """
    gain = explained.gains[index]
    cost = gain.nats - explained.nats[index] * gain.dispersion
    sigma = max(explained.fit.white_rms_nt, floor_nt) / explained.fit.noise_gain
    held = (_squares(search, without) - _squares(search, explained.fit)) / (2.0 * sigma**2)
    return (held - cost) / gain.dispersion


def _without(search: Search, less: _Less, floor_nt: float) -> Explained:
    return search.compared(less.on(search, _from_known(search, less.fit, floor_nt)), floor_nt)


def _from_known(search: Search, fit: Fit, floor_nt: float) -> Fit:
    """Each term from the numbers that its form has been at its best with, where a refit from there leaves less.

    A term that was removed may have drawn the numbers of others to an optimum that is none without it.
    """
    for index, term in enumerate(fit.terms):
        if not free_numbers(term):
            continue
        sigma = max(fit.white_rms_nt, floor_nt)
        for candidate in search.screen(search.workspace(fit, index), fit, sigma, among=[term.hypothesis]):
            again = replace(term, theta=candidate.theta, amplitudes=candidate.gain.amplitudes)
            trial = exchanged(search.problem, fit, index, again)
            fit = min((fit, trial), key=lambda one: _squares(search, one))
    return fit


def _squares(search: Search, fit: Fit) -> float:
    """Sum of squares of a fit's residual through the whitening of its noise, as the sensor's own noise [nT^2]."""
    white = search.white(fit.residual) / fit.noise_gain
    return float(white @ white)
