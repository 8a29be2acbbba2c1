"""Where columns are made: an effect that bends the field acts on it as it would be without the effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magcal_service.diagnosis.explain import Search
from magcal_service.diagnosis.problem import Problem, Term
from magcal_service.diagnosis.screen import hypotheses_of
from magcal_service.diagnosis.solution import solve
from magcal_service.model import measure
from magcal_service.physics.catalogue import effect_named
from tests.physics.scenes import NOISE_NT, X, scene, spoiled

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
