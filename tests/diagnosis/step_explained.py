"""A step of the bias on the clean scene, and how far it is believed among its rivals."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from magcal_service.diagnosis.blocks import Gain as BlockGain
from magcal_service.diagnosis.doubts import reasons
from magcal_service.diagnosis.explain import Explained
from magcal_service.diagnosis.linear import Gain
from magcal_service.diagnosis.problem import Fit, Problem, Term
from magcal_service.diagnosis.screen import Candidate
from magcal_service.diagnosis.solution import solve
from magcal_service.model import measure
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.interface import Hypothesis
from tests.physics.scenes import NOISE_NT, X, scene, spoiled

STEP_NT = np.array([220.0, -140.0, 90.0])
AT_S = 4100.0


def form(name: str) -> Hypothesis:
    """The first form of an effect on the scene."""
    return effect_named(name).hypotheses(scene())[0]


def problem() -> Problem:
    """The scene with a step of the bias."""
    late = (scene().time_s >= AT_S)[:, None]
    noise = NOISE_NT * np.random.default_rng(31).normal(size=(len(scene()), 3))
    return Problem(spoiled(measure(X, scene().calibrated_nt + STEP_NT * late + noise), scene()), NOISE_NT)


@cache
def fits() -> tuple[Fit, Fit]:
    """Nine errors alone, and with the step."""
    alone = solve(problem(), X)
    return alone, solve(problem(), alone.x, [Term(form("bias_step"), np.array([AT_S]), STEP_NT)])


def explained(rivals: Sequence[tuple[str, float]], own: float = 100.0) -> Explained:
    """The step at ``own`` nats, and rivals at theirs."""
    idle = Gain(0.0, 0.0, 0.0, np.zeros(0))
    ranked = [Candidate(form(name), np.zeros(0), idle, nats) for name, nats in [("bias_step", own), *rivals]]
    return Explained(fits()[1], (tuple(ranked),), (own,), (BlockGain(own, 1.0, 10, 10),))


def said(named: Explained, unexplained: float = 0.0, unknown: bool = False) -> tuple[str, ...]:
    """The reasons against it."""
    return reasons(named, unexplained, unknown)
