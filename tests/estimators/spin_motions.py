"""Crafts that do not spin steadily, as ticks: for the ways in which the spin estimator has to step back."""

import math
from collections.abc import Callable, Iterator

import numpy as np

from magcal_service.estimators.steady_spin.state import turned_once
from magcal_service.model import measure
from magcal_service.ticks.assembler import Tick
from tests.estimators.estimator_ticks import TABLE_1, tilted_dipole_eci

Motion = Callable[[np.ndarray], np.ndarray]

SPIN_RAD_S = 7.5 * 2.0 * math.pi / 60.0
INERTIA = np.array([1.0, 1.6, 2.1])


def ticks_of(motion: Motion, seconds: int, seed: int = 0, noise_nt: float = 300.0) -> Iterator[Tick]:
    """One sample a second of a craft whose attitudes (n, 3, 3) at times (n,) ``motion`` gives."""
    times = np.arange(seconds, dtype=float)
    reference = tilted_dipole_eci(times)
    field = np.einsum("nij,nj->ni", motion(times), reference)
    measured = measure(TABLE_1, field + noise_nt * np.random.default_rng(seed).normal(size=field.shape))
    magnitude = np.linalg.norm(reference, axis=1)
    for i in range(seconds):
        rows = slice(i, i + 1)
        yield Tick(i, times[rows], measured[rows], magnitude[rows], reference[rows])


def integrated(rate_of: Callable[[np.ndarray, float], np.ndarray], start: np.ndarray) -> Motion:
    """Attitudes from a body acceleration ``rate_of(w, t)``, by the midpoint rule in steps of a quarter of a second."""

    def attitudes(times: np.ndarray) -> np.ndarray:
        attitude, rate = turned_once(np.array([0.4, -0.8, 0.5]), 1.0)[0], start.copy()
        found = []
        for time in times:
            found.append(attitude)
            for at in time + 0.25 * np.arange(4):
                middle = rate + 0.125 * rate_of(rate, at)
                attitude = turned_once(middle, 0.25)[0] @ attitude
                rate = rate + 0.25 * rate_of(middle, at + 0.125)
        return np.array(found)

    return attitudes


def free(rate: np.ndarray, _: float) -> np.ndarray:
    """Euler's equations of a body with three different inertias."""
    x, y, z = rate.tolist()
    a, b, c = INERTIA.tolist()
    return np.array([(b - c) * y * z / a, (c - a) * z * x / b, (a - b) * x * y / c])


tumbling = integrated(free, SPIN_RAD_S * np.array([0.5, 0.6, 0.4]))
nutating = integrated(free, SPIN_RAD_S * np.array([0.15, 0.0, 1.0]))
despinning = integrated(lambda rate, _: -rate * 2e-5, SPIN_RAD_S * np.array([0.0, 0.0, 1.0]))
steady = integrated(lambda rate, _: 0.0 * rate, SPIN_RAD_S * np.array([0.0, 0.0, 1.0]))


def kicked(at_s: float) -> Motion:
    """A steady spin that a torque about the spin axis changes by 2 % within ten seconds."""
    return integrated(
        lambda rate, t: rate * (0.002 if at_s <= t < at_s + 10.0 else 0.0), SPIN_RAD_S * np.array([0.0, 0.0, 1.0])
    )
