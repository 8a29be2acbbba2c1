"""A state of the spin, and samples that one leaves."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from magcal_service.estimators.steady_spin.state import SpinState

X = np.array([900.0, -1400.0, 2100.0, 0.05, -0.08, 0.11, 0.03, -0.04, 0.06])
RATE = np.array([0.1, -0.5, 0.7])
SCALE = np.concatenate([np.full(3, 10.0), np.full(6, 1e-3), np.full(3, 1e-3), np.full(3, 1e-4)])


def covariance(seed: int = 1) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(15, 20)) * SCALE[:, None]
    return root @ root.T


def attitude() -> np.ndarray:
    return Rotation.from_rotvec([0.4, 1.1, -0.7]).as_matrix().T


def state(seed: int = 1) -> SpinState:
    return SpinState(X, attitude(), RATE, covariance(seed))
