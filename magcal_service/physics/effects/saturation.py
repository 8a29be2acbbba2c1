"""An axis that stops, or bends, at the end of its range."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn, Watched
from magcal_service.physics.columns import Columns
from magcal_service.physics.interface import Block, Effect, Finding, Hypothesis, Nonlinear, value_of
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.scene.view import View

_KNEES: Final = np.linspace(0.5, 0.97, 12)


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    for axis, name in enumerate("xyz"):
        values = scene.clean_field_nt[:, axis]
        largest = scene.constant("full_scale_nt", float(np.percentile(np.abs(values), 99.9)))

        def columns(theta: Array, axis: int = axis, values: Array = values, largest: float = largest) -> Columns:
            knee = float(theta[0]) * largest
            beyond = np.maximum(np.abs(values) - knee, 0.0) / max(largest - knee, 1.0)
            body = np.zeros((1, len(values), 3))
            body[0, :, axis] = -np.sign(values) * beyond**2
            return Columns(body=body)

        knee = Nonlinear("knee", "1", _KNEES)
        constants = {"axis": float(axis), "full_scale_nt": largest}
        block = Block("missing_nt", "nT", ())
        yield Hypothesis("saturation", "none", columns, (block,), f"soft knee of {name}", (knee,), constants, odds=1.0)


_FEWEST_CLIPPED: Final = 8
"""Samples at the largest value from which it is a stop; choice: fewer are met by a coarse converter."""

_REACH: Final = 3.0
"""Noise sigmas before a stop at which a sample may be stopped, too: of the samples there those are kept whose noise
points inwards, and what is kept is short by their mean."""

_MOST_NEAR: Final = 0.5
"""Of the samples that are not at a stop, what may be near it: a noise that reaches over half of the range is none, but
what the stop itself has left of a fit to all samples."""

_FLAT_TO_NEXT: Final = 5.0
"""Factor by which the largest value has to repeat more often than any of the five beside it.

A turning field has its largest value on a lattice 1 / (sqrt 2 - 1) = 2.4 times as often as the next; twice that is
clear of it.
"""


def _find(view: View) -> Finding | None:
    """A hard stop: the largest value of an axis repeats far more often than the values beside it.

    It spoils the samples at it, and those that would be near it without their noise.
    """
    field, clean = view.scene.field_nt, view.scene.clean_field_nt
    clipped, near = np.zeros(len(field), dtype=bool), np.zeros(len(field), dtype=bool)
    limit, axis_found = 0.0, 0
    for axis in range(3):
        values = field[:, axis]
        for side in (1.0, -1.0):
            end = side * float((side * values).max())
            at = values == end
            inside = np.abs(values - end)
            levels = np.unique(inside[~at])[:5]
            usual = max([float(np.count_nonzero(inside == level)) for level in levels], default=0.0)
            if np.count_nonzero(at) >= _FEWEST_CLIPPED and np.count_nonzero(at) > _FLAT_TO_NEXT * usual:
                clipped |= at
                near |= side * clean[:, axis] > side * end - _REACH * view.noise_nt
                limit, axis_found = abs(end), axis
    if not clipped.any():
        return None
    if np.count_nonzero(near & ~clipped) > _MOST_NEAR * np.count_nonzero(~clipped):
        near[:] = False
    rows = np.flatnonzero(clipped)
    parameters = {
        "axis": value_of(np.eye(3)[axis_found], np.zeros(3), "1"),
        "limit_nt": value_of(limit, 0.0, "nT"),
        "share_of_samples": value_of(float(clipped.mean()), 0.0, "1"),
    }
    time_s = view.scene.time_s
    window = (float(time_s[rows[0]]), float(time_s[rows[-1]]))
    return Finding(parameters, nats=float(len(rows)), share=1.0, spoiled=clipped | near, time_s=window)


EFFECT = Effect(
    name="saturation",
    acts_on=ActsOn.SAMPLES,
    watched=((Watched.FLAT_TOP, ""),),
    title="an axis stops or bends at the end of its range",
    equation="B_i = +-L beyond L; soft knee: what is missing grows as ((|B_i| - K) / (L - K))^2",
    units={
        "missing_nt": "nT",
        "knee": "1",
        "full_scale_nt": "nT",
        "limit_nt": "nT",
        "share_of_samples": "1",
        "axis": "1",
    },
    prior=(10.0, 30000.0),
    valid="a hard stop loses the sample: it is left out, and so are those within their noise of the stop",
    confused_with=("cubic_response", "stuck_axis"),
    separated_by="the sensor's range in its data sheet; a field of another size",
    source="data sheets of AMR and fluxgate sensors (full scale, linearity near it)",
    says=(
        "An axis stops at {limit_nt.size}: {share_of_samples.percent} of the samples are clipped.",
        "An axis bends near the end of its range, from {knee.percent} of it on: {missing_nt.size} are missing at "
        "the end.",
    ),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
    find=_find,
)
