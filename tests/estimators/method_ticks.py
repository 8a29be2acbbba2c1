"""Ticks of a cloud of vectors."""

from __future__ import annotations

import numpy as np

from magcal_service.config.settings import CraftConfig, SensorConfig
from magcal_service.model import measure
from magcal_service.ticks.assembler import Tick

X = np.array([900.0, -1400.0, 2100.0, 0.05, -0.08, 0.11, 0.03, -0.04, 0.06])
PRIOR = np.array([30_000.0] * 3 + [0.2] * 6)
NOISE_NT = 300.0
CONFIG = CraftConfig("c", SensorConfig(NOISE_NT))


def cloud(count: int, noise_nt: float = NOISE_NT, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Measured vectors in all directions (n, 3) and |H| (n,) [nT]."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    magnitude = rng.uniform(25_000.0, 50_000.0, count)
    return measure(X, direction * magnitude[:, None] + noise_nt * rng.normal(size=(count, 3))), magnitude


def ticks(field: np.ndarray, magnitude: np.ndarray, per_tick: int = 1, period_s: float = 1.0) -> list[Tick]:
    found = []
    for index, first in enumerate(range(0, len(field), per_tick)):
        part = slice(first, first + per_tick)
        times = period_s * (index + np.arange(len(field[part])) / per_tick)
        found.append(Tick(index, times, field[part], magnitude[part]))
    return found
