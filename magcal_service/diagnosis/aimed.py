"""Whole vectors: the reference in the sensor's axes, where an attitude and a reference vector were recorded.

w = (I + D) B - b - d is compared with R A H: A the recorded attitude, R the turn of the sensor against the body, which
nobody knows better than the mounting.  R is a first guess S and a small turn more, R = exp([phi]) S, with phi as three
unknowns beside the nine errors (D is symmetric, so no turn hides in it).

An attitude has noise of its own, and it only shows across the field: rows are weighted there by the field's noise over
both, so a poor attitude leaves the scalar residual's information and little more.

Source: Wahba 1965 and Markley 1988 (singular values) for the guess; Horn & Johnson 2013, section 7.3, for the polar
factors G = R'(I + D) of a linear fit; Sola et al. 2018 for the derivative of a turn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from magcal_service.diagnosis.offset import Offset
from magcal_service.earth import geomagnetic
from magcal_service.model import Array, calibrate
from magcal_service.physics.scene.scene import Scene
from magcal_service.recordings.channels import Axes
from magcal_service.recordings.recording import Recording
from magcal_service.residuals import white_noise_level
from magcal_service.wire.messages import Frame

_LEAST_GAIN: Final = (
    0.2  # smallest singular value of a linear fit that is a sensor's; less is a field that hardly turned
)


@dataclass(frozen=True, eq=False)
class Aimed:
    """Reference vectors in the sensor's axes.

    Parameters
    ----------
    reference_nt: (n, 3) S A H [nT]: by the attitude and the guess of the mounting.
    guess: (3, 3) S, sensor from body.
    across: weight of the rows across the field against those along it, 0 to 1.
    offset: what the reference may be off by in its own axes; None: it is as stated.
    """

    reference_nt: Array
    guess: Array
    across: float = 1.0
    offset: Offset | None = None

    @property
    def size(self) -> int:
        """Unknowns: a small turn of the sensor (3,), and what the reference is off by (k,)."""
        return 3 + (0 if self.offset is None else self.offset.size)

    @property
    def tie(self) -> Array:
        """Inverse prior variance of each unknown."""
        off = [] if self.offset is None else [self.offset.usual_nt**-2] * self.offset.size
        return np.array([0.0, 0.0, 0.0, *off])

    def turned(self, unknowns: Array) -> Array:
        """The reference (n, 3) with the sensor turned further by the first three of (3 + k,) [rad], off by the rest."""
        reference = self.reference_nt
        if self.offset is not None:
            reference = reference + self.offset.columns @ unknowns[3:]
        return np.asarray(reference @ turn(unknowns[:3]).T)

    def slopes(self, unknowns: Array) -> Array:
        """(n, 3, 3 + k) derivatives of ``turned`` by its unknowns."""
        phi = unknowns[:3]
        by_turn = -skew(self.turned(unknowns)) @ left_jacobian(phi)
        if self.offset is None:
            return by_turn
        return np.concatenate([by_turn, turn(phi) @ self.offset.columns], axis=2)

    def sensor_from_body(self, phi: Array) -> Array:
        """(3, 3) R."""
        return np.asarray(turn(phi) @ self.guess)

    def weighed(self, rows: Array) -> Array:
        """Rows (3 n,) or (3 n, k) with the part across the field weighted."""
        if self.across == 1.0:
            return rows
        unit = self.reference_nt / np.linalg.norm(self.reference_nt, axis=1)[:, None]
        table = rows.reshape(len(unit), 3, -1)
        along = np.einsum("ni,nik->nk", unit, table)
        found = self.across * table + (1.0 - self.across) * unit[:, :, None] * along[:, None, :]
        return np.asarray(found.reshape(rows.shape))

    def continued(self, rotation: Array) -> Aimed:
        """With as many samples more, of a craft that turns its body by rotations (n, 3, 3) beside what it did."""
        further = np.einsum("nij,nj->ni", rotation, self.reference_nt)
        offset = None if self.offset is None else self.offset.continued(rotation)
        return replace(self, reference_nt=np.concatenate([self.reference_nt, further]), offset=offset)

    def part(self, last: int) -> Aimed:
        """Of the first rows only."""
        offset = None if self.offset is None else self.offset.part(last)
        return replace(self, reference_nt=self.reference_nt[:last], offset=offset)


def skew(vectors: Array) -> Array:
    """(..., 3, 3) matrices of the cross product with vectors (..., 3)."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def turn(phi: Array) -> Array:
    """(3, 3) rotation by a vector phi (3,) [rad]."""
    angle, cross = float(np.linalg.norm(phi)), skew(phi)
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


def left_jacobian(phi: Array) -> Array:
    """(3, 3) J with turn(phi + e) = turn(J e) turn(phi) to first order."""
    angle, cross = float(np.linalg.norm(phi)), skew(phi)
    if angle < 1e-4:
        return np.asarray(np.eye(3) + 0.5 * cross)
    return np.asarray(
        np.eye(3) + (1.0 - np.cos(angle)) / angle**2 * cross + (angle - np.sin(angle)) / angle**3 * cross @ cross
    )


class InBody(NamedTuple):
    """A reference by a recorded attitude: (n, 3) in the body [nT], and (n, 3, 3) body from axes that are its own."""

    reference_nt: Array
    body_from_axes: Array
    axes: Axes


def in_body(recording: Recording, scene: Scene, attitude: tuple[Axes, Array] | None) -> InBody | None:
    """The reference in the body by a recorded attitude; None where either is missing."""
    if (
        attitude is None
        or recording.reference.vector_nt is None
        or not np.isfinite(recording.reference.vector_nt).all()
    ):
        return None
    reference = _in_axes(recording, scene, attitude[0])
    if reference is None:
        return None
    return InBody(np.asarray(np.einsum("nij,nj->ni", attitude[1], reference)), *_on_ground(scene, *attitude))


def _on_ground(scene: Scene, axes: Axes, body_from_axes: Array) -> tuple[Array, Axes]:
    """(n, 3, 3) body from the axes that what is around a place near the ground stays in, and which these are: north,
    east, down where time and place tell, else as the attitude has them."""
    place = scene.position_ecef_km
    if axes not in (Axes.ECI, Axes.ECEF) or not scene.utc or place is None:
        return body_from_axes, axes
    latitude, longitude, height_km = geomagnetic.geodetic_from_ecef(place)
    if float(np.median(height_km)) > geomagnetic.LOWEST_ORBIT_KM:  # a coil that plays an orbit
        return body_from_axes, axes
    fixed = [geomagnetic.ecef_from_ned(latitude, longitude, np.tile(one, (len(place), 1))) for one in np.eye(3)]
    given = [geomagnetic.eci_from_ecef(scene.time_ns, one) for one in fixed] if axes is Axes.ECI else fixed
    return np.asarray(body_from_axes @ np.stack(given, axis=2)), Axes.NED


def _in_axes(recording: Recording, scene: Scene, axes: Axes) -> Array | None:
    """The reference vector (n, 3) in the axes that the attitude refers to [nT]."""
    given, frame = recording.reference.vector_nt, recording.reference.frame
    assert given is not None
    if frame is not None and frame.value == axes.value:
        return given
    if frame is Frame.NED and axes is Axes.ENU:
        return np.asarray(given[:, [1, 0, 2]] * [1.0, 1.0, -1.0])
    if scene.reference_eci_nt is None or axes is Axes.ECI:
        return scene.reference_eci_nt
    if not scene.utc:
        return None
    fixed = geomagnetic.ecef_from_eci(scene.time_ns, np.asarray(scene.reference_eci_nt, dtype=np.float64))
    if axes is Axes.ECEF:
        return fixed
    if scene.position_ecef_km is None:
        return None
    latitude, longitude, _ = geomagnetic.geodetic_from_ecef(scene.position_ecef_km)
    north = geomagnetic.ned_from_ecef(latitude, longitude, fixed)
    return np.asarray(north if axes is Axes.NED else north[:, [1, 0, 2]] * [1.0, 1.0, -1.0])


def guessed(scene: Scene, reference_body_nt: Array, x: Array) -> tuple[Aimed, Array]:
    """A first guess of the mounting, and nine errors (9,) to start with.

    By a linear fit A H = G B - c, whose polar factors are the turn and I + D; where the field did not turn enough for
    that, by the rotation that brings the vectors calibrated by ``x`` (9,) closest.
    """
    columns = np.concatenate([scene.field_nt, np.full((len(scene), 1), 1e4)], axis=1)
    solution = np.linalg.lstsq(columns, reference_body_nt, rcond=1e-12)[0]
    left, values, right = np.linalg.svd(solution[:3].T)
    if values[-1] > _LEAST_GAIN and np.linalg.det(left @ right) > 0.0:
        matrix = right.T @ np.diag(values) @ right  # G = (U V')(V s V') = S'(I + D)
        guess = (left @ right).T
        reference = reference_body_nt @ guess.T
        bias = (scene.field_nt @ matrix.T - reference).mean(axis=0)
        d = matrix - np.eye(3)
        return Aimed(reference, guess), np.array([*bias, d[0, 0], d[1, 1], d[2, 2], d[0, 1], d[0, 2], d[1, 2]])
    left, _, right = np.linalg.svd(calibrate(x, scene.field_nt).T @ reference_body_nt)
    guess = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return Aimed(reference_body_nt @ guess.T, guess), x


def weighted(aimed: Aimed, scene: Scene, residual: Array, noise_nt: float) -> Aimed:
    """With the rows across the field weighted by what changes there from sample to sample, beyond the noise (n, 3)."""
    unit = aimed.reference_nt / np.linalg.norm(aimed.reference_nt, axis=1)[:, None]
    rows = residual.reshape(-1, 3)
    across = rows - np.einsum("ni,ni->n", rows, unit)[:, None] * unit
    levels = [white_noise_level(scene.time_ns, column) for column in across.T]
    level = float(np.sqrt(np.sum(np.square(levels)) / 2.0))  # two of three directions are across
    return replace(aimed, across=min(1.0, noise_nt / max(level, 1e-9)))
