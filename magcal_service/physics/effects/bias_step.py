"""The bias changes at an instant, or at several: a relay, a deployment, a magnetised part, a load on and off."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from magcal_service.physics.acting import ActsOn, Watched
from magcal_service.physics.columns import along_axes
from magcal_service.physics.drivers.change import step
from magcal_service.physics.drivers.instants import several
from magcal_service.physics.interface import Block, Effect, Hypothesis
from magcal_service.physics.scene.scene import Scene

_MOST_NT: Final = 20_000.0
"""A jump of one axis at most [nT]: a magnet of 0.1 A m2, as a large torquer's, 10 cm away along its axis."""


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    jump = step(scene, "bias_step", along_axes, Block("step_nt", "nT", most=_MOST_NT))
    yield replace(jump, if_along=("current_loop",))
    switched, steps = Block("switched_nt", "nT", most=_MOST_NT), Block("steps_nt", "nT", most=_MOST_NT)
    # what a load that nobody recorded by itself draws shows in a record of all loads among what the others do
    yield from several(scene, "bias_step", along_axes, switched, steps, as_well=("current_loop",))


EFFECT = Effect(
    name="bias_step",
    acts_on=ActsOn.FIELD,
    watched=((Watched.BIAS_STEP, ""),),
    title="the bias changes at an instant, or at several",
    two_levels=True,
    equation="d = step (t >= at); sum_j step_j (t >= at_j); switched: on from at_1 to at_2, at_3 to ...",
    units={"step_nt": "nT", "switched_nt": "nT", "steps_nt": "nT", "at_s": "s"},
    prior=(10.0, 5000.0),
    valid="up to six instants; each change is over within a sample",
    confused_with=("scale_step", "torquer", "current_loop", "bias_drift"),
    separated_by="the log of relays, deployments and torquer commands at that time",
    source="magnetisation by launch, deployment or torquers: 10-5000 nT (Springmann & Cutler 2012)",
    says=(
        "The bias of {step_nt.place} jumps by {step_nt.signed} at {at_s.size}, the most of the three.",
        "Something is switched at {at_s.each}: while it is, {switched_nt.place} has {switched_nt:more|less}.",
        "The bias jumps at {at_s.each}, the most by {steps_nt.signed} ({steps_nt.place}).",
    ),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
)
