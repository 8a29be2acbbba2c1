"""What may go wrong without anybody being told: each hazard with the largest size it is held possible at.

``docs/integrity.md`` has the reasons and sources of the sizes.  Fields of the craft's own (``[craft.trust]
disturbance_nt``) are set by the configuration, what ages or is out of place by physics.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Final


class Hazard(StrEnum):
    """Something that acts on the calibrated vector and may be too small to be seen."""

    REFERENCE_LATE = "reference_late"
    REFERENCE_DISPLACED = "reference_displaced"
    REFERENCE_SCALED = "reference_scaled"
    BIAS_STEP = "bias_step"
    BIAS_DRIFT = "bias_drift"
    ORBIT_BIAS = "orbit_bias"
    ORBIT_GAIN = "orbit_gain"
    PANEL_CURRENT = "panel_current"
    GAIN_STEP = "gain_step"


LATE_S: Final = 60.0
"""[s] of the reference's time: clocks apart by a minute; along the track the same as a place 450 km behind."""

DISPLACED_KM: Final = 1.0
"""[km] of height: element sets of a week; along the track more is a reference that is late."""

SCALED: Final = 5e-4
"""Of the reference's magnitude: coefficients a year old."""

STEP_NT: Final = 5000.0
"""[nT] of a step that is older than ``STEP_SEEN_TICKS``: what launch or deployment has magnetised."""

STEP_SEEN_TICKS: Final = 1920
"""Ticks after which a step of any size is allowed for; a newer one up to ``disturbance_nt`` only."""

GAIN_STEP: Final = 0.1
"""Of one axis, older than ``STEP_SEEN_TICKS``: a range that was switched, a bridge that was reset."""

DRIFT_NT_PER_H: Final = 1000.0
"""[nT/h] of each bias: electronics that warm up; ageing is a thousand times slower."""

REMEDY: Final = {
    Hazard.REFERENCE_LATE: "wait for more of the orbit: where the field grows and falls, a late reference shows",
    Hazard.REFERENCE_DISPLACED: "send a reference at the craft's place: a newer element set, or a receiver's position",
    Hazard.REFERENCE_SCALED: "take a newer field model: a wrong scale of the reference cannot be seen by the sensor",
    Hazard.BIAS_STEP: "wait, or turn the craft: a step shows once the field has come from several sides; where no "
    "such step can occur, lower disturbance_nt",
    Hazard.BIAS_DRIFT: "wait for more of the orbit: a drift shows with its square",
    Hazard.ORBIT_BIAS: "wait for a whole orbit with its eclipse, and send the temperature",
    Hazard.ORBIT_GAIN: "wait for a whole orbit with its eclipse, and send the temperature",
    Hazard.PANEL_CURRENT: "wait for the eclipse, or send the panels' currents",
    Hazard.GAIN_STEP: "wait, or turn the craft: a gain shows once the field has come from several sides",
}
"""What would lower the protection level that a hazard sets."""
