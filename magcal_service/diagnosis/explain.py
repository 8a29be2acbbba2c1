"""Which physics was left out: the best hypothesis fitted jointly, kept only if held-out blocks agree.

Several effects by forward selection with a backward check; rivals by their evidence in the same place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from magcal_service.diagnosis.linear import Workspace
from magcal_service.diagnosis.problem import Fit, Problem, Term, disturbances, solve
from magcal_service.diagnosis.screen import ACCEPTED_NATS, WHOLE, Candidate, Screen, hypotheses_of, search_cost
from magcal_service.model import STATE_SIZE, Array, measure

HELD_OUT_SHARE: Final = 0.3
"""Of the drop in squares inside, at least so much has to be seen on blocks that took no part."""

MOST_EFFECTS: Final = 3
"""Effects in one recording: beyond three they explain one another on the recordings tried."""

CLASS_NATS: Final = 3.0
"""Rivals within odds of 20 to 1 are one class: this recording cannot distinguish them."""

_CANCELLING: Final = 3.0
"""Times its largest size that an effect's field may have where parts of it cancel in the residual.

Choice: cancelling parts are known badly, so their sum needs room; a much larger factor lets them diverge unseen.
"""

_INEXACT: Final = 0.03  # of its evidence, what a driver that is only inferred may leave for others to take
_MOST_REFRESHED: Final = 4  # rounds of new columns; two are the rule
_STILL: Final = 0.02  # of the residual's rms: vectors that move by less change no column that matters
_RIVAL_SHARE: Final = 0.05  # of the best evidence: what has less is no rival and is not tried again
_MOST_TRIED: Final = 5  # effects fitted jointly in one step, the best first
_NEARLY: Final = 0.95  # of an inferred driver's evidence, what its record has to hold to replace it
_MOST_RESCORED: Final = 30  # candidates scored again at the noise that the best one would leave
_MOST_RIVALS: Final = 12  # of them kept as rivals for later steps


@dataclass(frozen=True, slots=True, eq=False)
class Explained:
    """The effects that were kept, jointly fitted, and for each what rivals would have done in its place.

    Parameters
    ----------
    fit: nine errors and effects.
    rivals: for each term, effect names with their best evidence in its place [nats], itself included, best first.
    nats: for each term, evidence for it over its absence.
    """

    fit: Fit
    rivals: tuple[tuple[Candidate, ...], ...] = ()
    nats: tuple[float, ...] = ()


@dataclass(eq=False)
class Search(Screen):
    """One search over a problem; parameters as ``Screen``.

    Parameters
    ----------
    close: labels of hypotheses that came near the best one in any step.
    """

    close: set[str] = field(default_factory=set, repr=False)

    def with_noise(self, problem: Problem, coefficients: Array) -> Search:
        """Another search over a problem under noise with a memory; it keeps the labels that came near before."""
        return replace(self, problem=problem, whitening=coefficients, hypotheses=[], close=set(self.close))

    # Selection

    def run(self, start: Fit, floor_nt: float) -> Explained:
        """Forward selection with a backward check after every step."""
        fit = start
        while len(fit.terms) < MOST_EFFECTS:
            larger = self._larger(fit, floor_nt)
            if larger is None:
                break
            larger = self.refreshed(larger)
            fit = self._exchanged(self._pruned(larger, floor_nt), floor_nt)
            if len(fit.terms) < len(larger.terms):
                break
        final = self.refreshed(fit)
        pruned = self._pruned(final, floor_nt)
        return self.compared(self._by_channel(final if pruned is final else self.refreshed(pruned), floor_nt), floor_nt)

    def refreshed(self, fit: Fit) -> Fit:
        """Fit once more with all columns made of vectors that the fit has calibrated; the search continues there.

        Columns made of other vectors than the model's are inconsistent with it, and combinations of many of them
        then hold the radial noise that they were freed of one by one.
        """
        for _ in range(_MOST_REFRESHED):
            clean, measured = self._clean(fit)
            scene = self.problem.scene
            moved_nt = float(np.sqrt(np.mean((clean - scene.calibrated_nt) ** 2)))
            problem = replace(self.problem, scene=scene.recalibrated(clean, measured))
            self.look_at(problem, hypotheses_of(self.effects, problem))
            known = {hypothesis.label: hypothesis for hypothesis in self.hypotheses}
            fit = solve(
                self.problem, fit.x, [replace(term, hypothesis=known[term.hypothesis.label]) for term in fit.terms]
            )
            if moved_nt < _STILL * fit.rms_nt:
                break
        return fit

    def _clean(self, fit: Fit) -> tuple[Array, Array]:
        """Vectors (n, 3) that a fit has calibrated, free of radial noise, and those measured that would give them."""
        scene = self.problem.scene
        if self.problem.is_vector:
            return scene.calibrated_nt, scene.clean_field_nt
        body, magnitude = disturbances(fit.terms, scene)
        clean = fit.unit * (scene.magnitude_nt + magnitude)[:, None]
        return clean, measure(fit.x[:STATE_SIZE], clean + body)

    def _larger(self, fit: Fit, floor_nt: float) -> Fit | None:
        """The fit with one effect more, the best that held-out blocks agree to; None where there is none."""
        present = {term.hypothesis.effect for term in fit.terms}
        tried: set[str] = set()
        for candidate in self._ranked(fit, floor_nt, sorted(present)):
            if candidate.nats < ACCEPTED_NATS or len(tried) >= _MOST_TRIED:
                break
            if candidate.hypothesis.effect in tried:
                continue
            tried.add(candidate.hypothesis.effect)
            term = Term(candidate.hypothesis, candidate.theta, candidate.gain.amplitudes)
            trial = solve(self.problem, fit.x, (*fit.terms, term))
            if self._agrees(fit, trial) and self._is_sized(trial):
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
        least = _RIVAL_SHARE * close[0].nats
        self.close |= {candidate.hypothesis.label for candidate in close[:_MOST_RIVALS] if candidate.nats > least}
        return close

    def _again(self, candidate: Candidate, space: Workspace, fit: Fit, sigma: float) -> Candidate:
        """Score a candidate again at a different noise sigma [nT]; its numbers stay."""
        rows = self.rows_of(candidate.hypothesis, candidate.theta, fit)
        assert rows is not None
        gain = space.gain(rows, sigma)
        return replace(candidate, gain=gain, nats=candidate.nats - candidate.gain.nats + gain.nats)

    def _is_sized(self, fit: Fit) -> bool:
        """Whether every term, refitted with the errors, is still no larger than its physics ever is.

        That holds for its part in the residual and, by ``_CANCELLING`` more, for the field itself, of which parts that
        cancel in the residual could be of any size.
        """
        for term in fit.terms:
            columns = term.hypothesis.columns(term.theta)
            rows = self.problem.rows(columns, fit.unit)
            largest = self.problem.largest(term.hypothesis)
            if rows is None or float(np.sqrt(np.mean((rows @ term.amplitudes) ** 2))) > largest:
                return False
            if term.hypothesis.is_whole and abs(float(term.amplitudes[0]) - 1.0) > WHOLE:
                return False
            field_nt, growth_nt = columns.field(term.amplitudes), columns.growth(term.amplitudes)
            squares = float((field_nt**2).sum()) + float(np.sum(np.square(growth_nt)))
            if math.sqrt(squares / len(field_nt)) > _CANCELLING * largest:
                return False
        return True

    def _agrees(self, before: Fit, after: Fit) -> bool:
        """Whether blocks that took no part gain by the new term too."""
        inside = float(before.residual @ before.residual) - float(after.residual @ after.residual)
        outside = float(before.held_out_residual @ before.held_out_residual)
        outside -= float(after.held_out_residual @ after.held_out_residual)
        return inside > 0.0 and outside > HELD_OUT_SHARE * inside

    def _pruned(self, fit: Fit, floor_nt: float) -> Fit:
        """Without the terms that are redundant beside the others."""
        while fit.terms:
            sigma = max(fit.rms_nt, floor_nt)
            nats = [self._worth(fit, index, sigma) for index in range(len(fit.terms))]
            weakest = int(np.argmin(nats))
            inexact = [
                n for n, term in zip(nats, fit.terms, strict=True) if term.hypothesis.driver.startswith("inferred")
            ]
            if nats[weakest] > max(ACCEPTED_NATS, _INEXACT * max(inexact, default=0.0)):
                return fit
            terms = tuple(term for index, term in enumerate(fit.terms) if index != weakest)
            fit = solve(self.problem, fit.x, terms)
        return fit

    def _worth(self, fit: Fit, index: int, sigma: float) -> float:
        """Evidence for one term with all others there."""
        term = fit.terms[index]
        rows = self.rows_of(term.hypothesis, term.theta, fit)
        assert rows is not None
        cost = sum(search_cost(number, self.problem) for number in term.hypothesis.nonlinear)
        return self.workspace(fit, index).gain(rows, sigma).nats - cost - math.log(self._forms[term.hypothesis.effect])

    def _exchanged(self, fit: Fit, floor_nt: float) -> Fit:
        """Each term but the newest replaced by a rival that does better in its place, now that the newest is there."""
        for index in range(len(fit.terms) - 1):
            sigma = max(fit.rms_nt, floor_nt)
            ranked = self._rivals(fit, index, sigma)
            own = next((c.nats for c in ranked if c.hypothesis is fit.terms[index].hypothesis), -math.inf)
            if not ranked or ranked[0].nats < own + CLASS_NATS:
                continue
            best = ranked[0]
            terms = list(fit.terms)
            terms[index] = Term(best.hypothesis, best.theta, best.gain.amplitudes)
            trial = solve(self.problem, fit.x, tuple(terms))
            if trial.held_out_rms_nt <= fit.held_out_rms_nt:
                fit = trial
        return fit

    def _by_channel(self, fit: Fit, floor_nt: float) -> Fit:
        """Terms with an inferred driver as the same effect by a recorded one, where that holds nearly as much.

        An inferred driver has no sensor noise, and so fits a little better than its record.
        """
        for index, term in enumerate(fit.terms):
            if not term.hypothesis.driver.startswith("inferred"):
                continue
            recorded = [
                hypothesis
                for hypothesis in self.hypotheses
                if hypothesis.effect == term.hypothesis.effect and hypothesis.driver.startswith("channel")
            ]
            space, sigma = self.workspace(fit, index), max(fit.rms_nt, floor_nt)
            ranked = self.screen(space, fit, sigma, among=[*recorded, term.hypothesis])
            own = next((c.nats for c in ranked if c.hypothesis is term.hypothesis), math.inf)
            best = next((c for c in ranked if c.hypothesis is not term.hypothesis), None)
            if best is None or best.nats < _NEARLY * own:
                continue
            terms = list(fit.terms)
            terms[index] = Term(best.hypothesis, best.theta, best.gain.amplitudes)
            trial = solve(self.problem, fit.x, terms)
            if self._is_sized(trial):
                fit = self.refreshed(trial)
        return fit

    def _rivals(self, fit: Fit, index: int, sigma: float) -> list[Candidate]:
        others = {t.hypothesis.effect for i, t in enumerate(fit.terms) if i != index}
        space = self.workspace(fit, index)
        mine = fit.terms[index].hypothesis
        close = [h for h in self.hypotheses if h is mine or h.label in self.close]
        return self.screen(space, fit, sigma, sorted(others), close)

    def compared(self, fit: Fit, floor_nt: float) -> Explained:
        """A fit with the rivals of each of its terms."""
        sigma = max(fit.rms_nt, floor_nt)
        rivals, nats = [], []
        for index in range(len(fit.terms)):
            rivals.append(_best_of_each(self._rivals(fit, index, sigma)))
            nats.append(self._worth(fit, index, sigma))
        return Explained(fit, tuple(rivals), tuple(nats))


def _best_of_each(ranked: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """The best form of each effect, best first."""
    best: dict[str, Candidate] = {}
    for candidate in ranked:
        best.setdefault(candidate.hypothesis.effect, candidate)
    return tuple(best.values())
