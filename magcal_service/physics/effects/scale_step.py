"""The gain changes at one instant: a range switch, a bridge reset, an upset register."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from magcal_service.physics.acting import ActsOn, Watched
from magcal_service.physics.columns import AFTER_BIAS, common_gain, gains
from magcal_service.physics.drivers.change import step
from magcal_service.physics.interface import Block, Effect, Hypothesis
from magcal_service.physics.scene.scene import Scene

_ROOM: Final = "a field that changed itself, as a room's does when iron is moved"
"""What leaves the same in a magnitude where no model of the Earth's field is the reference."""


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    yield step(scene, "scale_step", lambda s: gains(scene.clean_field_nt, s), Block("step", "1"))
    yield step(scene, "scale_step", lambda s: gains(scene.calibrated_nt, s), Block("step", "1"), AFTER_BIAS)
    common = Block("step_common", "1", (), each="step")
    one = step(scene, "scale_step", lambda s: common_gain(scene.clean_field_nt, s), common, "one gain")
    yield one if scene.in_orbit else replace(one, imitated_by=_ROOM)


EFFECT = Effect(
    name="scale_step",
    acts_on=ActsOn.FIELD,
    watched=((Watched.SCALE_STEP, ""),),
    title="the gain changes at one instant",
    equation="D + diag(step) from t >= at, so d = -diag(step) B; or of w where the bias is not amplified",
    units={"step": "1", "step_common": "1", "at_s": "s"},
    prior=(10.0, 5000.0),
    valid="one instant; the change is over within a sample",
    confused_with=("bias_step", "scale_drift"),
    separated_by="a field of another size after the change",
    source="range switches and set/reset straps of AMR bridges: 0.1-100 %",
    says=(
        "The gain of all axes {step_common.falls} by {step_common.percent} at {at_s.size}.",
        "The gain of {step.place} {step.falls} by {step.percent} at {at_s.size}, the most of the three.",
    ),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
)
