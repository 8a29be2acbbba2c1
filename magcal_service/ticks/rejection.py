"""Why a magnetometer sample is rejected, by the names that counters, status and metrics publish."""

from __future__ import annotations

from enum import StrEnum


class Rejection(StrEnum):
    """The reason for which a sample is not used; when each applies is in the table of ``ticks.assembler``."""

    LATE = "late"
    DOUBLED = "doubled"
    STUCK = "stuck"
    AXIS_STUCK = "axis_stuck"
    SATURATED = "saturated"
    TIME_BEHIND = "time_behind"
    TIME_AHEAD = "time_ahead"
    TIME_OUT_OF_RANGE = "time_out_of_range"
    CLOCK_CHANGED = "clock_changed"
    ZERO = "zero"
    CROWDED = "crowded"
