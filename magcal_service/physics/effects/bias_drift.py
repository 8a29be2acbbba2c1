"""The bias changes smoothly in time: ageing, outgassing, charging."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from magcal_service.physics.acting import ActsOn, Watched
from magcal_service.physics.columns import along_axes
from magcal_service.physics.drivers.change import drifts
from magcal_service.physics.drivers.ramps import ramp, relaxing_from
from magcal_service.physics.drivers.temperature import warms_unseen
from magcal_service.physics.interface import Block, Effect, Hypothesis
from magcal_service.physics.scene.scene import Scene

_MOST_NT: Final = 3000.0
"""Swing of one axis in a recording at the most [nT]: 30 K of a cheap sensor's 100 nT/K, where nobody recorded them."""


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    most = math.inf if scene.is_given else _MOST_NT  # a model of one recording may act in another, which is longer
    span_s = max(float(np.ptp(scene.time_s)), 1.0)
    smooth = drifts(scene, "bias_drift", along_axes, Block("nt_per_s", "nT/s", most=most / span_s))
    between = ramp(scene, "bias_drift", along_axes, Block("nt_between", "nT", most=most), at_once="bias_step")
    end = relaxing_from(scene, "bias_drift", along_axes, Block("nt_end", "nT", most=most), at_once="bias_step")
    for form in (*smooth, between, end):
        yield replace(form, as_well=("thermal_bias",) if warms_unseen(scene) else ())


EFFECT = Effect(
    name="bias_drift",
    acts_on=ActsOn.FIELD,
    watched=((Watched.BIAS_COURSE, ""),),
    title="the bias drifts",
    equation="d = rate t; rate t + curve t^2; or end (1 - exp(-t / tau)), t from the first sample or an instant; "
    "or between (t - from) / (to - from), 0 before and all of it after",
    units={
        "nt_per_s": "nT/s",
        "nt_per_s2": "nT/s2",
        "nt_end": "nT",
        "time_constant_s": "s",
        "nt_between": "nT",
        "from_s": "s",
        "to_s": "s",
    },
    prior=(5.0, 5000.0),
    of_one_recording=True,
    valid="smooth over the recording",
    confused_with=("thermal_bias", "external_field", "bias_step", "scale_drift"),
    separated_by="in orbit a longer recording: warmth comes back, a drift does not",
    or_record=(("temperature", "a record of the temperature"),),
    source="nT to uT per month (Olsen et al. 2020, monthly drift of platform magnetometers)",
    says=(
        "The bias of {nt_per_s.place} drifts by {nt_per_s.signed} at first, bending by up to {nt_per_s2.size}.",
        "The bias of {nt_per_s.place} drifts by {nt_per_s.signed}, the most of the three.",
        "The bias of {nt_end.place} relaxes by {nt_end.signed} from {from_s.size} on, with a time constant of "
        "{time_constant_s.size}.",
        "The bias of {nt_end.place} relaxes by {nt_end.signed} with a time constant of {time_constant_s.size}.",
        "The bias of {nt_between.place} changes by {nt_between.signed} from {from_s.size} to {to_s.size}, evenly.",
    ),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
)
