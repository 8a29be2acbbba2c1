"""Courses that errors take in time: a step at an instant, and smooth drifts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.columns import Columns, joined
from magcal_service.physics.drivers.temperature import Act
from magcal_service.physics.interface import Block, Hypothesis, Nonlinear
from magcal_service.physics.scene.scene import Scene

_INSTANTS: Final = 96
"""Change times tried first; choice: one percent of the recording apart, the best is refined; more cost a gain each."""

RELAXATION_SHARES: Final = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
"""Time constants of a relaxation, as shares of the recording: shorter is a step, longer a parabola."""


def instants(scene: Scene) -> Nonlinear:
    """The change times that are tried first: even in samples, and the start of every stretch after a gap."""
    rows = np.linspace(0, len(scene) - 1, _INSTANTS + 2)[1:-1].astype(np.intp)
    middle = 0.5 * (scene.time_s[rows] + scene.time_s[np.maximum(rows - 1, 0)])
    pauses = scene.time_s[scene.pauses[1:]] - 0.5 * scene.period_s
    return Nonlinear("at_s", "s", np.unique(np.concatenate([middle, pauses[:64]])), role="instant")


def step(scene: Scene, effect: str, act: Act, block: Block, variant: str = "") -> Hypothesis:
    """Nothing before an instant, a constant from then on."""

    def columns(theta: Array) -> Columns:
        return act((scene.time_s >= float(theta[0])).astype(np.float64))

    return Hypothesis(effect, "none", columns, (block,), variant, (instants(scene),))


def drifts(scene: Scene, effect: str, act: Act, block: Block) -> Iterator[Hypothesis]:
    """Linear, quadratic, and relaxing towards an end value, all zero at the origin of time.

    ``block``: of the linear one, its most being a swing over the span; a parabola swings as much by four times that.
    """
    elapsed = scene.time_s
    span = max(float(elapsed[-1]), 1.0)
    linear = act(elapsed)
    yield Hypothesis(effect, "none", lambda _: linear, (block,))
    most = 4.0 * block.most
    curve = Block(block.name.replace("per_s", "per_s2"), f"{block.unit}2", block.shape, most / span)
    both = joined(linear, act(elapsed**2))
    yield Hypothesis(effect, "none", lambda _: both, (replace(block, most=most), curve), "quadratic")
    tau = Nonlinear("time_constant_s", "s", span * np.array(RELAXATION_SHARES))
    end = Block(
        f"{block.name.removesuffix('_per_s').removesuffix('per_s')}_end".lstrip("_"),
        block.unit[:-2],
        block.shape,
        block.most * span,
    )

    def relaxing(theta: Array) -> Columns:
        return act(-np.expm1(-np.maximum(elapsed, 0.0) / float(theta[0])))

    yield Hypothesis(effect, "none", relaxing, (end,), "relaxing", (tau,))
