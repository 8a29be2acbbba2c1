"""Noise with a memory: what it is judged beside, and what its whitening may leave of it."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magcal_service.diagnosis import leftover, searching
from magcal_service.diagnosis.belief import posterior
from magcal_service.diagnosis.explain import Explained, Search
from magcal_service.diagnosis.leftover import Structure, significant, with_courses
from magcal_service.diagnosis.problem import Fit, Problem, Term, evaluate
from magcal_service.diagnosis.searching import memory_of, with_memory
from magcal_service.diagnosis.shapes import Shape
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array, measure
from magcal_service.physics.scene.scene import Scene
from tests.diagnosis.made_up import body_form
from tests.diagnosis.step_explained import explained
from tests.physics.scenes import COUNT, NOISE_NT, X, scene, spoiled, view

SLOW = np.sin(2.0 * np.pi * np.arange(COUNT) / COUNT)[None, :, None] * np.eye(3)[:, None]
"""A slow field (n, 3) along each of three axes."""

QUICK = np.sin(2.0 * np.pi * 7.0 * np.arange(COUNT) / COUNT)[None, :, None] * np.eye(3)[:, None]


def remembering(correlation: float, seed: int) -> Array:
    """(n, 3) of unit variance, fixed in the body, whose neighbours correlate."""
    white = np.random.default_rng([9141, seed]).normal(size=(COUNT, 3))
    found = np.array(white)
    for row in range(1, COUNT):
        found[row] = correlation * found[row - 1] + math.sqrt(1.0 - correlation**2) * white[row]
    return found


def made(errors: Array) -> Scene:
    """The clean craft with errors (n, 3) of the samples, in units of the noise."""
    clean = scene()
    return replace(spoiled(measure(X, clean.calibrated_nt + NOISE_NT * errors), clean), channels={})


def prepared_of(of: Scene) -> Any:
    problem = Problem(of, NOISE_NT)
    return SimpleNamespace(problem=problem, baseline=solve(problem, X), view=view(of), spin=None)


def test_noise_beside_names_that_leave_it_is_judged_beside_the_nine_errors_alone() -> None:
    """Names by chance changed its looks: a slow part, which is no noise's, was put beside it."""
    prepared = prepared_of(made(remembering(0.8, 1)))
    slow = body_form("bias_drift", "slow", *SLOW)
    beside = evaluate(prepared.problem, prepared.baseline.x, (Term(slow, np.zeros(0), np.full(3, 400.0)),))
    assert len(memory_of(prepared, prepared.problem, beside)) == 0
    search = Search(prepared.problem, [])
    end = with_memory(prepared, search, Explained(beside), lambda _: None)
    assert end.whitening[0] == pytest.approx(0.8, abs=0.15)
    assert not end.explained.fit.terms
    assert not significant(end.left[0])


def test_beside_names_that_explain_most_the_nine_errors_alone_are_not_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """A slow part of the residual that names take up may look as noise does without them."""
    prepared = prepared_of(made(remembering(0.0, 2) + 5.0 * SLOW.sum(axis=0)))
    asked: list[Fit] = []
    monkeypatch.setattr(searching, "quieted", lambda *arguments: asked.append(arguments[3]))
    monkeypatch.setattr(searching, "_standing", lambda *arguments: (arguments[2], []))
    for fields, count in ((SLOW, 1), (QUICK, 2)):
        fit = solve(prepared.problem, X, (Term(body_form("bias_drift", "slow", *fields), np.zeros(0), np.zeros(3)),))
        with_memory(prepared, Search(prepared.problem, []), Explained(fit), lambda _: None)
        assert asked == [fit, prepared.baseline][:count]
        asked.clear()


@pytest.mark.parametrize(
    ("is_whitened", "size", "nats"), [(True, 0.1, -4.0), (True, 0.2, 26.0), (False, 0.1, 26.0), (False, 0.2, 26.0)]
)
def test_what_is_faint_counts_beyond_the_memory_that_a_whitening_leaves(
    is_whitened: bool, size: float, nats: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 26 nats for a slow field in 1 / f noise 30 were a course of its own on every axis: the noise itself."""
    monkeypatch.setattr(leftover, "of_every_axis", lambda _blocks: 30.0)
    prepared = prepared_of(made(remembering(0.0, 3)))
    search = replace(Search(prepared.problem, []), whitening=np.full(1, 1e-9) if is_whitened else np.zeros(0))
    squares = (size * prepared.baseline.rms_nt) ** 2 * COUNT
    slow = Structure(Shape("slow 12", "says", lambda unit: unit), 26.0, squares, lambda: np.zeros(COUNT))
    (found,) = [one for one in with_courses(search, prepared.baseline, [slow], 1.0) if one.shape is slow.shape]
    assert found.nats == nats


def test_a_name_beside_one_that_noise_may_be_is_no_surer() -> None:
    """A shift in time and a cubic answer stood at 0.97 beside a lag that a moving average was."""
    named = replace(explained([]), has_memory=True)
    (term,) = named.fit.terms
    lag = replace(term, hypothesis=replace(term.hypothesis, effect="response_lag", by_samples=True))
    twice = replace(named, rivals=named.rivals * 2, nats=named.nats * 2, gains=named.gains * 2)
    other = replace(twice, fit=replace(named.fit, terms=(term, lag)))
    assert posterior(other, 0).own == pytest.approx(0.5)
    plain = replace(twice, fit=replace(named.fit, terms=(term, replace(lag, hypothesis=term.hypothesis))))
    assert posterior(plain, 0).own > 0.9
    recorded = replace(term, hypothesis=replace(term.hypothesis, driver="channel:battery"))
    assert posterior(replace(twice, fit=replace(named.fit, terms=(recorded, lag))), 0).own > 0.9
