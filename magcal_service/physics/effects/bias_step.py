"""The bias changes at one instant: a relay, a deployment, a magnetised part."""

from __future__ import annotations

from magcal_service.physics.acting import ActsOn, Watched
from magcal_service.physics.drivers.change import step
from magcal_service.physics.interface import Block, Effect, along_axes

EFFECT = Effect(
    name="bias_step",
    acts_on=ActsOn.FIELD,
    watched=((Watched.BIAS_STEP, ""),),
    title="the bias changes at one instant",
    equation="d = step (t >= at)",
    units={"step_nt": "nT", "at_s": "s"},
    prior=(10.0, 5000.0),
    valid="one instant; the change is over within a sample",
    confused_with=("scale_step", "torquer", "bias_drift"),
    separated_by="the log of relays, deployments and torquer commands at that time",
    source="magnetisation by launch, deployment or torquers: 10-5000 nT (Springmann & Cutler 2012)",
    says=("The bias of {step_nt.place} jumps by {step_nt.signed} at {at_s.size}, the most of the three.",),
    hypotheses=lambda scene: (step(scene, "bias_step", along_axes, Block("step_nt", "nT")),),
)
