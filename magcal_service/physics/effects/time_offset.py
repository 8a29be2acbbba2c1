"""Sensor and reference are tagged by clocks with an offset or a drift."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from magcal_service.physics.acting import ActsOn, Watched
from magcal_service.physics.columns import Columns
from magcal_service.physics.drivers.far import NEAR_S, shifted, within
from magcal_service.physics.drivers.whole_vectors import LARGEST_NT, another_time
from magcal_service.physics.interface import Block, Effect, Hypothesis
from magcal_service.physics.scene.scene import Scene

_MOST_DRIFT_PPM = 1e4
"""Drift of a clock at the most [1e-6]: of a resistor and a capacitor in a microcontroller, 1 %; quartz has 100."""

_LARGEST_NT = 5000.0
"""Largest part in a magnitude [nT]: two minutes of the field's steepest course in a low orbit."""

_AHEAD, _BEHIND = "ahead of the attitude", "behind the attitude"
"""Forms where samples and attitude are tagged apart: a vector is that of another attitude, whatever the field does."""


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    yield another_time(scene, "time_offset", _AHEAD, "ahead_s", 1.0, NEAR_S)
    yield another_time(scene, "time_offset", _BEHIND, "behind_s", -1.0, NEAR_S)
    yield from (replace(form, largest_nt=_LARGEST_NT) for form in _of_magnitudes(scene))
    yield from shifted(scene, "time_offset", "by minutes", ("late_s", "late_s_per_h"), with_earth=True)


def _of_magnitudes(scene: Scene) -> Iterator[Hypothesis]:
    """Forms by the course of the reference's magnitude."""
    slope = scene.magnitude_slope
    if float(np.std(slope)) <= 1e-3 and not scene.is_given:
        return
    if scene.moved_s is not None:  # the mean slope between here and there
        slope = slope + 0.5 * scene.magnitude_bend * within(scene.moved_s)
    drifted_s = scene.time_s * 1e-6
    offset, growing = slope[None], (slope * drifted_s)[None]
    block = Block("offset_s", "s", (), most=NEAR_S)
    yield Hypothesis(
        "time_offset", "none", lambda _: Columns(magnitude=offset), (block,), moves_s=lambda a: float(a[0])
    )
    blocks = (block, Block("drift_ppm", "1e-6", (), most=_MOST_DRIFT_PPM))
    both = np.concatenate([offset, growing])
    yield Hypothesis(
        "time_offset",
        "none",
        lambda _: Columns(magnitude=both),
        blocks,
        "with drift",
        moves_s=lambda a: a[0] + a[1] * drifted_s,
    )


EFFECT = Effect(
    name="time_offset",
    acts_on=ActsOn.REFERENCE_TIME,
    not_live=("by minutes", _AHEAD, _BEHIND),
    watched=((Watched.SLOPE, ""),),
    title="time tags of sensor and reference, or attitude, disagree",
    equation="the field at the sensor at its tag t is H_ref(t + offset + drift t); by attitude A(t + offset) H_ref",
    units={
        "offset_s": "s",
        "ahead_s": "s",
        "behind_s": "s",
        "drift_ppm": "1e-6",
        "late_s": "s",
        "late_s_per_h": "s/h",
        "share": "1",
    },
    prior=(10.0, LARGEST_NT),
    valid=(
        "to second order in the offset: below two minutes in low orbit; by minutes, up to 20 of them; by an attitude "
        "within half a radian of turning"
    ),
    confused_with=("position_offset", "thermal_bias", "reference_epoch"),
    separated_by="a GNSS time stamp in both logs; or an arc at another inclination to the Earth's turning",
    source="51 nT per second through IGRF at 300 km (largest d|H|/dt); clocks as in pulsar timing (PINT)",
    says=(
        "The samples match the reference {offset_s:later|earlier} than tagged; the clocks drift apart by "
        "{drift_ppm.signed}.",
        "The samples match the reference {offset_s:later|earlier} than tagged.",
        "The samples match the recorded attitude {ahead_s.size} later than tagged; by as much more as the sensor "
        "answers late, if it does.",
        "The samples match the recorded attitude {behind_s.size} earlier than tagged.",
        "The samples match the reference {late_s:later|earlier} than tagged at the start, changing by "
        "{late_s_per_h.signed}.",
    ),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
)
