"""What has no name, as curves over drivers that are there again on another day, kept if held-out blocks gain.

A curve is piecewise linear over the driver's recorded range: a growth of the magnitude, a body field or a gain per
axis (``physics.apply.empirical``).  It is fitted together with the nine errors and the effects beside it, under a prior
of the size of the residual.  Driver, kind and number of knots are chosen by the residual on blocks that took no part.
It says nothing of a cause.

Where no such driver holds anything, a course over the recording's own time is fitted, which is of no use elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.belief import FEWEST_SAMPLES, STANDS_OUT
from magcal_service.diagnosis.explain import Search
from magcal_service.diagnosis.linear import FOLDS, fold_solutions
from magcal_service.diagnosis.problem import Fit, Problem, Term, amplitude_columns, amplitude_tie, is_collapsed
from magcal_service.diagnosis.screen import ACCEPTED_NATS
from magcal_service.diagnosis.solution import solve
from magcal_service.model import BIAS, STATE_SIZE, Array, d_matrix
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.apply.empirical import NAME, Empirical, Kind, hats
from magcal_service.physics.columns import Columns, along_axes, gains
from magcal_service.physics.drivers.computed import COMPUTED, driver_unit, driver_values
from magcal_service.physics.interface import Block, Effect, Hypothesis
from magcal_service.physics.scene.scene import Scene

ELAPSED: Final = "elapsed_time"
"""Driver of a course over the recording's own time."""

MOST_CURVES: Final = 3
"""Curves of one recording, one driver each; as many as it has effects (``MOST_EFFECTS``)."""

_KNOTS: Final = (3, 6, 11)
"""Knots that are tried: a bend, a curve, a course with several turns; the second one when drivers are screened."""

_KNOTS_OF_TIME: Final = (6, 12, 24)
"""The same of a course over time: 24 knots are two held-out blocks apart, with fewer between them nothing is known."""

_TRIED: Final = 5
"""Curves whose number of knots is tried, the likeliest first; choice: more have not come first on any recording."""

_FITTED: Final = 3
"""Of them, those that are fitted jointly, one after another until one stands; choice: each is a whole fit."""

_WORTH_FITTING: Final = 2.0
"""Standard errors of the gain, to first order, from which on a joint fit is tried: one that stands at 3 has as much."""

_EDGE: Final = 0.005
"""Share of the samples at each end of a driver's values that lie beyond the range: single values hold no curve."""

_FEWEST_IN_RANGE: Final = 100
"""Samples inside the range from which on a curve is tried."""

_SAME_FIELD: Final = 0.01
"""Of the field's size, what it has to change by to drive anything: less is a place within a field."""

_CLOCK: Final = 0.98
"""Rank correlation with time from which on a driver is a clock: the recording cannot tell it from elapsed time."""

_WIDE: Final = 3.0
"""Times the residual's rms, what a knot may add: of a body field the residual sees one part only."""

_ALIKE: Final = 0.9
"""Of the squares that the best curve takes off on held-out blocks, what one by another driver has to take off to be
told with it."""

_EARLIER: Final = 2.0 / 3.0
"""Share of the recording that the rest is foretold from."""

_COVERED: Final = 0.2
"""Of the rest, the samples at least whose drivers have values that were there before: else nothing is foretold."""


@dataclass(frozen=True, slots=True, eq=False)
class Form:
    """A curve before it is fitted: driver, kind, knots (k,), and the mean (k,) of their weights over the samples."""

    driver: str
    kind: Kind
    quantity: str
    column: int
    knots: Array
    mean: Array

    def hypothesis(self, scene: Scene, largest_nt: float) -> Hypothesis:
        """As the fit takes it, on a scene."""
        return Hypothesis(
            NAME,
            self.driver,
            lambda _: self._columns(scene),
            (Block("values", self.kind.unit, (len(self.knots), self.kind.axes)),),
            variant=f"{self.kind} {self.column}",
            largest_nt=largest_nt,
        )

    def _columns(self, scene: Scene) -> Columns:
        x = values_of(scene, self.driver, self.column, self.quantity)
        assert x is not None, "the driver was there when the form was made"
        weights = hats(x, self.knots) - self.mean
        weights[(x < self.knots[0]) | (x > self.knots[-1])] = 0.0
        if self.kind is Kind.MAGNITUDE:
            return Columns(magnitude=np.ascontiguousarray(weights.T))
        return along_axes(weights) if self.kind is Kind.BIAS else gains(scene.clean_field_nt, weights)

    def curve(self, amplitudes: Array, covariance: Array) -> Empirical:
        """As ``physics.toml`` has it: values beyond the mean, of amplitudes (k a,) with covariance (k a, k a)."""
        count = self.kind.axes
        centred = np.eye(len(self.knots)) - np.outer(np.ones(len(self.knots)), self.mean)
        spread = np.kron(centred, np.eye(count))
        shape = (len(self.knots),) if self.kind is Kind.MAGNITUDE else (len(self.knots), count)
        sigma = np.sqrt(np.maximum(np.diagonal(spread @ covariance @ spread.T), 0.0))
        return Empirical(
            driver=self.driver,
            kind=self.kind,
            quantity=self.quantity,
            column=self.column,
            knots=self.knots,
            values=(spread @ amplitudes).reshape(shape),
            sigma=sigma.reshape(shape),
            span=(float(self.knots[0]), float(self.knots[-1])),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Modelled:
    """What has no name, modelled.

    Parameters
    ----------
    before, fit: nine errors and effects, without and with the curves.
    curves: the curves.
    standard_errors: by how many of its errors over blocks the held-out gain stands out.
    seen, blocks: in how many blocks it gains, of how many.
    forward_nt: rms of the last third, foretold from the rest, without and with the curves [nT]; None where the drivers
        had no such values before.
    alike: other drivers that do nearly as well.
    """

    before: Fit
    fit: Fit
    curves: tuple[Empirical, ...]
    standard_errors: float
    seen: int
    blocks: int
    forward_nt: tuple[float, float] | None
    alike: tuple[str, ...]

    @property
    def held_out_rms_nt(self) -> tuple[float, float]:
        """rms on blocks that took no part, without and with the curves [nT]."""
        return self.before.held_out_rms_nt, self.fit.held_out_rms_nt

    @property
    def is_usable(self) -> bool:
        """Whether it may be used on another day, inside its range: a course over time has none there."""
        return all(curve.driver != ELAPSED for curve in self.curves)

    def as_json(self) -> dict[str, Any]:
        """For ``diagnosis.json``."""
        return {
            "curves": [_as_json(curve) for curve in self.curves],
            "held_out_rms_nt": _pair(self.held_out_rms_nt),
            "forward_rms_nt": None if self.forward_nt is None else _pair(self.forward_nt),
            "gain_standard_errors": round(self.standard_errors, 2),
            "gains_in_blocks": [self.seen, self.blocks],
            "usable_elsewhere": self.is_usable,
            "interpolating_only": True,
            "outside": "not applied (driver_outside)",
            "alike": list(self.alike),
            "bias_nt": self.fit.x[BIAS].tolist(),
            "D": d_matrix(self.fit.x[:STATE_SIZE]).tolist(),
        }


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    form: Form
    hypothesis: Hypothesis
    residual: Array
    """(m,) white, on held-out blocks, to first order [nT]."""

    @property
    def left(self) -> float:
        """Sum of its squares [nT^2]."""
        return float(self.residual @ self.residual)


def modelled(search: Search, fit: Fit, floor_nt: float, with_sun: bool) -> Modelled | None:
    """The curves that take most off a residual on held-out blocks; None where no gain stands out of its scatter.

    Parameters
    ----------
    search: as it has explained.
    fit: nine errors and effects.
    floor_nt: least noise that evidence is counted in [nT].
    with_sun: whether the craft's attitude can be had on another day, as a steady spin's.
    """
    if len(fit.problem.scene) < FEWEST_SAMPLES or is_collapsed(fit.x):
        return None
    largest_nt = _WIDE * fit.rms_nt
    found: Modelled | None = None
    taken = {term.hypothesis.driver for term in fit.terms}
    if any(driver.startswith("inferred") for driver in taken):  # the same light under another name
        taken |= {f"computed:{name}" for name in ("light", "sun_zenith", "sun_x", "sun_y", "sun_z")}
    forms: list[Form] = []
    while len(forms) < MOST_CURVES:
        before = fit if found is None else found.fit
        drivers = [one for one in _drivers(before.problem.scene, with_sun) if one[0] not in taken]
        larger = _larger(search, fit, before, forms, drivers, largest_nt, floor_nt)
        if larger is None:
            break
        found, form = larger
        forms.append(form)
        taken.add(form.driver)
    if found is not None:
        return found
    larger = _larger(search, fit, fit, [], [(ELAPSED, 0, "")], largest_nt, floor_nt)
    return None if larger is None else larger[0]


def unit_of(curve: Empirical) -> str:
    """Unit of a curve's driver, elapsed time among them."""
    return "s" if curve.driver == ELAPSED else driver_unit(curve.driver, curve.quantity)


def _pair(rms_nt: tuple[float, float]) -> dict[str, float]:
    return {"before": rms_nt[0], "after": rms_nt[1]}


def _as_json(curve: Empirical) -> dict[str, Any]:
    return {
        "driver": curve.driver,
        "quantity": curve.quantity,
        "column": curve.column,
        "driver_unit": unit_of(curve),
        "kind": str(curve.kind),
        "form": f"piecewise linear, {len(curve.knots)} knots",
        "knots": curve.knots.tolist(),
        "values": curve.values.tolist(),
        "sigma": curve.sigma.tolist(),
        "unit": curve.kind.unit,
        "range": list(curve.span),
    }


def values_of(scene: Scene, driver: str, column: int = 0, quantity: str = "") -> Array | None:
    """Values (n,) of a driver, elapsed time among them; None where the scene lacks it."""
    return scene.time_s if driver == ELAPSED else driver_values(scene, driver, column, quantity)


def _drivers(scene: Scene, with_sun: bool) -> Iterator[tuple[str, int, str]]:
    """Driver, column and quantity of what changes here and is no clock."""
    recorded = [(f"channel:{c.name}", i, c.quantity) for c in scene.channels.values() for i in range(c.values.shape[1])]
    computed = [
        (f"computed:{name}", 0, "")
        for name in COMPUTED
        if with_sun or not name.startswith("sun_") or name == "sun_zenith"
    ]
    for driver, column, quantity in [*recorded, *computed]:
        values = driver_values(scene, driver, column, quantity)
        if values is None or not np.isfinite(values).all():
            continue
        least = _SAME_FIELD * float(np.mean(values)) if driver == "computed:field_size" else 0.0
        if np.ptp(values) > least and not _is_clock(values):
            yield driver, column, quantity


def _is_clock(values: Array) -> bool:
    """Whether values (n,) only rise or only fall with time."""
    rank = np.empty(len(values))
    rank[np.argsort(values, kind="stable")] = np.arange(len(values))
    ties = np.unique(values, return_inverse=True)[1]
    mean = np.bincount(ties, weights=rank) / np.bincount(ties)
    return bool(abs(np.corrcoef(mean[ties], np.arange(len(values)))[0, 1]) > _CLOCK)


def _form(scene: Scene, driver: str, column: int, quantity: str, kind: Kind, count: int) -> Form | None:
    """Knots at equal shares of the samples; None where too few values are told apart."""
    x = values_of(scene, driver, column, quantity)
    assert x is not None
    edge = 0.0 if driver == ELAPSED else _EDGE
    knots = np.unique(np.quantile(x, np.linspace(edge, 1.0 - edge, count)))
    inside = (x >= knots[0]) & (x <= knots[-1])
    if len(knots) < 2 or np.count_nonzero(inside) < _FEWEST_IN_RANGE:
        return None
    return Form(driver, kind, quantity, column, knots, hats(x[inside], knots).mean(axis=0))


def _larger(
    search: Search,
    fit: Fit,
    before: Fit,
    forms: Sequence[Form],
    drivers: Sequence[tuple[str, int, str]],
    largest_nt: float,
    floor_nt: float,
) -> tuple[Modelled, Form] | None:
    """One curve more than ``before`` has, ``forms``; None where no gain stands out."""
    trials = _trials(search, before, drivers, largest_nt, floor_nt)
    worth = [one for one in trials if _gain(before.held_out_white, one.residual, before.problem)[0] > _WORTH_FITTING]
    for best in worth[:_FITTED]:
        trial = _fitted(search, before, [*forms, best.form], best, largest_nt)
        both = [*forms, best.form]
        if not _stands(before, trial, both):
            continue
        curves, alike = _curves(trial, both), _alike(before, trials, best)
        return Modelled(fit, trial, curves, *_gain_of(fit, trial), _forward_nt(fit, trial, both), alike), best.form
    return None


def _stands(before: Fit, trial: Fit, forms: Sequence[Form]) -> bool:
    """Whether a gain stands out of its scatter.

    Of what is to be used elsewhere also in a fit that has arrived, and forward in time.
    """
    gain = _gain_of(before, trial)[0]
    if is_collapsed(trial.x) or gain < STANDS_OUT or not trial.held_out_rms_nt < before.held_out_rms_nt:
        return False
    if forms[-1].driver == ELAPSED:
        return True
    forward_nt = _forward_nt(before, trial, forms)
    return trial.converged and forward_nt is not None and forward_nt[1] < forward_nt[0]


def _alike(before: Fit, trials: Sequence[_Trial], best: _Trial) -> tuple[str, ...]:
    """Other drivers whose curve takes off nearly as much."""
    whole = float((before.held_out_white**2).sum())
    close = (one.form.driver for one in trials if whole - one.left > _ALIKE * (whole - best.left))
    return tuple(driver for driver in dict.fromkeys(close) if driver != best.form.driver)


def _trials(
    search: Search, fit: Fit, drivers: Sequence[tuple[str, int, str]], largest_nt: float, floor_nt: float
) -> list[_Trial]:
    """The likeliest curves by what they leave on held-out blocks, least first; each with its best number of knots."""
    problem = fit.problem
    search.look_at(problem, search.hypotheses)
    space = search.workspace(fit)
    sigma = max(math.sqrt(space.squares / space.count), floor_nt)
    ranked: list[tuple[float, tuple[str, int, str], Kind]] = []
    for driver in drivers:
        for kind in Kind:
            rows = _rows(fit, driver, kind, 6 if driver[0] != ELAPSED else 12, largest_nt)
            if rows is not None:
                ranked.append((space.gain(search.white(rows[1]), sigma).nats, driver, kind))
    cost = math.log(max(len(ranked), 1)) + ACCEPTED_NATS
    ranked = sorted((one for one in ranked if one[0] > cost), key=lambda one: -one[0])[:_TRIED]
    found = []
    for _, driver, kind in ranked:
        tried = []
        for count in _KNOTS_OF_TIME if driver[0] == ELAPSED else _KNOTS:
            rows = _rows(fit, driver, kind, count, largest_nt)
            if rows is not None:
                tried.append(_Trial(rows[0], rows[2], _held_out(fit, rows[1], rows[2])))
        found.append(min(tried, key=lambda one: one.left))
    return sorted(found, key=lambda one: one.left)


def _rows(
    fit: Fit, driver: tuple[str, int, str], kind: Kind, count: int, largest_nt: float
) -> tuple[Form, Array, Hypothesis] | None:
    """A form with its rows (m, k a) of the residual; None where this residual does not see it, or no reference can."""
    scene = fit.problem.scene
    name = driver[0].partition(":")[2]
    if kind is Kind.MAGNITUDE and (fit.problem.is_vector or (name in COMPUTED and COMPUTED[name].of_sensor)):
        return None
    form = _form(scene, *driver, kind, count)
    if form is None:
        return None
    hypothesis = form.hypothesis(scene, largest_nt)
    rows = fit.problem.rows(hypothesis.columns(np.zeros(0)), fit.unit)
    assert rows is not None
    return form, rows, hypothesis


def _held_out(fit: Fit, rows: Array, hypothesis: Hypothesis) -> Array:
    """White residual (m,) on held-out blocks [nT], with rows (m, k) beside what is fitted, to first order."""
    problem = fit.problem
    term = Term(hypothesis, np.zeros(0), np.zeros(hypothesis.size))
    columns = np.concatenate([fit.white_columns, problem.white(rows)], axis=1)
    tie = np.concatenate([fit.tie, amplitude_tie(problem, term, hypothesis.columns(term.theta))])
    solutions = fold_solutions(fit.white_residual, columns, problem.fold, tie * fit.white_rms_nt**2)
    left = np.array(fit.white_residual)
    for number in range(FOLDS):
        inside = problem.fold == number
        left[inside] -= columns[inside] @ solutions[number]
    return left


def _fitted(search: Search, before: Fit, forms: Sequence[Form], best: _Trial, largest_nt: float) -> Fit:
    """Everything jointly, with columns made of vectors that the fit has calibrated."""
    beside = replace(search, problem=before.problem, effects=(*search.effects, _effect(forms, largest_nt)), close=set())
    rows = before.problem.rows(best.hypothesis.columns(np.zeros(0)), before.unit)
    assert rows is not None
    space = beside.workspace(before)
    amplitudes = space.gain(beside.white(rows), max(before.white_rms_nt, 1e-3)).amplitudes
    terms = (*before.terms, Term(best.hypothesis, np.zeros(0), amplitudes))
    return beside.refreshed(solve(before.problem, before.x, terms))


def _effect(forms: Sequence[Form], largest_nt: float) -> Effect:
    """The curves as the search takes them."""
    return Effect(
        name=NAME,
        acts_on=ActsOn.FIELD,
        title="a curve without a name",
        equation="m = f(x), d_i = f_i(x) or d_i = -f_i(x) B_i, f piecewise linear",
        units={"values": "nT"},
        prior=(0.0, largest_nt),
        valid="inside the driver's recorded range",
        confused_with=(),
        separated_by="",
        source="",
        says=(),
        hypotheses=lambda scene: [form.hypothesis(scene, largest_nt) for form in forms],
    )


def _curves(fit: Fit, forms: Sequence[Form]) -> tuple[Empirical, ...]:
    by_label = {form.hypothesis(fit.problem.scene, 1.0).label: form for form in forms}
    found = []
    for index, term in enumerate(fit.terms):
        if term.hypothesis.effect == NAME:
            own = amplitude_columns(fit, index)
            found.append(by_label[term.hypothesis.label].curve(term.amplitudes, fit.covariance[own, own]))
    return tuple(found)


def _gain_of(before: Fit, after: Fit) -> tuple[float, int, int]:
    """``_gain`` of a fit over the one before."""
    return _gain(before.held_out_white, after.held_out_white, after.problem)


def _gain(before: Array, after: Array, problem: Problem) -> tuple[float, int, int]:
    """By how many of its errors over blocks the held-out gain stands out; in how many blocks it is one, of how many.

    A block gains q = 1/2 ln(mean before^2 / mean after^2), in nats a sample, as in ``trust.harm``: a few blocks in
    which much is wrong do not count for all.
    """
    number = problem.blocks(after)
    gained = 0.5 * np.log(np.bincount(number, before**2) / np.bincount(number, after**2))
    error = float(np.std(gained, ddof=1)) / math.sqrt(len(gained))
    return float(np.mean(gained)) / max(error, 1e-300), int(np.count_nonzero(gained > 0.0)), len(gained)


def _forward_nt(before: Fit, after: Fit, forms: Sequence[Form]) -> tuple[float, float] | None:
    """rms [nT] of the last third of the recording foretold from the rest, without and with the curves.

    Of its samples those at which every driver has a value that was there before: a curve is for use inside its range.
    None where they are few.
    """
    scene = after.problem.scene
    later = np.arange(len(scene)) >= _EARLIER * len(scene)
    covered = np.array(later)
    for form in forms:
        x = values_of(scene, form.driver, form.column, form.quantity)
        assert x is not None
        known = x[~later]
        covered &= (x >= known.min()) & (x <= known.max())
    if np.count_nonzero(covered) < _COVERED * np.count_nonzero(later):
        return None
    rows, fold = (np.repeat(part, after.problem.rows_per_sample) for part in (covered, np.where(later, 0, 1)))
    return _foretold_nt(before, fold, rows), _foretold_nt(after, fold, rows)


def _foretold_nt(fit: Fit, fold: NDArray[np.intp], rows: NDArray[np.bool_]) -> float:
    """rms of rows [nT] under the fit to those whose fold (m,) is not 0."""
    solution = fold_solutions(fit.white_residual, fit.white_columns, fold, fit.tie * fit.white_rms_nt**2)[0]
    return float(np.sqrt(np.mean((fit.residual[rows] - fit.columns[rows] @ solution) ** 2)))
