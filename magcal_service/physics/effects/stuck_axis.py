"""An axis that repeats one value while the others move: a frozen register, a bus fault."""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.physics.acting import ActsOn
from magcal_service.physics.effects.quantisation import step_of
from magcal_service.physics.interface import Effect, Finding, value_of
from magcal_service.physics.scene.view import View, runs

SHORTEST: Final = 25
"""Samples with one value; the others have to move by twenty noise sigmas meanwhile."""

_COARSE_SHORTEST: Final = 400
"""The same where an axis moves in steps larger than the noise, and stays on one for a while when the field turns."""

_MOTION_SIGMAS: Final = 20.0
"""Noise sigmas by which another axis has to move meanwhile; choice: a tenth of the field at 300 nT of noise."""


def _find(view: View) -> Finding | None:
    field, time_s = view.scene.field_nt, view.scene.time_s
    spoiled = np.zeros(len(field), dtype=bool)
    longest: tuple[int, int, int] = (0, 0, 0)
    for axis in range(3):
        coarse = step_of(field[:, axis]) > view.noise_nt
        shortest = _COARSE_SHORTEST if coarse else SHORTEST
        stops = (field[:, axis].max(), field[:, axis].min())  # what repeats there is clipped, not stuck
        same = np.concatenate([[False], np.diff(field[:, axis]) == 0.0])
        for first, end in runs(same):
            begin = first - 1
            if field[begin, axis] in stops:
                continue
            others = np.delete(field[begin:end], axis, axis=1)
            if end - begin < shortest or float(np.ptp(others, axis=0).max()) < _MOTION_SIGMAS * view.noise_nt:
                continue
            spoiled[begin:end] = True
            if end - begin > longest[1] - longest[0]:
                longest = (begin, end, axis)
    if not spoiled.any():
        return None
    rows = np.flatnonzero(spoiled)
    begin, end, axis = longest
    parameters = {
        "axis": value_of(np.eye(3)[axis], np.zeros(3), "1"),
        "value_nt": value_of(float(field[begin, axis]), 0.0, "nT"),
        "share_of_samples": value_of(float(spoiled.mean()), 0.0, "1"),
        "from_s": value_of(float(time_s[begin]), 0.0, "s"),
        "to_s": value_of(float(time_s[end - 1]), 0.0, "s"),
    }
    window = (float(time_s[rows[0]]), float(time_s[rows[-1]]))
    return Finding(parameters, nats=float(len(rows)), share=1.0, spoiled=spoiled, time_s=window)


EFFECT = Effect(
    name="stuck_axis",
    acts_on=ActsOn.SAMPLES,
    title="an axis repeats one value",
    equation="B_i = const over a stretch while the other axes move",
    units={"axis": "1", "value_nt": "nT", "share_of_samples": "1", "from_s": "s", "to_s": "s"},
    prior=(100.0, 100000.0),
    valid="exact repetition; the stretch is left out of every fit",
    confused_with=("saturation", "quantisation"),
    separated_by="the value: a stop is at the end of the range, a frozen register anywhere",
    source="bus and register faults; found by exact repetition",
    says=(
        "An axis repeats one value while the others move, over {share_of_samples.percent} of the samples; longest is "
        "{axis.place} at {value_nt.signed}, from {from_s} s to {to_s} s.",
    ),
    find=_find,
)
