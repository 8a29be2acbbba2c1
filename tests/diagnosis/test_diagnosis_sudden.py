"""A jump held against the same change over minutes: what is not seen to be sudden is hardly believed to be a jump."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cache, partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import optimize

from magcal_service.diagnosis import sudden as changes
from magcal_service.diagnosis.belief import posterior, unlisted
from magcal_service.diagnosis.blocks import Gain
from magcal_service.diagnosis.doubts import SURE
from magcal_service.diagnosis.explain import Explained, Search
from magcal_service.diagnosis.problem import Fit, Problem, Term
from magcal_service.diagnosis.solution import solve
from magcal_service.diagnosis.sudden import Slower, _jointly, slower
from magcal_service.model import Array, calibrate, measure
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.interface import Hypothesis
from tests.physics.scenes import NOISE_NT, X, scene, spoiled

JUMP_NT = np.array([220.0, -140.0, 90.0])  # 3.4 sigma
AT_S = 4100.0
LENGTHS_S = 600.0 * 2.0 ** np.arange(4)  # all that the scene is longer than
EACH = 5  # samples from one place of a change to the next: 20 s


@cache
def jump(length_s: float, size: float) -> tuple[Search, Fit]:
    """A change of the bias that takes so long, fitted as a jump."""
    of = scene()
    noise = NOISE_NT * np.random.default_rng(9021).normal(size=(len(of), 3))
    changed = of.calibrated_nt + size * JUMP_NT * course(of.time_s, AT_S, length_s)[:, None] + noise
    problem = Problem(spoiled(measure(X, changed), of), NOISE_NT)
    form = next(h for h in effect_named("bias_step").hypotheses(problem.scene) if not h.variant)
    return Search(problem, [form]), solve(problem, X, [Term(form, np.array([AT_S]), size * JUMP_NT)])


def course(time_s: Array, at_s: float, length_s: float) -> Array:
    """From 0 to 1, evenly, with its middle at an instant."""
    return np.clip((time_s - at_s) / length_s + 0.5, 0.0, 1.0)


def likelihood(length_s: float, size: float) -> float:
    search, fit = jump(length_s, size)
    return slower(search, fit, 0, search.workspace(fit, 0), fit.white_rms_nt)


def test_a_jump_that_stands_out_is_seen_to_be_one_and_a_slow_change_to_be_none() -> None:
    assert likelihood(1e-3, 1.0) < 1e-3
    assert likelihood(1500.0, 1.0) > 1e3


def test_its_likelihood_is_that_of_every_change_fitted_alone() -> None:
    """The second way: each change at each edge with its own course, projected off the nine errors at once."""
    _, fit = jump(700.0, 0.1)
    time_s, sigma2 = fit.problem.scene.time_s, fit.white_rms_nt**2
    residual = fit.residual + fit.columns[:, 9:12] @ fit.terms[0].amplitudes
    nine = np.linalg.qr(fit.columns[:, :9])[0]
    residual = residual - nine @ (nine.T @ residual)

    places = time_s[1::EACH]

    def nats(length_s: float) -> Array:
        found = []
        for at_s in places:
            columns = fit.unit * course(time_s, at_s, length_s)[:, None]
            columns = columns - nine @ (nine.T @ columns)
            left = residual - columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]
            found.append((residual @ residual - left @ left) / (2.0 * sigma2))
        return np.array(found)

    sudden, slow = nats(1e-6), np.stack([nats(length) for length in LENGTHS_S])
    expected = np.mean(np.exp(slow - sudden.max())) / np.mean(np.exp(sudden - sudden.max()))
    assert 0.1 < expected < 10.0
    assert likelihood(700.0, 0.1) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(("size", "is_sure"), [(1.0, True), (0.1, False)])
def test_a_jump_too_faint_to_be_seen_as_sudden_is_not_sure(size: float, is_sure: bool) -> None:
    slow, fit = likelihood(1e-3, size), jump(1e-3, size)[1]
    told: Any = SimpleNamespace(likelihoods=(slow,))
    named = Explained(fit, ((),), (100.0,), (Gain(100.0, 1.0, 10, 10),), slower=told)
    believed = posterior(named, 0)
    assert (believed.own >= SURE) is is_sure
    assert believed.members == (("bias_step",) if is_sure else ("bias_step", "unknown"))
    assert unlisted(named, 0) == ("" if is_sure else "a drift over minutes by a cause in no catalogue")


def test_slow_changes_are_worked_out_once_they_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr(changes, "slower", lambda *arguments: asked.append(arguments[2]) or 0.5)
    search, fit = jump(1e-3, 1.0)
    lazy = Slower(search, fit, [fit.white_rms_nt])
    assert asked == []
    assert lazy.likelihoods == lazy.likelihoods == (0.5,)
    assert asked == [0]


def test_a_slow_change_that_comes_near_to_first_order_counts_as_it_does_by_a_joint_solution() -> None:
    """First-order evidence of a slow change, beside samples that have a jump: as where columns are made elsewhere."""
    (search, sudden), (other, slow) = jump(1e-3, 1.0), jump(1500.0, 1.0)
    sigma = sudden.white_rms_nt
    assert slower(other, slow, 0, other.workspace(slow, 0), sigma) > 1e3
    assert slower(search, sudden, 0, other.workspace(slow, 0), sigma) < 1.0


@pytest.mark.parametrize("length_s", [600.0, 1200.0])
def test_by_a_joint_solution_is_by_least_squares_of_all_unknowns(length_s: float) -> None:
    """The second way: scipy's least squares of the magnitudes, the middle of the change among the unknowns."""
    search, fit = jump(700.0, 1.0)
    of, sigma = fit.problem.scene, fit.white_rms_nt

    def left(x: Array, share: Array) -> Array:
        vector = calibrate(x[:9], of.field_nt) - share[:, None] * x[9:12]
        return (np.linalg.norm(vector, axis=1) - of.magnitude_nt - fit.problem.noise_nt**2 / of.magnitude_nt) / sigma

    start = np.concatenate([X, JUMP_NT])
    scale = np.concatenate([np.full(3, 100.0), np.full(6, 0.01), np.full(3, 100.0)])
    jumps = (course(of.time_s, at_s, 1e-3) for at_s in (AT_S, AT_S - 150.0, AT_S + 150.0))
    sudden = min(optimize.least_squares(partial(left, share=share), start, x_scale=scale).cost for share in jumps)

    def while_over(x: Array) -> Array:
        return left(x, course(of.time_s, AT_S + 100.0 * x[12], length_s))

    trials = [np.append(start, place) for place in (-1.5, 0.0, 1.5)]
    over = min(optimize.least_squares(while_over, x, x_scale=np.append(scale, 1.0)).cost for x in trials)
    assert _jointly(search, fit, 0, AT_S, length_s) / sigma**2 == pytest.approx(sudden - over, abs=2.0)


def test_of_several_recordings_a_slow_change_is_held_against_a_jump_to_first_order() -> None:
    """Their forms are made of each one's own, and have no columns that a course could be laid over."""

    @dataclass(frozen=True, slots=True, eq=False)
    class Several(Hypothesis):
        pass

    search, fit = jump(1500.0, 1.0)
    form = fit.terms[0].hypothesis
    several = Several(**{field.name: getattr(form, field.name) for field in fields(form)})
    joint = replace(fit, terms=(replace(fit.terms[0], hypothesis=several),))
    assert slower(search, joint, 0, search.workspace(fit, 0), fit.white_rms_nt) > 1e3
