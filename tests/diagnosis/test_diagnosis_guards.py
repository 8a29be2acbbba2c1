"""What keeps a diagnosis from saying too much: priors, bounds, instants by their cost, shapes that no name may take."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.explain import Search
from magcal_service.diagnosis.leftover import largest_product, significant, structures
from magcal_service.diagnosis.parameters import parameters_of
from magcal_service.diagnosis.problem import Fit, Problem, Term, evaluate
from magcal_service.diagnosis.screen import hypotheses_of
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array, measure
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.columns import Columns, along_axes
from magcal_service.physics.interface import Block, Hypothesis, Nonlinear
from magcal_service.physics.scene.scene import Scene
from tests.physics.scenes import COUNT, NOISE_NT, X, scene, spoiled


def flown(disturbance_nt: Array, seed: int = 21) -> Scene:
    """The clean craft with a body field (n, 3) added, no telemetry."""
    noise = np.random.default_rng(seed).normal(0.0, NOISE_NT, (COUNT, 3))
    clean = scene()
    return replace(spoiled(measure(X, clean.calibrated_nt + disturbance_nt + noise), clean), channels={})


def twins(largest_nt: float) -> Fit:
    """Two columns that are all but the same, fitted to one disturbance along x of 100 nT."""
    swing = np.sin(scene().time_s / 700.0)
    almost = swing + 1e-4 * np.cos(scene().time_s / 31.0)
    both = Hypothesis(
        "current_loop", "none", lambda _: along_axes(np.stack([swing, almost], axis=1)), (Block("nt", "nT", (2, 3)),)
    )
    problem = Problem(flown(100.0 * swing[:, None] * np.eye(3)[0]), NOISE_NT, largest_nt={"current_loop": largest_nt})
    return solve(problem, X, [Term(both, np.zeros(0), np.zeros(6))])


def test_a_prior_keeps_columns_that_cancel_from_running_away() -> None:
    """Untied, twins of opposite sign reach 10 uT and more; tied to 300 nT they share the 100 nT between them."""
    wild, tied = twins(math.inf).terms[0].amplitudes, twins(300.0).terms[0].amplitudes
    assert float(np.abs(wild).max()) > 10_000.0
    assert float(np.abs(tied).max()) < 600.0
    assert float(tied[0] + tied[3]) == pytest.approx(100.0, abs=15.0)


def test_a_number_at_its_bound_does_not_keep_the_rest_from_being_fitted() -> None:
    """A course slower than any that is searched: the time constant stays at its end, the rest is fitted."""
    course = 1.0 - np.exp(-scene().time_s / 30_000.0)
    slowest = Nonlinear("time_constant_s", "s", np.array([500.0, 2000.0, 8000.0]))

    def columns(theta: Array) -> Columns:
        return along_axes(1.0 - np.exp(-scene().time_s / float(theta[0])))

    form = Hypothesis("bias_drift", "none", columns, (Block("end", "nT"),), nonlinear=(slowest,))
    problem = Problem(flown(np.outer(course, [4000.0, -2500.0, 3000.0])), NOISE_NT)
    fit = solve(problem, X, [Term(form, np.array([8000.0]), np.zeros(3))])
    assert fit.terms[0].theta[0] == pytest.approx(8000.0)
    assert fit.rms_nt < 1.2 * NOISE_NT


def step_at(instant_s: float) -> Fit:
    """A gain of x that steps by 0.01, fitted at the right instant."""
    clean = scene()
    after = (clean.time_s >= instant_s)[:, None] * clean.calibrated_nt * np.array([-0.01, 0.0, 0.0])
    problem = Problem(flown(after), NOISE_NT)
    form = next(h for h in effect_named("scale_step").hypotheses(problem.scene) if not h.variant)
    return solve(problem, X, [Term(form, np.array([instant_s]), np.zeros(3))])


def test_an_instant_is_as_sure_as_the_step_is_visible_there() -> None:
    """1 sigma is that of the squares that the step leaves at every other instant, evaluated one by one."""
    fit = step_at(4000.0)
    sigma = float(parameters_of(fit, 0, effect_named("scale_step"))["at_s"].sigma)
    instants = 3998.0 + 4.0 * np.arange(-100, 101)
    (term,) = fit.terms
    left = [
        evaluate(fit.problem, fit.x, [replace(term, theta=np.array([at_s]))], derivatives=False).residual
        for at_s in instants
    ]
    cost = 0.5 * (np.array(left) ** 2).sum(axis=1) / fit.rms_nt**2
    weight = np.exp(cost.min() - cost)
    square = weight @ ((instants - 4000.0) ** 2 + 16.0 / 12.0) / weight.sum()
    assert sigma == pytest.approx(float(np.sqrt(square)), rel=0.05)


def searched(disturbance_nt: Array) -> tuple[Search, Fit]:
    """A search without any physics, and the nine errors' fit."""
    problem = Problem(flown(disturbance_nt), NOISE_NT)
    return Search(problem, []), solve(problem, X)


def bursts() -> Array:
    """Twelve decays of a field at no regular times (n, 3)."""
    rng = np.random.default_rng(3)
    course = np.zeros(COUNT)
    for start in rng.uniform(0.0, 7500.0, 12):
        since = scene().time_s - start
        course += np.where(since >= 0.0, 500.0 * rng.exponential() * np.exp(-np.maximum(since, 0.0) / 60.0), 0.0)
    return np.outer(course, [0.6, -0.64, 0.48])


def test_bursts_are_seen_as_what_comes_and_goes() -> None:
    """The family of transients is the best of all for them, and says nothing of a clean craft."""
    search, fit = searched(bursts())
    best = structures(search, fit, None, 0.3 * NOISE_NT)[0]
    assert best.shape.name == "transients"
    assert significant(best)
    quiet = structures(*searched(np.zeros((COUNT, 3))), None, 0.3 * NOISE_NT)
    assert not any(significant(structure) for structure in quiet)


@pytest.mark.parametrize(("along", "axes"), [([0.0, 0.0, 1.0], 1), ([0.6, -0.5, 0.62], 3)])
def test_one_product_of_two_components_holds_all_of_itself(along: list[float], axes: int) -> None:
    """Bx By of 1e-6 per nT on an axis or in a direction: its own columns take the whole excess; of white noise none."""
    w = scene().calibrated_nt
    search, fit = searched(np.outer(w[:, 0] * w[:, 1] * 1e-6, along))
    excess = float(fit.residual @ fit.residual) - len(fit.residual) * NOISE_NT**2
    assert largest_product(search, fit, 0.3 * NOISE_NT, axes) == pytest.approx(excess, rel=0.15)
    if axes > 1:
        assert largest_product(search, fit, 0.3 * NOISE_NT) < 0.7 * excess
    clean, quiet = searched(np.zeros((COUNT, 3)))
    assert largest_product(clean, quiet, 0.3 * NOISE_NT, axes) < 20.0 * axes * NOISE_NT**2


def test_a_recorded_driver_stands_in_for_its_inference() -> None:
    """With the Sun's direction on a channel, as exact as worked out, the channel is named."""
    clean = scene()
    assert clean.sun_body is not None
    assert clean.lit is not None
    sun = clean.sun_body * clean.lit[:, None]
    recorded = replace(clean.channels["sun"], values=sun + np.random.default_rng(2).normal(0.0, 0.01, sun.shape))
    at = replace(flown(sun @ np.array([[150.0, 30.0, 0.0], [-60.0, 90.0, 20.0], [10.0, 0.0, 120.0]])))
    problem = Problem(replace(at, channels={"sun": recorded}), NOISE_NT)
    effects = [effect_named("sun_disturbance")]
    search = Search(problem, hypotheses_of(effects, problem), effects)
    found = search.run(solve(problem, X), 0.3 * NOISE_NT)
    assert [term.hypothesis.driver for term in found.fit.terms] == ["channel:sun"]
