"""Small scenes for the catalogue: a craft that turns about a fixed axis on a circular orbit, with all its telemetry."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from magcal_service.earth import geomagnetic
from magcal_service.model import Array, calibrate, measure
from magcal_service.physics.interface import Hypothesis, Nonlinear
from magcal_service.physics.scene.scene import Scene, Telemetry
from magcal_service.physics.scene.view import View

ORIGIN_NS = 1_742_472_000 * 10**9  # 2025-03-20T12:00:00Z
PERIOD_S = 4.0
COUNT = 2000
RATE_RAD_S = 0.21
NOISE_NT = 80.0
X = np.array([4000.0, -2500.0, 1200.0, 0.03, -0.05, 0.02, 0.01, -0.02, 0.015])
AXIS_BODY = np.array([0.36, 0.48, 0.8])
AXIS_ECI = np.array([-0.6, 0.64, 0.48])
_RADIUS_KM = 6878.0
_ORBIT_RAD_S = 1.1068e-3
_INCLINATION_RAD = 0.9


def triad(axis: Array) -> Array:
    """A right-handed triad (3, 3), rows, whose last row is the axis."""
    first = np.cross(axis, [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis])


def turning(axis_body: Array, axis_eci: Array, phase: Array) -> Array:
    """Body from ECI (n, 3, 3) of a craft at angles ``phase`` (n,) about +axis, right-handed."""
    turn = np.zeros((len(phase), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(phase)
    turn[:, 0, 1], turn[:, 1, 0] = np.sin(phase), -np.sin(phase)
    turn[:, 2, 2] = 1.0
    return np.asarray(triad(axis_body).T @ turn @ triad(axis_eci))


def orbit_eci_km(time_s: Array) -> Array:
    """Places (n, 3) [km], ECI, on a circle."""
    angle = _ORBIT_RAD_S * time_s + 0.4
    plane = np.stack(
        [np.cos(angle), np.sin(angle) * np.cos(_INCLINATION_RAD), np.sin(angle) * np.sin(_INCLINATION_RAD)]
    )
    return _RADIUS_KM * plane.T


def _channels(time_s: Array, body_from_eci: Array, axis_body: Array) -> dict[str, Telemetry]:
    angle = _ORBIT_RAD_S * time_s
    lit = (np.sin(angle) > -0.5).astype(np.float64)
    sun = body_from_eci @ np.array([0.8, 0.6, 0.0]) * lit[:, None]
    panels = np.maximum(np.stack([sun[:, 0], -sun[:, 1]], axis=1), 0.0)
    fired = np.sign(np.sin(time_s[:, None] / np.array([71.0, 113.0, 197.0]))) * (np.sin(time_s / 300.0) > 0.0)[:, None]
    made = {
        "temperature": ("temperature", 12.0 + 9.0 * np.sin(angle - 0.7)[:, None]),
        "current": ("current", 0.9 * panels),
        "battery": ("current", (1.2 * lit - 0.3)[:, None]),
        "torquer": ("magnetic moment", 0.2 * fired),
        "sun": ("dimensionless", sun),
        "gyro": ("angular rate", np.broadcast_to(RATE_RAD_S * axis_body, (len(time_s), 3)).copy()),
    }
    return {name: Telemetry(name, quantity, values) for name, (quantity, values) in made.items()}


@cache
def scene(noise_nt: float = 0.0) -> Scene:
    """Everything recorded, nothing wrong: nine errors ``X``, white noise, place, UTC, a vector, every kind of channel.

    Its arrays refuse to be written to.
    """
    time_s = PERIOD_S * np.arange(COUNT)
    time_ns = ORIGIN_NS + np.rint(time_s * 1e9).astype(np.int64)
    inertial = orbit_eci_km(time_s)
    reference = geomagnetic.igrf_eci_nt(time_ns, inertial)
    attitude = turning(AXIS_BODY, AXIS_ECI, RATE_RAD_S * time_s + 0.3)
    body = np.einsum("nij,nj->ni", attitude, reference)
    noise = np.random.default_rng(77).normal(0.0, 1.0, body.shape) * noise_nt
    made = Scene(
        time_s=time_s,
        origin_ns=ORIGIN_NS,
        utc=True,
        field_nt=measure(X, body + noise),
        calibrated_nt=body,
        clean_field_nt=measure(X, body),
        magnitude_nt=np.linalg.norm(reference, axis=1),
        reference_eci_nt=reference,
        position_ecef_km=geomagnetic.ecef_from_eci(time_ns, inertial),
        channels=_channels(time_s, attitude, AXIS_BODY),
        body_from_eci=attitude,
    )
    for array in arrays(made):
        array.flags.writeable = False
    return made


def arrays(of: Scene) -> list[Array]:
    """Every array that a scene was given."""
    given = [of.time_s, of.field_nt, of.calibrated_nt, of.clean_field_nt, of.magnitude_nt]
    given += [part for part in (of.reference_eci_nt, of.position_ecef_km, of.body_from_eci) if part is not None]
    return given + [channel.values for channel in of.channels.values()]


def view(of: Scene, noise_nt: float = NOISE_NT) -> View:
    """The stage at which the nine errors are known: the residual at ``X``."""
    residual = np.linalg.norm(calibrate(X, of.field_nt), axis=1) - of.magnitude_nt
    return View(of, residual, noise_nt)


def spoiled(field_nt: Array, of: Scene) -> Scene:
    """The same scene with other samples."""
    return replace(of, field_nt=field_nt)


def some_numbers(hypothesis: Hypothesis) -> Array:
    """Nonlinear numbers (m,) at which columns may be asked for: the middle of each grid, or a line at 0.0213 Hz."""
    return np.array([_some(number) for number in hypothesis.nonlinear])


def _some(number: Nonlinear) -> float:
    if number.role == "frequency":
        return 0.0213
    if number.role == "period":
        return 317.0
    return float(number.grid[len(number.grid) // 2])
