"""Which physics was left out: every hypothesis screened, the best refined and fitted jointly, kept only if held-out
blocks agree; several by forward selection with a backward check; rivals by their evidence in the same place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.linear import Gain, Workspace
from magcal_service.diagnosis.lines import strongest
from magcal_service.diagnosis.problem import Fit, Problem, Term, disturbances, free_numbers, solve
from magcal_service.model import STATE_SIZE, Array, measure
from magcal_service.physics.effects.coloured_noise import whitened
from magcal_service.physics.interface import Columns, Effect, Hypothesis, Nonlinear, oscillation

ACCEPTED_NATS: Final = 12.0
"""Evidence from which on an effect counts: odds of 160 000 to 1, after what the search itself costs."""

HELD_OUT_SHARE: Final = 0.3
"""Of the drop in squares inside, at least so much has to be seen on blocks that took no part."""

MOST_EFFECTS: Final = 3
CLASS_NATS: Final = 3.0
"""Rivals within odds of 20 to 1 are one class: this recording cannot tell them apart."""

LEAST_VISIBLE: Final = 0.03
"""Of an effect's own size in the residual, what the nine errors have not absorbed; less is rounding, no evidence."""

_CANCELLING: Final = 3.0
_WHOLE: Final = 0.25
_INEXACT: Final = 0.03  # of its evidence, what a driver that is only inferred may leave for others to take
_MOST_REFRESHED: Final = 4
_STILL: Final = 0.02
_SLOWEST_DUTY_HZ: Final = 1.0 / 300.0
_LEAST_LINE_NATS: Final = 4.0
_RIVAL_SHARE: Final = 0.05
_MOST_TRIED: Final = 5
_NEARLY: Final = 0.95
_CLOSE: Final = 30
_NEAR: Final = 12
_REPEATABLE: Final[tuple[str, ...]] = ()
_LINES: Final = 3
_OF_LINES: Final = ("frequency", "period")


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A hypothesis with its best nonlinear numbers, its gain, and its evidence after the cost of the search."""

    hypothesis: Hypothesis
    theta: Array
    gain: Gain
    nats: float


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
class Search:
    """One search over a problem.

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
    _cache: dict[int, Array] = field(default_factory=dict, repr=False)
    close: set[str] = field(default_factory=set, repr=False)

    def __post_init__(self) -> None:
        self._count_forms()

    def _count_forms(self) -> None:
        """How many forms each effect has: what choosing the best of them costs."""
        names = [hypothesis.effect for hypothesis in self.hypotheses]
        self._forms = {name: names.count(name) for name in set(names)}

    # Rows

    def white(self, rows: Array) -> Array:
        """Rows (m,) or (m, k) through the noise's whitening filter."""
        if not len(self.whitening):
            return rows
        found = whitened(rows.reshape(len(rows), -1), self.whitening, self.problem.scene.unit)
        return found.reshape(rows.shape)

    def workspace(self, fit: Fit, without: int | None = None) -> Workspace:
        """The residual with a fit's columns out; ``without``: as if that term had never been fitted."""
        residual, columns = fit.residual, fit.columns
        if without is not None:
            own = _columns_of(fit, without)
            linear = own[: fit.terms[without].hypothesis.size]
            residual = residual + columns[:, linear] @ fit.terms[without].amplitudes
            columns = np.delete(columns, own, axis=1)
        return Workspace(self.white(residual), self.white(columns))

    def rows_of(self, hypothesis: Hypothesis, theta: Array, fit: Fit) -> Array | None:
        """White columns of a hypothesis (m, k); those without nonlinear numbers are kept."""
        if not hypothesis.nonlinear and id(hypothesis) in self._cache:
            return self._cache[id(hypothesis)]
        rows = self.problem.rows(hypothesis.columns(theta), fit.unit)
        if rows is None or not np.isfinite(rows).all():
            return None
        rows = self.white(rows)
        if not hypothesis.nonlinear:
            self._cache[id(hypothesis)] = rows
        return rows

    def _rows(self, columns: Columns, fit: Fit) -> Array:
        rows = self.problem.rows(columns, fit.unit)
        assert rows is not None, "a proposal for a residual that does not see it"
        return self.white(rows)

    # Screening

    def screen(
        self,
        space: Workspace,
        fit: Fit,
        sigma_nt: float,
        skip: Sequence[str] = (),
        among: Sequence[Hypothesis] | None = None,
    ) -> list[Candidate]:
        """Every hypothesis (or those ``among``) at its best, best first."""
        lines: Array | None = None
        found = []
        for hypothesis in self.hypotheses if among is None else among:
            if hypothesis.effect in skip:
                continue
            if lines is None and any(number.role in _OF_LINES for number in hypothesis.nonlinear):
                lines = self._lines(space, fit)
            candidate = self._best(hypothesis, space, fit, sigma_nt, lines)
            if candidate is not None:
                found.append(candidate)
        return sorted(found, key=lambda candidate: -candidate.nats)

    def _lines(self, space: Workspace, fit: Fit) -> Array:
        if self.problem.is_vector:
            return np.zeros(0)
        scene = self.problem.scene
        found = strongest(scene, space.residual, fit.unit, _LINES, self.spin_hz)
        if not len(found):
            return found
        rows = self.white(oscillation(scene.time_s, float(found[0])).along(fit.unit))
        enough = space.gain(rows, math.sqrt(space.squares / space.count)).nats > _LEAST_LINE_NATS
        return found if enough else found[:0]

    def _best(
        self, hypothesis: Hypothesis, space: Workspace, fit: Fit, sigma_nt: float, lines: Array | None
    ) -> Candidate | None:
        cost = math.log(self._forms[hypothesis.effect]) + hypothesis.odds
        grids = [_grid(number, lines, self.spin_hz) for number in hypothesis.nonlinear]
        if any(len(grid) == 0 for grid in grids):
            return None

        def gain(theta: Array) -> Gain | None:
            rows = self.rows_of(hypothesis, theta, fit)
            return None if rows is None else space.gain(rows, sigma_nt)

        if not grids:
            only = gain(np.zeros(0))
            if only is None:
                return None
            return self._believable(Candidate(hypothesis, np.zeros(0), only, only.nats - cost), space, fit)
        if hypothesis.nonlinear[0].role == "instant":
            found = self._instant(hypothesis, space, fit, sigma_nt)
            if found is None:
                return None
            cost += _search_cost(hypothesis.nonlinear[0], self.problem)
            return self._believable(Candidate(hypothesis, found[0], found[1], found[1].nats - cost), space, fit)
        best: tuple[float, Array, Gain] | None = None
        if hypothesis.proposals is None:
            tried = _product(grids)
        else:
            tried = hypothesis.proposals(lambda columns, rows: space.segments(self._rows(columns, fit), rows))
        for values in tried:
            trial = gain(values)
            if trial is not None and (best is None or trial.nats > best[0]):
                best = (trial.nats, values, trial)
        if best is None:
            return None
        theta, refined = best[1], best[2]
        if best[0] > 0.5 * ACCEPTED_NATS:
            theta, refined = _refined(hypothesis, gain, theta, refined, grids, self.problem)
        cost += sum(_search_cost(number, self.problem) for number in hypothesis.nonlinear)
        return self._believable(Candidate(hypothesis, theta, refined, refined.nats - cost), space, fit)

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

    def _believable(self, candidate: Candidate, space: Workspace, fit: Fit) -> Candidate | None:
        """The candidate, unless it is larger than its physics ever is, or all but absorbed by what is fitted anyway."""
        if candidate.nats < 0.5 * ACCEPTED_NATS:
            return candidate
        if candidate.hypothesis.is_whole and abs(float(candidate.gain.amplitudes[0]) - 1.0) > 2.0 * _WHOLE:
            return None
        rows = self.rows_of(candidate.hypothesis, candidate.theta, fit)
        assert rows is not None
        signal = rows @ candidate.gain.amplitudes
        size = float(signal @ signal)
        if math.sqrt(size / len(signal)) > self.problem.largest(candidate.hypothesis):
            return None
        seen = space.projected(signal[:, None])
        return candidate if float((seen**2).sum()) > LEAST_VISIBLE**2 * size else None

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
        """The fit once more with all columns made of vectors that it itself has calibrated.

        Columns made of other vectors than the model's own are inconsistent with it, and combinations of many of them
        then hold the radial noise that they were freed of one by one.
        """
        for _ in range(_MOST_REFRESHED):
            clean, measured = self._clean(fit)
            scene = self.problem.scene
            moved_nt = float(np.sqrt(np.mean((clean - scene.calibrated_nt) ** 2)))
            self.problem = replace(self.problem, scene=scene.recalibrated(clean, measured))
            self.hypotheses = hypotheses_of(self.effects, self.problem)
            self._cache = {}
            self._count_forms()
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
        present = {term.hypothesis.effect for term in fit.terms} - set(_REPEATABLE)
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
        close = [self._again(candidate, space, fit, sigma) for candidate in ranked[:_CLOSE]]
        close.sort(key=lambda candidate: -candidate.nats)
        least = _RIVAL_SHARE * close[0].nats
        self.close |= {candidate.hypothesis.label for candidate in close[:_NEAR] if candidate.nats > least}
        return close

    def _again(self, candidate: Candidate, space: Workspace, fit: Fit, sigma: float) -> Candidate:
        """The same hypothesis at the same numbers, at another noise."""
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
            if term.hypothesis.is_whole and abs(float(term.amplitudes[0]) - 1.0) > _WHOLE:
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
        """Without the terms that the others have made superfluous."""
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
        cost = sum(_search_cost(number, self.problem) for number in term.hypothesis.nonlinear)
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

        A driver that is worked out has no noise of a sensor's, and so is a little better than its own record.
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
        others = {t.hypothesis.effect for i, t in enumerate(fit.terms) if i != index} - set(_REPEATABLE)
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


def _columns_of(fit: Fit, index: int) -> NDArray[np.intp]:
    """Numbers of the columns that belong to a term: amplitudes, then nonlinear numbers."""
    at, free = fit.problem.size, fit.linear_size
    for number, term in enumerate(fit.terms):
        count, moving = term.hypothesis.size, len(free_numbers(term))
        if number == index:
            return np.concatenate([np.arange(at, at + count), np.arange(free, free + moving)]).astype(np.intp)
        at, free = at + count, free + moving
    raise IndexError(index)


def _grid(number: Nonlinear, lines: Array | None, spin_hz: float | None) -> Array:
    """Values to try first; a period may show as a line of its own or as side lines of the spin."""
    if number.role not in _OF_LINES:
        return number.grid
    if lines is None or not len(lines):
        return np.zeros(0)
    if number.role == "frequency":
        return lines
    beside = [] if spin_hz is None else [np.abs(lines - spin_hz), lines + spin_hz]
    found = np.unique(np.round(np.concatenate([lines, *beside]), 7))
    return 1.0 / found[found > _SLOWEST_DUTY_HZ]


def _product(grids: Sequence[Array]) -> Array:
    """Every combination of the grids' values (m, k)."""
    return np.stack([axis.ravel() for axis in np.meshgrid(*grids, indexing="ij")], axis=1)


def _search_cost(number: Nonlinear, problem: Problem) -> float:
    """ln of how many independent places were looked at."""
    if number.role in ("frequency", "period", "instant"):
        return math.log(max(len(problem.scene), 2))
    return math.log(max(len(number.grid), 1))


def _refined(
    hypothesis: Hypothesis,
    gain: object,
    theta: Array,
    best: Gain,
    grids: Sequence[Array],
    problem: Problem,
) -> tuple[Array, Gain]:
    """The nonlinear numbers moved one after another by shrinking steps while the evidence grows."""
    assert callable(gain)
    theta = np.array(theta)
    for _ in range(2 if len(grids) > 1 else 1):
        for index, number in enumerate(hypothesis.nonlinear):
            step = _first_step(number, float(theta[index]), grids[index], problem)
            while step > _last_step(number, float(theta[index]), problem):
                for sign in (1.0, -1.0):
                    trial = np.array(theta)
                    trial[index] += sign * step
                    if not _allowed(number, float(trial[index])):
                        continue
                    other = gain(trial)
                    if other is not None and other.nats > best.nats:
                        theta, best = trial, other
                        break
                else:
                    step *= 0.5
    return theta, best


def _allowed(number: Nonlinear, value: float) -> bool:
    """Whether a number is within the range that is searched; lines and periods only have to be positive."""
    if number.role in ("frequency", "period"):
        return value > 0.0
    return bool(number.grid.min() <= value <= number.grid.max())


def _first_step(number: Nonlinear, value: float, grid: Array, problem: Problem) -> float:
    span = max(float(np.ptp(problem.scene.time_s)), 1.0)
    if number.role == "frequency":
        return 0.25 / span
    if number.role == "period":
        return 0.25 * value**2 / span
    if len(grid) < 2:
        return 0.0
    nearest = int(np.argmin(np.abs(grid - value)))
    gaps = np.diff(np.sort(grid))
    return 0.5 * float(gaps[min(max(nearest - 1, 0), len(gaps) - 1)])


def _last_step(number: Nonlinear, value: float, problem: Problem) -> float:
    span = max(float(np.ptp(problem.scene.time_s)), 1.0)
    if number.role == "frequency":
        return 0.005 / span
    if number.role == "period":
        return 0.005 * value**2 / span
    if number.role == "instant":
        return 0.4 * problem.scene.period_s
    return 0.02 * max(abs(value), 1e-3)


def hypotheses_of(effects: Sequence[Effect], problem: Problem) -> list[Hypothesis]:
    """Every way every effect may act on a problem's scene, in a form that its residual can see."""
    found = [hypothesis for effect in effects for hypothesis in effect.hypotheses(problem.scene)]
    if not problem.is_vector:
        return found
    of_reference = {effect.name for effect in effects if effect.acts_on.is_reference}
    return [replace(h) for h in found if h.effect not in of_reference]
