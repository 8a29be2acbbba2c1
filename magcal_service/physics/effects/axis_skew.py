"""Axes digitised one after another."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
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

_LOOP: Final = "a closed loop of metal around {}, whose induced current opposes a change of the field"
"""What delays one axis alone as well, by the time constant of a frame of a panel."""


_BESIDE_X: Final = {AXES[0]: f"{AXES[1]} and {AXES[2]}", AXES[1]: AXES[1], AXES[2]: AXES[2]}
"""Axes whose delay against x is the one of an axis that is apart from the other two, by that axis."""


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    """Each of two axes against x; and one axis apart from the other two, which a loop of metal around it is as well."""
    slope, most = scene.field_slope, min(_LONGEST_S, scene.period_s)

    def against_x(labels: tuple[str, ...]) -> Columns:
        body = np.zeros((len(labels), len(scene), 3))
        for row, number in _delayed(labels):
            body[row, :, number] = slope[:, number]
        return Columns(body=body)

    pair = against_x(AXES[1:])
    yield Hypothesis("axis_skew", "none", lambda _: pair, (Block("after_x_s", "s", (2,), most, labels=(AXES[1:],)),))
    for axis, delayed in _BESIDE_X.items():
        least, highest = (0.0, math.inf) if axis == AXES[0] else (-math.inf, 0.0)
        block = Block("after_x_s", "s", (1,), most, least, highest, ((delayed,),))
        columns = against_x((delayed,))
        yield Hypothesis(
            "axis_skew",
            "none",
            lambda _, made=columns: made,  # type: ignore[misc]
            (block,),
            f"{axis} behind",
            refines="axis_skew",
            imitated_by=_LOOP.format(axis),
        )


def _delayed(labels: Sequence[str]) -> Iterator[tuple[int, int]]:
    """Which axes the delays are of, as (delay, axis)."""
    for row, label in enumerate(labels):
        yield from ((row, number) for number, axis in enumerate(AXES) if axis in label)


def _derived(parameters: Values) -> Values:
    """The delays of all three axes, x taken as the first."""
    after = parameters["after_x_s"]
    value, sigma = np.zeros(3), np.zeros(3)
    for row, number in _delayed(after.labels[0]):
        value[number], sigma[number] = after.value[row], after.sigma[row]
    return {"delay_s": value_of(value, sigma, "s")}


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
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
    absorbed="at a constant spin rate the nine errors take up the delays as D12, D13, D23",
)
