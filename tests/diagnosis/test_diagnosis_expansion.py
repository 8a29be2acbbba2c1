"""Where columns are made: an effect that bends the field acts on it as it would be without the effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.expansion import where_moved
from magcal_service.diagnosis.explain import Search
from magcal_service.diagnosis.problem import Problem, Term
from magcal_service.diagnosis.screen import hypotheses_of
from magcal_service.diagnosis.solution import solve
from magcal_service.earth import geomagnetic
from magcal_service.model import measure
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.interface import Hypothesis
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.scene.steady_spin import solve_spin
from tests.physics.scenes import AXIS_BODY, AXIS_ECI, NOISE_NT, ORIGIN_NS, X, orbit_eci_km, scene, spoiled, turning

PER_NT2 = np.array([2.4e-11, -1.8e-11, 1.4e-11])


def test_a_strong_cube_has_the_numbers_of_the_field_without_it() -> None:
    """Of the cube of what is measured it would have others: by three times its share of the field."""
    of = scene()
    added = PER_NT2 * measure(X, of.calibrated_nt) ** 3
    noise = np.random.default_rng(9063).normal(0.0, NOISE_NT, (len(of), 3))
    problem = Problem(spoiled(measure(X, of.calibrated_nt + added + noise), of), NOISE_NT)
    effects = (effect_named("cubic_response"),)
    search = Search(problem, hypotheses_of(effects, problem), effects)
    form = next(h for h in search.hypotheses if not h.variant)
    fit = search.refreshed(solve(problem, X, [Term(form, np.zeros(0), np.zeros(3))]))
    sigma = np.sqrt(np.diagonal(fit.covariance)[9:12])
    found = fit.terms[0].amplitudes
    assert np.all(np.abs(found - PER_NT2) < 3.0 * sigma)
    of_measured = replace(search.problem, scene=replace(search.problem.scene, undisturbed_nt=None))
    other = next(h for h in hypotheses_of(effects, of_measured) if not h.variant)
    (term,) = solve(of_measured, fit.x, [Term(other, np.zeros(0), found)]).terms
    assert np.max(np.abs(term.amplitudes - PER_NT2) / sigma) > 3.0


def test_a_form_made_anew_is_not_tried_as_it_was_before() -> None:
    """A lag that is known is expanded there alone: at the 4 s that it was first tried at, a lag of 40 ms was 56 ms."""
    late_s, of = 4.0, scene(NOISE_NT)  # a lag, and not of 40 ms
    before = of.magnitude_nt - late_s * of.magnitude_slope
    late = replace(of, magnitude_nt=of.magnitude_nt**2 / before)  # the samples are as long as the field was
    effects = (effect_named("response_lag"),)
    problem = Problem(late, NOISE_NT)
    search = Search(problem, hypotheses_of(effects, problem), effects)
    fit = solve(problem, X)
    (found,) = search.screen(search.workspace(fit), fit, NOISE_NT)
    assert float(found.theta[0]) != 0.04
    search.look_at(*moved(search, 0.04))
    form = next(one for one in search.hypotheses if one.label == found.hypothesis.label)
    again = search.screen(search.workspace(fit), fit, NOISE_NT, among=[form])
    assert {float(one.theta[0]) for one in again} == {0.04}


def moved(search: Search, late_s: float) -> tuple[Problem, list[Hypothesis]]:
    """A problem whose fit has found a lag, with its forms."""
    of = replace(search.problem.scene, moved_s=np.full(len(search.problem.scene), -late_s))
    problem = replace(search.problem, scene=of)
    return problem, hypotheses_of(search.effects, problem)


def test_a_turn_is_counted_against_the_reference_where_the_fit_has_moved_it() -> None:
    """Over a quarter of an orbit a reference 40 s late turns otherwise than the field at a sample."""
    late_s, rate = 40.0, 0.07
    time_s = 4.0 * np.arange(400)
    time_ns = ORIGIN_NS + (time_s * 1e9).astype(np.int64)
    true, late = (geomagnetic.igrf_eci_nt(time_ns - int(by * 1e9), orbit_eci_km(time_s - by)) for by in (0.0, late_s))
    body = np.einsum("nij,nj->ni", turning(AXIS_BODY, AXIS_ECI, rate * time_s), true)
    size = np.linalg.norm(late, axis=1)
    flown = Scene(time_s, ORIGIN_NS, True, body, body, body, size, reference_eci_nt=late)
    moved = where_moved(flown, np.full(len(time_s), late_s))
    assert np.abs(moved.reference_eci_nt[:-10] - true[:-10]).max() < 1.0
    assert (
        np.abs(moved.reference_eci_nt[-10:] - true[-10:]).max() < 250.0
    )  # straight on, past the end: an eighth of the way
    assert moved.magnitude_nt == pytest.approx(np.linalg.norm(moved.reference_eci_nt, axis=1))
    off = [abs(solve_spin(one, None, rate).rate_rad_s / rate - 1.0) for one in (flown, moved)]
    assert off[1] < 1e-4 < off[0]


def test_a_magnitude_stays_where_it_is() -> None:
    """Without a vector nothing is turned that could be counted against it."""
    of = replace(scene(), reference_eci_nt=None)
    assert where_moved(of, np.full(len(of), 40.0)) is of
    assert where_moved(scene(), np.zeros(len(of))) is scene()
