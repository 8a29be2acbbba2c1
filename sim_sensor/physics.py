"""A ``physics.toml`` added to a scenario: its nine errors, its effects and curves on the scenario's own drivers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from magcal_service.base.errors import ConfigError, Fault
from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.earth import geomagnetic
from magcal_service.model import BIAS, D_ALL, measure
from magcal_service.physics.apply.empirical import NAME
from magcal_service.physics.apply.forward import DriverMissingError, MisfitError, at_origin, bind, described, followed
from magcal_service.physics.apply.model_file import PhysicsModel
from magcal_service.physics.effects import (
    bias_step,
    current_loop,
    external_field,
    position_offset,
    reference_epoch,
    response_lag,
    scale_step,
    sun_disturbance,
    thermal_bias,
    thermal_scale,
    time_offset,
    torquer,
)
from magcal_service.physics.scene.memory import Memory
from magcal_service.physics.scene.scene import Scene, Telemetry
from sim_sensor.scenario import UNITS, Channel, Scenario

Floats = npt.NDArray[np.float64]
Times = npt.NDArray[np.int64]


def with_errors(scenario: Scenario, model: PhysicsModel) -> Scenario:
    """The scenario with the model's nine errors."""
    bx, by, bz = model.x[BIAS].tolist()
    d11, d22, d33, d12, d13, d23 = model.x[D_ALL].tolist()
    return replace(scenario, sensor=replace(scenario.sensor, bias_nt=(bx, by, bz), D=(d11, d22, d33, d12, d13, d23)))


def own_effects(scenario: Scenario) -> dict[str, str]:
    """What a scenario does by itself, as names of the catalogue, with the keys that switch it off."""
    effects, sensor, field = scenario.effects, scenario.sensor, scenario.field
    thermal, steps = effects.thermal, effects.steps
    panels = any(any(panel.field_nt_per_a) for panel in effects.panels)
    placed = (field.reference_along_track_km, field.reference_radial_km)
    found = {
        thermal_bias.EFFECT.name: ("thermal.bias_nt_per_k", thermal is not None and any(thermal.bias_nt_per_k)),
        thermal_scale.EFFECT.name: ("thermal.scale_per_k", thermal is not None and any(thermal.scale_per_k)),
        current_loop.EFFECT.name: ("[[panel]] field_nt_per_a", panels),
        sun_disturbance.EFFECT.name: ("[[panel]] field_nt_per_a", panels),
        torquer.EFFECT.name: ("[torquer]", effects.torquer is not None),
        bias_step.EFFECT.name: ("[[step]] bias_nt", any(any(step.bias_nt) for step in steps)),
        scale_step.EFFECT.name: ("[[step]] D", any(any(step.D) for step in steps)),
        response_lag.EFFECT.name: ("magnetometer.lag_s", sensor.lag_s > 0.0),
        external_field.EFFECT.name: ("field.ring_current_nt", field.ring_current_nt != 0.0),
        time_offset.EFFECT.name: ("field.reference_time_offset_s", field.reference_time_offset_s != 0.0),
        position_offset.EFFECT.name: ("field.reference_along_track_km and reference_radial_km", any(placed)),
        reference_epoch.EFFECT.name: ("field.reference_epoch", field.reference_epoch_ns is not None),
    }
    return {effect: keys for effect, (keys, acts) in found.items() if acts}


def doubled(scenario: Scenario, model: PhysicsModel) -> dict[str, str]:
    """Effects of a model that a scenario has by itself already, with the keys that switch its own off: both act."""
    own = own_effects(scenario)
    return {term.effect: own[term.effect] for term in model.terms if term.effect in own}


class AddedPhysics:
    """Effects and curves of a model along one run, block after block.

    Parameters
    ----------
    model: from ``physics.toml``.
    channels: names of the scenario's telemetry, for what is refused.
    """

    def __init__(self, model: PhysicsModel, channels: tuple[Channel, ...]) -> None:
        self.model = model
        self._channels = channels
        self._memories = [Memory() for _ in model.terms]
        self._last_ns: int | None = None

    def overlapping(self, times_ns: Times) -> Times:
        """The times of a block with the last time of the block before in front: an effect with a past goes on there."""
        return times_ns if self._last_ns is None else np.concatenate([[self._last_ns], times_ns]).astype(np.int64)

    def on(self, scene: Scene, rows: int) -> tuple[Floats, Floats]:
        """Body field (n, 3) and growth of the magnitude (n,) [nT] on the last ``rows`` of a scene.

        Raises ConfigError where the scenario lacks what drives an effect.
        """
        body, growth = np.zeros((rows, 3)), np.zeros(rows)
        placed = at_origin(scene, self.model)
        for term, memory in zip(self.model.terms, self._memories, strict=True):
            try:
                field, magnitude = bind(term, placed, memory).disturbance()
            except DriverMissingError:
                raise self._undriven(f"physics: {term.effect}.driver", described(term)) from None
            except MisfitError as error:
                raise ConfigError([Fault(f"physics: {term.effect}", str(error), "numbers that fit the form")]) from None
            body += field[-rows:]
            growth += np.broadcast_to(magnitude, len(scene))[-rows:]
        for curve in self.model.empirical:
            try:
                field, magnitude = curve.disturbance(followed(curve, placed), placed.clean_field_nt)
            except DriverMissingError:
                raise self._undriven(f"physics: {NAME}.driver", curve.driver) from None
            body += field[-rows:]
            growth += magnitude[-rows:]
        self._last_ns = int(scene.time_ns[-1])
        return body, growth

    def _undriven(self, where: str, driver: str) -> ConfigError:
        known = ", ".join(channel.value for channel in self._channels) or "none"
        accepted = f"the scenario has nothing that drives it; its telemetry: {known}; position is needed for light"
        return ConfigError([Fault(where, driver, accepted)])


def scene_of(
    model: PhysicsModel,
    times_ns: Times,
    reference_eci_nt: Floats,
    body_from_eci: Floats,
    position_eci_km: Floats,
    channels: dict[Channel, Floats],
) -> Scene:
    """What the catalogue sees of a block: the field without noise, and drivers without theirs."""
    ambient = (body_from_eci @ reference_eci_nt[..., None])[..., 0]
    clean = measure(model.x, ambient)
    units = {channel: CHANNEL_UNITS[UNITS[channel]].quantity for channel in channels}
    return Scene(
        time_s=(times_ns - times_ns[0]) * 1e-9,
        origin_ns=int(times_ns[0]),
        utc=True,
        field_nt=clean,
        calibrated_nt=ambient,
        clean_field_nt=clean,
        magnitude_nt=np.linalg.norm(reference_eci_nt, axis=1),
        reference_eci_nt=reference_eci_nt,
        position_ecef_km=geomagnetic.ecef_from_eci(times_ns, position_eci_km),
        channels={c.value: Telemetry(c.value, units[c], values) for c, values in channels.items()},
        body_from_eci=body_from_eci,
    )
