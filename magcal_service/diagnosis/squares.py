"""Sums of squares that fits are held against one another by, as noise of the sensor's own."""

from __future__ import annotations

from magcal_service.diagnosis.problem import Fit


def inside_nt2(fit: Fit) -> float:
    """Of what is left in the rows that were fitted [nT^2]."""
    return float(fit.sensor_residual @ fit.sensor_residual)


def held_out_nt2(fit: Fit) -> float:
    """On rows that took no part [nT^2]."""
    return float(fit.sensor_held_out @ fit.sensor_held_out)
