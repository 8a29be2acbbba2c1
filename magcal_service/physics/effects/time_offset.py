"""Sensor and reference are tagged by clocks with an offset or a drift."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from magcal_service.physics.acting import ActsOn, Watched
from magcal_service.physics.columns import Columns
from magcal_service.physics.drivers.far import shifted
from magcal_service.physics.interface import Block, Effect, Hypothesis
from magcal_service.physics.scene.scene import Scene


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    slope = scene.magnitude_slope
    if float(np.std(slope)) <= 1e-3 and not scene.is_given:
        return
    offset, growing = slope[None], (slope * scene.time_s * 1e-6)[None]
    block = Block("offset_s", "s", ())
    yield Hypothesis("time_offset", "none", lambda _: Columns(magnitude=offset), (block,))
    blocks = (block, Block("drift_ppm", "1e-6", ()))
    both = np.concatenate([offset, growing])
    yield Hypothesis("time_offset", "none", lambda _: Columns(magnitude=both), blocks, "with drift")
    yield from shifted(scene, "time_offset", "by minutes", ("late_s", "late_s_per_h"), with_earth=True)


EFFECT = Effect(
    name="time_offset",
    acts_on=ActsOn.REFERENCE_TIME,
    not_live=("by minutes",),
    watched=((Watched.SLOPE, ""),),
    title="time tags of sensor and reference disagree",
    equation="the field at the sensor at its tag t is H_ref(t + offset + drift t)",
    units={"offset_s": "s", "drift_ppm": "1e-6", "late_s": "s", "late_s_per_h": "s/h", "share": "1"},
    prior=(10.0, 5000.0),
    valid="to first order in the offset: below about a minute in low orbit; by minutes, up to 20 of them",
    confused_with=("position_offset", "thermal_bias", "reference_epoch"),
    separated_by="a GNSS time stamp in both logs; or an arc at another inclination to the Earth's turning",
    source="51 nT per second through IGRF at 300 km (largest d|H|/dt); clocks as in pulsar timing (PINT)",
    says=(
        "The samples match the reference {offset_s.signed} later than tagged; the clocks drift apart by "
        "{drift_ppm.signed}.",
        "The samples match the reference {offset_s.signed} later than tagged.",
        "The samples match the reference {late_s.signed} later than tagged, and later by {late_s_per_h.signed}.",
    ),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
)
