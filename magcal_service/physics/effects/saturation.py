"""An axis that stops, or bends, at the end of its range."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn, Watched
from magcal_service.physics.columns import Columns
from magcal_service.physics.interface import Block, Effect, Finding, Hypothesis, Nonlinear, value_of
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.scene.view import View
from magcal_service.samples.stops import stops

_STATED_NATS: Final = 30.0
"""What a stated range is worth: a reading at it is no guess, were it one.  More than ``odds`` counts (10^12 to 1)."""

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

        knee = Nonlinear("knee", "1", _KNEES, spans=True)
        constants = {"axis": float(axis), "full_scale_nt": largest}
        block = Block("missing_nt", "nT", (), least=0.0)
        yield Hypothesis("saturation", "none", columns, (block,), f"soft knee of {name}", (knee,), constants, odds=1.0)


def _find(view: View) -> Finding | None:
    """Hard stops: they spoil the samples at them, and those that would be near them without their noise."""
    found = stops(view.scene.field_nt, view.scene.magnitude_nt, view.range_nt)
    if not found:
        return None
    clipped = np.any([one.rows for one in found], axis=0)
    rows = np.flatnonzero(clipped)
    axes = [one.axis for one in found]
    limits = value_of([one.at_nt for one in found], np.zeros(len(found)), "nT")
    parameters = {
        "axis": value_of(np.isin(range(3), axes).astype(np.float64), np.zeros(3), "1"),
        "limit_nt": replace(limits, labels=(tuple("xyz"[axis] for axis in axes),)),
        "share_of_samples": value_of(float(clipped.mean()), 0.0, "1"),
    }
    time_s = view.scene.time_s
    window = (float(time_s[rows[0]]), float(time_s[rows[-1]]))
    spoiled = np.any([one.spoiled for one in found], axis=0)
    nats = float(len(rows)) + (_STATED_NATS if any(abs(one.at_nt) == view.range_nt for one in found) else 0.0)
    return Finding(parameters, nats=nats, share=1.0, spoiled=spoiled, time_s=window)


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
        "Readings stop at {limit_nt.placed}, the end of the range: {share_of_samples.percent} of the samples are "
        "clipped.",
        "An axis bends near the end of its range, from {knee.percent} of it on: {missing_nt.size} are missing at "
        "the end.",
    ),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
    find=_find,
)
