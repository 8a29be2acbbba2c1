"""Names of what can be wrong with a recording itself; ``inspect/`` finds them, a descriptor may accept them."""

from __future__ import annotations

from enum import StrEnum


class Code(StrEnum):
    """Kinds of defect."""

    ZERO_ROWS = "zero_rows"
    SENTINEL = "sentinel"
    WRAPPED = "wrapped"
    HELD_READINGS = "held_readings"
    SHARED_TIMES = "shared_times"
    BURSTS = "bursts"
    TIME_UNIT = "time_unit"
    TIME_EPOCH = "time_epoch"
    TIME_ORDER = "time_order"
    POSITION_JUMP = "position_jump"
    POSITION_ZERO = "position_zero"
    POSITION_STILL = "position_still"
    ALTITUDE_UNIT = "altitude_unit"
    ORBIT_HEIGHT = "orbit_height"
    LONGITUDE_SIGN = "longitude_sign"
    SHIFTED_COLUMNS = "shifted_columns"
    AXES = "axes"
    AXES_CHANGED = "axes_changed"
    GYRO_UNIT = "gyro_unit"
    TORQUER_UNIT = "torquer_unit"
    CURRENT_UNIT = "current_unit"
    FIELD_SCALE = "field_scale"
    START_TRANSIENT = "start_transient"
    REFERENCE_REPEATS = "reference_repeats"
    STUCK_AXIS = "stuck_axis"
    SATURATED = "saturated"
