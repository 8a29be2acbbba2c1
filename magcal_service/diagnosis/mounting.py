"""How the sensor is mounted: its turn against the body, where whole vectors were compared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from magcal_service.diagnosis.problem import Fit
from magcal_service.model import STATE_SIZE, Array


@dataclass(frozen=True, slots=True, eq=False)
class Mounting:
    """The sensor's axes against the body's.

    Parameters
    ----------
    sensor_from_body: (3, 3) turns vectors of the body into the sensor's axes.
    sigma_deg: (3,) 1 sigma of a small further turn about each of the sensor's axes [deg].
    """

    sensor_from_body: Array
    sigma_deg: Array

    @property
    def angle_deg(self) -> float:
        """Angle of the turn [deg]."""
        return float(np.degrees(np.arccos(np.clip((np.trace(self.sensor_from_body) - 1.0) / 2.0, -1.0, 1.0))))

    def as_json(self) -> dict[str, Any]:
        """The object of ``diagnosis.json``."""
        return {
            "sensor_from_body": self.sensor_from_body.tolist(),
            "angle_deg": self.angle_deg,
            "sigma_deg": self.sigma_deg.tolist(),
        }


def mounting_of(fit: Fit) -> Mounting | None:
    """The mounting that a fit has found; None where it compared no whole vectors."""
    aimed = fit.problem.aimed
    if aimed is None:
        return None
    turn = slice(STATE_SIZE, STATE_SIZE + 3)
    sigma = np.sqrt(np.maximum(np.diagonal(fit.covariance)[turn], 0.0))
    return Mounting(aimed.sensor_from_body(fit.x[turn]), np.degrees(sigma))
