"""How far the nine errors may be off by what their reference is off by, against draws of it that are fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.errors_spread import errors_covariance
from magcal_service.diagnosis.field_error import FieldError, Scale
from magcal_service.diagnosis.joint.problem import JointProblem
from magcal_service.diagnosis.problem import Fit, Problem
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array, measure
from tests.physics.scenes import X, scene, spoiled

NOISE_NT, DRAWS = 10.0, 60


def error_at(scale: Scale) -> FieldError:
    found = FieldError.of(scene(), NOISE_NT)
    assert found is not None
    return found.scaled(scale)


def problem(error: FieldError | None) -> Problem:
    """The flight with white noise, beside errors of its reference that its noise counts."""
    noise = NOISE_NT * np.random.default_rng(40).normal(size=(len(scene()), 3))
    return Problem(spoiled(measure(X, scene().calibrated_nt + noise), scene()), NOISE_NT, field_error=error)


def moved(of: Problem, by_nt: Array) -> Array:
    """Nine errors (9,) with the reference's magnitude off by so much (n,)."""
    return np.asarray(solve(replace(of, scene=replace(of.scene, magnitude_nt=of.scene.magnitude_nt + by_nt)), X).x[:9])


def drawn(error: FieldError, covariance: Array, rng: np.random.Generator) -> Array:
    """An error of the magnitude (n,) of a covariance between the knots."""
    values, vectors = np.linalg.eigh(covariance)
    at = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.normal(size=len(values)))
    return np.interp(np.arange(len(scene())), np.asarray(error.lines.at), at)


def grown(fit: Fit) -> Array:
    """What the reference adds to the standard deviations (9,)."""
    return np.asarray(np.sqrt(np.diagonal(errors_covariance(fit) - fit.covariance[:9, :9])))


@pytest.mark.parametrize("coarse", [0.25, 1.0])
def test_the_spread_is_that_of_errors_that_are_drawn_and_fitted(coarse: float) -> None:
    """Where the noise counts a quarter of the usual errors the rest is drawn, and where it counts them all what is the
    same everywhere alone, 12 nT along each axis of the Earth."""
    error, rng = error_at(Scale(coarse, 1.0)), np.random.default_rng(41)
    assert error.beside_noise is not None
    fitted = problem(error)
    fits = np.stack([moved(fitted, drawn(error, error.beside_noise, rng)) for _ in range(DRAWS)])
    ratio = fits.std(axis=0) / grown(solve(fitted, X))
    assert np.all((ratio > 0.7) & (ratio < 1.35))  # of 60 draws a standard deviation is known to 9 %


def test_what_is_the_same_everywhere_is_a_field_of_one_direction() -> None:
    """Its covariance is that of q (12 nT along each axis of the Earth, and no more than three directions) along H."""
    error = error_at(Scale())
    assert error.outside is not None
    values = np.linalg.eigvalsh(error.outside)
    assert np.count_nonzero(values > 1e-9 * values[-1]) == 3
    assert np.diagonal(error.outside) == pytest.approx(144.0)


def test_off_orbit_and_of_whole_vectors_nothing_is_added() -> None:
    assert problem(None).field_error is None
    plain = solve(problem(None), X)
    np.testing.assert_array_equal(errors_covariance(plain), plain.covariance[:9, :9])
    turned = FieldError.of(scene(), NOISE_NT, np.tile(np.eye(3), (len(scene()), 1, 1)))
    assert turned is not None
    assert turned.beside_noise is None


def test_of_several_recordings_each_has_its_own() -> None:
    """Two of one flight whose errors nothing ties together: what one of them has alone."""
    alone = problem(error_at(Scale(0.25, 1.0)))
    both = solve(JointProblem.of([alone, alone]), np.concatenate([X, X]))
    assert isinstance(both.problem, JointProblem)
    single = errors_covariance(solve(alone, X))
    for number, rows in enumerate(both.problem.slices):
        found = errors_covariance(both, alone, rows, slice(9 * number, 9 * number + 9))
        assert np.sqrt(np.diagonal(found)) == pytest.approx(np.sqrt(np.diagonal(single)), rel=0.05)
