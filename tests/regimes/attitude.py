"""How a craft turns: steadily, with the Earth, not at all, or as a free rigid body.

A motion answers seconds t (n,) with matrices (n, 3, 3) that take inertial vectors (on the ground: vectors of the room)
to body axes.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tests.regimes.orbit import Floats, Orbit

Motion = Callable[[Floats], Floats]


def random_rotation(rng: np.random.Generator) -> Floats:
    """A rotation matrix (3, 3), evenly of all."""
    return matrices(rng.standard_normal((1, 4)))[0]


def matrices(quaternion: Floats) -> Floats:
    """(n, 3, 3) that turn vectors as the quaternions (n, 4), scalar first, do."""
    q = quaternion / np.linalg.norm(quaternion, axis=1)[:, None]
    w, v = q[:, :1, None], q[:, 1:]
    cross = np.zeros((len(q), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    cross[:, 1, 0], cross[:, 2, 0], cross[:, 2, 1] = v[:, 2], -v[:, 1], v[:, 0]
    return np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross


def quaternions(turn: Floats) -> Floats:
    """(n, 4), scalar first and not negative, of rotation matrices (n, 3, 3); the inverse of ``matrices``."""
    trace = np.trace(turn, axis1=1, axis2=2)
    diagonal = np.diagonal(turn, axis1=1, axis2=2)
    squares = np.maximum(np.c_[1.0 + trace, 1.0 - trace[:, None] + 2.0 * diagonal], 0.0) / 4.0
    largest = np.argmax(squares, axis=1)
    sums = np.zeros((len(turn), 4, 4))
    for a, b, value in (
        (0, 1, turn[:, 2, 1] - turn[:, 1, 2]),
        (0, 2, turn[:, 0, 2] - turn[:, 2, 0]),
        (0, 3, turn[:, 1, 0] - turn[:, 0, 1]),
        (1, 2, turn[:, 0, 1] + turn[:, 1, 0]),
        (1, 3, turn[:, 0, 2] + turn[:, 2, 0]),
        (2, 3, turn[:, 1, 2] + turn[:, 2, 1]),
    ):
        sums[:, a, b] = sums[:, b, a] = value / 4.0
    for a in range(4):
        sums[:, a, a] = squares[:, a]
    q = sums[np.arange(len(turn)), largest]
    q /= np.linalg.norm(q, axis=1)[:, None]
    return np.where(q[:, :1] < 0.0, -q, q)


def about(axis: Floats, angle: Floats) -> Floats:
    """(n, 3, 3) to axes turned by +angle (n,) about an axis (3,)."""
    half = -angle / 2.0
    return matrices(np.c_[np.cos(half), np.sin(half)[:, None] * axis])


def spinning(rng: np.random.Generator, rate_rpm: float, axis: Floats) -> Motion:
    """A steady turn about a body axis (3,) that keeps its direction in space."""
    start, rate = random_rotation(rng), rate_rpm * math.tau / 60.0
    return lambda t: about(axis, rate * t) @ start


def inertial(rng: np.random.Generator) -> Motion:
    """Three-axis control to a fixed attitude; the pointing wanders by half a degree over minutes."""
    start = random_rotation(rng)
    size = np.radians(rng.uniform(0.1, 0.6, 3))
    period, phase = rng.uniform(300.0, 2500.0, 3), rng.uniform(0.0, math.tau, 3)
    return lambda t: (
        matrices(np.c_[np.ones(len(t)), 0.5 * size * np.sin(math.tau * t[:, None] / period + phase)]) @ start
    )


def nadir_pointing(rng: np.random.Generator, orbit: Orbit) -> Motion:
    """One turn an orbit: z down, x along the track, with a small roll, pitch and yaw; the sensor is mounted anyhow."""
    mounted = random_rotation(rng)
    size = np.radians(rng.uniform(0.2, 2.0, 3))
    period, phase = rng.uniform(200.0, 3000.0, 3), rng.uniform(0.0, math.tau, 3)

    def body(t: Floats) -> Floats:
        place = orbit.position_km(t)
        down = -place / np.linalg.norm(place, axis=1)[:, None]
        normal = -np.cross(place, orbit.position_km(t + 0.5) - orbit.position_km(t - 0.5))
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        local = np.stack([np.cross(normal, down), normal, down], axis=1)
        wander = matrices(np.c_[np.ones(len(t)), 0.5 * size * np.sin(math.tau * t[:, None] / period + phase)])
        return mounted @ wander @ local

    return body


def tumbling(rng: np.random.Generator, seconds: float, rate_deg_s: float) -> Motion:
    """A rigid body of three unequal moments of inertia that nothing turns."""
    inertia = unequal_inertia(rng)
    rate = rng.standard_normal(3)
    rate *= math.radians(rate_deg_s) / np.linalg.norm(rate)
    return rigid_body(inertia, rate, rng.standard_normal(4), seconds)


def unequal_inertia(rng: np.random.Generator) -> Floats:
    """Three rising moments of inertia (3,) of about 1, the largest below the sum of the others, as bodies have them.

    With the masses' mean squares p along the axes they are p_y + p_z, p_x + p_z, p_x + p_y.
    """
    squares = rng.uniform(0.6, 1.4, 3)
    inertia = np.sort(squares.sum() - squares)
    return inertia / inertia.mean() + np.array([-0.12, 0.0, 0.12])


def rigid_body(inertia: Floats, rate: Floats, start: Floats, seconds: float) -> Motion:
    """Euler's equations from a body rate (3,) [rad/s] and an attitude (4,): Runge-Kutta in steps of a degree."""
    step = float(min(1.0, math.radians(1.0) / np.linalg.norm(rate)))
    knots = np.arange(-10.0 * step, seconds + 20.0 * step, step)
    i1, i2, i3 = (float(value) for value in inertia)

    State = tuple[float, float, float, float, float, float, float]

    def slope(s: State) -> State:
        w, x, y, z, p, q, r = s
        # the quaternion leads from body to space: dq/dt = q (0, rate) / 2
        return (
            -0.5 * (x * p + y * q + z * r),
            0.5 * (w * p + y * r - z * q),
            0.5 * (w * q + z * p - x * r),
            0.5 * (w * r + x * q - y * p),
            (i2 - i3) / i1 * q * r,
            (i3 - i1) / i2 * r * p,
            (i1 - i2) / i3 * p * q,
        )

    def moved(s: State, d: State, h: float) -> State:
        w, x, y, z, p, q, r = s
        dw, dx, dy, dz, dp, dq, dr = d
        return w + h * dw, x + h * dx, y + h * dy, z + h * dz, p + h * dp, q + h * dq, r + h * dr

    w, x, y, z = (start / np.linalg.norm(start)).tolist()
    p, q, r = rate.tolist()
    state = (w, x, y, z, p, q, r)
    found = []
    for _ in knots:
        found.append(state[:4])
        k1 = slope(state)
        k2 = slope(moved(state, k1, step / 2.0))
        k3 = slope(moved(state, k2, step / 2.0))
        k4 = slope(moved(state, k3, step))
        mean = [(a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in zip(k1, k2, k3, k4, strict=True)]
        state = moved(state, (*mean,), step)
    course = np.array(found)

    def body(t: Floats) -> Floats:
        at = (t - knots[0]) / step
        row = np.clip(at.astype(np.intp), 0, len(knots) - 2)
        part = (at - row)[:, None]
        between = course[row] * (1.0 - part) + course[row + 1] * part
        return np.transpose(matrices(between), (0, 2, 1))

    return body


def turntable(rng: np.random.Generator) -> Motion:
    """Two axes of a turntable: yaw goes round, the tilt sweeps slowly over most of the sphere."""
    yaw_rate = math.radians(rng.uniform(2.0, 9.0))
    sweep, phase = rng.uniform(500.0, 900.0), rng.uniform(0.0, math.tau, 2)
    mounted = random_rotation(rng)

    def body(t: Floats) -> Floats:
        tilt = math.radians(85.0) * np.sin(math.tau * t / sweep + phase[0])
        yaw = about(np.array([0.0, 0.0, 1.0]), yaw_rate * t + phase[1])
        return mounted @ about(np.array([1.0, 0.0, 0.0]), tilt) @ yaw

    return body
