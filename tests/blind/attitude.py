"""Motion of a rigid, axially symmetric body: spin, coning without torque, and despin by a torque about the axis.

For such a body Euler's equations have closed solutions, so the attitude is a function of time and can be asked for at
any instant; a test integrates the equations step by step against them.  Without torque the momentum stands still, the
body's axis goes round it at L / It, and the body turns about its axis relative to that by (1 - Ia / It) w3.
With a torque about the axis Ia dw/dt = T: a constant one gives a linear rate, an eddy-current one (T = -k w) an
exponential.  Source: Wertz 1978, sections 16.2 and 17.3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tests.blind.vectors import Floats, frame_turned_about_z, frame_with_z_along, log_uniform, random_direction

RPM = math.tau / 60.0


@dataclass(frozen=True, slots=True)
class RateProfile:
    """Spin rate over time: w = end + (start - end) exp(-t / tau) + slope t [rad/s]."""

    start_rad_s: float
    end_rad_s: float = 0.0
    tau_s: float = math.inf
    slope_rad_s2: float = 0.0

    def rate(self, times_s: Floats) -> Floats:
        """The rate (n,) [rad/s]."""
        gap = self.start_rad_s - self.end_rad_s
        return self.end_rad_s + gap * np.exp(-times_s / self.tau_s) + self.slope_rad_s2 * times_s

    def angle(self, times_s: Floats) -> Floats:
        """Its integral since time zero (n,) [rad]."""
        gap = self.start_rad_s - self.end_rad_s
        relaxed = times_s if math.isinf(self.tau_s) else -self.tau_s * np.expm1(-times_s / self.tau_s)
        return self.end_rad_s * times_s + gap * relaxed + 0.5 * self.slope_rad_s2 * times_s**2


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Attitude of the craft.

    Parameters
    ----------
    axis_body: (3,) symmetry axis in the body, which is the mean spin axis.
    momentum_eci: (3,) direction of the angular momentum.
    rate: spin about the axis (the body's w3 where it cones).
    phase_rad: spin angle at time zero.
    cone_rad: angle between the axis and the momentum.
    inertia_ratio: Ia / It, axial over transverse: below 1 a rod, above 1 a disc.
    """

    axis_body: Floats
    momentum_eci: Floats
    rate: RateProfile
    phase_rad: float = 0.0
    cone_rad: float = 0.0
    inertia_ratio: float = 0.5

    @property
    def precession_rad_s(self) -> float:
        """Rate of the axis about the momentum, L / It, at the start."""
        return self.inertia_ratio * self.rate.start_rad_s / math.cos(self.cone_rad)

    def body_from_eci(self, times_s: Floats) -> Floats:
        """Rotations (n, 3, 3): body = matrix @ ECI."""
        from_momentum = frame_with_z_along(self.momentum_eci)
        to_body = frame_with_z_along(self.axis_body).T
        if self.cone_rad == 0.0:
            spinning = frame_turned_about_z(self.phase_rad + self.rate.angle(times_s))
            return np.asarray(to_body @ spinning @ from_momentum, dtype=np.float64)
        precession = self.precession_rad_s
        relative = self.rate.start_rad_s * (1.0 - self.inertia_ratio)
        cosine, sine = math.cos(self.cone_rad), math.sin(self.cone_rad)
        tilt = np.array([[1.0, 0.0, 0.0], [0.0, cosine, sine], [0.0, -sine, cosine]])
        own = frame_turned_about_z(self.phase_rad + relative * times_s)
        around = frame_turned_about_z(precession * times_s)
        return np.asarray((to_body @ own) @ (tilt @ (around @ from_momentum)), dtype=np.float64)

    def body_rate(self, times_s: Floats) -> Floats:
        """Angular velocity (n, 3) in the body [rad/s]."""
        w3 = self.rate.rate(times_s)
        across = self.precession_rad_s * math.sin(self.cone_rad)
        angle = self.phase_rad + self.rate.start_rad_s * (1.0 - self.inertia_ratio) * times_s
        local = np.stack([across * np.sin(angle), across * np.cos(angle), w3], axis=-1)
        return np.asarray(local @ frame_with_z_along(self.axis_body), dtype=np.float64)


def draw_motion(rng: np.random.Generator, sample_hz: float) -> Motion:
    """A pure spin of 0.5 to 30 rpm below Nyquist, about any direction in space and often about a body axis."""
    fastest = min(30.0, 0.45 * 60.0 * sample_hz)
    while True:
        rpm = log_uniform(rng, 0.5, fastest)
        samples = 60.0 * sample_hz / rpm  # in one turn
        if samples > 8.0 or abs(samples - round(samples)) > 0.02 * samples:
            break  # a few samples at the same phases over and over would show no error of the sensor
    choice = rng.random()
    if choice < 0.5:
        axis = np.array([0.0, 0.0, 1.0])
    elif choice < 0.7:
        axis = np.eye(3)[rng.integers(2)]
    else:
        axis = random_direction(rng)
    sign = 1.0 if rng.random() < 0.8 else -1.0
    rate = RateProfile(sign * rpm * RPM, sign * rpm * RPM)
    return Motion(axis, random_direction(rng), rate, rng.uniform(0.0, math.tau))
