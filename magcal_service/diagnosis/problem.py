"""Simulation and recording side by side: nine errors, effects, and the residual, with its derivatives.

Two forms of residual, one interface.  Scalar: e = |w| - |H| - m, one row a sample.  Vector, where an attitude was
recorded and the reference has one magnitude only (a room): r = w - A H0, three rows a sample, H0 three more unknowns:
on a sphere the scalar form is degenerate.  w = (I + D) B - b - d with d and m the effects' (``physics.interface``).

Derivatives are taken where the noise is not (``model.without_radial_noise``): at the measured vector they hold the
residual's noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.linear import folds, held_out
from magcal_service.model import BIAS, D_ALL, STATE_SIZE, Array, calibrate, d_matrix, field_jacobian
from magcal_service.physics.interface import Columns, Hypothesis
from magcal_service.physics.scene.scene import Scene

PRIOR_BIAS_NT: Final = 2e5
"""1 sigma of each bias [nT]: four times a strong field; only what the recording says nothing of is held by it."""

PRIOR_D: Final = 0.5
"""1 sigma of each element of D [-], as weak."""

HELD: Final = ("instant", "held")
"""Roles of nonlinear numbers that a refit leaves where the search has put them: columns jump with them."""

_ITERATIONS: Final = 12
"""Most steps; the fit is taken as it is then.

Choice: a step that lowers the cost is always kept, so more would only polish; the search solves one for each candidate
that it tries.
"""

_CONVERGED: Final = 1e-4
"""Squared length of a step, in sigmas, below which it is not taken any more: a hundredth of a sigma."""


@dataclass(frozen=True, slots=True, eq=False)
class Term:
    """A hypothesis with its nonlinear numbers (m,) and amplitudes (k,)."""

    hypothesis: Hypothesis
    theta: Array
    amplitudes: Array


@dataclass(frozen=True, eq=False)
class Problem:
    """Samples, and how their residual is formed.

    Parameters
    ----------
    scene: the samples.
    noise_nt: white noise, 1 sigma per axis [nT]; its mean sigma^2 / |H| is subtracted from the scalar residual.
    room_from_body: (n, 3, 3) attitude to a room in which the field is uniform; None: the scalar form.
    largest_nt: rms that each effect may have [nT], by name: 1 sigma of the prior of what every amplitude adds.
    """

    scene: Scene
    noise_nt: float
    room_from_body: Array | None = None
    largest_nt: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_vector(self) -> bool:
        """Whether rows are components, three a sample."""
        return self.room_from_body is not None

    @property
    def size(self) -> int:
        """Unknowns before any effect: nine, and the field of the room."""
        return STATE_SIZE + 3 * self.is_vector

    @cached_property
    def fold(self) -> NDArray[np.intp]:
        """Fold number of each row."""
        numbers = folds(self.scene.time_s)
        return np.repeat(numbers, 3) if self.is_vector else numbers

    @cached_property
    def row_time_s(self) -> Array:
        """Time of each row."""
        return np.repeat(self.scene.time_s, 3) if self.is_vector else self.scene.time_s

    def largest(self, hypothesis: Hypothesis) -> float:
        """rms that a hypothesis may have [nT]."""
        return min(hypothesis.largest_nt, self.largest_nt.get(hypothesis.effect, np.inf))

    def rows(self, columns: Columns, unit: Array) -> Array | None:
        """Columns as rows of the residual (m, k), or None where they are zero in this form."""
        if not self.is_vector:
            return columns.along(unit)
        return columns.components()


@dataclass(frozen=True, eq=False)
class Fit:
    """A solution of a problem.

    Parameters
    ----------
    problem: what was solved.
    x: (9,) or with the room's field (12,).
    terms: effects.
    residual: (m,) [nT].
    columns: (m, p) derivatives of the residual: -d residual / d (unknowns, amplitudes, nonlinear numbers).
    unit: (n, 3) direction of the calibrated field in the body.
    calibrated_nt: (n, 3) w.
    tie: (p,) inverse prior variances.
    """

    problem: Problem
    x: Array
    terms: tuple[Term, ...]
    residual: Array
    columns: Array
    unit: Array
    calibrated_nt: Array
    tie: Array

    @property
    def rms_nt(self) -> float:
        """rms of the residual [nT]."""
        return float(np.sqrt(np.mean(self.residual**2)))

    @property
    def linear_size(self) -> int:
        """Unknowns and amplitudes, without the nonlinear numbers."""
        return self.problem.size + sum(term.hypothesis.size for term in self.terms)

    @property
    def unknowns(self) -> Array:
        """(p,) nine errors, amplitudes, and zero for what has no prior to be tied to."""
        values = np.zeros(self.linear_size + sum(len(free_numbers(term)) for term in self.terms))
        values[:STATE_SIZE] = self.x[:STATE_SIZE]
        amplitudes = [term.amplitudes for term in self.terms]
        if amplitudes:
            values[self.problem.size : self.linear_size] = np.concatenate(amplitudes)
        return values

    @cached_property
    def covariance(self) -> Array:
        """(p, p) of unknowns, amplitudes and nonlinear numbers, robust to a coloured residual.

        Block sums of the score stand for its variance (Liang & Zeger 1986); never smaller than for white noise.
        """
        sigma2 = max(float(self.residual @ self.residual) / len(self.residual), 1e-12)
        scale = np.linalg.norm(self.columns, axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        scaled = self.columns / scale
        inverse = np.linalg.pinv(scaled.T @ scaled + np.diag(sigma2 * self.tie / scale**2), rcond=1e-12)
        white = sigma2 * inverse
        score = scaled * self.residual[:, None]
        count = max(30, len(score) // 400)
        sums = np.add.reduceat(score, np.arange(0, len(score), max(1, len(score) // count)))
        robust = inverse @ (sums.T @ sums) @ inverse
        grow = np.sqrt(np.maximum(np.diagonal(robust) / np.maximum(np.diagonal(white), 1e-300), 1.0))
        grow = np.where(grow > 1.5, grow, 1.0)  # block sums themselves scatter by 1 / sqrt(2 blocks)
        return np.asarray(white * np.outer(grow, grow) / np.outer(scale, scale))

    @cached_property
    def held_out_residual(self) -> Array:
        """(m,) residual of each row under the fit to the other folds."""
        return held_out(self.residual, self.columns, self.problem.fold, self.tie * self.rms_nt**2)

    @cached_property
    def held_out_rms_nt(self) -> float:
        """rms of that [nT]."""
        return float(np.sqrt(np.mean(self.held_out_residual**2)))


def is_collapsed(x: Array) -> bool:
    """Whether nine errors (9 or more,) are no sensor's: an eigenvalue of I + D outside 0.5 to 2."""
    values = np.linalg.eigvalsh(np.eye(3) + d_matrix(x[:STATE_SIZE]))
    return bool(values[0] < 0.5 or values[-1] > 2.0)


def _tie(problem: Problem) -> Array:
    tie = np.zeros(problem.size)
    tie[BIAS], tie[D_ALL] = PRIOR_BIAS_NT**-2, PRIOR_D**-2
    return tie


def _amplitude_tie(problem: Problem, term: Term, columns: Columns) -> Array:
    """(k,) inverse prior variances of a term's amplitudes: what cancels could be of any size otherwise."""
    return np.asarray((columns.sizes() / problem.largest(term.hypothesis)) ** 2)


def disturbances(terms: Sequence[Term], scene: Scene) -> tuple[Array, Array]:
    """Additive body field d (n, 3) and growth of the magnitude m (n,) of all terms [nT]."""
    body, magnitude = np.zeros((len(scene), 3)), np.zeros(len(scene))
    for term in terms:
        columns = term.hypothesis.columns(term.theta)
        body += columns.field(term.amplitudes)
        magnitude += columns.growth(term.amplitudes)
    return body, magnitude


def evaluate(problem: Problem, x: Array, terms: Sequence[Term], derivatives: bool = True) -> Fit:
    """Residual and derivatives at given unknowns."""
    scene = problem.scene
    body, magnitude = disturbances(terms, scene)
    w = calibrate(x[:STATE_SIZE], scene.field_nt) - body
    length = np.linalg.norm(w, axis=1)
    if problem.room_from_body is not None:
        target = np.einsum("nji,j->ni", problem.room_from_body, x[STATE_SIZE:])
        residual = (w - target).reshape(-1)
        clean = target
    else:
        target_length = scene.magnitude_nt + magnitude
        residual = length - target_length - problem.noise_nt**2 / scene.magnitude_nt
        clean = w
    if not derivatives:
        return Fit(problem, x, tuple(terms), residual, np.zeros((len(residual), 0)), np.zeros((0, 3)), w, np.zeros(0))
    if problem.room_from_body is None:  # all of it, for the columns of effects are made of such vectors too
        clean = w * (target_length / length)[:, None]
    inverse = np.linalg.inv(np.eye(3) + d_matrix(x[:STATE_SIZE]))
    jacobian = field_jacobian(scene.field_nt + (clean - w) @ inverse.T)
    unit = clean / np.linalg.norm(clean, axis=1)[:, None]
    parts, ties = [-_model_rows(problem, jacobian, unit)], [_tie(problem)]
    slopes = []
    for term in terms:
        made = term.hypothesis.columns(term.theta)
        parts.append(_required(problem.rows(made, unit)))
        ties.append(_amplitude_tie(problem, term, made))
        slopes += _slopes(problem, term, unit)
    columns = np.concatenate([*parts, *[slope[:, None] for slope in slopes]], axis=1)
    tie = np.concatenate([*ties, np.zeros(len(slopes))])
    return Fit(problem, x, tuple(terms), residual, columns, unit, w, tie)


def _required(rows: Array | None) -> Array:
    assert rows is not None, "a term that says nothing in this form was fitted"
    return rows


def _model_rows(problem: Problem, jacobian: Array, unit: Array) -> Array:
    """d residual / d unknowns (m, 9 or 12)."""
    if problem.room_from_body is None:
        return np.asarray(np.einsum("ni,nij->nj", unit, jacobian))
    body_from_room = np.transpose(problem.room_from_body, (0, 2, 1))
    return np.concatenate([jacobian, -body_from_room], axis=2).reshape(-1, STATE_SIZE + 3)


def _slopes(problem: Problem, term: Term, unit: Array) -> list[Array]:
    """Columns for the nonlinear numbers, by central differences; an instant has none that means anything."""
    slopes: list[Array] = []
    for index, number in enumerate(term.hypothesis.nonlinear):
        if number.role in HELD:
            continue
        size = max(abs(float(term.theta[index])), 1e-3)
        step = size * 1e-4 if number.role in ("frequency", "period") else size * 1e-2
        if number.role == "frequency":
            step = 0.02 / max(float(np.ptp(problem.scene.time_s)), 1.0)
        if number.role == "period":
            step = 0.02 * float(term.theta[index]) ** 2 / max(float(np.ptp(problem.scene.time_s)), 1.0)
        moved = []
        for sign in (1.0, -1.0):
            theta = np.array(term.theta)
            theta[index] += sign * step
            moved.append(_required(problem.rows(term.hypothesis.columns(theta), unit)) @ term.amplitudes)
        slopes.append((moved[0] - moved[1]) / (2.0 * step))
    return slopes


def free_numbers(term: Term) -> list[int]:
    """Indices of the nonlinear numbers that a refit moves."""
    return [index for index, number in enumerate(term.hypothesis.nonlinear) if number.role not in HELD]


def solve(problem: Problem, start: Array, terms: Sequence[Term] = ()) -> Fit:
    """All unknowns jointly by damped Gauss-Newton from ``start``.

    The nonlinear numbers move along, inside their searched range; a step that does not lower the sum of squares is
    shortened.
    """
    fit = evaluate(problem, start, terms)
    for _ in range(_ITERATIONS):
        sigma2 = max(float(fit.residual @ fit.residual) / len(fit.residual), 1e-12)
        scale = np.linalg.norm(fit.columns, axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        scaled = fit.columns / scale
        tie = fit.tie * sigma2
        normal = scaled.T @ scaled + np.diag(tie / scale**2)
        right = scaled.T @ fit.residual - tie * fit.unknowns / scale
        step = np.linalg.lstsq(normal, right, rcond=1e-13)[0]
        free = ~_blocked(fit, step / scale)
        if not free.all():
            step = np.zeros(len(scale))
            step[free] = np.linalg.lstsq(normal[np.ix_(free, free)], right[free], rcond=1e-13)[0]
        if float(step @ normal @ step) < _CONVERGED * sigma2:
            break
        better = _line_search(fit, step / scale, tie)
        if better is None:
            break
        fit = better
    return fit


def _line_search(fit: Fit, step: Array, tie: Array) -> Fit | None:
    """The fit a share of the step on that costs no more: squares of the residual and, by ``tie`` (p,), of unknowns."""

    def cost_of(trial: Fit) -> float:
        return float(trial.residual @ trial.residual) + float(tie @ trial.unknowns**2)

    cost = cost_of(fit)
    for share in (1.0, 0.5, 0.2, 0.05):
        x, terms = _moved(fit, share * step)
        if is_collapsed(x) and not is_collapsed(fit.x):
            continue
        trial = evaluate(fit.problem, x, terms, derivatives=False)
        if cost_of(trial) <= cost * (1.0 + 1e-9):
            return evaluate(fit.problem, x, terms)
    return None


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
    """Which unknowns (p,) are nonlinear numbers that the step would move out of their range.

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
