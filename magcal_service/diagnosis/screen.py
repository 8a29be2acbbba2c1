"""Every hypothesis at its best on a residual: rows through the noise's whitening, grids, and plausible sizes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.grids import OF_LINES, combinations, tried_first
from magcal_service.diagnosis.linear import Gain, Products, Workspace
from magcal_service.diagnosis.lines import body_spectrum, strongest
from magcal_service.diagnosis.plausible import has_its_sign
from magcal_service.diagnosis.problem import Fit, Problem
from magcal_service.diagnosis.refine import refined as refined_numbers
from magcal_service.diagnosis.term_columns import columns_of
from magcal_service.model import Array
from magcal_service.physics.columns import Columns, oscillation
from magcal_service.physics.effects.coloured_noise import Whitener
from magcal_service.physics.interface import WHOLE, Effect, Hypothesis, Nonlinear
from magcal_service.physics.scene.scene import SUN_AHEAD
from magcal_service.physics.segments import Segments

ACCEPTED_NATS: Final = 12.0
"""Evidence from which on an effect counts: odds of 160 000 to 1, after what the search itself costs."""

LEAST_VISIBLE: Final = 0.03
"""Of an effect's size in the residual, what the nine errors have not absorbed; less is rounding, no evidence."""

LEAST_LEFT: Final = 0.1
"""Of an effect's size, what the nine errors leave at least of something as large as a shifted orbit."""

_NEAR: Final = 0.5
"""Of the best evidence, what a form has to have for those that refine it to be tried: a lag seldom hides half of it."""

_LEAST_LINE_NATS: Final = 4.0  # a line with less evidence is one of noise, and no frequency to try
_LINES: Final = 3  # strongest lines of the residual that frequencies and periods are tried at
_CHANGES: Final = ("instant", "edge")  # roles of times of a change, which are sought over all samples

_WORTH_REFINING: Final = 0.3
"""Of the best evidence on the grids: what has less there does not come first by being refined."""

_MOST_KEPT_BYTES: Final = 64_000_000
"""Of columns that are kept: all of a catalogue on five hours, a third of what three hundred channels bring."""

_MOST_KNOWN: Final = 3  # sets of numbers that a hypothesis was at its best with, kept for when it is a rival


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A hypothesis with its best nonlinear numbers, its gain, and its evidence after the cost of the search."""

    hypothesis: Hypothesis
    theta: Array
    gain: Gain
    nats: float


@dataclass(eq=False)
class Screen:
    """A problem's residual, and the hypotheses that may explain it.

    Parameters
    ----------
    problem: the problem.
    hypotheses: what may be left out.
    effects: the catalogue that the hypotheses come from.
    whitening: autoregressive coefficients (p,) of the noise; empty: white.
    spin_hz: the spin's frequency, for lines.
    """

    problem: Problem
    hypotheses: Sequence[Hypothesis]
    effects: Sequence[Effect] = ()
    whitening: Array = field(default_factory=lambda: np.zeros(0))
    spin_hz: float | None = None
    _cache: dict[int, Array] = field(default_factory=dict, init=False, repr=False)
    _units: dict[int, Array] = field(default_factory=dict, init=False, repr=False)
    _known: dict[str, list[Array]] = field(default_factory=dict, init=False, repr=False)
    _whitener: Whitener | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        self.look_at(self.problem, self.hypotheses)

    def look_at(self, problem: Problem, hypotheses: Sequence[Hypothesis]) -> None:
        """Continue with another problem and its hypotheses; rows of the one before are discarded."""
        self.problem, self.hypotheses, self._cache, self._units = problem, hypotheses, {}, {}
        self._whitener = None
        names = [hypothesis.effect for hypothesis in hypotheses]
        self._forms = {name: names.count(name) for name in set(names)}  # what choosing the best of them costs

    def follow(self, other: Screen) -> None:
        """Continue where another one of the same recording is, with what its hypotheses were at their best with."""
        self.look_at(other.problem, other.hypotheses)
        self._known = other._known

    def white(self, rows: Array) -> Array:
        """Rows (m,) or (m, k) through the noise's whitening filter."""
        rows = self.problem.white(rows)
        if not len(self.whitening):
            return rows
        if self._whitener is None:
            self._whitener = Whitener(self.whitening, self.problem.scene.unit)
        return self._whitener.white(rows.reshape(len(rows), -1)).reshape(rows.shape)

    def beside(self, _form: Hypothesis) -> Sequence[Hypothesis]:
        """Forms that act in the recordings in which one does."""
        return self.hypotheses

    @property
    def is_symmetric(self) -> bool:
        """Whether the noise's whitening is a symmetric matrix that takes a while, so that products go without it."""
        return not len(self.whitening) and self.problem.field_error is not None and not self.problem.is_vector

    def products(self, space: Workspace, rows: Array) -> Products:
        """Of what the whitening makes of rows (m, k)."""
        return space.products_before(rows, self.problem) if self.is_symmetric else space.products(self.white(rows))

    def workspace(self, fit: Fit, without: int | None = None) -> Workspace:
        """The residual with a fit's columns out; ``without``: as if that term had never been fitted."""
        residual, columns = fit.residual, fit.columns
        if without is not None:
            own = columns_of(fit, without)
            linear = own[: fit.terms[without].hypothesis.size]
            residual = residual + columns[:, linear] @ fit.terms[without].amplitudes
            columns = np.delete(columns, own, axis=1)
        return Workspace(self.white(residual), self.white(columns))

    def rows_of(self, hypothesis: Hypothesis, theta: Array, fit: Fit) -> Array | None:
        """White columns of a hypothesis (m, k); without nonlinear numbers those of the first fit asked about, kept."""
        if hypothesis.nonlinear:
            return self._made(hypothesis, theta, fit.unit)
        number = id(hypothesis)
        if number not in self._cache:
            rows = self._made(hypothesis, theta, self._units.setdefault(number, fit.unit))
            if rows is None or sum(kept.nbytes for kept in self._cache.values()) + rows.nbytes > _MOST_KEPT_BYTES:
                return rows
            self._cache[number] = rows
        return self._cache[number]

    def _made(self, hypothesis: Hypothesis, theta: Array, unit: Array) -> Array | None:
        rows = self.problem.rows(hypothesis.columns(theta), unit)
        return None if rows is None or not np.isfinite(rows).all() else self.white(rows)

    def seen(self, columns: Columns, fit: Fit) -> Array:
        """White rows (m, k) of columns that this residual can see."""
        return self.white(self._seen(columns, fit))

    def _seen(self, columns: Columns, fit: Fit) -> Array:
        rows = self.problem.rows(columns, fit.unit)
        assert rows is not None, "a magnitude, which a residual of components does not see"
        return rows

    def _sums(self, columns: Columns, first_rows: NDArray[np.intp], space: Workspace, fit: Fit) -> Segments:
        if self.is_symmetric and first_rows.tolist() == [0]:
            return space.sums_before(self._seen(columns, fit), self.problem)
        return space.segments(self.seen(columns, fit), first_rows)

    # Screening

    def screen(
        self,
        space: Workspace,
        fit: Fit,
        sigma_nt: float,
        skip: Sequence[str] = (),
        among: Sequence[Hypothesis] | None = None,
    ) -> list[Candidate]:
        """Every hypothesis not in ``skip`` (effects, labels) at its best, best first; or those ``among``, near it."""
        lines: Array | None = None
        found: list[Candidate] = []
        every = self.hypotheses if among is None else among
        wanted = [h for h in every if h.effect not in skip and h.label not in skip]
        if any(number.role in OF_LINES for hypothesis in wanted for number in hypothesis.nonlinear):
            lines = self._lines(space, fit)

        def try_each(hypotheses: Iterable[Hypothesis]) -> None:
            trials = (self._coarse(one, space, fit, sigma_nt, lines, afresh=among is None) for one in hypotheses)
            found.extend(trial for trial in trials if trial is not None)

        try_each(one for one in wanted if among is not None or not one.refines)
        if among is None:
            near = _near(found)
            try_each(one for one in wanted if one.refines in near)
        best = max((one.gain.nats for one in found), default=0.0) if among is None else 0.0
        least = max(_WORTH_REFINING * best, 0.5 * ACCEPTED_NATS)
        fine = [
            self._fine(one, space, fit, sigma_nt, lines, afresh=among is None) if one.gain.nats > least else one
            for one in found
        ]
        believed = [one for one in fine if self._is_believable(one, space, fit)]
        return sorted(believed, key=lambda candidate: -candidate.nats)

    def _lines(self, space: Workspace, fit: Fit) -> Array:
        scene = self.problem.scene
        found = strongest(scene, body_spectrum(scene, space.residual, fit.unit), _LINES, self.spin_hz)
        if not len(found):
            return found
        enough = (
            space.gain(
                self.seen(oscillation(scene.time_s, float(found[0])), fit), math.sqrt(space.squares / space.count)
            ).nats
            > _LEAST_LINE_NATS
        )
        return found if enough else found[:0]

    def _coarse(
        self,
        hypothesis: Hypothesis,
        space: Workspace,
        fit: Fit,
        sigma_nt: float,
        lines: Array | None,
        afresh: bool,
    ) -> Candidate | None:
        """The best of a hypothesis' grid or proposals; not ``afresh``, of what it was at its best with before."""
        grids = [tried_first(number, lines, self.spin_hz) for number in hypothesis.nonlinear]
        if any(len(grid) == 0 for grid in grids) or LEAST_LEFT * hypothesis.least_nt > fit.rms_nt:
            return None
        cost = self._cost(hypothesis)
        if grids and hypothesis.nonlinear[0].role == "instant" and hypothesis.proposals is None:
            found = self._instant(hypothesis, space, fit, sigma_nt)
            return None if found is None else Candidate(hypothesis, *found, found[1].nats - cost)
        best: tuple[Array, Gain] | None = None
        for values in self._trials(hypothesis, grids, space, fit, afresh):
            trial = self._gain(hypothesis, values, space, fit, sigma_nt)
            if trial is not None and (best is None or trial.nats > best[1].nats):
                best = values, trial
        if best is not None and afresh and hypothesis.nonlinear and hypothesis.nonlinear[0].role in _CHANGES:
            self._keep(hypothesis, best[0])
        return None if best is None else Candidate(hypothesis, *best, best[1].nats - cost)

    def _cost(self, hypothesis: Hypothesis) -> float:
        """Nats that choosing a form and its nonlinear numbers costs, and what odds there are against it."""
        searched = sum(search_cost(number, self.problem) for number in hypothesis.nonlinear)
        return math.log(self._forms[hypothesis.effect]) + hypothesis.odds + searched

    def at(self, hypothesis: Hypothesis, theta: Array, space: Workspace, fit: Fit, sigma_nt: float) -> list[Candidate]:
        """A hypothesis at given nonlinear numbers, whoever found them; none where the residual does not see it."""
        gain = self._gain(hypothesis, theta, space, fit, sigma_nt)
        return [] if gain is None else [Candidate(hypothesis, theta, gain, gain.nats - self._cost(hypothesis))]

    def _trials(
        self, hypothesis: Hypothesis, grids: Sequence[Array], space: Workspace, fit: Fit, afresh: bool
    ) -> Array | list[Array]:
        """Nonlinear numbers (q, m) to try."""
        if not grids:
            return np.zeros((1, 0))
        if not afresh and not any(number.role in OF_LINES for number in hypothesis.nonlinear):
            own = [term.theta for term in fit.terms if term.hypothesis is hypothesis]
            if known := [*self._known.get(hypothesis.label, []), *own]:
                return [hypothesis.anew(theta) for theta in known]
        if hypothesis.proposals is None:
            return combinations(grids)
        each = self.problem.rows_per_sample
        return hypothesis.proposals(lambda columns, rows: self._sums(columns, each * rows, space, fit), grids)

    def _keep(self, hypothesis: Hypothesis, theta: Array) -> None:
        """Remember numbers that a hypothesis was at its best with, for when it is a rival."""
        self._known[hypothesis.label] = [*self._known.get(hypothesis.label, [])[1 - _MOST_KNOWN :], theta]

    def _gain(self, hypothesis: Hypothesis, theta: Array, space: Workspace, fit: Fit, sigma_nt: float) -> Gain | None:
        if hypothesis.nonlinear and self.is_symmetric:
            rows = self.problem.rows(hypothesis.columns(theta), fit.unit)
            products = None if rows is None else space.products_before(rows, self.problem)
            return products.gain(sigma_nt) if products is not None and np.isfinite(products.normal).all() else None
        rows = self.rows_of(hypothesis, theta, fit)
        return None if rows is None else space.gain(rows, sigma_nt)

    def _fine(
        self,
        candidate: Candidate,
        space: Workspace,
        fit: Fit,
        sigma_nt: float,
        lines: Array | None,
        afresh: bool,
    ) -> Candidate:
        """A candidate with its nonlinear numbers moved to their best."""
        hypothesis = candidate.hypothesis
        if not hypothesis.nonlinear or hypothesis.nonlinear[0].role in _CHANGES:
            return candidate
        grids = [tried_first(number, lines, self.spin_hz) for number in hypothesis.nonlinear]
        theta, gain = refined_numbers(
            hypothesis,
            lambda trial: self._gain(hypothesis, trial, space, fit, sigma_nt),
            candidate.theta,
            candidate.gain,
            grids,
            self.problem,
            near=not afresh and hypothesis.label in self._known,
        )
        self._keep(hypothesis, theta)
        return Candidate(hypothesis, theta, gain, candidate.nats - candidate.gain.nats + gain.nats)

    def _instant(
        self, hypothesis: Hypothesis, space: Workspace, fit: Fit, sigma_nt: float
    ) -> tuple[Array, Gain] | None:
        """The best instant of a change: first on the grid, then every sample between the best one's neighbours."""
        rows = self.rows_of(hypothesis, np.array([-np.inf]), fit)
        if rows is None:
            return None
        times = self.problem.row_time_s
        firsts = np.unique(np.searchsorted(times, hypothesis.nonlinear[0].grid))
        firsts = firsts[(firsts > 0) & (firsts < len(times) - 1)]
        if len(firsts) < 3:
            return None
        best = int(np.argmax([gain.nats for gain in space.gated(rows, firsts, sigma_nt)]))
        low, high = firsts[max(best - 1, 0)], firsts[min(best + 1, len(firsts) - 1)]
        finer = np.arange(low, high + 1)
        if self.problem.is_vector:
            finer = np.unique(finer - finer % 3)
        gains = space.gated(rows, finer[finer > 0], sigma_nt)
        top = int(np.argmax([gain.nats for gain in gains]))
        row = int(finer[finer > 0][top])
        return np.array([0.5 * (times[row] + times[max(row - 1 - 2 * self.problem.is_vector, 0)])]), gains[top]

    def _is_believable(self, candidate: Candidate, space: Workspace, fit: Fit) -> bool:
        """Whether a candidate is no larger than its physics ever is, and not nearly absorbed by the other columns."""
        if candidate.nats < 0.5 * ACCEPTED_NATS:
            return True
        if candidate.hypothesis.is_quickest(candidate.theta):
            return False
        if candidate.hypothesis.is_whole and abs(float(candidate.gain.amplitudes[0]) - 1.0) > 2.0 * WHOLE:
            return False
        if not has_its_sign(candidate.hypothesis, candidate.gain.amplitudes):
            return False
        rows = self.rows_of(candidate.hypothesis, candidate.theta, fit)
        assert rows is not None
        signal = rows @ candidate.gain.amplitudes
        size = float(signal @ signal)
        if math.sqrt(size / len(signal)) > self.problem.largest(candidate.hypothesis):
            return False
        seen = space.projected(signal[:, None])
        return float((seen**2).sum()) > LEAST_VISIBLE**2 * size


def _near(found: Sequence[Candidate]) -> set[str]:
    """Labels of the forms near enough to the best for one number more to matter."""
    best = max((candidate.nats for candidate in found), default=0.0)
    least = max(_NEAR * best, ACCEPTED_NATS)
    return {candidate.hypothesis.label for candidate in found if candidate.nats > least}


def search_cost(number: Nonlinear, problem: Problem) -> float:
    """ln of the number of independent trials."""
    if number.role in (*OF_LINES, *_CHANGES):
        return math.log(max(len(problem.scene), 2))
    return math.log(max(len(number.grid), 1))


def _under_sun(hypothesis: Hypothesis, ahead_deg: float) -> Hypothesis:
    """A hypothesis that says under which Sun it was found, where its driver is inferred from that."""
    if not hypothesis.is_inferred:
        return hypothesis
    return replace(hypothesis, constants={**hypothesis.constants, SUN_AHEAD: ahead_deg})


def hypotheses_of(effects: Sequence[Effect], problem: Problem) -> list[Hypothesis]:
    """Every way every effect may act on a problem's scene, in a form that its residual can see."""
    scene = problem.scene
    possible = [effect for effect in effects if scene.in_orbit or not effect.in_orbit_only]
    found = [hypothesis for effect in possible for hypothesis in effect.hypotheses(scene)]
    if scene.sun_ahead_deg:
        found = [_under_sun(hypothesis, scene.sun_ahead_deg) for hypothesis in found]
    if not scene.in_orbit:  # what is inferred is inferred from an orbit: light, torquers that unload momentum
        found = [hypothesis for hypothesis in found if not hypothesis.is_inferred]
    if not problem.is_vector:
        return [hypothesis for hypothesis in found if not hypothesis.needs_vectors]
    of_reference = {effect.name for effect in effects if effect.acts_on.is_reference}
    return [replace(h) for h in found if h.needs_vectors or h.effect not in of_reference]


def is_simpler(one: Hypothesis, than: Hypothesis) -> bool:
    """Whether a form is of the same effect by the same driver, and has fewer amplitudes."""
    return (one.effect, one.driver) == (than.effect, than.driver) and one.size < than.size


def with_simpler(first: Candidate, ranked: Sequence[Candidate], least_nats: float) -> Iterator[Candidate]:
    """A candidate, and the best form of its effect by the same driver that has fewer amplitudes.

    What holds next to nothing more by further amplitudes, such as those of a level that a coil keeps, is fitted in
    vain with them: blocks that took no part are foretold worse than without.

    Parameters
    ----------
    first: tried first.
    ranked: candidates, best first.
    least_nats: evidence that the simpler form has to hold.
    """
    yield first
    for other in ranked:
        if is_simpler(other.hypothesis, first.hypothesis) and not other.hypothesis.in_place:
            if other.nats >= least_nats:
                yield other
            return
