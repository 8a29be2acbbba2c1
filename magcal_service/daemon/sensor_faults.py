"""Which rejected samples show a fault of the sensor: the reason of the verdict, and when the fault is over."""

from __future__ import annotations

from typing import Final

from magcal_service.ticks.rejection import Rejection
from magcal_service.trust.reasons import Reason

SENSOR_FAULTS: Final = {
    Rejection.STUCK: (Reason.STUCK, 1),
    Rejection.AXIS_STUCK: (Reason.AXIS_STUCK, 1),
    Rejection.SATURATED: (Reason.SATURATED, 60),
}
"""Rejections that show a fault of the sensor: the reason, and how many accepted samples in a row end it.

A turning craft dips into saturation once a turn: its sensor is sound only when it has not for a while.
"""
