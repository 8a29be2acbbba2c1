"""Vectors, rotations and interpolation that every cause needs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
OverTime = Callable[[Floats], Floats]
"""A quantity as a function of the times (n,) [s since the first sample]."""


def unit(vectors: Floats) -> Floats:
    """Vectors (..., 3) at length one."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True), dtype=np.float64)


def random_direction(rng: np.random.Generator) -> Floats:
    """A direction (3,), all equally likely."""
    return unit(rng.normal(size=3))


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number between two positive ones, its logarithm uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def dot(first: Floats, second: Floats) -> Floats:
    """Scalar products (...,) of vectors (..., 3)."""
    return np.asarray(np.einsum("...i,...i->...", first, second), dtype=np.float64)


def turn(matrices: Floats, vectors: Floats) -> Floats:
    """Matrices (n, 3, 3) times vectors (n, 3) or one vector (3,)."""
    if vectors.ndim == 1:
        return np.asarray(matrices @ vectors, dtype=np.float64)
    return np.asarray((matrices @ vectors[..., None])[..., 0], dtype=np.float64)


def frame_with_z_along(axis: Floats) -> Floats:
    """Rows are the axes of a right-handed frame whose z is along ``axis`` (3,): new = frame @ old."""
    z = unit(axis)
    other = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = unit(np.cross(other, z))
    return np.stack([x, np.cross(z, x), z])


def frame_turned_about_z(angle_rad: Floats) -> Floats:
    """(n, 3, 3): components in axes turned by +angle (n,) about z."""
    cosine, sine, zero = np.cos(angle_rad), np.sin(angle_rad), np.zeros_like(angle_rad)
    rows = [cosine, sine, zero, -sine, cosine, zero, zero, zero, np.ones_like(angle_rad)]
    return np.stack(rows, axis=-1).reshape(*angle_rad.shape, 3, 3)


def hermite(start: float, step: float, values: Floats, times: Floats) -> Floats:
    """Smooth values (m, k) on an even grid, by cubic pieces, at ``times`` (n,) -> (n, k).

    Slopes are central differences of fourth order (one-sided of second order in the two outermost knots).  The error
    within is step^4 / 384 of the fourth derivative: for the main field along a low orbit and 20 s, below 0.01 nT.
    """
    slopes = np.gradient(values, axis=0, edge_order=2)
    slopes[2:-2] = (values[:-4] - 8.0 * values[1:-3] + 8.0 * values[3:-1] - values[4:]) / 12.0
    place = (times - start) / step
    knot = np.clip(place.astype(np.int64), 0, len(values) - 2)
    s = (place - knot)[:, None]
    first, second = values[knot], values[knot + 1]
    change = second - first
    left, right = slopes[knot] - change, change - slopes[knot + 1]
    return np.asarray(first + s * change + s * (1.0 - s) * ((1.0 - s) * left + s * right), dtype=np.float64)
