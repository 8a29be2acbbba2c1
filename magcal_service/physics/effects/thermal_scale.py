"""A gain that follows the sensor's temperature."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from magcal_service.model import Array
from magcal_service.physics.acting import WARMTH, ActsOn, Watched
from magcal_service.physics.columns import AFTER_BIAS, Columns, common_gain, gains
from magcal_service.physics.drivers.temperature import direct_by_temperature, held_at, inferred, recorded
from magcal_service.physics.interface import Block, Effect, Hypothesis
from magcal_service.physics.scene.scene import Scene

_MOST_PER_K: Final = 0.01
"""Gain per kelvin at most: three times the -0.3 %/K of a bridge driven by a constant voltage (Honeywell HMC1001)."""

_MOST_SWING: Final = 0.35
"""Gain between light and shadow at most: 0.3 %/K over 115 K, which no board inside a craft sees."""


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    def each(signal: Array) -> Columns:
        return gains(scene.clean_field_nt, signal)

    def common(signal: Array) -> Columns:
        return common_gain(scene.clean_field_nt, signal)

    def after(signal: Array) -> Columns:
        return gains(scene.calibrated_nt, signal)

    yield from recorded(scene, "thermal_scale", each, Block("per_k", "1/K", most=_MOST_PER_K))
    for hypothesis in recorded(
        scene, "thermal_scale", common, Block("per_k_common", "1/K", (), _MOST_PER_K, each="per_k")
    ):
        yield replace(hypothesis, variant=f"one gain, {hypothesis.variant}".removesuffix(", "))
    yield from inferred(scene, "thermal_scale", each, Block("swing", "1", most=_MOST_SWING))
    one = Block("swing_common", "1", (), _MOST_SWING, each="swing")
    for hypothesis in inferred(scene, "thermal_scale", common, one, settles=False):  # no drift has one gain for all
        yield replace(hypothesis, variant=f"one gain, {hypothesis.variant}")
    for hypothesis in recorded(scene, "thermal_scale", after, Block("per_k", "1/K", most=_MOST_PER_K)):
        yield replace(hypothesis, variant=f"{AFTER_BIAS}, {hypothesis.variant}".removesuffix(", "))
    for hypothesis in inferred(scene, "thermal_scale", after, Block("swing", "1", most=_MOST_SWING)):
        yield replace(hypothesis, variant=f"{AFTER_BIAS}, {hypothesis.variant}")


EFFECT = Effect(
    name="thermal_scale",
    acts_on=ActsOn.FIELD,
    watched=((Watched.SCALE_BY, "temperature"), (Watched.SCALE_BY, WARMTH)),
    title="a gain that follows the sensor's temperature",
    equation="D(T) = D + diag(a) (T - T0), so d = -diag(a) (T - T0) B; or of w behind a bias that is not amplified",
    units={
        "per_k": "1/K",
        "per_k_common": "1/K",
        "swing": "1",
        "start_swing": "1",
        "swing_common": "1",
        "start_swing_common": "1",
        "time_constant_s": "s",
        "skin_s": "s",
        "zero_degc": "degC",
    },
    prior=(5.0, 5000.0),
    valid="linear in T over tens of kelvin; T0 is the mean of the recording",
    confused_with=("thermal_bias", "current_loop", "scale_drift"),
    separated_by="a field of another size at the same temperature: another phase of the orbit, or another spin axis",
    source="Honeywell HMC1001 data sheet: about -0.3 %/K open loop; Toeffner-Clausen et al. 2016: 1e-6/K for Swarm",
    says=(
        "The gain of all axes {per_k_common.falls} by {per_k_common.size} with {driver}.",
        "The gain of {per_k.place} {per_k.falls} by {per_k.size} with {driver}, the most of the three.",
        "The gain of all axes {swing_common.falls} by {swing_common.percent} from shadow to light, following "
        "{driver} with a time constant of {time_constant_s.size}.",
        "The gain of {swing.place} {swing.falls} by {swing.percent} from shadow to light, the most of the three, "
        "following {driver} with a time constant of {time_constant_s.size}.",
        "The gain of {start_swing.place} is {start_swing.percent} off at the start, the most of the three, and settles "
        "with a time constant of {time_constant_s.size}, as a sensor does that warms up or cools down.",
    ),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
    held_at=held_at,
    direct=lambda term: direct_by_temperature(term, "per_k", is_gain=True),
)
