"""Simulated ticks for the estimators' tests: a spin in a field that turns as in a low orbit, and equation (1)."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from magcal_service.model import measure
from magcal_service.ticks.assembler import Tick

TABLE_1 = np.array([5000.0, 3000.0, 4000.0, 0.05, 0.10, 0.05, 0.05, 0.05, 0.05])


def tilted_dipole_eci(times_s: np.ndarray) -> np.ndarray:
    """A centred dipole tilted by 10 degrees along a circular orbit of 612 km and 74 degrees (n, 3) [nT], ECI."""
    radius, rate, inclination = 1.096, 2.0 * math.pi / 5810.0, math.radians(74.0)
    phase = rate * times_s
    position = np.stack(
        [np.cos(phase), np.sin(phase) * math.cos(inclination), np.sin(phase) * math.sin(inclination)], axis=1
    )
    turn = 7.292e-5 * times_s
    tilt = math.radians(10.0)
    axis = np.stack(
        [math.sin(tilt) * np.cos(turn), math.sin(tilt) * np.sin(turn), np.full_like(turn, math.cos(tilt))], axis=1
    )
    along = np.einsum("ni,ni->n", axis, position)[:, None]
    return -29_500.0 / radius**3 * (3.0 * along * position - axis)


def triad(axis: np.ndarray) -> np.ndarray:
    """Rows: two vectors across a unit vector, and the vector itself (3, 3)."""
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis])


@dataclass
class Craft:
    """A spinning craft with a magnetometer; ``ticks`` plays it second by second.

    Parameters
    ----------
    spin_eci, spin_body: direction of the spin axis, inertial and in the body.
    rate_rpm, rate_hz: spin rate and sample rate.
    """

    seed: int
    x: np.ndarray = field(default_factory=lambda: TABLE_1)
    noise_nt: float = 300.0
    rate_rpm: float = 7.5
    rate_hz: int = 1
    spin_eci: tuple[float, float, float] = (1.0, 1.0, 1.0)
    spin_body: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def arrays(self, seconds: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Times (n,) [s], measured vectors (n, 3) [nT], reference (n, 3) [nT], ECI."""
        rng = np.random.default_rng(self.seed)
        times = np.arange(seconds * self.rate_hz) / self.rate_hz
        reference = tilted_dipole_eci(times)
        inertial = np.array(self.spin_eci) / np.linalg.norm(self.spin_eci)
        body = np.array(self.spin_body) / np.linalg.norm(self.spin_body)
        along = reference @ triad(inertial).T
        phase = self.rate_rpm * 2.0 * math.pi / 60.0 * times + rng.uniform(0.0, 2.0 * math.pi)
        cos, sin = np.cos(phase), np.sin(phase)
        turned = np.stack(
            [cos * along[:, 0] + sin * along[:, 1], cos * along[:, 1] - sin * along[:, 0], along[:, 2]], axis=1
        )
        field_body = turned @ triad(body) + self.noise_nt * rng.normal(size=reference.shape)
        return times, measure(self.x, field_body), reference

    def ticks(self, seconds: int) -> Iterator[Tick]:
        """One tick a second."""
        times, measured, reference = self.arrays(seconds)
        magnitude = np.linalg.norm(reference, axis=1)
        for second in range(seconds):
            rows = slice(second * self.rate_hz, (second + 1) * self.rate_hz)
            yield Tick(second, times[rows], measured[rows], magnitude[rows], reference[rows])
