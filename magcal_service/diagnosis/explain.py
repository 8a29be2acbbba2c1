"""Which physics was left out: the best hypothesis fitted jointly, kept only if held-out blocks agree.

Several effects by forward selection with a backward check; rivals by their evidence in the same place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence, Set
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from magcal_service.diagnosis.blocks import Gain, gain_over
from magcal_service.diagnosis.expansion import anew, clean_vectors
from magcal_service.diagnosis.instants import has_other_course, in_stages, jumps_instead, timed
from magcal_service.diagnosis.linear import Workspace
from magcal_service.diagnosis.plausible import all_within_physics, within_physics
from magcal_service.diagnosis.problem import Fit, Problem, Term
from magcal_service.diagnosis.rivals import best_of_each, is_as_sudden, is_recorded, tempered
from magcal_service.diagnosis.screen import ACCEPTED_NATS, Candidate, Screen, hypotheses_of, search_cost, with_simpler
from magcal_service.diagnosis.solution import ON_THE_WAY, exchanged, solve
from magcal_service.diagnosis.squares import held_out_nt2, inside_nt2
from magcal_service.diagnosis.stages import RIVALS, SEARCHING, Progress, untold
from magcal_service.diagnosis.sudden import Slower
from magcal_service.model import Array
from magcal_service.physics.interface import Hypothesis
from magcal_service.physics.scene.vectors import Vectors

HELD_OUT_SHARE: Final = 0.3
"""Of the drop in squares inside, at least so much has to be seen on blocks that took no part."""

MOST_EFFECTS: Final = len(SEARCHING)
"""Effects in one recording: beyond three they explain one another on the recordings tried."""

CLASS_NATS: Final = 3.0
"""Rivals within odds of 20 to 1 are one class: this recording cannot distinguish them."""

LIKELIER: Final = 1.0
"""Nats by which a rival in the same class comes first at the end: odds of 3 to 1; closer, the first one found stays."""

OF_BLOCKS: Final = 5.0
"""Nats that held-out blocks may speak against a likelier rival at the end: choice, names of one class scatter so."""

_INEXACT: Final = 0.03  # of its evidence, what a driver that is only inferred may leave for others to take
_MOST_REFRESHED: Final = 4  # rounds of new columns; two are the rule
_STILL: Final = 0.02  # of the residual's rms: vectors that move by less change no column that matters
RIVAL_SHARE: Final = 0.05  # of the best evidence: what has less is no rival and is not tried again
_MOST_EXCHANGES: Final = 3  # names that give their place to a rival at the end; one was the rule where it was tried
_MOST_TRIED: Final = 5  # effects fitted jointly in one step, the best first; recorded drivers are tried after them too
_NEARLY: Final = 0.95  # of an inferred driver's evidence, what its record has to hold to replace it
_MOST_RESCORED: Final = 30  # candidates scored again at the noise that the best one would leave
_MOST_RIVALS: Final = 12  # of them kept as rivals for later steps, beside those by records and the best of each effect


@dataclass(frozen=True, slots=True, eq=False)
class Explained:
    """The effects that were kept, jointly fitted, and for each what rivals would have done in its place.

    Parameters
    ----------
    fit: nine errors and effects.
    rivals: for each term, effect names with their best evidence in its place [nats], itself included, best first.
    nats: for each term, evidence for it over its absence that survives the blocks' scatter.
    gains: for each term, what it gains over the blocks.
    drivers: for each term, its own effect by each driver, at its best, best first.
    courses: for each term, whether another course of its effect, of other numbers, holds nearly as much.
    slower: changes over minutes instead of the terms' jumps; None without terms.
    has_memory: whether the noise that they are held against has one.
    shaped_nats, lasting_nats: what is seen beside all of them and has no name: in a shape of its own, and lasting.
    """

    fit: Fit
    rivals: tuple[tuple[Candidate, ...], ...] = ()
    nats: tuple[float, ...] = ()
    gains: tuple[Gain, ...] = ()
    drivers: tuple[tuple[Candidate, ...], ...] = ()
    courses: tuple[bool, ...] = ()
    slower: Slower | None = None
    has_memory: bool = False
    shaped_nats: float = 0.0
    lasting_nats: float = 0.0

    def own_nats(self, index: int) -> float:
        """Evidence for a term beside its rivals [nats]; its own where it is not among them, nearly absorbed."""
        name = self.fit.terms[index].hypothesis.effect
        return next((c.nats for c in self.rivals[index] if c.hypothesis.effect == name), self.nats[index])


@dataclass(eq=False)
class Search(Screen):
    """One search over a problem; parameters as ``Screen``, and ``close``: labels of hypotheses that came near the best
    one in any step."""

    close: set[str] = field(default_factory=set, repr=False)

    def with_noise(self, problem: Problem, coefficients: Array) -> Search:
        """Another search over a problem under noise with a memory; it keeps the labels that came near before."""
        return replace(self, problem=problem, whitening=coefficients, hypotheses=[], close=set(self.close))

    # Selection

    def recorded_first(self, fit: Fit, baseline: Fit, floor_nt: float) -> Fit:
        """Where to begin under this search's noise: with the recorded drivers of a fit that hold, else without."""
        terms = [term for term in fit.terms if is_recorded(term.hypothesis)]
        if terms:
            began = self._bounded(self.refreshed(solve(self.problem, fit.x, terms)))
            if (found := self._pruned(began, floor_nt)).terms:
                return found
        return self.refreshed(baseline)

    def run(self, start: Fit, floor_nt: float, progress: Progress = untold) -> Explained:
        """Forward selection with a backward check after every step, and once more into room that rivals leave."""
        fit = self.selected(start, floor_nt, progress)
        progress(RIVALS)
        found = self.settled(fit, floor_nt)
        kept = {term.hypothesis.effect for term in found.fit.terms}
        dropped = {term.hypothesis.effect for term in fit.terms} - kept
        if not kept or not dropped:
            return found
        more = self.selected(found.fit, floor_nt, progress, dropped)
        return found if more is found.fit else self.settled(more, floor_nt)

    def selected(self, fit: Fit, floor_nt: float, progress: Progress, without: Set[str] = frozenset()) -> Fit:
        """A fit with further effects, as many as hold; ``without``: effects, or labels of forms, that are not tried."""
        while len(fit.terms) < MOST_EFFECTS:
            progress(SEARCHING[len(fit.terms)])
            before = self.problem, self.hypotheses
            larger = self._larger(fit, floor_nt, without)
            if larger is None:
                break
            larger = self.refreshed(larger)
            if not within_physics(larger, len(fit.terms)):  # what it was first found by is not what it needs
                without = {*without, larger.terms[-1].hypothesis.label}
                self.look_at(*before)
                continue
            fit = self._exchanged(self._pruned(larger, floor_nt), floor_nt)
            if len(fit.terms) < len(larger.terms):
                break
        return fit

    def settled(self, fit: Fit, floor_nt: float) -> Explained:
        """What was selected, at its end, beside its rivals."""
        final = self._bounded(self.refreshed(fit))
        pruned = self._pruned(final, floor_nt)
        settled = final if pruned is final else self._bounded(self.refreshed(pruned))
        settled = self._bounded(self._by_channel(settled, floor_nt))
        for index in range(len(settled.terms)):
            settled = timed(self, settled, index)
        return self.compared(jumps_instead(self, settled, floor_nt), floor_nt)

    def again(self, problem: Problem, fit: Fit, floor_nt: float) -> Explained:
        """The terms of a fit under another problem's noise: refitted, and without those that it makes doubtful.

        One by a computed driver, exact to a few per cent, stands for what else holds no more: that is looked for again
        where another name has taken its place.
        """
        self.look_at(problem, self.forms(problem))
        fit = self._bounded(self.refreshed(solve(problem, fit.x, fit.terms)))
        found = self.compared(self._pruned(fit, floor_nt), floor_nt)
        are, were = ([term.hypothesis.is_inferred for term in one.terms] for one in (found.fit, fit))
        if any(are) or not any(were):
            return found
        more = self.selected(found.fit, floor_nt, untold)
        return found if more is found.fit else self.settled(more, floor_nt)

    def refreshed(self, fit: Fit) -> Fit:
        """Fit once more with all columns made of what the fit has found; the search continues there.

        They are made of the vectors that it has calibrated, and expanded halfway to where it has moved the reference:
        columns of other vectors are inconsistent with the model, and combinations of many of them then hold the radial
        noise that they were freed of one by one.
        """
        for count in range(1, _MOST_REFRESHED + 1):
            found, scene = self.clean(fit), self.problem.scene
            moved_s, before_s = (np.zeros(1) if one is None else one for one in (found.moved_s, scene.moved_s))
            moved_nt = found.calibrated_nt - scene.calibrated_nt
            moved_nt2 = float(np.mean(moved_nt**2 + ((moved_s - before_s) * scene.magnitude_slope)[:, None] ** 2))
            problem = replace(self.problem, scene=scene.recalibrated(found))
            self.look_at(problem, ())  # forms and columns of the vectors before go before there are new ones
            self.look_at(problem, self.forms(problem))
            known = {hypothesis.label: hypothesis for hypothesis in self.hypotheses}
            terms = [anew(term, known[term.hypothesis.label]) for term in fit.terms]
            if moved_nt2 < (_STILL * fit.rms_nt) ** 2 or count == _MOST_REFRESHED:
                break
            fit = solve(self.problem, fit.x, terms, ON_THE_WAY)
        return solve(self.problem, fit.x, terms)

    def forms(self, problem: Problem) -> list[Hypothesis]:
        """Every hypothesis of the catalogue on a problem."""
        return hypotheses_of(self.effects, problem)

    def taken(self, terms: Sequence[Term]) -> list[str]:
        """Effects, or labels of forms, that are not tried beside terms: each is there once."""
        return sorted({term.hypothesis.effect for term in terms})

    def clean(self, fit: Fit) -> Vectors:
        """As ``clean_vectors``."""
        return clean_vectors(fit)

    def _larger(self, fit: Fit, floor_nt: float, without: Set[str]) -> Fit | None:
        """The fit with one effect more, the best that held-out blocks agree to; None where there is none."""
        tried: set[str] = set()
        ranked = self._ranked(fit, floor_nt, [*self.taken(fit.terms), *sorted(without)])
        for candidate in ranked:
            if candidate.nats < ACCEPTED_NATS:
                break
            full = len(tried) >= _MOST_TRIED and not is_recorded(candidate.hypothesis)
            if candidate.hypothesis.effect in tried or candidate.hypothesis.in_place or full:
                continue
            tried.add(candidate.hypothesis.effect)
            for one in with_simpler(candidate, ranked, ACCEPTED_NATS):
                term = Term(one.hypothesis, one.theta, one.gain.amplitudes)
                trial = solve(self.problem, fit.x, (*fit.terms, term), ON_THE_WAY)
                if self.agrees(fit, trial) and all_within_physics(trial):
                    return trial
        return None

    def _ranked(self, fit: Fit, floor_nt: float, skip: Sequence[str]) -> list[Candidate]:
        """Every hypothesis, best first, by the noise that the best of them would leave."""
        space = self.workspace(fit)
        sigma = max(math.sqrt(space.squares / space.count), floor_nt)
        ranked = self.screen(space, fit, sigma, skip)
        if not ranked:
            return []
        left = max(space.squares - ranked[0].gain.squares, 0.0) / space.count
        sigma = max(math.sqrt(left), floor_nt)
        close = [self._again(candidate, space, fit, sigma) for candidate in ranked[:_MOST_RESCORED]]
        close.sort(key=lambda candidate: -candidate.nats)
        near = [candidate for candidate in close if candidate.nats > RIVAL_SHARE * close[0].nats]
        recorded = [one for one in near if is_recorded(one.hypothesis)]
        each = best_of_each(near, lambda hypothesis: hypothesis.effect)
        self.close |= {candidate.hypothesis.label for candidate in (*near[:_MOST_RIVALS], *recorded, *each)}
        return close

    def _again(self, candidate: Candidate, space: Workspace, fit: Fit, sigma: float) -> Candidate:
        """Score a candidate again at a different noise sigma [nT]; its numbers stay."""
        rows = self.rows_of(candidate.hypothesis, candidate.theta, fit)
        assert rows is not None
        gain = space.gain(rows, sigma)
        return replace(candidate, gain=gain, nats=candidate.nats - candidate.gain.nats + gain.nats)

    def _bounded(self, fit: Fit) -> Fit:
        """Without the terms that a refit has taken out of their physics, the weakest of them first."""
        while not all_within_physics(fit):
            beyond = [index for index in range(len(fit.terms)) if not within_physics(fit, index)]
            weakest = min(beyond, key=lambda index: self._worth(fit, index, fit.white_rms_nt))
            fit = solve(self.problem, fit.x, [term for index, term in enumerate(fit.terms) if index != weakest])
        return fit

    def agrees(self, before: Fit, after: Fit) -> bool:
        """Whether blocks that took no part gain by the new term too."""
        inside = inside_nt2(before) - inside_nt2(after)
        return inside > 0.0 and held_out_nt2(before) - held_out_nt2(after) > HELD_OUT_SHARE * inside

    def _pruned(self, fit: Fit, floor_nt: float) -> Fit:
        """Without the terms that are redundant beside the others."""
        while fit.terms:
            sigma = max(fit.white_rms_nt, floor_nt)
            nats = [self._worth(fit, index, sigma) for index in range(len(fit.terms))]
            weakest = int(np.argmin(nats))
            inexact = [n for n, term in zip(nats, fit.terms, strict=True) if term.hypothesis.is_inferred]
            if nats[weakest] > max(ACCEPTED_NATS, _INEXACT * max(inexact, default=0.0)):
                return fit
            terms = tuple(term for index, term in enumerate(fit.terms) if index != weakest)
            fit = self._bounded(solve(self.problem, fit.x, terms))
        return fit

    def _worth(self, fit: Fit, index: int, sigma: float) -> float:
        """Evidence for one term with all others there."""
        term = fit.terms[index]
        rows = self.rows_of(term.hypothesis, term.theta, fit)
        assert rows is not None
        cost = sum(search_cost(number, self.problem) for number in term.hypothesis.nonlinear)
        return self.workspace(fit, index).gain(rows, sigma).nats - cost - math.log(self._forms[term.hypothesis.effect])

    def _exchanged(self, fit: Fit, floor_nt: float) -> Fit:
        """Each term replaced by a rival that does better in its place, now that the others are there."""
        for index in range(len(fit.terms)):
            sigma = max(fit.white_rms_nt, floor_nt)
            ranked = self._rivals(fit, index, sigma)
            if is_recorded(fit.terms[index].hypothesis):
                space, blocks = self.workspace(fit, index), self.problem.blocks(self.white(fit.residual))
                ranked = tempered(self, ranked, fit, index, space, blocks, sigma, most_fitted=0)
            fit = self._with_better(fit, index, ranked) or fit
        return fit

    def _by_channel(self, fit: Fit, floor_nt: float) -> Fit:
        """Terms with an inferred driver as the same effect by a recorded one, where that holds nearly as much: an
        inferred one has no sensor noise, and so fits a little better than its record."""
        for index, term in enumerate(fit.terms):
            if not term.hypothesis.is_inferred:
                continue
            recorded = [
                hypothesis
                for hypothesis in self.hypotheses
                if hypothesis.effect == term.hypothesis.effect and is_recorded(hypothesis)
            ]
            space, sigma = self.workspace(fit, index), max(fit.white_rms_nt, floor_nt)
            ranked = self.screen(space, fit, sigma, among=[*recorded, term.hypothesis])
            own = next((c.nats for c in ranked if c.hypothesis is term.hypothesis), math.inf)
            best = next((c for c in ranked if c.hypothesis is not term.hypothesis), None)
            if best is None or best.nats < _NEARLY * own:
                continue
            term = Term(best.hypothesis, best.theta, best.gain.amplitudes)
            trial = exchanged(self.problem, fit, index, term)
            if all_within_physics(trial):
                fit = self.refreshed(trial)
        return fit

    def _rivals(self, fit: Fit, index: int, sigma: float) -> list[Candidate]:
        others = self.taken([term for number, term in enumerate(fit.terms) if number != index])
        space = self.workspace(fit, index)
        mine = fit.terms[index].hypothesis
        moves = mine.moves_s is not None  # what else does is expanded where this has moved it: near it only now
        close = [
            h
            for h in self.hypotheses
            if h is mine or h.label in self.close or (moves and h.moves_s is not None) or is_as_sudden(h, mine)
        ]
        ranked = [*self.screen(space, fit, sigma, others, close), *in_stages(self, fit, index, space, sigma)]
        if not any(one.hypothesis is mine for one in ranked):  # to first order beyond its physics; as fitted it is not
            ranked += self.at(mine, fit.terms[index].theta, space, fit, sigma)
        return sorted(ranked, key=lambda candidate: -candidate.nats)

    def compared(self, fit: Fit, floor_nt: float, given_up: frozenset[str] = frozenset()) -> Explained:
        """A fit with the rivals of each of its terms, as far as their differences stand out of the blocks' scatter.

        Terms whose own evidence does not are left out; one that a rival beats even so gives it its place, for good,
        where the rival keeps it: ``given_up`` are the labels of those that did.
        """
        while True:
            fit = self._bounded(fit)
            sigma = max(fit.white_rms_nt, floor_nt)
            blocks, after = self.problem.blocks(self.white(fit.residual)), self.workspace(fit).residual
            spaces = [self.workspace(fit, index) for index in range(len(fit.terms))]
            gains = [gain_over(space.residual, after, blocks, sigma**2) for space in spaces]
            worth = [self._worth(fit, index, sigma) for index in range(len(fit.terms))]
            nats = [one / gain.dispersion for one, gain in zip(worth, gains, strict=True)]
            if not nats or min(nats) > ACCEPTED_NATS:
                break
            weakest = int(np.argmin(nats))
            fit = solve(self.problem, fit.x, [term for index, term in enumerate(fit.terms) if index != weakest])
        rivals = [
            tempered(self, self._rivals(fit, index, sigma), fit, index, space, blocks, sigma)
            for index, space in enumerate(spaces)
        ]
        for index, ranked in enumerate(rivals if len(given_up) < _MOST_EXCHANGES else ()):
            open_ = [c for c in ranked if c.hypothesis.label not in given_up]
            other = self._with_better(fit, index, open_, LIKELIER, OF_BLOCKS)
            if other is not None:
                left, before = given_up | {fit.terms[index].hypothesis.label}, (self.problem, self.hypotheses)
                found = self.compared(self.refreshed(other), floor_nt, left)
                if len(found.fit.terms) == len(fit.terms):
                    return found
                self.look_at(*before)
                gone = other.terms[index].hypothesis.effect  # in its own place it has come to nothing
                rivals[index] = [c for c in ranked if c.hypothesis.effect != gone]
        best = tuple(best_of_each(ranked, lambda hypothesis: hypothesis.effect) for ranked in rivals)
        courses = tuple(
            has_other_course(term, ranked, CLASS_NATS) for term, ranked in zip(fit.terms, rivals, strict=True)
        )
        slow = Slower(replace(self), fit, [sigma * gain.dispersion**0.5 for gain in gains])
        return Explained(fit, best, tuple(nats), tuple(gains), self._drivers(fit, rivals), courses, slow)

    def _drivers(self, fit: Fit, rivals: Sequence[Sequence[Candidate]]) -> tuple[tuple[Candidate, ...], ...]:
        """For each term its effect by each driver."""
        own = (
            [candidate for candidate in ranked if candidate.hypothesis.effect == term.hypothesis.effect]
            for term, ranked in zip(fit.terms, rivals, strict=True)
        )
        return tuple(best_of_each(ranked, lambda hypothesis: hypothesis.driver) for ranked in own)

    def _with_better(
        self,
        fit: Fit,
        index: int,
        ranked: Sequence[Candidate],
        by_nats: float = CLASS_NATS,
        may_cost: float | None = None,
    ) -> Fit | None:
        """The fit with the first of ``ranked``, or a simpler form of it, in a term's place, where that beats it and
        held-out blocks speak against it by less, or by no more than ``may_cost`` [nats]."""
        own = next((c.nats for c in ranked if c.hypothesis is fit.terms[index].hypothesis), -math.inf)
        if not ranked or ranked[0].nats < own + by_nats:
            return None
        noise = fit.white_rms_nt / fit.noise_gain
        for best in with_simpler(ranked[0], ranked, own + by_nats):
            term = Term(best.hypothesis, best.theta, best.gain.amplitudes)
            trial = exchanged(self.problem, fit, index, term, ON_THE_WAY)
            gained = best.nats - own if math.isfinite(own) else 0.0
            most = 2.0 * noise**2 * (gained if may_cost is None else may_cost)
            if best.hypothesis.is_quickest(trial.terms[index].theta) or not all_within_physics(trial):
                continue
            if held_out_nt2(trial) <= held_out_nt2(fit) + most:
                return trial
        return None
