"""The sensor responds late: a low-pass, an averaging driver, eddy currents in the structure around it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from magcal_service.physics.acting import ActsOn
from magcal_service.physics.interface import Block, Columns, Effect, Hypothesis, Values, value_of
from magcal_service.physics.scene.scene import Scene


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    if scene.rate_body is None:
        return
    slope = scene.field_slope
    along = np.einsum("ni,ni->n", slope, scene.unit)
    across2 = np.maximum(np.einsum("ni,ni->n", slope, slope) - along**2, 0.0)
    loss = -(0.5 * across2 / np.linalg.norm(scene.calibrated_nt, axis=1))[:, None] * scene.unit
    columns = Columns(body=loss[None])
    yield Hypothesis("response_lag", "none", lambda _: columns, (Block("tau2_s2", "s2", ()),))


def _derived(parameters: Values) -> Values:
    """The time constant, from what is lost across the field, which grows as tau^2."""
    loss = parameters["tau2_s2"]
    tau = float(np.sqrt(max(float(loss.value), 0.0)))
    if tau <= 0.0:
        return {}
    return {"tau_s": value_of(tau, float(loss.sigma) / (2.0 * tau), "s")}


EFFECT = Effect(
    name="response_lag",
    acts_on=ActsOn.FIELD,
    title="the sensor answers late",
    equation="tau dy/dt = A H - y: what turns is short by 1 / sqrt(1 + w^2 tau^2), |B| by tau^2 |dB/dt|^2 / (2 |B|)",
    units={"tau2_s2": "s2", "tau_s": "s"},
    prior=(5.0, 5000.0),
    valid="tau below about a tenth of a turn",
    confused_with=("axis_skew", "scale_drift", "spin_rate"),
    separated_by="another spin rate: at a steady rate it is a gain and an angle, and the nine errors absorb it",
    source="first-order response; Wertz 1978, section 17 (eddy currents)",
    says=("The sensor answers late, with a time constant of {tau_s.size}.",),
    derived=_derived,
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
    absorbed="at a constant spin rate the nine errors take up gain and angle of the lag whole",
)
