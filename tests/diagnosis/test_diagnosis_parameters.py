"""The numbers of an effect: one gain for all axes says nothing of a single one."""

from __future__ import annotations

import numpy as np

from magcal_service.diagnosis.parameters import of_each_axis, parameters_of
from magcal_service.diagnosis.problem import Fit, Problem, Term
from magcal_service.diagnosis.solution import solve
from magcal_service.model import measure
from magcal_service.physics.catalogue import effect_named
from tests.physics.scenes import NOISE_NT, X, scene, spoiled

PER_K = np.array([3.0e-4, 2.0e-4, 4.0e-4])
EFFECT = effect_named("thermal_scale")


def fitted(variant: str) -> Fit:
    """Three gains that follow the recorded temperature, fitted in a form."""
    of = scene()
    forms = [h for h in EFFECT.hypotheses(of) if h.driver == "channel:temperature"]
    each = next(h for h in forms if not h.variant)
    added = each.columns(np.zeros(0)).field(PER_K)
    noise = np.random.default_rng(9064).normal(0.0, NOISE_NT, (len(of), 3))
    problem = Problem(spoiled(measure(X, of.calibrated_nt + added + noise), of), NOISE_NT)
    form = next(h for h in EFFECT.hypotheses(problem.scene) if h.driver == each.driver and h.variant == variant)
    return solve(problem, X, [Term(form, np.zeros(0), np.full(form.size, 3.0e-4))])


def test_each_axis_has_its_own_gain_where_one_was_fitted_for_all() -> None:
    """Within three of its own sigmas; the common one is beyond that of two axes."""
    fit = fitted("one gain")
    own, common = of_each_axis(fit, 0, EFFECT)["per_k"], parameters_of(fit, 0, EFFECT)["per_k_common"]
    assert np.all(np.abs(own.value - PER_K) < 3.0 * own.sigma)
    assert np.count_nonzero(np.abs(common.value - PER_K) > 5.0 * common.sigma) == 2
    assert np.all(own.sigma > common.sigma)


def test_a_form_that_has_a_number_for_each_axis_needs_no_other() -> None:
    assert of_each_axis(fitted(""), 0, EFFECT) == {}
