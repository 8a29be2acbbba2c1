"""A bias that follows the sensor's temperature."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from magcal_service.physics.acting import WARMTH, ActsOn, Watched
from magcal_service.physics.columns import along_axes
from magcal_service.physics.drivers.temperature import direct_by_temperature, held_at, inferred, recorded
from magcal_service.physics.interface import Block, Effect, Hypothesis
from magcal_service.physics.scene.scene import Scene

_MOST_PER_K_NT: Final = 300.0
"""Bias per kelvin at most [nT/K]: six times what bridges of consumer grade have (5 to 50 nT/K)."""

_MOST_SWING_NT: Final = 10_000.0
"""Bias between light and shadow at most [nT]: 100 nT/K over 100 K."""


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    yield from recorded(scene, "thermal_bias", along_axes, Block("nt_per_k", "nT/K", most=_MOST_PER_K_NT))
    yield from inferred(scene, "thermal_bias", along_axes, Block("nt_swing", "nT", most=_MOST_SWING_NT))


EFFECT = Effect(
    name="thermal_bias",
    acts_on=ActsOn.FIELD,
    watched=((Watched.BIAS_BY, "temperature"), (Watched.BIAS_BY, WARMTH)),
    title="a bias that follows the sensor's temperature",
    equation="d = k (T - T0); where T is not recorded, dT/dt = (T_eq(lit) - T) / tau",
    units={
        "nt_per_k": "nT/K",
        "nt_swing": "nT",
        "start_nt_swing": "nT",
        "time_constant_s": "s",
        "skin_s": "s",
        "zero_degc": "degC",
    },
    prior=(5.0, 5000.0),
    valid="linear in T over tens of kelvin; T0 is the mean of the recording",
    confused_with=("current_loop", "thermal_scale", "bias_drift", "sun_disturbance"),
    separated_by="eclipse edges sampled every second: a temperature rounds them, a current does not; a heater test",
    source="Belsten et al. 2023 (AERO-VISTA): 5-50 nT/K for AMR; Primdahl 1979: 0.1-1 nT/K for fluxgates",
    says=(
        "The bias of {nt_per_k.place} changes by {nt_per_k.signed} with {driver}, the most of the three.",
        "The bias of {nt_swing.place} swings by {nt_swing.signed} from shadow to light, the most of the three, "
        "following {driver} with a time constant of {time_constant_s.size}.",
        "The bias of {start_nt_swing.place} is {start_nt_swing.signed} off at the start, the most of the three, and "
        "settles with a time constant of {time_constant_s.size}, as a sensor does that warms up or cools down.",
    ),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
    held_at=held_at,
    direct=lambda term: direct_by_temperature(term, "nt_per_k"),
)
