"""The magnetometer: equation (1) with every disturbance that a scenario switches on.

B = (I + D)^-1 (A H + b + d + eps),   eps ~ N(0, diag(noise^2)),   then clipped, then rounded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from magcal_service.base.typed_toml.keys import number, section, sections
from magcal_service.wire.messages import Vector
from sim_sensor.declarations import Six, per_axis, six, vector
from sim_sensor.disturbances import Craft, Panel, Step, Thermal, Torquer

Floats = npt.NDArray[np.float64]
FieldAt = Callable[[Floats], Floats]
"""Body field (n, 3) [nT] at elapsed times (n,) [s]."""

_LAG_NODES = 32
"""Of the quadrature: gain and phase are then right to 1e-4 up to a lag of one radian of turn."""

_LEAST_WEIGHT = 1e-12  # the weights sum to 1, so nodes left out are worth less than 32e-12 of the field: 2e-6 nT


@dataclass(frozen=True)
class Effects:
    """Disturbances of a scenario; all absent by default."""

    thermal: Thermal | None = section(Thermal, None)
    panels: tuple[Panel, ...] = sections(Panel, name="panel")
    torquer: Torquer | None = section(Torquer, None)
    steps: tuple[Step, ...] = sections(Step, name="step")


@dataclass(frozen=True)
class Sensor:
    """A three-axis magnetometer.

    Parameters
    ----------
    rate_hz: samples per second, 0.02 to 50.
    bias_nt, D: the nine errors; D as D11 D22 D33 D12 D13 D23 [-].
    noise_nt: 1 sigma per axis of the corrected field [nT], white.
    lag_s: time constant of a first-order response to the ambient field [s], 0 for none.
    lsb_nt: step of the digital output [nT], 0 for none.
    full_scale_nt: output is clipped at plus and minus this [nT], 0 for none.
    """

    rate_hz: float = number(1.0, 0.02, 50.0, unit="Hz", file_only=True)
    bias_nt: Vector = vector(5e5, unit="nT", file_only=True)
    D: Six = six(file_only=True)
    noise_nt: Vector = per_axis(1e5, unit="nT", file_only=True)
    lag_s: float = number(0.0, 0.0, 10.0, unit="s")
    lsb_nt: float = number(0.0, 0.0, 1e5, unit="nT")
    full_scale_nt: float = number(0.0, 0.0, 1e6, unit="nT")


def symmetric(D: Six | Floats) -> Floats:
    """Matrices (..., 3, 3) of D11 D22 D33 D12 D13 D23 (..., 6)."""
    values = np.asarray(D, dtype=np.float64)
    return values[..., [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(*values.shape[:-1], 3, 3)


def lagged(field_body_nt: FieldAt, elapsed_s: Floats, lag_s: float) -> Floats:
    """Response (n, 3) of a first-order sensor to a body field that is known at any time.

    y(t) = integral of exp(-s / tau) / tau * x(t - s) ds over s > 0, by Gauss-Laguerre quadrature of 32 nodes: gain
    and phase are right to 1e-4 up to w tau = 1 (a spin of 1 rad/s with a lag of 1 s).  Starts in its steady state.
    """
    if lag_s == 0.0:
        return field_body_nt(elapsed_s)
    nodes, weights = np.polynomial.laguerre.laggauss(_LAG_NODES)
    response = np.zeros((len(elapsed_s), 3))
    for node, weight in zip(nodes.tolist(), weights.tolist(), strict=True):
        if weight > _LEAST_WEIGHT:
            response += weight * field_body_nt(elapsed_s - lag_s * node)
    return response


def errors_at(sensor: Sensor, steps: tuple[Step, ...], elapsed_s: Floats) -> tuple[Floats, Floats]:
    """True b (n, 3) [nT] and D (n, 6) [-] at elapsed times (n,), with every step that has happened."""
    bias = np.tile(np.array(sensor.bias_nt), (len(elapsed_s), 1))
    D = np.tile(np.array(sensor.D), (len(elapsed_s), 1))
    for step in steps:
        since = (elapsed_s >= step.at_s)[:, None]
        bias += since * np.array(step.bias_nt)
        D += since * np.array(step.D)
    return bias, D


def disturbance_nt(effects: Effects, craft: Craft, elapsed_s: Floats) -> Floats:
    """Additive body field d (n, 3) [nT] of all effects."""
    field = np.zeros((len(elapsed_s), 3))
    if effects.thermal is not None:
        excess_k = craft.temperature_degc(elapsed_s) - effects.thermal.zero_degc
        field += np.outer(excess_k, effects.thermal.bias_nt_per_k)
    if effects.panels:
        sun_body, lit = craft.sun_body(elapsed_s), craft.lit(elapsed_s)
        for panel in effects.panels:
            field += np.outer(panel.current_a(sun_body, lit), panel.field_nt_per_a)
    if effects.torquer is not None:
        field += effects.torquer.field_nt(elapsed_s)
    return field


def measured_nt(
    sensor: Sensor,
    effects: Effects,
    craft: Craft,
    elapsed_s: Floats,
    ambient_body_nt: Floats,
    noise_nt: Floats,
    added_nt: Floats | float = 0.0,
) -> Floats:
    """The sensor's output B (n, 3) [nT].

    Parameters
    ----------
    elapsed_s: times of the samples (n,) [s].
    ambient_body_nt: A H after the response lag (n, 3) [nT].
    noise_nt: eps (n, 3) [nT].
    added_nt: d (n, 3) [nT] beside that of ``effects``.
    """
    bias, D = errors_at(sensor, effects.steps, elapsed_s)
    if effects.thermal is not None:
        excess_k = craft.temperature_degc(elapsed_s) - effects.thermal.zero_degc
        D[:, :3] += np.outer(excess_k, effects.thermal.scale_per_k)
    right = ambient_body_nt + bias + disturbance_nt(effects, craft, elapsed_s) + added_nt + noise_nt
    output = np.linalg.solve(np.eye(3) + symmetric(D), right[..., None])[..., 0]
    if sensor.full_scale_nt > 0.0:
        output = np.clip(output, -sensor.full_scale_nt, sensor.full_scale_nt)
    if sensor.lsb_nt > 0.0:
        output = np.rint(output / sensor.lsb_nt) * sensor.lsb_nt
    return np.asarray(output, dtype=np.float64)
