"""A sensor turned by hand on the ground, where the field has one magnitude."""

import numpy as np

from magcal_service.model import Array, d_matrix

FIELD_NT = 48_500.0
TRUTH = np.array([12_000.0, -8_000.0, 15_000.0, 0.08, -0.05, 0.02, 0.03, -0.02, 0.01])
"""Nine errors in the order of ``model.STATE_NAMES`` [nT, -]."""


def random_errors(seed: int) -> Array:
    """Nine errors (9,), uniform up to 20 uT, 0.1 and 0.05."""
    return np.repeat([20_000.0, 0.1, 0.05], 3) * np.random.default_rng([seed, 1]).uniform(-1.0, 1.0, 9)


def hand_turned(
    seed: int,
    *,
    seconds: float = 60.0,
    rate_hz: float = 10.0,
    noise_nt: float = 100.0,
    iron_nt: float = 0.0,
    around_z_only: float = 0.0,
    truth: Array = TRUTH,
) -> tuple[Array, Array, Array]:
    """Times (n,) [s], B (n, 3) and magnitudes of H (n,) [nT].

    Parameters
    ----------
    seed, seconds, rate_hz, noise_nt: of the log; noise is 1 sigma per axis.
    iron_nt: the field's magnitude wanders by so much (1 sigma) within two seconds [nT].
    around_z_only: 1: turned about z alone.
    truth: nine errors (9,).
    """
    rng = np.random.default_rng(seed)
    count, step_s = round(seconds * rate_hz), 1.0 / rate_hz
    keep, kept = np.exp(-step_s / np.array([3.0, 2.0])), []
    rate, wander, unit = np.zeros(3), 0.0, np.array([0.6, 0.0, 0.8])
    for _ in range(count):
        rate = keep[0] * rate + np.sqrt(1.0 - keep[0] ** 2) * rng.standard_normal(3)  # 1 rad/s, for three seconds
        wander = keep[1] * wander + np.sqrt(1.0 - keep[1] ** 2) * rng.standard_normal()
        turn = step_s * (rate * [0.0, 0.0, 1.0] if around_z_only else rate)
        angle = float(np.linalg.norm(turn))
        axis = turn / angle
        unit = unit * np.cos(angle) + np.cross(unit, axis) * np.sin(angle) + axis * (axis @ unit) * (1 - np.cos(angle))
        kept.append((FIELD_NT + iron_nt * wander) * unit)
    field = np.linalg.solve(np.eye(3) + d_matrix(truth), (np.array(kept) + truth[:3]).T).T
    return step_s * np.arange(count), field + noise_nt * rng.standard_normal(field.shape), np.full(count, FIELD_NT)
