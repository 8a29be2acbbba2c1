"""Equations (2) and (4) as the paper has them, and the derivative: what the filters' own arithmetic is held against."""

from __future__ import annotations

import numpy as np

from magcal_service.model import BIAS, Array, calibrate, d_matrix, field_jacobian


def scalar_measurement(field_nt: Array, reference_magnitude_nt: Array) -> Array:
    """z = |B|^2 - |H|^2, equation (2) [nT^2]; B (..., 3), |H| (...)."""
    z: Array = np.einsum("...i,...i->...", field_nt, field_nt) - reference_magnitude_nt**2
    return z


def predicted_scalar(x: Array, field_nt: Array) -> Array:
    """h(x) = -B'(2D + D^2)B + 2 B'(I + D) b - |b|^2, equation (4) [nT^2]; x (9,), B (..., 3)."""
    d, b = d_matrix(x), x[BIAS]
    e = 2.0 * d + d @ d
    quadratic = np.einsum("...i,ij,...j->...", field_nt, e, field_nt)
    h: Array = -quadratic + 2.0 * field_nt @ ((np.eye(3) + d) @ b) - b @ b
    return h


def scalar_jacobian(x: Array, field_nt: Array) -> Array:
    """dh/dx = -2 w' J(B) [nT^2 per unit of x]; x (9,), B (..., 3) -> (..., 9).  From (4) as |B|^2 - |w|^2."""
    w = calibrate(x, field_nt)
    derivative: Array = -2.0 * np.einsum("...i,...ij->...j", w, field_jacobian(field_nt))
    return derivative
