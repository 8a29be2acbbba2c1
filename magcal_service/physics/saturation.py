"""An axis that stops, or bends, at the end of its range."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.interface import Block, Columns, Effect, Hypothesis, Nonlinear
from magcal_service.physics.scene import Scene

_KNEES: Final = np.linspace(0.5, 0.97, 12)


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    for axis, name in enumerate("xyz"):
        values = scene.field_nt[:, axis]
        largest = float(np.percentile(np.abs(values), 99.9))

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


EFFECT = Effect(
    name="saturation",
    title="an axis stops or bends at the end of its range",
    equation="B_i = +-L beyond L; soft knee: what is missing grows as ((|B_i| - K) / (L - K))^2",
    units={"missing_nt": "nT", "knee": "1", "limit_nt": "nT", "share_of_samples": "1"},
    prior=(10.0, 30000.0),
    valid="a hard stop loses the sample: clipped samples are left out of every fit, not repaired",
    confused_with=("cubic_response", "stuck_axis"),
    separated_by="the sensor's range in its data sheet; a field of another size",
    source="data sheets of AMR and fluxgate sensors (full scale, linearity near it)",
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
)
