"""A search over several recordings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from magcal_service.diagnosis.expansion import clean_vectors
from magcal_service.diagnosis.explain import Search
from magcal_service.diagnosis.instants import timed
from magcal_service.diagnosis.joint.catalogue import Forms
from magcal_service.diagnosis.joint.forms import JointHypothesis, joint, like, transferred
from magcal_service.diagnosis.joint.frozen import frozen, frozen_term
from magcal_service.diagnosis.joint.problem import JointProblem
from magcal_service.diagnosis.linear import Workspace
from magcal_service.diagnosis.problem import Fit, Problem, Term, free_numbers
from magcal_service.diagnosis.screen import Candidate
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array
from magcal_service.physics.interface import Hypothesis
from magcal_service.physics.scene.vectors import Vectors

_OF_INFERRED: Final = 0.5
"""Of what amplitudes of every recording's own hold, what common ones have to hold to be preferred: one craft has one
set of numbers, and no inferred driver is so exact that a set for each day would not fit better.  How far they differ is
said by the comparison of each recording with the others."""

_OF_EXACT: Final = 0.9
"""The same where the course is recorded, or follows from the field and the clock, and is right to a few per cent: of
two days of which one has half of the other's number, common ones hold as much.  What differs so has changed."""


def common_share(form: Hypothesis) -> float:
    """Of what each recording's own numbers of a form hold, what common ones have to hold at least to be preferred."""
    return _OF_INFERRED if form.is_inferred else _OF_EXACT


@dataclass(eq=False)
class JointSearch(Search):
    """As ``Search``, over the forms of several recordings.

    Parameters
    ----------
    catalogue: the forms.
    names: of the recordings in the problem.
    only: forms that are made; None: all of them.
    held: terms whose common numbers are taken as known, by the label that their forms have in a recording.
    """

    catalogue: Forms = field(default_factory=lambda: Forms((), {}))
    names: tuple[str, ...] = ()
    only: tuple[JointHypothesis, ...] | None = None
    held: Mapping[str, Term] = field(default_factory=dict)
    _with_own: bool = field(default=False, init=False)

    def beside(self, form: Hypothesis) -> Sequence[Hypothesis]:
        """As ``Screen.beside``: of a form of one recording alone, those of that one."""
        assert isinstance(form, JointHypothesis)
        return [one for one in self.hypotheses if isinstance(one, JointHypothesis) and one.solo == form.solo]

    def forms(self, problem: Problem) -> list[Hypothesis]:
        """Every hypothesis of the catalogue on a problem of several recordings."""
        assert isinstance(problem, JointProblem)
        found = self.catalogue.on(problem.parts, self.names, self.only)
        return [frozen(form, self.held[form.base]) if form.base in self.held else form for form in found]

    def refreshed(self, fit: Fit) -> Fit:
        """As ``Search.refreshed``; forms that are not in the fit are made once, at its end."""
        wanted, self.only = self.only, tuple(joint(term) for term in fit.terms)
        fit = super().refreshed(fit)
        self.only = wanted
        if wanted is not None:
            return fit
        self.look_at(self.problem, self.forms(self.problem))
        known = {form.label: form for form in self.hypotheses}
        return replace(fit, terms=tuple(replace(term, hypothesis=known[term.hypothesis.label]) for term in fit.terms))

    def taken(self, terms: Sequence[Term]) -> list[str]:
        """As ``Search.taken``: what changes in one recording alone may do so in another one, too."""
        forms = [joint(term) for term in terms]
        return [
            one.label
            for one in self.hypotheses
            if isinstance(one, JointHypothesis) and any(one.effect == form.effect and one.meets(form) for form in forms)
        ]

    def screen(
        self,
        space: Workspace,
        fit: Fit,
        sigma_nt: float,
        skip: Sequence[str] = (),
        among: Sequence[Hypothesis] | None = None,
    ) -> list[Candidate]:
        """As ``Screen.screen``, without amplitudes of each recording's own where common ones do nearly as well."""
        found = super().screen(space, fit, sigma_nt, skip, among)
        if self._with_own:
            return found
        common = {_base(one): one.gain.squares for one in found if not _is_own(one)}

        def is_as_good(own: Candidate) -> bool:
            return common.get(_base(own), 0.0) > common_share(own.hypothesis) * own.gain.squares

        return [one for one in found if not (_is_own(one) and is_as_good(one))]

    def _rivals(self, fit: Fit, index: int, sigma: float) -> list[Candidate]:
        """As ``Search._rivals``; those of a term with amplitudes of each recording's own may have some, too."""
        if not joint(fit.terms[index]).is_each_its_own:
            return super()._rivals(fit, index, sigma)
        forms = [one for one in self.hypotheses if isinstance(one, JointHypothesis)]
        near = {one.base for one in forms if one.label in self.close}
        self.close |= {one.label for one in forms if one.base in near}
        self._with_own = True
        try:
            return super()._rivals(fit, index, sigma)
        finally:
            self._with_own = False

    def _exchanged(self, fit: Fit, floor_nt: float) -> Fit:
        """As ``Search._exchanged``, with changes that take a while timed by joint solutions.

        Else the next effect takes what an edge at the wrong time leaves: a step was named at the end of a ramp.
        """
        fit = super()._exchanged(fit, floor_nt)
        for index, term in enumerate(fit.terms):
            if any(number.role == "edge" for number in term.hypothesis.nonlinear):
                fit = timed(self, fit, index)
        return fit

    def arrived(self, fit: Fit) -> Fit:
        """A fit from other nonlinear numbers where it has stalled, the best that arrives; else as it is.

        Two time constants in a row answer alike whichever comes first: where they meet, derivatives say nothing.
        """
        if fit.converged:
            return fit
        for trial in self._from_elsewhere(fit):
            if trial.white_rms_nt < 1.001 * fit.white_rms_nt:
                return self.refreshed(trial)
        return fit

    def at_its_best(self, fit: Fit) -> Fit:
        """A fit from other nonlinear numbers where that leaves least; else as it is.

        A recording may suit one form at two places, of which all recordings together are near the worse: a slow answer
        after a quick one, and two of one length.
        """
        best = min((fit, *self._from_elsewhere(fit)), key=lambda one: one.white_rms_nt / one.noise_gain)
        return fit if best is fit else self.refreshed(best)

    def _from_elsewhere(self, fit: Fit) -> Iterator[Fit]:
        """Fits that have arrived from other nonlinear numbers of one term."""
        for index, term in enumerate(fit.terms):
            for theta in _other_starts(term):
                terms = [replace(term, theta=theta) if k == index else other for k, other in enumerate(fit.terms)]
                trial = solve(self.problem, fit.x, terms)
                if trial.converged:
                    yield trial

    def clean(self, fit: Fit) -> Vectors:
        """As ``clean_vectors``, of all recordings one after another."""
        assert isinstance(fit.problem, JointProblem)
        return Vectors.together([clean_vectors(one) for one in fit.problem.fits(fit.x, fit.terms)])


def _other_starts(term: Term) -> Iterator[Array]:
    """Nonlinear numbers of a term one for the other, and each half and twice as large, as far as they are in range."""
    if len(free_numbers(term)) != len(term.theta) or not len(term.theta):
        return
    starts = [term.theta[::-1]] if len(term.theta) > 1 else []
    for index in range(len(term.theta)):
        starts += [
            np.where(np.arange(len(term.theta)) == index, factor * term.theta, term.theta) for factor in (0.5, 2.0)
        ]
    grids = [number.grid for number in term.hypothesis.nonlinear]
    for theta in starts:
        if all(grid.min() <= one <= grid.max() for one, grid in zip(theta.tolist(), grids, strict=True)):
            yield theta


def _base(candidate: Candidate) -> str:
    assert isinstance(candidate.hypothesis, JointHypothesis)
    return candidate.hypothesis.base


def _is_own(candidate: Candidate) -> bool:
    assert isinstance(candidate.hypothesis, JointHypothesis)
    return candidate.hypothesis.is_each_its_own


def refitted(
    catalogue: Forms,
    singles: Sequence[Problem],
    names: Sequence[str],
    x: Array,
    terms: Sequence[Term] = (),
    held: Sequence[Term] = (),
    dispersion: float = 1.0,
    relative: Sequence[float] = (),
    *,
    anywhere: bool = False,
) -> Fit:
    """A fit of some of the recordings, with columns of the vectors that it calibrates itself.

    Parameters
    ----------
    catalogue, singles, names: the forms; the recordings' problems and names.
    x: start of their unknowns, one after another.
    terms: fitted on recordings among which these are; what does not act on these is left out.
    dispersion, relative: as of ``JointProblem``.
    held: terms of other recordings, whose common numbers are taken for those of ``terms`` with the same form.
    anywhere: whether nonlinear numbers far from those of ``terms`` are tried where the fit arrives, too.
    """
    problem = JointProblem.of(singles, dispersion, relative)
    known = {joint(term).base: term for term in held}
    forms = catalogue.on(problem.parts, names, [joint(term) for term in terms])
    started = []
    for term in terms:
        form = like(joint(term), forms)
        if form is not None:
            one = transferred(term, form)
            started.append(frozen_term(one, known[form.base]) if form.base in known else one)
    only = tuple(joint(term) for term in started)
    search = JointSearch(problem, [], catalogue=catalogue, names=tuple(names), only=only, held=known)
    fit = search.arrived(search.refreshed(solve(problem, x, started)))
    return search.at_its_best(fit) if anywhere else fit
