"""Equation (6) as a measurement: what a spin window says about the nine errors, for one filter or many runs at once.

Across the spin axis the mean of the true field over a window is zero, so the mean of the calibrated vectors there is
the innovation.  The vectors are projected to the known magnitude first: a plain mean contains the radial noise that the
scalar updates have already used.

Source: Cetin, Soken, Tekinalp 2020, equation (6); the projection is original to this project.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.estimators.parts.spin_window import Window
from magcal_service.estimators.parts.unscented import (
    Innovation,
    UnscentedWeights,
    sigma_points,
    transformed_innovation,
)
from magcal_service.model import BIAS, Array, d_matrix, field_jacobian

_IDENTITY_2: Final = np.eye(2)
_IDENTITY_3: Final = np.eye(3)


def spin_innovation(
    x: Array, root: Array, weights: UnscentedWeights, window: Window, field_nt: Array, noise_variance: float
) -> Innovation:
    """The two pseudo-measurements (6) of a window [nT]; leading axes (...) are runs.

    Parameters
    ----------
    x, root: states (..., 9) and the lower Cholesky factors of their covariances (..., 9, 9).
    window: the window's weights, magnitudes and axes, the same for every run; its own vectors are not used.
    field_nt: measured vectors B of the window's samples (..., k, 3) [nT].
    noise_variance: s^2 of the isotropic noise [nT^2].
    """
    matrix = _IDENTITY_3 + d_matrix(x)
    magnitude, across, bias = window.reference_magnitude_nt, window.across, x[..., None, BIAS]
    projected = _to_magnitude(field_nt @ matrix - bias, magnitude)
    mean = (across @ (window.weights @ projected)[..., None])[..., 0]
    # the sensitivity is taken where the vectors hold neither radial noise nor the window's mean
    clean = projected - mean[..., None, :] @ across
    field_clean = (clean + bias) @ np.linalg.inv(matrix)
    points = sigma_points(x, root, weights)
    moved = np.einsum("...kij,...pj->...pki", field_jacobian(field_clean), points)
    moved += field_clean[..., None, :, :]
    moved = _to_magnitude(moved, magnitude)
    outputs = np.einsum("k,...pki->...pi", window.weights, moved) @ across.T
    noise = _noise_of_mean(window, (projected / magnitude[:, None]) @ across.T, noise_variance)
    return transformed_innovation(root, weights, outputs, outputs[..., 0, :] - mean, noise)


def _to_magnitude(vectors: Array, magnitude_nt: Array) -> Array:
    """Vectors (..., k, 3), scaled in place to the lengths |H| (k,): for many runs copies cost more than arithmetic."""
    vectors *= (magnitude_nt / np.sqrt((vectors * vectors).sum(axis=-1)))[..., None]
    return vectors


def _noise_of_mean(window: Window, unit: Array, noise_variance: float) -> Array:
    """Covariance (..., 2, 2) [nT^2] of a mean: tangential noise of unit vectors (..., k, 2), and the window's leak."""
    square = window.weights**2
    tangential = _IDENTITY_2 * square.sum() - np.einsum("k,...ki,...kj->...ij", square, unit, unit)
    noise: Array = noise_variance * window.share * tangential + window.leak_nt**2 * _IDENTITY_2
    return noise
