"""Sums of squares that fits are held against one another by, as noise of the sensor's own."""

from __future__ import annotations

import numpy as np

from magcal_service.diagnosis.problem import Fit
from magcal_service.model import Array


def inside_nt2(fit: Fit) -> float:
    """Of what is left in the rows that were fitted [nT^2]."""
    return float(fit.sensor_residual @ fit.sensor_residual)


def held_out_nt2(fit: Fit) -> float:
    """On rows that took no part [nT^2]."""
    return float(fit.sensor_held_out @ fit.sensor_held_out)


def with_noise_of(fit: Fit, other: Fit) -> Array:
    """(m,) what another fit leaves, its noise brought to what a fit makes of the sensor's, sample by sample [nT].

    Where gains of the axes differ, noise rises and falls with the field's direction, and so does a block's square.
    """
    mine, its = (one.problem.noise_gains(one.x, one.unit) for one in (fit, other))
    return np.asarray(other.residual * np.repeat(mine / its, fit.problem.rows_per_sample))
