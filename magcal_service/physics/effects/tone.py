"""A line at a fixed frequency: a converter, a wheel, a heater's pulse width, seen directly or aliased."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn, Watched
from magcal_service.physics.columns import Columns, oscillation
from magcal_service.physics.interface import Block, Effect, Hypothesis, Nonlinear, Values, value_of
from magcal_service.physics.scene.scene import Scene


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    if len(scene) < 64 and not scene.is_given:
        return

    def columns(theta: Array) -> Columns:
        return oscillation(scene.time_s, float(theta[0]))

    blocks = (Block("cosine_nt", "nT"), Block("sine_nt", "nT"))
    frequency = Nonlinear("frequency_hz", "Hz", np.empty(0), role="frequency")
    yield Hypothesis("tone", "none", columns, blocks, nonlinear=(frequency,))


def _derived(parameters: Values) -> Values:
    """The line's size: root of the summed squares of its six amplitudes."""
    parts = [parameters["cosine_nt"], parameters["sine_nt"]]
    size = float(np.sqrt(sum(float((part.value**2).sum()) for part in parts)))
    spread = sum(float(((part.value * part.sigma) ** 2).sum()) for part in parts) ** 0.5 / max(size, 1e-12)
    return {"amplitude_nt": value_of(size, spread, "nT")}


EFFECT = Effect(
    name="tone",
    acts_on=ActsOn.FIELD,
    watched=((Watched.LINE, ""),),
    title="a line at a fixed frequency, fixed in the body",
    switched="the suspected converter, wheel or heater",
    is_line=True,
    equation="d = p cos(2 pi f t) + q sin(2 pi f t), f as sampled: |f_true - n f_s|",
    units={"cosine_nt": "nT", "sine_nt": "nT", "frequency_hz": "Hz", "amplitude_nt": "nT"},
    prior=(1.0, 1000.0),
    valid="constant amplitude, frequency and phase over the recording",
    confused_with=("torquer", "sun_disturbance"),
    separated_by="another sampling rate moves an alias and leaves a true line; switching the suspect off",
    source="spectra of platform magnetometers: converters, wheels and heaters, 1-500 nT",
    says=("A line of {amplitude_nt.size} at {frequency_hz.size}, or an alias of a faster one, fixed in the body.",),
    derived=_derived,
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
)
