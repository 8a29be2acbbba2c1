"""Which causes there are."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from types import MappingProxyType

from tests.blind import body, driven, hysteresis, motion, noise, outside, power, reference, response, thermal, torquer
from tests.blind.cause import Builder

EFFECTS: Mapping[str, Builder] = MappingProxyType(
    {
        "thermal_bias": thermal.thermal_bias,
        "thermal_scale": thermal.thermal_scale,
        "current_loop": power.current_loop,
        "torquer": torquer.torquer,
        "time_offset": reference.time_offset,
        "reference_epoch": reference.reference_epoch,
        "external_field": reference.external_field,
        "position_offset": reference.position_offset,
        "bias_step": body.bias_step,
        "scale_step": body.scale_step,
        "bias_drift": body.bias_drift,
        "scale_drift": body.scale_drift,
        "tone": body.tone,
        "cubic_response": response.cubic_response,
        "saturation": response.saturation,
        "quantisation": response.quantisation,
        "sun_disturbance": body.sun_disturbance,
        "response_lag": motion.response_lag,
        "axis_skew": motion.axis_skew,
        "nutation": motion.nutation,
        "spin_rate": motion.spin_rate,
        "coloured_noise": noise.coloured_noise,
        "hysteresis": hysteresis.hysteresis,
        "stuck_axis": response.stuck_axis,
    }
)
"""A builder for every effect of the catalogue (``magcal_service.physics``), by the name it has there."""

OUTSIDE: Mapping[str, Builder] = MappingProxyType(
    {
        "field_product": outside.field_product,
        "telegraph": outside.telegraph,
        "bursts": outside.bursts,
        "pendulum": outside.pendulum,
        "chirp": outside.chirp,
        "patch": outside.patch,
        "walk": outside.walk,
        "thermostat": outside.thermostat,
    }
)
"""Disturbances that have none."""

DRIVEN_OUTSIDE: Mapping[str, Builder] = MappingProxyType(
    {"hopkinson": driven.hopkinson, "two_paths": driven.two_paths},
)
"""Those that follow a recorded channel; drawn by name only, as ``"outside:hopkinson"``."""

SEVERAL: Mapping[str, Builder] = MappingProxyType(
    {"switched": body.switched, "duty": body.duty, "steps": body.steps, "moving_average": motion.moving_average},
)
"""Effects of the catalogue, by kinds of their own: as they are where they happen more than once, or to samples."""

ABSORBED: Mapping[str, Builder] = MappingProxyType(
    {"steady_lag": motion.steady_lag, "steady_skew": motion.steady_skew},
)
"""Effects of the catalogue as they are where nothing of them shows: to be answered ``none``."""

BUILDERS: Mapping[str, Builder] = MappingProxyType({**EFFECTS, **OUTSIDE, **DRIVEN_OUTSIDE, **ABSORBED, **SEVERAL})

DRIVEN = frozenset({"thermal_bias", "thermal_scale", "current_loop", "torquer", "sun_disturbance"})
"""Effects whose driver can be recorded or not."""

NOT_IN_PAIRS = frozenset({"quantisation", "saturation", "nutation", "spin_rate", "coloured_noise", "stuck_axis"})
"""Effects that a pair cannot have: no scalar signature, or one that every other disturbs."""

UNLIKE = frozenset(
    {
        frozenset({"time_offset", "position_offset"}),  # the same along the track
        frozenset({"thermal_bias", "thermal_scale"}),  # would need two thermometers
        frozenset({"response_lag", "axis_skew"}),  # both need the same despin
    }
)
"""Pairs that make no sense together."""

PAIRS: tuple[tuple[str, str], ...] = tuple(
    (first, second)
    for first, second in combinations(sorted(set(EFFECTS) - NOT_IN_PAIRS), 2)
    if frozenset({first, second}) not in UNLIKE
)
"""Pairs of effects that can be found together."""

KINDS: tuple[str, ...] = (*EFFECTS, *SEVERAL, "pair", "none", "absorbed", "outside")
"""What ``draw_case`` takes; also a pair by name, ``"tone+bias_step"``, and ``"outside:walk"``."""
