"""Made-up hypotheses on the clean craft, and a search among them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from magcal_service.diagnosis.explain import Search
from magcal_service.diagnosis.problem import Fit, Problem
from magcal_service.diagnosis.screen import Candidate, hypotheses_of
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array, measure
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.columns import Columns
from magcal_service.physics.interface import Block, Effect, Hypothesis
from magcal_service.physics.scene.scene import Scene
from tests.physics.scenes import COUNT, NOISE_NT, X, scene, spoiled

FLOOR_NT = 0.3 * NOISE_NT
TIME_S = scene().time_s
SLOW, QUICK, OTHER = np.sin(TIME_S / 700.0), np.sin(TIME_S / 260.0), np.cos(TIME_S / 410.0)


def flown(disturbance_nt: Array, grown_nt: Array | float = 0.0) -> Scene:
    """The clean craft at its usual noise with a body field (n, 3) and a growth of the magnitude (n,)."""
    noise = np.random.default_rng(21).normal(0.0, NOISE_NT, (COUNT, 3))
    clean = scene()
    noisy = spoiled(measure(X, clean.calibrated_nt + disturbance_nt + noise), clean)
    return replace(noisy, channels={}, magnitude_nt=clean.magnitude_nt - grown_nt)


def along(axis: int, signal: Array) -> Array:
    """A signal (n,) along one axis of the body (n, 3)."""
    return np.outer(signal, np.eye(3)[axis])


def body_form(effect: str, variant: str, *fields: Array, **changes: object) -> Hypothesis:
    """A form whose every amplitude adds one of the fields (n, 3)."""
    columns = Columns(body=np.stack(fields))
    return Hypothesis(
        effect,
        "none",
        lambda _: columns,
        (Block("nt", "nT", (len(fields),)),),
        variant,
        **changes,  # type: ignore[arg-type]
    )


def grown_form(*signals: Array, **changes: object) -> Hypothesis:
    """A form whose every amplitude adds one of the signals (n,) to the magnitude."""
    columns = Columns(magnitude=np.stack(signals))
    return Hypothesis("grown", "none", lambda _: columns, (Block("nt", "nT", (len(signals),)),), **changes)  # type: ignore[arg-type]


def made_up(name: str, *forms: Hypothesis) -> Effect:
    """An effect with these forms, on scenes as long as this craft's recording only."""
    own = replace(effect_named("bias_drift"), name=name, find=None)
    return replace(own, hypotheses=lambda of: forms if len(of) == COUNT else ())


def searching(of: Scene, *forms: Hypothesis, largest_nt: float = math.inf) -> tuple[Search, Fit]:
    """A search among forms, and the nine errors' fit."""
    problem = Problem(of, NOISE_NT, largest_nt={form.effect: largest_nt for form in forms})
    names = dict.fromkeys(form.effect for form in forms)
    effects = [made_up(name, *(form for form in forms if form.effect == name)) for name in names]
    return Search(problem, hypotheses_of(effects, problem), effects), solve(problem, X)


def screened(search: Search, fit: Fit) -> list[Candidate]:
    """Every hypothesis at its best, at the noise as it is."""
    return search.screen(search.workspace(fit), fit, NOISE_NT)
