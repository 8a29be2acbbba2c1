"""A tumbling sensor on a bench, by equations of its own: attitude, reference vector, channels that go along together.

Nothing of the service is used but its recordings; quaternions, courses and noise are made here.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from magcal_service.recordings.recording import Recording
from magcal_service.recordings.specs import PlatformKind, PlatformSpec

_FINE = 10  # steps a sample, in which the craft turns and the sensor answers

Array = NDArray[np.float64]


def attitudes(rng: np.random.Generator, time_s: Array) -> tuple[Array, Array]:
    """Quaternions (n, 4), scalar first, that turn inertial vectors into the body, and rates (n, 3) [rad/s]."""
    phase, speed = rng.uniform(0.0, 6.28, 3), rng.uniform(0.01, 0.05, 3)
    quaternion, found = np.array([1.0, 0.0, 0.0, 0.0]), []
    rates = 0.06 * np.sin(np.outer(time_s, speed) + phase)
    for step, (x, y, z) in zip(np.diff(time_s, append=time_s[-1]), rates, strict=True):
        found.append(quaternion)
        grow = np.array([[0.0, -x, -y, -z], [x, 0.0, -z, y], [y, z, 0.0, -x], [z, -y, x, 0.0]])
        quaternion = quaternion + 0.5 * step * grow @ quaternion
        quaternion = quaternion / np.linalg.norm(quaternion)
    return np.array(found), rates


def turned(quaternion: Array, vectors: Array) -> Array:
    """Vectors (n, 3) turned by quaternions (n, 4)."""
    w, v = quaternion[:, :1], quaternion[:, 1:]
    return np.asarray(vectors + 2.0 * np.cross(v, np.cross(v, vectors) + w * vectors))


def course(rng: np.random.Generator, time_s: Array) -> Array:
    """A slow course with steps in it, of zero mean and unit size (n,)."""
    share = time_s / time_s[-1]
    slow = sum(rng.normal() / k * np.sin(6.28 * (k * share + rng.uniform())) for k in range(1, 9))
    steps = np.sign(np.sin(6.28 * (rng.uniform(5.0, 15.0) * share + rng.uniform())))
    both = slow + 0.7 * steps
    return np.asarray((both - both.mean()) / both.std())


def alike(rng: np.random.Generator, time_s: Array, count: int) -> Array:
    """Courses (n, count): the first, and others that go along with it by 0.9 to 0.99."""
    first, found = course(rng, time_s), []
    for _ in range(count - 1):
        other, rho = course(rng, time_s), rng.uniform(0.9, 0.99)
        other -= first * float(first @ other) / float(first @ first)
        found.append(rho * first + np.sqrt(1.0 - rho**2) * other / other.std())
    return np.stack([first, *found], axis=1)


def low_passed(drive: Array, steps: float) -> Array:
    """What a low-pass of so many steps answers to a drive (n, 3) that is straight in each step: exactly."""
    kept = np.exp(-1.0 / steps)
    share = steps * (1.0 - kept)
    found = [drive[0]]
    for before, now in pairwise(drive):
        found.append(kept * found[-1] + (share - kept) * before + (1.0 - share) * now)
    return np.array(found)


@dataclass
class Bench:
    """What is wrong with the sensor, and what was recorded.

    Parameters
    ----------
    added_nt: (n, 3) field beside the reference's, sensor axes [nT].
    sensor_from_body: (3, 3) mounting.
    lag_s: time constant of the sensor's answer [s].
    attitude_noise_rad: 1 sigma of the recorded attitude about each axis [rad]; steady: whether the reference is;
        in_a_room: whether its magnitude alone was recorded.
    reference_off_nt: (3,) what the field is beyond the reference, in the reference's axes [nT].
    is_still: whether the body does not turn.
    channels: name -> (values, unit).
    """

    seed: int
    count: int = 1800
    noise_nt: float = 100.0
    added_nt: Array | float = 0.0
    sensor_from_body: Array = field(default_factory=lambda: np.eye(3))
    lag_s: float = 0.0
    attitude_noise_rad: float = 0.0
    with_attitude: bool = False
    steady: bool = False
    in_a_room: bool = False
    reference_off_nt: Array | float = 0.0
    is_still: bool = False
    channels: dict[str, tuple[Array, str]] = field(default_factory=dict)

    @property
    def time_s(self) -> Array:
        """(n,) [s]."""
        return np.arange(self.count, dtype=np.float64)

    def recording(self) -> Recording:
        """The recording; its reference changes slowly in size and direction."""
        rng = np.random.default_rng([self.seed, 1])
        fine_s = np.arange(_FINE * self.count) / _FINE
        quaternion, _ = attitudes(rng, fine_s)
        share = 0.0 * fine_s if self.steady else fine_s / fine_s[-1]
        reference = np.stack(
            [20e3 + 6e3 * np.sin(5.0 * share), -9e3 + 8e3 * np.cos(4.0 * share), 30e3 - 9e3 * share], axis=1
        )
        if self.is_still:
            quaternion = np.tile(quaternion[:1], (len(fine_s), 1))
        body = np.array(turned(quaternion, reference + self.reference_off_nt))
        if self.lag_s:
            body = low_passed(body, self.lag_s * _FINE)
        quaternion, reference, body = quaternion[::_FINE], reference[::_FINE], body[::_FINE]
        w = body @ self.sensor_from_body.T + self.added_nt + rng.normal(0.0, self.noise_nt, (self.count, 3))
        matrix = np.eye(3) + np.array([[0.02, 0.004, -0.006], [0.004, -0.03, 0.008], [-0.006, 0.008, 0.01]])
        measured = np.linalg.solve(matrix, (w + np.array([1500.0, -900.0, 700.0])).T).T
        tilt = rng.normal(0.0, self.attitude_noise_rad, (self.count, 3)) / 2.0
        noisy = quaternion + np.stack(
            [
                -(tilt * quaternion[:, 1:]).sum(axis=1),
                *(quaternion[:, :1] * tilt + np.cross(tilt, quaternion[:, 1:])).T,
            ],
            axis=1,
        )
        made = Recording.from_arrays(
            time=self.time_s,
            B=measured,
            H=np.linalg.norm(reference, axis=1) if self.in_a_room else reference,
            noise_nt=self.noise_nt,
            channels=self.channels,
            attitude=noisy if self.with_attitude else None,
        )
        return replace(made, descriptor=replace(made.descriptor, platform=PlatformSpec(PlatformKind.BENCH)))
