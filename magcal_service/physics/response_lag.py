"""The sensor answers late: a low-pass, an averaging driver, eddy currents in the structure around it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from magcal_service.physics.interface import Block, Columns, Effect, Hypothesis, Values, value_of
from magcal_service.physics.scene import Scene


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    slope = scene.field_slope
    late = -slope
    second = np.einsum("ni,ni->n", slope, slope)
    along = np.einsum("ni,ni->n", slope, scene.unit)
    bend = (second - along**2) / np.linalg.norm(scene.calibrated_nt, axis=1)
    loss = -(bend[:, None] * scene.unit)
    body = np.stack([late, loss])
    blocks = (Block("lag_s", "s", ()), Block("loss_s2", "s2", ()))
    yield Hypothesis("response_lag", "none", lambda _: Columns(body=body), blocks)


def _derived(parameters: Values) -> Values:
    """The time constant, from the loss across the field (tau^2), which a lag of one sign cannot imitate."""
    loss = parameters["loss_s2"]
    tau = float(np.sqrt(max(float(loss.value), 0.0)))
    if tau <= 0.0:
        return {}
    return {"tau_s": value_of(tau, float(loss.sigma) / (2.0 * tau), "s")}


EFFECT = Effect(
    name="response_lag",
    title="the sensor answers late",
    equation="tau dy/dt = AH - y: d = -tau dB/dt, and |d| falls short by tau^2 |dB/dt|^2 / (2 |B|) across the field",
    units={"lag_s": "s", "loss_s2": "s2", "tau_s": "s"},
    prior=(5.0, 5000.0),
    valid="tau below about a tenth of a turn",
    confused_with=("axis_skew", "scale_drift", "spin_rate"),
    separated_by="another spin rate: at a steady rate it is a gain and an angle, and the nine errors absorb it",
    source="first-order response; Wertz 1978, section 17 (eddy currents)",
    says=(
        "The sensor answers late, with a time constant of {tau_s} s.",
        "The sensor answers late, by {lag_s} s.",
    ),
    derived=_derived,
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
    absorbed="at a constant spin rate the nine errors take up gain and angle of the lag whole",
)
