"""Attitude of a craft that spins as its model says: the phase from each sample, the axis in space from all of them.

With a the axis in the body and c in space, w . a = H . c at every instant, whatever the phase: a line through the
origin in H / |H| and (w . a) / |H|, by least squares on the sums of all samples so far.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.apply.model_file import ModelSpin
from magcal_service.physics.scene.steady_spin import attitude_of, turns_of
from magcal_service.wire.messages import Vector

_AXIS_RAD: Final = 0.1
"""1 sigma to which the spin axis in space has to be known [rad]: the Sun on a panel is then right to a tenth."""

_AXIS_MEMORY: Final = 10.0
"""Samples that count as one for it: what the model does not hold of w along the axis changes slowly."""

_AXIS_LENGTH: Final = 0.1
"""By how much it may miss the length of 1: more is no turn about the model's axis of the body."""


def no_axis_sums() -> Array:
    """Sums (5, 5) of products of H / |H|, (w . a) / |H| and 1, over no sample."""
    return np.zeros((5, 5))


def axis_sums_with(sums: Array, direction: Array, along: float) -> Array:
    """The sums with one more sample: H / |H| (3,) and (w . a) / |H|."""
    row = np.array([*direction, along, 1.0])
    return np.asarray(sums + np.outer(row, row))


def axis_of(sums: Array) -> Array | None:
    """The spin axis in space (3,), a unit vector; None until it is known."""
    count = float(sums[4, 4])
    if count < _AXIS_MEMORY:
        return None
    normal = sums[:3, :3] + 1e-9 * np.eye(3)
    axis = np.linalg.solve(normal, sums[:3, 3])
    left = max(float(sums[3, 3] - sums[:3, 3] @ axis), 0.0) / count
    variance = _AXIS_MEMORY * left * float(np.linalg.eigvalsh(np.linalg.inv(normal))[-1])
    length = float(np.linalg.norm(axis))
    if variance > _AXIS_RAD**2 or abs(length - 1.0) > _AXIS_LENGTH:
        return None
    return np.asarray(axis / length)


def attitude(calibrated: Array, reference: Vector, spin: ModelSpin, axis_eci: Array) -> Array:
    """Attitudes (n, 3, 3) about the model's axis, the phase of each from its calibrated sample (n, 3) [nT]."""
    body = np.array(spin.axis_body)
    turn, _ = turns_of(calibrated, np.broadcast_to(np.array(reference), calibrated.shape), body, axis_eci)
    return attitude_of(body, axis_eci, np.angle(turn))
