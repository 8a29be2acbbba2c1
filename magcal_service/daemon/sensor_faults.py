"""What a refused sample tells of the sensor: the reason of the verdict, and when the fault is over."""

from __future__ import annotations

from typing import Final

from magcal_service.trust.reasons import Reason

SENSOR_FAULTS: Final = {
    "stuck": (Reason.STUCK, 1),
    "axis_stuck": (Reason.AXIS_STUCK, 1),
    "saturated": (Reason.SATURATED, 60),
}
"""Refusals that tell of a fault of the sensor: the reason, and how many accepted samples in a row end it.

A turning craft dips into saturation once a turn: its sensor is sound only when it has not for a while.
"""
