"""How the craft turns: steady spin, spin-up, and the exact coning of an axisymmetric body free of torque.

The spin axis ``a`` is fixed in the body, the angular momentum ``h`` in space.  In axes with z along ``h`` (space) and
z along ``a`` (body) the attitude is Rz(phi) Rx(theta) Rz(psi), with nutation angle theta and, for an inertia ratio
r = I_axis / I_across and rate w about the axis,

    psi' = r w / cos(theta),    phi' = (1 - r) w,    psi' cos(theta) + phi' = w.

Source: Wertz 1978, section 16.3.2 (torque-free motion of an axisymmetric body).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from magcal_service.base.typed_toml.keys import number
from magcal_service.base.typed_toml.record import Reading
from magcal_service.wire.messages import Vector
from sim_sensor.declarations import RPM, direction

Floats = npt.NDArray[np.float64]


def _check_free_of_torque(reading: Reading, _: str, nutation_rad: float) -> None:
    acceleration: float = reading.values["acceleration_rad_s2"]
    if nutation_rad and acceleration:
        reading.table.refuse("spin_up_rpm_per_hour", acceleration, "0 with nutation_deg: coning is free of torque")


@dataclass(frozen=True)
class Spin:
    """Rotation of the body in space.

    Parameters
    ----------
    axis_body: spin axis in the body, unit.
    direction_eci: angular momentum in ECI, unit; where the axis points without nutation.
    rate_rad_s: rate about +axis at elapsed time 0 [rad/s].
    phase_rad: angle about the axis at elapsed time 0 [rad].
    acceleration_rad_s2: constant growth of the rate [rad/s^2]; only without nutation.
    nutation_rad: angle between axis and angular momentum [rad], 0 to below pi/2.
    inertia_ratio: moment of inertia about the axis over that across it, 0 to 2; matters with nutation only.
    """

    axis_body: Vector = direction("z", name="axis", file_only=True)
    direction_eci: Vector = direction(name="direction")
    rate_rad_s: float = number(
        7.5, -60.0, 60.0, name="rate_rpm", unit="rpm", convert=lambda rpm: rpm * RPM, file_only=True
    )
    phase_rad: float = number(0.0, -360.0, 360.0, name="phase_deg", unit="deg", convert=math.radians)
    acceleration_rad_s2: float = number(
        0.0,
        -60.0,
        60.0,
        name="spin_up_rpm_per_hour",
        unit="rpm/h",
        convert=lambda rpm_per_hour: rpm_per_hour * RPM / 3600.0,
    )
    nutation_rad: float = number(
        0.0, 0.0, 80.0, name="nutation_deg", unit="deg", convert=math.radians, check=_check_free_of_torque
    )
    inertia_ratio: float = number(1.0, 0.01, 2.0)

    def _angles(self, elapsed_s: Floats) -> tuple[Floats, Floats]:
        psi = self.inertia_ratio * self.rate_rad_s / math.cos(self.nutation_rad) * elapsed_s
        own = (1.0 - self.inertia_ratio) * self.rate_rad_s * elapsed_s
        phi = self.phase_rad + own + 0.5 * self.acceleration_rad_s2 * elapsed_s**2
        return phi, psi

    def body_from_eci(self, elapsed_s: Floats) -> Floats:
        """Attitude matrices (n, 3, 3), equation (1)'s A, at elapsed times (n,) [s]."""
        phi, psi = self._angles(np.asarray(elapsed_s, dtype=np.float64))
        cos_t, sin_t = math.cos(self.nutation_rad), math.sin(self.nutation_rad)
        tilt = np.array([[1.0, 0.0, 0.0], [0.0, cos_t, sin_t], [0.0, -sin_t, cos_t]])
        turning = _about_z(phi) @ tilt @ _about_z(psi)
        matrices: Floats = triad(self.axis_body).T @ turning @ triad(self.direction_eci)
        return matrices

    def rate_body_rad_s(self, elapsed_s: Floats) -> Floats:
        """Angular rate (n, 3) [rad/s] in body axes: what an ideal gyro reads."""
        elapsed_s = np.asarray(elapsed_s, dtype=np.float64)
        phi, _ = self._angles(elapsed_s)
        across = self.inertia_ratio * self.rate_rad_s * math.tan(self.nutation_rad)
        along = self.rate_rad_s + self.acceleration_rad_s2 * elapsed_s
        rates: Floats = np.stack([across * np.sin(phi), across * np.cos(phi), along], axis=-1) @ triad(self.axis_body)
        return rates

    def fastest_rad_s(self, duration_s: float) -> float:
        """Largest rate [rad/s] reached from 0 to ``duration_s``."""
        along = max(abs(self.rate_rad_s), abs(self.rate_rad_s + self.acceleration_rad_s2 * duration_s))
        return math.hypot(along, self.inertia_ratio * self.rate_rad_s * math.tan(self.nutation_rad))


def triad(axis: Vector) -> Floats:
    """Right-handed unit rows (3, 3) whose third is ``axis``; the first is the coordinate axis it leaves freest.

    The choice for z is the identity, so that a spin about body z has phase 0 where body x is the first row.
    """
    third = np.asarray(axis, dtype=np.float64)
    third = third / np.linalg.norm(third)
    helper = np.eye(3)[0] if abs(third[0]) < 0.9 else np.eye(3)[1]
    first = helper - third * (third @ helper)
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(third, first), third])


def _about_z(angle_rad: Floats) -> Floats:
    """Matrices (n, 3, 3) that give components in axes turned by +angle about z."""
    cosine, sine, zero = np.cos(angle_rad), np.sin(angle_rad), np.zeros_like(angle_rad)
    rows = [cosine, sine, zero, -sine, cosine, zero, zero, zero, zero + 1.0]
    return np.stack(rows, axis=-1).reshape(*cosine.shape, 3, 3)
