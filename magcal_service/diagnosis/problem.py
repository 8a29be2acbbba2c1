"""Simulation and recording side by side: nine errors, effects, and the residual, with its derivatives.

Three forms of residual, one interface.  Scalar: e = |w| - |H| - m, one row a sample.  Vector, where an attitude was
recorded, three rows a sample: r = w - R A (H + o) where the reference is a vector, with the turn R of the sensor
against the body and what it is off by as unknowns more (``aimed``); r = w - |H| A h where it has one magnitude only (a
room), with the field's direction h as unknowns more: on a sphere the scalar form is degenerate.  w = (I + D) B - b - d
with d and m the effects' (``physics.interface``).

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

from magcal_service.diagnosis.aimed import Aimed
from magcal_service.diagnosis.axis_noise import step_to_clean
from magcal_service.diagnosis.blocks import numbered, pass_numbers
from magcal_service.diagnosis.collapse import is_collapsed
from magcal_service.diagnosis.field_error import FieldError
from magcal_service.diagnosis.groups import Groups
from magcal_service.diagnosis.linear import fold_solutions, folds, held_out
from magcal_service.diagnosis.slopes import HELD, lengths, number_slopes, room_slopes, unknown_slopes
from magcal_service.diagnosis.spread import robust_covariance, scaled_inverse
from magcal_service.model import STATE_SIZE, Array, calibrate, d_matrix
from magcal_service.physics.columns import Columns
from magcal_service.physics.interface import Hypothesis
from magcal_service.physics.scene.scene import Scene

PRIOR_BIAS_NT: Final = 2e5
"""1 sigma of each bias [nT]: four times a strong field; only what the recording says nothing of is held by it."""

PRIOR_D: Final = 0.5
"""1 sigma of each element of D [-], as weak."""

_FINITE_NT2: Final = 1e300  # squares beyond which nothing is worked out any more

_NOT_MOVED: Final = 1e6
"""Times a column's square, what ties its amplitude to where it is: it moves by a millionth."""


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
    room_from_body: (n, 3, 3) attitude to a room of uniform field; None: there is none.
    largest_nt: rms that each effect may have [nT], by name: 1 sigma of the prior of what every amplitude adds.
    field_error: errors of the field model itself, part of the residual's noise; None: there is none.
    aimed: reference vectors in the sensor's axes; None, and no room either: the scalar form.
    noise_covariance: (3, 3) of the calibrated vectors' noise over its mean variance; None: alike in all directions.
    """

    scene: Scene
    noise_nt: float
    room_from_body: Array | None = None
    largest_nt: Mapping[str, float] = field(default_factory=dict)
    field_error: FieldError | None = None
    aimed: Aimed | None = None
    noise_covariance: Array | None = None

    @property
    def is_vector(self) -> bool:
        """Whether rows are components, three a sample."""
        return self.room_from_body is not None or self.aimed is not None

    @property
    def rows_per_sample(self) -> int:
        """Rows of the residual that one sample has."""
        return 3 if self.is_vector else 1

    @property
    def size(self) -> int:
        """Unknowns before any effect: nine, and a vector along the room's field, or those of ``aimed``."""
        return STATE_SIZE + (self.aimed.size if self.aimed is not None else 3 * self.is_vector)

    @property
    def tie_beside(self) -> Array:
        """Inverse prior variances of the unknowns beside the nine errors."""
        return np.zeros(self.size - STATE_SIZE) if self.aimed is None else self.aimed.tie

    @cached_property
    def fold(self) -> NDArray[np.intp]:
        """Fold number of each row."""
        return np.repeat(folds(self.scene.time_s), self.rows_per_sample)

    @cached_property
    def row_time_s(self) -> Array:
        """Time of each row."""
        return np.repeat(self.scene.time_s, self.rows_per_sample)

    def largest(self, hypothesis: Hypothesis) -> float:
        """rms that a hypothesis may have [nT]."""
        return min(hypothesis.largest_nt, self.largest_nt.get(hypothesis.effect, np.inf))

    def white(self, rows: Array) -> Array:
        """Rows (m,) or (m, k) of the residual in which the noise is white."""
        if self.aimed is not None:
            rows = self.aimed.weighed(rows)
        return rows if self.field_error is None else self.field_error.whitened(rows)

    def white_products(self, rows: Array, groups: Groups | None = None) -> Array:
        """(k, k) products of rows (m, k) with one another once they are white; ``groups``: as of field errors."""
        if self.field_error is not None and self.aimed is None:
            return self.field_error.products(rows, groups)
        white = self.white(rows if groups is None else groups.columns(rows))
        return np.asarray(white.T @ white)

    def target(self, x: Array) -> Array:
        """(n, 3) what w should be in the vector form [nT], free of the samples' noise."""
        if self.aimed is not None:
            return self.aimed.turned(x[STATE_SIZE:])
        assert self.room_from_body is not None, "the scalar form has no vector to compare with"
        towards = x[STATE_SIZE:] / np.linalg.norm(x[STATE_SIZE:])
        return np.asarray(np.einsum("nji,j->ni", self.room_from_body, towards) * self.scene.magnitude_nt[:, None])

    def target_slopes(self, x: Array) -> Array | None:
        """d target / d what turns or moves it (n, 3, k); None in the scalar form."""
        if self.aimed is not None:
            return self.aimed.slopes(x[STATE_SIZE:])
        room = self.room_from_body
        return None if room is None else room_slopes(room, x[STATE_SIZE:], self.scene.magnitude_nt)

    def is_collapsed(self, x: Array) -> bool:
        """Whether the nine errors among the unknowns (size,) are no sensor's."""
        return is_collapsed(x)

    def noise_gains(self, x: Array, unit: Array) -> Array:
        """(n,) times a sensor's noise per axis, what errors (size,) make of it along each sample's field (n, 3)."""
        return np.asarray(np.linalg.norm(unit @ (np.eye(3) + d_matrix(x[:STATE_SIZE])), axis=1))

    def evaluated(self, x: Array, terms: Sequence[Term], derivatives: bool, most_nt2: float = np.inf) -> Fit:
        """What ``evaluate`` gives."""
        return _evaluated(self, x, terms, derivatives, most_nt2)

    def acting(self, term: Term) -> list[tuple[Problem, Term]]:
        """Each recording's own problem in which a term acts, with the term as it is there."""
        return [(self, term)]

    @cached_property
    def passes(self) -> NDArray[np.intp] | None:
        """(n,) number of each sample's pass; None where the recording is no few passes."""
        return pass_numbers(self.scene.time_s)

    def blocks(self, white_residual: Array) -> NDArray[np.intp]:
        """Block number (m,) of each row for evidence that is counted over blocks of the residual (m,)."""
        return numbered(white_residual, self.rows_per_sample)

    def rows(self, columns: Columns, unit: Array) -> Array | None:
        """Columns as rows of the residual (m, k), or None where they are zero in this form."""
        return columns.components() if self.is_vector else columns.along(unit)


@dataclass(frozen=True, eq=False)
class Fit:
    """A solution of a problem.

    Parameters
    ----------
    problem: what was solved.
    x: (9,), or with the room's field (12,), or with the unknowns of ``aimed`` (12 + k,).
    terms: effects.
    residual: (m,) [nT].
    columns: (m, p) derivatives of the residual: -d residual / d (unknowns, amplitudes, nonlinear numbers).
    unit: (n, 3) direction of the calibrated field in the body.
    calibrated_nt: (n, 3) w.
    tie: (p,) inverse prior variances.
    converged: whether ``solve`` has arrived here, by its own test.
    """

    problem: Problem
    x: Array
    terms: tuple[Term, ...]
    residual: Array
    columns: Array
    unit: Array
    calibrated_nt: Array
    tie: Array
    converged: bool = False

    @property
    def rms_nt(self) -> float:
        """rms of the residual [nT]."""
        return float(np.sqrt(np.mean(self.residual**2)))

    @cached_property
    def white_residual(self) -> Array:
        """(m,) residual through the whitening of its noise [nT]."""
        return self.problem.white(self.residual)

    @property
    def squares(self) -> float:
        """Sum of squares of the white residual [nT^2]."""
        return float(self.white_residual @ self.white_residual)

    @cached_property
    def white_columns(self) -> Array:
        """(m, p) columns through the same."""
        return self.problem.white(self.columns)

    @cached_property
    def normal_equations(self) -> tuple[Array, Array, Array]:
        """Norms of the white columns (p,), 1 for zeros; products of them so scaled (p, p) and with the residual."""
        found = self.problem.white_products(np.concatenate([self.columns.T, self.residual[None]]).T)
        products, right = found[:-1, :-1], found[:-1, -1]
        scale = np.sqrt(np.where(np.diagonal(products) > 0.0, np.diagonal(products), 1.0))
        return scale, products / np.outer(scale, scale), right / scale

    @cached_property
    def noise_gain(self) -> float:
        """Times a sensor's own noise per axis, what calibration makes of it along the field, by I + D."""
        return float(np.sqrt(np.mean(self.problem.noise_gains(self.x, self.unit) ** 2)))

    @property
    def sensor_residual(self) -> Array:
        """(m,) white, as the sensor's own noise [nT]: errors that shrink the field leave less for that alone."""
        return self.white_residual / self.noise_gain

    @property
    def sensor_held_out(self) -> Array:
        """(m,) the same under the fit to the other folds [nT]."""
        return self.held_out_white / self.noise_gain

    @cached_property
    def white_rms_nt(self) -> float:
        """rms of the white residual [nT]: what evidence is counted in."""
        return float(np.sqrt(np.mean(self.white_residual**2)))

    @property
    def linear_size(self) -> int:
        """Unknowns and amplitudes, without the nonlinear numbers."""
        return self.problem.size + sum(term.hypothesis.size for term in self.terms)

    @property
    def unknowns(self) -> Array:
        """(p,) nine errors, amplitudes, and zero for nonlinear numbers, which have no prior to be tied to."""
        values = np.zeros(self.linear_size + sum(len(free_numbers(term)) for term in self.terms))
        values[: self.problem.size] = self.x
        amplitudes = [term.amplitudes for term in self.terms]
        if amplitudes:
            values[self.problem.size : self.linear_size] = np.concatenate(amplitudes)
        return values

    @cached_property
    def scaled_inverse(self) -> Array:
        """(p, p) inverse of the products of the columns that ``normal_equations`` scales, priors included."""
        scale, products, _ = self.normal_equations
        return scaled_inverse(products, self._sigma2 * self.tie / scale**2)

    @cached_property
    def covariance(self) -> Array:
        """(p, p) of unknowns, amplitudes and nonlinear numbers, robust to a coloured residual."""
        scale = self.normal_equations[0]
        scaled = robust_covariance(self.scaled_inverse, self.white_columns / scale, self.white_residual, self._sigma2)
        return np.asarray(scaled / np.outer(scale, scale))

    @property
    def _sigma2(self) -> float:
        return max(self.white_rms_nt**2, 1e-12)

    @cached_property
    def _held_out(self) -> tuple[Array, Array]:
        """(m,) residuals of each row under the fit to the other folds: as it is, and white.

        The state that a recording begins in stays as all rows have it: those of the first block alone tell it, and the
        others would foretell that block from nothing.
        """
        solutions = fold_solutions(self.white_residual, self.white_columns, self.problem.fold, self.held_tie)
        fold = self.problem.fold
        plain = held_out(self.residual, self.columns, fold, solutions)
        return plain, held_out(self.white_residual, self.white_columns, fold, solutions)

    @property
    def held_tie(self) -> Array:
        """(p,) weak diagonal of a fit to a part of the rows, which leaves the beginning's state as it is [nT^2]."""
        tie = self.tie * self.white_rms_nt**2
        tie[self.starts] = _NOT_MOVED * np.maximum((self.white_columns[:, self.starts] ** 2).sum(axis=0), 1e-300)
        return tie

    @property
    def starts(self) -> NDArray[np.intp]:
        """Numbers of the columns of states that a recording begins in, of terms that hold more than that."""
        found: list[int] = []
        at = self.problem.size
        for term in self.terms:
            blocks = term.hypothesis.blocks
            more = not all(block.is_start for block in blocks)
            for block in blocks:
                found += range(at, at + block.size) if block.is_start and more else ()
                at += block.size
        return np.array(found, dtype=np.intp)

    @property
    def held_out_residual(self) -> Array:
        """(m,) residual of each row under the fit to the other folds [nT]."""
        return self._held_out[0]

    @property
    def held_out_white(self) -> Array:
        """(m,) the same through the whitening of its noise [nT]."""
        return self._held_out[1]

    @cached_property
    def held_out_rms_nt(self) -> float:
        """rms of the residual on rows that took no part [nT]."""
        return float(np.sqrt(np.mean(self.held_out_residual**2)))


def amplitude_tie(problem: Problem, term: Term, columns: Columns) -> Array:
    """(k,) inverse prior variances of a term's amplitudes: what cancels or hardly acts could be of any size else.

    By the largest field of an effect, and the most that a number is: evenly spread, of a third of its square.
    """
    most = np.repeat([block.most for block in term.hypothesis.blocks], [block.size for block in term.hypothesis.blocks])
    return np.asarray((columns.sizes() / problem.largest(term.hypothesis)) ** 2 + 3.0 / most**2)


def disturbances(terms: Sequence[Term], scene: Scene, made: Sequence[Columns] = ()) -> tuple[Array, Array]:
    """Additive body field d (n, 3) and growth of the magnitude m (n,) of all terms [nT], of columns ``made`` if any."""
    body, magnitude = np.zeros((len(scene), 3)), np.zeros(len(scene))
    for term, columns in zip(terms, made or [term.hypothesis.columns(term.theta) for term in terms], strict=True):
        body += columns.field(term.amplitudes)
        magnitude += columns.growth(term.amplitudes)
    return body, magnitude


def evaluate(
    problem: Problem, x: Array, terms: Sequence[Term], derivatives: bool = True, most_nt2: float = np.inf
) -> Fit:
    """Residual and derivatives at given unknowns; these are left out where the white squares exceed ``most_nt2``, or
    are no number."""
    return problem.evaluated(x, terms, derivatives, most_nt2)


def _evaluated(problem: Problem, x: Array, terms: Sequence[Term], derivatives: bool, most_nt2: float) -> Fit:
    scene = problem.scene
    made = [term.hypothesis.columns(term.theta) for term in terms]
    body, magnitude = disturbances(terms, scene, made)
    w = np.asfortranarray(calibrate(x[:STATE_SIZE], scene.field_nt) - body)  # and so what is made of it
    if problem.is_vector:
        clean = problem.target(x)
        residual = (w - clean).reshape(-1)
    else:
        length, wanted = lengths(w), scene.magnitude_nt + magnitude
        residual = length - wanted - problem.noise_nt**2 / scene.magnitude_nt
        # all of the noise that is seen, for the columns of effects are made of such vectors too
        clean = w + step_to_clean(w / length[:, None], problem.noise_covariance) * (wanted - length)[:, None]
        clean *= (wanted / lengths(clean))[:, None]
    bare = Fit(problem, x, tuple(terms), residual, np.zeros((len(residual), 0)), np.zeros((0, 3)), w, np.zeros(0))
    if not derivatives or not bare.squares <= min(most_nt2, _FINITE_NT2):  # what is no number is beyond any
        return bare
    inverse = np.linalg.inv(np.eye(3) + d_matrix(x[:STATE_SIZE]))
    measured = scene.field_nt + (clean - w) @ inverse.T
    unit = clean / lengths(clean)[:, None]
    parts = [-unknown_slopes(measured, unit, problem.target_slopes(x))]
    ties = [np.repeat([PRIOR_BIAS_NT**-2, PRIOR_D**-2], [3, 6]), problem.tie_beside]
    slopes: list[Array] = []
    span_s = float(np.ptp(scene.time_s))
    for term, own in zip(terms, made, strict=True):
        parts.append(_required(problem.rows(own, unit)))
        ties.append(amplitude_tie(problem, term, own))

        def added(theta: Array, term: Term = term) -> Array:
            return _required(problem.rows(term.hypothesis.columns(theta), unit)) @ term.amplitudes

        slopes += number_slopes(term.hypothesis.nonlinear, term.theta, added, span_s)
    columns = np.concatenate([*[part.T for part in parts], *[slope[None] for slope in slopes]]).T  # each in one piece
    tie = np.concatenate([*ties, np.zeros(len(slopes))])
    fit = replace(bare, columns=columns, unit=unit, tie=tie)
    fit.__dict__["white_residual"] = bare.white_residual  # known already
    return fit


def _required(rows: Array | None) -> Array:
    assert rows is not None, "a term that says nothing in this form was fitted"
    return rows


def free_numbers(term: Term) -> list[int]:
    """Indices of the nonlinear numbers that a refit moves."""
    return [index for index, number in enumerate(term.hypothesis.nonlinear) if number.role not in HELD]
