"""Nine errors and known fields by the magnitude alone, with and without what is known of the nine errors."""

from __future__ import annotations

import numpy as np
import pytest

from magcal_service.estimators.parts.magnitude_fit import MagnitudeFit, magnitude_fit
from magcal_service.model import Array, calibrate, d_matrix

X = np.array([5000.0, 1000.0, 4000.0, 0.05, 0.10, 0.05, 0.05, 0.05, 0.05])
KNOWN = np.array([100.0] * 3 + [0.003] * 6)
NOISE_NT, START = 50.0, 0.4


def fitted(count: int, seed: int, known: Array | None, start: float = START, prior: float = 0.5) -> MagnitudeFit:
    """A spinning sensor that cools down by ``start`` of a field, fitted from errors that are off by one sigma each."""
    rng = np.random.default_rng([909, seed])
    time_s = np.arange(count, dtype=float)
    phase, tilt = 0.8 * time_s, 0.3 + 0.001 * time_s
    ambient = 4e4 * np.stack([np.cos(phase) * np.cos(tilt), np.sin(phase) * np.cos(tilt), np.sin(tilt)], axis=1)
    fields = np.exp(-time_s / 600.0)[:, None] * np.array([2000.0, -1500.0, 3000.0])
    inverse = np.linalg.inv(np.eye(3) + d_matrix(X))
    measured = (ambient + X[:3] + NOISE_NT * rng.standard_normal((count, 3))) @ inverse.T + start * fields
    first = X + KNOWN * rng.choice([-1.0, 1.0], 9)
    return magnitude_fit(first, measured, np.full(count, 4e4), fields[:, None], prior, known)


@pytest.mark.parametrize("seed", range(4))
def test_a_start_is_known_in_minutes_where_the_nine_errors_are_nearly(seed: int) -> None:
    """Five minutes: beside nine free errors nothing is known of it but its prior."""
    with_them, without = fitted(300, seed, KNOWN), fitted(300, seed, None)
    sigma, free = (float(np.sqrt(one.covariance[0, 0])) for one in (with_them, without))
    assert sigma < 0.1
    assert free > 2.0 * sigma
    assert abs(with_them.amplitudes[0] - START) < 4.0 * sigma


def test_the_nine_errors_covariance_holds_where_the_start_is_known() -> None:
    """Their squared errors over their covariance, of forty flights; nine times one is expected."""
    squares = []
    for seed in range(40):
        fit = fitted(600, 100 + seed, KNOWN, start=0.0, prior=1e-6)
        root = np.linalg.cholesky(fit.x_covariance / np.outer(KNOWN, KNOWN))
        squares.append(float(np.sum(np.linalg.solve(root, (fit.x - X) / KNOWN) ** 2)))
    assert 7.0 < float(np.mean(squares)) < 11.0


def test_many_samples_overrule_what_was_known() -> None:
    wrong = fitted(3000, 7, 0.01 * KNOWN)
    free = fitted(3000, 7, KNOWN)
    vectors = np.array([[3e4, 0.0, 1e4], [0.0, 3e4, 1e4], [1e4, 0.0, -3e4]])
    off = np.abs(calibrate(free.x, vectors) - calibrate(X, vectors)).max()
    assert off < 40.0
    assert np.abs(wrong.x - X).max() > np.abs(free.x - X).max()  # tied a hundred times as hard it stays where it was
