"""The sensor's noise as a diagnosis says it, draws it and hands it over: one number everywhere."""

from __future__ import annotations

import numpy as np

from magcal_service.diagnosis.problem import Fit
from magcal_service.residuals import white_noise_level


def sensor_noise_nt(fit: Fit, stated_nt: float | None) -> float:
    """White noise of the sensor, 1 sigma per axis [nT]: as stated, else what is white in what a fit leaves.

    Of the fit with the effects: with the nine errors alone it would hold what is fast of them.  It is that of
    calibrated vectors, which residuals are held against.
    """
    if stated_nt is not None:
        return stated_nt
    time_ns, each = fit.problem.scene.time_ns, fit.problem.rows_per_sample
    floors = [white_noise_level(time_ns, column) for column in fit.residual.reshape(len(time_ns), each).T]
    return float(np.sqrt(np.mean(np.square(floors))))
