"""The residual of simulation and recording, its derivatives, and the fit of nine errors with effects."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magcal_service.diagnosis.collapse import is_collapsed
from magcal_service.diagnosis.problem import Fit, Problem, Term, disturbances, evaluate
from magcal_service.diagnosis.solution import solve
from magcal_service.model import BIAS, D_ALL, STATE_SIZE, Array, measure
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.columns import Columns, along_axes
from magcal_service.physics.interface import Block, Hypothesis
from tests.physics.scenes import NOISE_NT, X, scene, spoiled

STEP_NT = np.array([220.0, -140.0, 90.0])
AT_S = 4100.0


def form(name: str, variant: str = "", driver: str = "") -> Hypothesis:
    """One form of an effect on the scene."""
    forms = effect_named(name).hypotheses(scene())
    return next(h for h in forms if h.variant == variant and h.driver.startswith(driver))


@cache
def stepped() -> Problem:
    """The noisy scene with a bias that jumps by ``STEP_NT`` at ``AT_S``."""
    late = (scene().time_s >= AT_S)[:, None]
    noise = NOISE_NT * np.random.default_rng(9).normal(size=(len(scene()), 3))
    return Problem(spoiled(measure(X, scene().calibrated_nt + STEP_NT * late + noise), scene()), NOISE_NT)


@cache
def step_fit() -> Fit:
    """Nine errors and the step, from a poor start."""
    term = Term(form("bias_step"), np.array([AT_S]), np.zeros(3))
    return solve(stepped(), np.zeros(STATE_SIZE), [term])


def slopes(problem: Problem, x: Array, steps: Sequence[float]) -> Array:
    """Minus the residual's derivative by each unknown (m, p), by differences."""
    found = []
    for index, step in enumerate(steps):
        moved = [np.array(x), np.array(x)]
        moved[0][index] += step
        moved[1][index] -= step
        up, down = (evaluate(problem, point, [], derivatives=False).residual for point in moved)
        found.append((down - up) / (2.0 * step))
    return np.stack(found, axis=1)


def test_derivatives_by_the_nine_errors_are_those_of_the_residual() -> None:
    """Without noise the nine columns are the residual's numeric derivatives, to 1e-6."""
    problem = Problem(scene(), 0.0)
    numeric = slopes(problem, X, [1.0] * 3 + [1e-5] * 6)
    columns = evaluate(problem, X, []).columns
    assert np.linalg.norm(columns - numeric, axis=0) == pytest.approx(0.0, abs=1e-6 * np.linalg.norm(numeric))


def test_derivatives_in_a_room_are_those_of_the_residual() -> None:
    """In the vector form nine errors and the field's direction have twelve such columns; along it nothing moves."""
    assert scene().body_from_eci is not None
    room = np.transpose(scene().body_from_eci, (0, 2, 1))
    problem, field = Problem(scene(), 0.0, room), np.array([21e3, -3e3, 17e3])
    fitting = spoiled(measure(X, np.einsum("nji,j->ni", room, field)), scene())
    fitting = replace(fitting, magnitude_nt=np.full(len(fitting), np.linalg.norm(field)))
    problem = Problem(fitting, 0.0, room)
    x = np.concatenate([X, field])
    fit = evaluate(problem, x, [])
    assert fit.residual == pytest.approx(np.zeros(3 * len(scene())), abs=1e-6)
    numeric = slopes(problem, x, [1.0] * 3 + [1e-5] * 6 + [1.0] * 3)
    assert np.abs(fit.columns - numeric).max() < 1e-6 * np.abs(numeric).max()
    assert fit.columns[:, STATE_SIZE:] @ field == pytest.approx(np.zeros(len(fit.columns)), abs=1e-6)


def test_the_true_errors_leave_the_noise() -> None:
    """At the truth the residual is the noise along the field: its level, and a mean of nothing."""
    residual = evaluate(Problem(scene(NOISE_NT), NOISE_NT), X, []).residual
    assert float(np.std(residual)) == pytest.approx(NOISE_NT, rel=0.06)
    assert abs(float(residual.mean())) < 3.0 * NOISE_NT / np.sqrt(len(residual))


def test_nine_errors_are_found_from_zero() -> None:
    """A clean recording gives back its errors within 3.5 of their sigmas."""
    fit = solve(Problem(scene(NOISE_NT), NOISE_NT), np.zeros(STATE_SIZE))
    off = np.abs(fit.x - X) / np.sqrt(np.diagonal(fit.covariance))
    assert float(off.max()) < 3.5
    assert fit.rms_nt == pytest.approx(NOISE_NT, rel=0.05)


def test_errors_and_effect_are_found_together() -> None:
    """With a step, all twelve numbers come back within 3.5 of their sigmas."""
    fit = step_fit()
    sigma = np.sqrt(np.diagonal(fit.covariance))
    found = np.concatenate([fit.x, fit.terms[0].amplitudes])
    assert float((np.abs(found - np.concatenate([X, STEP_NT])) / sigma[:12]).max()) < 3.5
    assert float(sigma[9:12].max()) < 0.2 * float(np.abs(STEP_NT).max())


def test_a_step_left_out_pulls_the_bias() -> None:
    """Without the step the bias is off by about half of it, ten times as far as with it, and the residual grows."""
    alone = solve(stepped(), X)
    off = float(np.linalg.norm(alone.x[BIAS] - X[BIAS]))
    assert off == pytest.approx(0.5 * float(np.linalg.norm(STEP_NT)), rel=0.2)
    assert off > 10.0 * float(np.linalg.norm(step_fit().x[BIAS] - X[BIAS]))
    assert alone.rms_nt > 1.1 * step_fit().rms_nt


def test_held_out_rms_improves_with_the_right_effect() -> None:
    """On blocks that took no part the step takes the residual down to the noise."""
    assert step_fit().held_out_rms_nt == pytest.approx(NOISE_NT, rel=0.05)
    assert solve(stepped(), X).held_out_rms_nt > 1.1 * step_fit().held_out_rms_nt


def test_a_nonlinear_number_is_found_with_the_rest() -> None:
    """A tone's frequency, started a third of a turn off, comes back to a hundredth of a turn over the recording."""
    swing = 150.0 * np.sin(2.0 * np.pi * 0.0213 * scene().time_s)[:, None] * np.array([0.6, 0.0, 0.8])
    noise = NOISE_NT * np.random.default_rng(10).normal(size=(len(scene()), 3))
    problem = Problem(spoiled(measure(X, scene().calibrated_nt + swing + noise), scene()), NOISE_NT)
    span = float(np.ptp(scene().time_s))
    fit = solve(problem, X, [Term(form("tone"), np.array([0.0213 + 0.3 / span]), np.full(6, 10.0))])
    assert float(fit.terms[0].theta[0]) == pytest.approx(0.0213, abs=0.03 / span)
    assert float(np.linalg.norm(fit.terms[0].amplitudes)) == pytest.approx(150.0, rel=0.1)


def test_disturbances_of_terms_add_up() -> None:
    """Body fields and magnitudes of several terms are summed, each into its own."""
    step = Term(form("bias_step"), np.array([AT_S]), STEP_NT)
    warm = Term(form("thermal_bias", driver="channel"), np.zeros(0), np.array([1.0, 2.0, 3.0]))
    late = Term(form("time_offset"), np.zeros(0), np.array([0.5]))
    body, magnitude = disturbances([step, warm, late], scene())
    zero = warm.hypothesis.constants["zero_degc"]
    warmth = scene().channels["temperature"].values - zero
    expected = STEP_NT * (scene().time_s >= AT_S)[:, None] + warmth * np.array([1.0, 2.0, 3.0])
    assert body == pytest.approx(expected, abs=1e-9)
    assert magnitude == pytest.approx(0.5 * scene().magnitude_slope, abs=1e-9)


def test_a_collapsed_sensor_is_told() -> None:
    """Errors that shrink an axis to a third are no sensor's; those of the scene are."""
    shrunk = np.array(X)
    shrunk[D_ALL][0] = -0.67
    assert is_collapsed(shrunk)
    assert not is_collapsed(X)


@pytest.mark.parametrize(("most", "prior"), [(math.inf, 5000.0), (900.0, 900.0 / math.sqrt(3.0))])
def test_what_nothing_tells_is_as_wide_as_its_prior(most: float, prior: float) -> None:
    """Of two columns that are one, each amplitude is unknown; only their sum is known.

    The cube along an axis that saw little field came out eight times what any sensor has, and its name was dropped.
    """
    late, largest_nt = (scene().time_s >= AT_S).astype(np.float64), 5000.0
    twice = Hypothesis(
        "torquer",
        "none",
        lambda _: along_axes(np.stack([late, late], axis=1)),
        (Block("both", "nT", (2, 3), most),),
        largest_nt=largest_nt,
    )
    once = replace(twice, columns=lambda _: along_axes(late[:, None]), blocks=(Block("one", "nT"),))
    pair, single = (solve(stepped(), X, [Term(one, np.zeros(0), np.zeros(one.size))]) for one in (twice, once))
    sigma = np.sqrt(np.diagonal(pair.covariance)[STATE_SIZE:])
    prior /= 1.0 if math.isfinite(most) else math.sqrt(float(np.mean(late**2)))  # of all rows, and of a number
    assert sigma == pytest.approx(prior / np.sqrt(2.0), rel=0.1)
    added = np.kron([1.0, 1.0], np.eye(3))
    known = np.sqrt(np.diagonal(added @ pair.covariance[STATE_SIZE:, STATE_SIZE:] @ added.T))
    assert known == pytest.approx(np.sqrt(np.diagonal(single.covariance)[STATE_SIZE:]), rel=0.1)


@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_covariance_holds_for_white_and_for_coloured_noise(correlation: float) -> None:
    """Over eight draws the nine errors' distances have a mean square of about one; a memory does not make them sure."""
    squares = []
    for seed in range(8):
        white = np.random.default_rng(60 + seed).normal(size=(len(scene()), 3))
        noise = np.array(white)
        for row in range(1, len(noise)):
            noise[row] = correlation * noise[row - 1] + np.sqrt(1.0 - correlation**2) * white[row]
        fit = solve(Problem(spoiled(measure(X, scene().calibrated_nt + NOISE_NT * noise), scene()), NOISE_NT), X)
        squares.append(np.mean((fit.x - X) ** 2 / np.diagonal(fit.covariance)))
    assert 0.5 < float(np.mean(squares)) < 1.8


@pytest.mark.parametrize(("excess", "growth"), [(0, 1.0), (28, 1.0), (32, 1.6)])
def test_a_covariance_grows_only_by_what_block_sums_do_not_do_by_chance(excess: int, growth: float) -> None:
    """Signs +-s in 30 blocks of 400: sums of +-``excess`` s make the mean's sigma ``excess`` / 20 times s / sqrt(n)."""
    level_nt, ups = 7.0, (400 + excess) // 2
    block = np.repeat([level_nt, -level_nt], [ups, 400 - ups])
    residual = np.concatenate([sign * block for sign in np.tile([1.0, -1.0], 15)])
    problem: Any = SimpleNamespace(white=lambda rows: rows, white_products=lambda rows: rows.T @ rows)
    none = np.zeros((0, 3))
    fit = Fit(problem, np.zeros(1), (), residual, np.ones((12_000, 1)), none, none, np.zeros(1))
    assert np.sqrt(fit.covariance) == pytest.approx(growth * level_nt / np.sqrt(12_000))


@pytest.mark.parametrize(("name", "low", "high"), [("start_nt", 0.7, 1.4), ("own_nt", 3.0, np.inf)])
def test_what_a_recording_begins_in_is_told_by_its_beginning_alone(name: str, low: float, high: float) -> None:
    """A state that fades within the first of fifty blocks: that block, held out, is not foretold without the state.

    A state that is called otherwise is: the rest of the recording knows nothing of it, so its block is left with it.
    """
    time_s = scene().time_s
    fading, course = np.exp(-time_s / 15.0), np.sin(time_s / 900.0)
    made = Hypothesis(
        "made_up",
        "none",
        lambda _: Columns(body=np.stack([fading, course])[:, :, None] * np.array([0.6, 0.0, 0.8])),
        (Block(name, "nT", ()), Block("course_nt", "nT", ())),
    )
    term = Term(made, np.zeros(0), np.array([900.0, 200.0]))
    body, _ = disturbances([term], scene())
    noise = NOISE_NT * np.random.default_rng(14).normal(size=body.shape)
    problem = Problem(spoiled(measure(X, scene().calibrated_nt + body + noise), scene()), NOISE_NT)
    fit = solve(problem, X, [term])
    first = fit.held_out_residual[: len(time_s) // 50]
    left = float(np.sqrt(np.mean(first**2))) / NOISE_NT
    assert low < left < high


def test_derivatives_are_left_out_where_too_much_is_left() -> None:
    """The squares of the white residual decide, and what is left is the same either way."""
    problem = Problem(scene(NOISE_NT), NOISE_NT)
    whole = evaluate(problem, X, [])
    bare, kept = (evaluate(problem, X, [], most_nt2=share * whole.squares) for share in (0.999, 1.001))
    assert bare.columns.size == bare.tie.size == 0
    assert np.array_equal(bare.residual, whole.residual)
    assert np.array_equal(kept.columns, whole.columns)
