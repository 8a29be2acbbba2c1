"""The joint fit arrives, at the zero of its score, from near and far, and says so where it does not."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magcal_service.diagnosis import solution
from magcal_service.diagnosis.collapse import is_collapsed
from magcal_service.diagnosis.prepare import baseline_start
from magcal_service.diagnosis.problem import Fit, Problem, Term, evaluate
from magcal_service.diagnosis.solution import _Held, _Step, _tried, _where_it_turns, ended, solve
from magcal_service.model import STATE_SIZE, Array, d_matrix, measure
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.columns import Columns, along_axes
from magcal_service.physics.interface import Block, Hypothesis, Nonlinear
from tests.physics.scenes import NOISE_NT, X, scene, spoiled

FAR = np.array([40_000.0, -25_000.0, 30_000.0, 0.25, -0.2, 0.15, 0.1, -0.1, 0.05])


def steps_to_go(problem: Problem, x: Array) -> float:
    """Length of the Gauss-Newton step at a point, in sigmas, by the normal equations."""
    fit = evaluate(problem, x, [])
    scale = np.linalg.norm(fit.columns, axis=0)
    columns = fit.columns / scale
    normal = columns.T @ columns
    step = np.linalg.solve(normal, columns.T @ fit.residual)
    return float(np.sqrt(step @ normal @ step)) / fit.rms_nt


@pytest.mark.parametrize("start", [np.zeros(STATE_SIZE), X, FAR], ids=["zero", "truth", "far"])
def test_every_start_ends_at_one_zero_of_the_score(start: Array) -> None:
    """From zero, from the truth and from 50 uT off: the same nine numbers, with less than 0.02 sigma still to go."""
    problem = Problem(scene(NOISE_NT), NOISE_NT)
    fit = solve(problem, start)
    assert fit.converged
    assert steps_to_go(problem, fit.x) < 0.02
    sigma = np.sqrt(np.diagonal(fit.covariance))
    assert float((np.abs(fit.x - solve(problem, X).x) / sigma).max()) < 0.05


def test_the_zero_of_the_score_is_nearer_the_truth_than_the_least_squares() -> None:
    """Six draws of much noise: least squares is biased by the noise in B, several sigma of the mean of the draws."""
    noise_nt = 30.0 * NOISE_NT
    far, near = [], []
    for seed in range(6):
        noise = noise_nt * np.random.default_rng(80 + seed).normal(size=(len(scene()), 3))
        problem = Problem(spoiled(measure(X, scene().calibrated_nt + noise), scene()), noise_nt)
        fit = solve(problem, X)
        sigma = np.sqrt(np.diagonal(fit.covariance))
        near.append((fit.x - X) / sigma)
        far.append((least_squares(problem, fit.x) - X) / sigma)

    def of_the_mean(found: list[Array]) -> float:
        return float(np.sqrt(len(found)) * np.abs(np.mean(found, axis=0)).max())

    assert of_the_mean(near) < 3.5 < 5.0 < of_the_mean(far)


def least_squares(problem: Problem, x: Array) -> Array:
    """The least sum of squares of |w| - |H| - s^2 / |H|, by Gauss-Newton with the derivatives at the noisy vectors."""
    for _ in range(8):
        residual = evaluate(problem, x, [], derivatives=False).residual
        columns = np.stack([slope(problem, x, index) for index in range(STATE_SIZE)], axis=1)
        scale = np.linalg.norm(columns, axis=0)
        x = x - np.linalg.lstsq(columns / scale, residual, rcond=None)[0] / scale
    return x


def slope(problem: Problem, x: Array, index: int) -> Array:
    """Derivative of the residual by one unknown, by central differences."""
    step = np.zeros(STATE_SIZE)
    step[index] = 1.0 if index < 3 else 1e-5
    up, down = (evaluate(problem, x + sign * step, [], derivatives=False).residual for sign in (1.0, -1.0))
    return (up - down) / (2.0 * step[index])


def test_a_fit_that_has_no_solution_says_so() -> None:
    """A field of one direction fixes nothing: steps end, and not at a solution; or the prior alone decides."""
    one_way = replace(scene(), field_nt=np.tile([30_000.0, 0.0, 0.0], (len(scene()), 1)))
    fit = solve(Problem(one_way, NOISE_NT), FAR)
    assert not fit.converged or float(np.sqrt(np.diagonal(fit.covariance))[:3].max()) > 1000.0


def test_a_short_arc_does_not_end_in_a_half_collapsed_minimum() -> None:
    """A bias three times the field, a sixth of an orbit: the sensor is found, not one that shrinks vectors."""
    part = len(scene()) // 6
    first = scene(NOISE_NT)
    large = np.array([90_000.0, -30_000.0, -28_000.0, 0.13, 0.02, 0.03, 0.05, 0.01, 0.03])
    field = measure(large, scene().calibrated_nt[:part])
    arc = replace(
        first,
        time_s=first.time_s[:part],
        field_nt=field,
        calibrated_nt=field,
        clean_field_nt=field,
        magnitude_nt=first.magnitude_nt[:part],
        reference_eci_nt=None,
        position_ecef_km=None,
        body_from_eci=None,
        channels={},
    )
    x = baseline_start(arc, None)
    assert not is_collapsed(x)
    assert float(np.linalg.det(np.eye(3) + d_matrix(x))) == pytest.approx(
        float(np.linalg.det(np.eye(3) + d_matrix(large))), rel=0.1
    )


def relaxing_to(amplitude_nt: float) -> tuple[Problem, Term]:
    """A field that changes in the middle of a recording, and a relaxation that is fitted to it: much is left that bends
    with its time constant."""
    part = scene().time_s / scene().time_s[-1]
    change = amplitude_nt * np.tanh(6.0 * part - 3.0)[:, None] * np.array([1.0, 0.6, -0.5])
    noise = NOISE_NT * np.random.default_rng(5).normal(size=change.shape)
    problem = Problem(spoiled(measure(X, scene().calibrated_nt + change) + noise, scene()), NOISE_NT)
    shares = Nonlinear("share", "1", np.geomspace(0.01, 10.0, 9))
    form = Hypothesis(
        "bias_drift",
        "none",
        lambda theta: along_axes(np.exp(-part / theta[0])),
        (Block("k", "nT"),),
        nonlinear=(shares,),
        largest_nt=5000.0,
    )
    return problem, Term(form, np.array([0.5]), np.full(3, 10.0))


@pytest.mark.parametrize("amplitude_nt", [1000.0, 3000.0])
def test_where_columns_bend_the_steps_learn_of_it(amplitude_nt: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps by the normal matrix alone creep, 34 and 28 of them; with what they tell half as many arrive."""
    problem, term = relaxing_to(amplitude_nt)
    taken = []

    def solved(bends: float, converged: float) -> Fit:
        calls: list[None] = []
        monkeypatch.setattr(solution, "evaluate", lambda *a, **k: calls.append(None) or evaluate(*a, **k))
        monkeypatch.setattr(solution, "_BENDS", bends)
        monkeypatch.setattr(solution, "_CONVERGED", converged)
        fit = solve(problem, X, [term])
        taken.append(len(calls))
        assert fit.converged
        return fit

    exact, learned, creeping = solved(100.0, 1e-10), solved(100.0, 1e-4), solved(0.0, 1e-4)
    sigma = float(np.sqrt(exact.covariance[-1, -1]))
    for one in (learned, creeping):
        assert abs(float(one.terms[0].theta[0] - exact.terms[0].theta[0])) < 0.01 * sigma
    assert taken[1] < 0.6 * taken[2]


def test_a_bend_tells_how_the_score_fell() -> None:
    """With it the equations are exact over the step that it was learned from, and in one direction only."""
    problem, term = relaxing_to(1000.0)
    first = evaluate(problem, X, [term])
    before = _Step.of(first, first.white_rms_nt**2)
    step = 0.1 * before.damped(0.0) / before.scale
    there = _tried(before, step)
    assert there is not None
    bend = there.bent(before, step, None)
    fallen = before.score * before.scale - there.score * there.scale
    normal = there.normal * np.outer(there.scale, there.scale)
    np.testing.assert_allclose((normal + bend) @ step, fallen, rtol=1e-6, atol=1e-9 * float(np.abs(fallen).max()))
    assert np.linalg.matrix_rank(bend / np.outer(there.scale, there.scale), tol=1e-9) == 1


def test_a_number_that_nothing_tells_does_not_end_in_an_error() -> None:
    """Its sigma leads out of all numbers; a singular value decomposition of what is none ended the diagnosis."""

    def columns(theta: Array) -> Columns:
        return along_axes(np.where(abs(theta[0]) < 1e3, 1.0, np.nan) * np.cos(scene().time_s / 300.0)[:, None])

    grid = Nonlinear("any", "1", np.array([-1e12, 1e12]))
    form = Hypothesis("torquer", "none", columns, (Block("k", "nT"),), nonlinear=(grid,), largest_nt=500.0)
    problem = Problem(scene(NOISE_NT), NOISE_NT)
    fit = evaluate(problem, X + 1e-3, [Term(form, np.array([5.0]), np.full(3, 10.0))])
    assert float(np.sqrt(fit.covariance[-1, -1])) > 1e4
    here = _Step.of(fit, fit.white_rms_nt**2)
    out = np.zeros(len(here.scale))
    out[-1] = 1e4
    assert _tried(here, out) is None
    assert np.isfinite(solve(problem, fit.x, fit.terms).terms[0].theta[0])


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_zero_over_a_hump_is_found_where_the_score_points(side: float) -> None:
    """What is left to go rises between 0.079 and the zero at 0.05, and falls before the zero; the sign leads there."""

    def at(value: float) -> _Held:
        way = side * 0.05 - value
        to_go = 0.0156 + 0.05 * abs(way) if abs(way) > 0.004 else way**2
        fit: Any = SimpleNamespace(converged=to_go < 1e-6, value=value)
        return _Held(value, to_go, way, fit)

    found: Any = _where_it_turns(at, lambda value: side * min(max(side * value, 0.01), 1.0), at(side * 0.079))
    assert found.value == pytest.approx(side * 0.05, abs=1e-3)
    assert found.converged


def test_without_a_zero_within_reach_a_fit_stays() -> None:
    """A score that points one way for ever, and one whose end is too far off."""

    def endless(value: float) -> _Held:
        fit: Any = SimpleNamespace(converged=False)
        return _Held(value, 0.5, 1.0, fit)

    near, nothing = endless(0.1), endless(0.0)
    assert _where_it_turns(endless, lambda value: value, nothing) is nothing.fit
    assert _where_it_turns(endless, lambda value: value, near) is near.fit
    assert _where_it_turns(lambda value: replace(endless(value), to_go=5.0), lambda value: value, near) is near.fit


@pytest.mark.parametrize("period_s", [70.3, 90.0, 130.0], ids=["odd", "whole samples", "whole samples, longer"])
@pytest.mark.parametrize("off", [0.0, 2e-4], ids=["at its period", "beside it"])
def test_a_duty_arrives_though_the_model_jumps_with_its_period(period_s: float, off: float) -> None:
    """No slope is zero at the best period; its field, which was solved for, is within 3 sigma of the truth."""
    forms = effect_named("torquer").hypotheses(scene())
    duty = next(one for one in forms if "period" in {number.role for number in one.nonlinear})
    on_nt, share, phase = np.array([230.0, -210.0, -180.0]), 0.3, 0.5
    on = (np.mod(scene().time_s / period_s - phase, 1.0) < share)[:, None]
    noise = NOISE_NT * np.random.default_rng(71).normal(size=(len(scene()), 3))
    problem = Problem(spoiled(measure(X, scene().calibrated_nt + on * on_nt + noise), scene()), NOISE_NT)
    near = Term(duty, np.array([period_s * (1.0 + off), share, phase]), on_nt)
    found = ended(solve(problem, X, [near]))
    assert found.converged
    (term,) = found.terms
    assert term.hypothesis is duty
    cycles = float(scene().time_s[-1]) / period_s
    assert abs(term.theta[0] / period_s - 1.0) * cycles < 0.05  # of a cycle, at the end: its edges are sampled
    sigma = np.sqrt(np.diagonal(found.covariance))[problem.size : problem.size + 3]
    assert float(np.abs((term.amplitudes - on_nt) / sigma).max()) < 3.0
    aside = [
        evaluate(problem, found.x, [replace(term, theta=term.theta * [1.0 + side, 1.0, 1.0])]) for side in (-1e-4, 1e-4)
    ]
    assert found.white_rms_nt <= min(one.white_rms_nt for one in aside) + 1e-3


@pytest.mark.parametrize(
    ("half_width", "seed", "stalls"),
    [(0.3, 1, False), (0.3, 4, True), (0.5, 3, True)],
    ids=["by its own steps", "at a kink", "at another"],
)
def test_a_faint_hysteresis_arrives_though_its_answer_bends_with_its_width(
    half_width: float, seed: int, stalls: bool
) -> None:
    """Damped steps may stall at where samples change sides; its width is within 3 sigma of the truth there."""
    form = effect_named("hysteresis").hypotheses(scene())[0]
    width, share = np.array([half_width]), np.array([0.004, -0.006, 0.002])
    noise = NOISE_NT * np.random.default_rng(seed).normal(size=(len(scene()), 3))
    spoilt = spoiled(measure(X, scene().calibrated_nt + form.columns(width).field(share) + noise), scene())
    solved = solve(Problem(spoilt, NOISE_NT), X, [Term(form, 1.1 * width, share)])
    assert solved.converged is not stalls
    found = ended(solved)
    assert found.converged
    sigma = float(np.sqrt(np.diagonal(found.covariance))[-1])
    assert abs(found.terms[0].theta[0] - half_width) < 3.0 * sigma


@pytest.mark.parametrize("seed", [2002, 2003, 2005])
def test_dumping_along_the_field_arrives(seed: int) -> None:
    """What a turn of the pulses' vectors would change leaves no magnitude another, and is no unknown of the fit."""
    hypothesis = next(h for h in effect_named("torquer").hypotheses(scene()) if "dumped" in h.variant)
    theta = np.array([518.0, 0.177, 0.958])
    coupling = np.array([[0.0, 0.012, 0.009], [-0.018, 0.006, 0.0], [0.003, 0.009, 0.0]])
    on = np.mod((scene().time_s - hypothesis.constants["middle_s"]) / theta[0] - theta[2], 1.0) < theta[1]
    fired = scene().calibrated_nt @ coupling * on[:, None]
    noise = NOISE_NT * np.random.default_rng(seed).normal(size=(len(scene()), 3))
    problem = Problem(spoiled(measure(X, scene().calibrated_nt + fired + noise), scene()), NOISE_NT)
    fit = solve(problem, X, [Term(hypothesis, theta, np.zeros(6))])
    assert fit.converged
    assert fit.white_rms_nt < 1.05 * NOISE_NT
