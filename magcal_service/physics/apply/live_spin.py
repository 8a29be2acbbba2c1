"""Attitude of a craft that spins as its model says: the phase from each sample, the axis in space from all of them.

With a the axis in the body and c in space, w . a = H . c at every instant, whatever the phase; nine errors of another
day add an offset o that changes slowly:

    (w . a) / |H| = (H / |H|) . c + o        |c| = 1, o about zero

by least squares on the sums of all samples so far.  The length of c is what makes it known in minutes: H turns along an
arc that is nearly a plane, which alone says nothing of the part of c across it.  The length does, but for its sign, so
there may be two axes, one the mirror image of the other; which it is has to be sure as well.

Source: the minimum of a quadratic form on a sphere, and the one other that it may have: Martinez 1994, SIAM J. Optim.
"""

from __future__ import annotations

import math
from collections.abc import Callable
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

_OFFSET: Final = 0.03
"""1 sigma of what nine errors of another day leave along the axis, in parts of |H|: a microtesla in a low orbit."""

_AXIS_SURE: Final = 9.0
"""By how much the mirror image has to fit worse, in squares over their variance: 3 sigma."""

_HALVINGS: Final = 60
"""Of a bracket of the multiplier: to the last bits of a double."""

_PASSES: Final = 3
"""Over which the weight of the offset's prior and the noise that is left settle to a percent."""


def no_axis_sums() -> Array:
    """Sums (5, 5) of products of H / |H|, (w . a) / |H| and 1, over no sample."""
    return np.zeros((5, 5))


def axis_sums_with(sums: Array, direction: Array, along: float) -> Array:
    """The sums with one more sample: H / |H| (3,) and (w . a) / |H|."""
    row = np.array([*direction, along, 1.0])
    return np.asarray(sums + np.outer(row, row))


def axis_of(sums: Array) -> Array | None:
    """The spin axis in space (3,), a unit vector; None until it is known, and is not its mirror image."""
    count = float(sums[4, 4])
    if count < _AXIS_MEMORY:
        return None
    tie = 0.0
    for _ in range(_PASSES):
        weight = count + tie
        normal = sums[:3, :3] - np.outer(sums[:3, 4], sums[:3, 4]) / weight
        right = sums[:3, 3] - sums[:3, 4] * sums[3, 4] / weight
        axis, mirror, multiplier = _on_sphere(normal, right)
        square = float(sums[3, 3] - sums[3, 4] ** 2 / weight)
        left = max(square + _cost(axis, normal, right), 1e-12 * count) / count
        tie = _AXIS_MEMORY * left / _OFFSET**2
    across = np.linalg.svd(axis[None])[2][1:]
    stiffness = float(np.linalg.eigvalsh(across @ (normal - multiplier * np.eye(3)) @ across.T)[0])
    if _AXIS_MEMORY * left > _AXIS_RAD**2 * stiffness:
        return None
    if mirror is not None:
        worse = _cost(mirror, normal, right) - _cost(axis, normal, right)
        if worse < _AXIS_SURE * _AXIS_MEMORY * left:
            return None
    return axis


def _cost(c: Array, normal: Array, right: Array) -> float:
    """Sum of squares at c (3,), less what does not depend on it."""
    return float(c @ normal @ c - 2.0 * right @ c)


def _on_sphere(normal: Array, right: Array) -> tuple[Array, Array | None, float]:
    """The unit vector (3,) with the least cost, the other minimum where there is one, and the multiplier of the first.

    (N - m) c = r with |c| = 1: the least cost is at m below all eigenvalues of N, another minimum at the smaller root
    between the first two.
    """
    values, vectors = np.linalg.eigh(normal)
    parts = vectors.T @ right
    least = 1e-12 * max(float(values[-1]), 1e-300)  # where a part is zero, two axes fit alike and either will do
    parts = np.where(np.abs(parts) < least, least, parts)
    squares, levels = (parts**2).tolist(), values.tolist()

    def excess(m: float) -> float:
        return math.fsum(z / (level - m) ** 2 for z, level in zip(squares, levels, strict=True)) - 1.0

    def at(m: float) -> Array:
        c = vectors @ (parts / (values - m))
        return np.asarray(c / np.linalg.norm(c))

    first, second, _ = levels
    multiplier = _root(excess, first - math.sqrt(sum(squares)), first, rising=True)
    lowest = first + (second - first) / (1.0 + (squares[1] / squares[0]) ** (1.0 / 3.0))  # of the two nearest terms
    if not second > first or excess(lowest) >= 0.0:
        return at(multiplier), None, multiplier
    return at(multiplier), at(_root(excess, first, lowest, rising=False)), multiplier


def _root(excess: Callable[[float], float], low: float, high: float, *, rising: bool) -> float:
    """Where a monotonous function is zero, from the side of its pole."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if (excess(middle) < 0.0) is rising:
            low = middle
        else:
            high = middle
    return low if rising else high


def attitude(calibrated: Array, reference: Vector, spin: ModelSpin, axis_eci: Array) -> Array:
    """Attitudes (n, 3, 3) about the model's axis, the phase of each from its calibrated sample (n, 3) [nT]."""
    body = np.array(spin.axis_body)
    turn, _ = turns_of(calibrated, np.broadcast_to(np.array(reference), calibrated.shape), body, axis_eci)
    return attitude_of(body, axis_eci, np.angle(turn))
