"""What surrounds the sensor along the orbit: sunlight, the Sun's direction in the body, and its temperature."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
import numpy.typing as npt

from sim_sensor.scenario import Scenario
from sim_sensor.sunlight import lit_fraction, sun_direction_eci

Floats = npt.NDArray[np.float64]

_LIGHT_STEP_S = 5.0  # grid of light and temperature; an eclipse edge moves by at most half of it


class Environment:
    """Answers what a disturbance may ask (``disturbances.Craft``), at elapsed times (n,) [s].

    Parameters
    ----------
    scenario: with nothing left to chance.
    duration_s: length of the run [s]; later times get the last value.
    """

    def __init__(self, scenario: Scenario, duration_s: float) -> None:
        self._scenario, self._duration_s = scenario, duration_s

    def lit(self, elapsed_s: Floats) -> Floats:
        """Lit fraction (n,)."""
        grid_s, lit = self._light
        return np.asarray(np.interp(elapsed_s, grid_s, lit))

    def sun_body(self, elapsed_s: Floats) -> Floats:
        """Direction of the Sun (n, 3), body, unit."""
        times = self._scenario.start_ns + np.rint(elapsed_s * 1e9).astype(np.int64)
        return rotate(self._scenario.spin.body_from_eci(elapsed_s), sun_direction_eci(times))

    def temperature_degc(self, elapsed_s: Floats) -> Floats:
        """Sensor temperature (n,) [degC]."""
        return np.asarray(np.interp(elapsed_s, self._light[0], self._temperatures))

    @cached_property
    def _light(self) -> tuple[Floats, Floats]:
        count = math.ceil(self._duration_s / _LIGHT_STEP_S) + 2
        grid_s = np.asarray(np.arange(count) * _LIGHT_STEP_S, dtype=np.float64)
        times = self._scenario.start_ns + (grid_s * 1e9).astype(np.int64)
        return grid_s, lit_fraction(times, self._scenario.orbit.position_eci_km(times))

    @cached_property
    def _temperatures(self) -> Floats:
        thermal = self._scenario.effects.thermal
        if thermal is None:
            raise ValueError("temperature_degc needs a scenario with [thermal]")
        return thermal.history_degc(self._light[1], _LIGHT_STEP_S)


def rotate(matrices: Floats, vectors: Floats) -> Floats:
    """Each matrix (n, 3, 3) times its vector (n, 3)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])
