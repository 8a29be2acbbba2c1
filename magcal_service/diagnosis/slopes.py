"""Derivatives of the residual by its unknowns and by nonlinear numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from magcal_service.model import STATE_SIZE, Array, field_jacobian, magnitude_jacobian
from magcal_service.physics.interface import Nonlinear

HELD: Final = ("instant", "edge", "held")
"""Roles of nonlinear numbers that a refit leaves where the search has put them: columns jump or bend with them."""


def lengths(vectors: Array) -> Array:
    """Of each of some vectors (n, 3)."""
    return np.asarray(np.sqrt(np.einsum("ni,ni->n", vectors, vectors)))


def room_slopes(room_from_body: Array, field: Array, magnitude_nt: Array) -> Array:
    """d target / d H0 (n, 3, 3): only the direction of H0 (3,) counts, its length is as stated."""
    size = float(np.linalg.norm(field))
    across = (np.eye(3) - np.outer(field, field) / size**2) / size
    return np.asarray(np.transpose(room_from_body, (0, 2, 1)) @ across * magnitude_nt[:, None, None])


def unknown_slopes(measured_nt: Array, unit: Array, of_target: Array | None) -> Array:
    """d residual / d unknowns (m, 9 or 9 + k), for measured vectors (n, 3) [nT].

    Parameters
    ----------
    unit: direction of the field in the body (n, 3).
    of_target: in a vector form, d target / d what turns or moves it (n, 3, k).
    """
    if of_target is None:
        return magnitude_jacobian(measured_nt, unit)
    return np.concatenate([field_jacobian(measured_nt), -of_target], axis=2).reshape(
        -1, STATE_SIZE + of_target.shape[2]
    )


def number_slopes(
    numbers: Sequence[Nonlinear], theta: Array, added: Callable[[Array], Array], span_s: float
) -> list[Array]:
    """Columns (m,) for nonlinear numbers by central differences; an instant has none that means anything.

    Parameters
    ----------
    added: from the numbers (k,) to what they add to the residual (m,).
    span_s: length of the recording [s].
    """
    slopes: list[Array] = []
    for index, number in enumerate(numbers):
        if number.role in HELD:
            continue
        value = float(theta[index])
        step = max(abs(value), 1e-3) * (1e-4 if number.role in ("frequency", "period") else 1e-2)
        if number.role == "frequency":
            step = 0.02 / max(span_s, 1.0)
        if number.role == "period":
            step = 0.02 * value**2 / max(span_s, 1.0)
        moved = []
        for sign in (1.0, -1.0):
            at = np.array(theta)
            at[index] += sign * step
            moved.append(added(at))
        slopes.append((moved[0] - moved[1]) / (2.0 * step))
    return slopes
