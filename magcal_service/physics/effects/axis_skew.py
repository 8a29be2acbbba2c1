"""Axes digitised one after another."""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.physics.acting import ActsOn
from magcal_service.physics.columns import Columns
from magcal_service.physics.interface import Block, Effect, Hypothesis, Values, value_of
from magcal_service.physics.saying import AXES
from magcal_service.physics.scene.scene import Scene

_LONGEST_S: Final = 0.4
"""From the first axis to the last, at most [s]: two conversions of the slowest setting of slow parts (0.2 s each at
5 Hz, LIS3MDL and HMC5883 data sheets); and never longer than from one sample to the next."""


def _hypotheses(scene: Scene) -> tuple[Hypothesis, ...]:
    slope = scene.field_slope
    body = np.zeros((2, len(scene), 3))
    body[0, :, 1], body[1, :, 2] = slope[:, 1], slope[:, 2]
    return (
        Hypothesis(
            "axis_skew",
            "none",
            lambda _: Columns(body=body),
            (Block("after_x_s", "s", (2,), most=min(_LONGEST_S, scene.period_s), labels=(AXES[1:],)),),
        ),
    )


def _derived(parameters: Values) -> Values:
    """The delays of all three axes, x taken as the first."""
    after = parameters["after_x_s"]
    return {"delay_s": value_of([0.0, *after.value], [0.0, *after.sigma], "s")}


EFFECT = Effect(
    name="axis_skew",
    acts_on=ActsOn.FIELD,
    needs_rate=True,
    title="axes digitised one after another",
    equation="d_i = delay_i dB_i/dt for y and z against x",
    units={"after_x_s": "s", "delay_s": "s"},
    prior=(1.0, 1000.0),
    valid="delays far below a turn",
    confused_with=("response_lag",),
    separated_by="another spin rate: at a steady rate it is a non-orthogonality, and the nine errors absorb it",
    source="0.1-10 ms between channels of a multiplexed converter",
    says=("The axes are digitised one after another: {after_x_s.place} {after_x_s.signed} after x.",),
    derived=_derived,
    hypotheses=_hypotheses,
    absorbed="at a constant spin rate the nine errors take up the delays as D12, D13, D23",
)
