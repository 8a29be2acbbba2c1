"""The gain changes smoothly in time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from magcal_service.physics.acting import ActsOn, Watched
from magcal_service.physics.columns import AFTER_BIAS, gains
from magcal_service.physics.drivers.change import drifts
from magcal_service.physics.drivers.ramps import ramp, relaxing_from
from magcal_service.physics.drivers.temperature import warms_unseen
from magcal_service.physics.interface import Block, Effect, Hypothesis
from magcal_service.physics.scene.scene import Scene


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    for form in _forms(scene):
        yield replace(form, as_well=("thermal_scale",) if warms_unseen(scene) else ())


def _forms(scene: Scene) -> Iterator[Hypothesis]:
    yield from drifts(scene, "scale_drift", lambda s: gains(scene.clean_field_nt, s), Block("per_s", "1/s"))
    for hypothesis in drifts(scene, "scale_drift", lambda s: gains(scene.calibrated_nt, s), Block("per_s", "1/s")):
        yield replace(hypothesis, variant=f"{AFTER_BIAS}, {hypothesis.variant}".strip(", "))
    for course, block in ((ramp, "between"), (relaxing_from, "end")):
        yield course(
            scene, "scale_drift", lambda s: gains(scene.clean_field_nt, s), Block(block, "1"), at_once="scale_step"
        )


EFFECT = Effect(
    name="scale_drift",
    acts_on=ActsOn.FIELD,
    watched=((Watched.SCALE_COURSE, ""),),
    title="the gain drifts",
    equation="D + diag(rate) t, so d = -diag(rate) t B; or in the other courses that a bias takes",
    units={
        "per_s": "1/s",
        "per_s2": "1/s2",
        "end": "1",
        "time_constant_s": "s",
        "between": "1",
        "from_s": "s",
        "to_s": "s",
    },
    prior=(5.0, 5000.0),
    of_one_recording=True,
    valid="smooth over the recording",
    confused_with=("thermal_scale", "bias_drift"),
    separated_by="in orbit a longer recording: warmth comes back, a drift does not",
    or_record=(("temperature", "a record of the temperature"),),
    source="Swarm: -79 ppm per year (Toeffner-Clausen et al. 2016)",
    says=(
        "The gain of {per_s.place} {per_s.falls} by {per_s.size} at first, bending by up to {per_s2.size}.",
        "The gain of {per_s.place} {per_s.falls} by {per_s.size}, the most of the three.",
        "The gain of {end.place} {end.falls} by {end.percent} in all from {from_s.size} on, with a time constant of "
        "{time_constant_s.size}.",
        "The gain of {end.place} {end.falls} by {end.percent} in all, with a time constant of {time_constant_s.size}.",
        "The gain of {between.place} {between.falls} by {between.percent} from {from_s.size} to {to_s.size}, evenly.",
    ),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
)
