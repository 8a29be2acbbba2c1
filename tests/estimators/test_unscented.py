"""The unscented update against filterpy's, against a plain Kalman filter, and against its own sigma points."""

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from magcal_service.estimators.parts.unscented import (
    UnscentedWeights,
    cholesky,
    scalar_innovation,
    sigma_points,
    transformed_innovation,
)
from magcal_service.model import calibrate, without_radial_noise

STATE = np.array([4000.0, 2500.0, 4600.0, 0.04, 0.08, 0.06, 0.05, 0.04, 0.05])
SIGMA = np.array([500.0] * 3 + [0.02] * 6)
MAGNITUDE = 38_000.0


def covariance(seed: int) -> np.ndarray:
    """A full covariance with those sigmas."""
    mixed = np.random.default_rng(seed).normal(size=(9, 14))
    raw = mixed @ mixed.T
    scale = SIGMA / np.sqrt(np.diagonal(raw))
    return raw * np.outer(scale, scale)


def measured_on_the_sphere() -> np.ndarray:
    """A measured vector without any residual, where the projection changes nothing."""
    w = MAGNITUDE * np.array([0.6, -0.48, 0.64])
    return np.linalg.solve(np.eye(3) + STATE[[[3, 6, 7], [6, 4, 8], [7, 8, 5]]], w + STATE[:3])


@pytest.mark.parametrize(("alpha", "beta", "kappa"), [(1.0, 2.0, 0.0), (1.0, 0.0, 0.0), (0.5, 2.0, 3.0)])
def test_against_filterpy_on_the_same_model(alpha: float, beta: float, kappa: float) -> None:
    field, P, noise = measured_on_the_sphere(), covariance(1), 300.0**2
    residual = np.linalg.norm(calibrate(STATE, field)) - MAGNITUDE
    assert abs(residual) < 1e-6

    def squared_length(x: np.ndarray) -> np.ndarray:
        return np.array([np.sum(calibrate(x, field) ** 2)])

    points = MerweScaledSigmaPoints(9, alpha, beta, kappa, sqrt_method=lambda m: np.linalg.cholesky(m).T)
    witness = UnscentedKalmanFilter(9, 1, 1.0, squared_length, lambda x, dt: x, points)
    witness.x, witness.P, witness.Q = STATE.copy(), P.copy(), np.zeros((9, 9))
    witness.R = np.array([[4.0 * MAGNITUDE**2 * noise + 6.0 * noise**2]])
    witness.predict()
    witness.update(np.array([MAGNITUDE**2 + 3.0 * noise]))

    weights = UnscentedWeights.scaled(alpha, beta, kappa)
    innovation = scalar_innovation(STATE, cholesky(P), weights, field, MAGNITUDE, noise, noise)
    x, updated = innovation.apply(STATE, P)
    assert innovation.variance == pytest.approx(witness.S[0, 0], rel=1e-9)
    assert np.allclose(x, witness.x, rtol=1e-9)
    assert np.allclose(updated, witness.P, rtol=1e-6, atol=1e-12)


def test_the_closed_form_equals_the_transform_over_its_nineteen_points() -> None:
    P, weights, noise = covariance(2), UnscentedWeights.scaled(1.0, 2.0, 0.0), 300.0**2
    field = measured_on_the_sphere() + np.array([200.0, -350.0, 120.0])
    root = cholesky(P)
    closed = scalar_innovation(STATE, root, weights, field, MAGNITUDE, noise, noise)
    _, clean = without_radial_noise(STATE, field[None], np.array([MAGNITUDE]))
    lengths = np.array([[np.sum(calibrate(point, clean[0]) ** 2)] for point in sigma_points(STATE, root, weights)])
    shift = np.sum(calibrate(STATE, field) ** 2) - lengths[0, 0]
    variance = np.array([[4.0 * MAGNITUDE**2 * noise + 6.0 * noise**2]])
    plain = transformed_innovation(root, weights, lengths + shift, np.array([MAGNITUDE**2 + 3.0 * noise]), variance)
    assert closed.value == pytest.approx(plain.value[0], rel=1e-9)
    assert closed.variance == pytest.approx(plain.covariance[0, 0], rel=1e-9)
    assert np.allclose(closed.cross, plain.cross[:, 0], rtol=1e-9)


def test_a_linear_measurement_gives_the_kalman_update() -> None:
    P, weights = covariance(3), UnscentedWeights.scaled(1.0, 2.0, 0.0)
    rows, noise = np.random.default_rng(4).normal(size=(2, 9)) / SIGMA, np.diag([0.5, 2.0])
    root = cholesky(P)
    outputs = sigma_points(STATE, root, weights) @ rows.T
    measured = rows @ STATE + np.array([0.3, -0.8])
    x, updated = transformed_innovation(root, weights, outputs, measured, noise).apply(STATE, P)
    gain = P @ rows.T @ np.linalg.inv(rows @ P @ rows.T + noise)
    assert np.allclose(x, STATE + gain @ np.array([0.3, -0.8]), rtol=1e-9)
    assert np.allclose(updated, P - gain @ rows @ P, rtol=1e-6, atol=1e-12)


def test_updated_covariance_is_symmetric_to_the_last_bit() -> None:
    P = covariance(5)
    P = 0.5 * (P + P.T)
    weights = UnscentedWeights.scaled(1.0, 2.0, 0.0)
    innovation = scalar_innovation(STATE, cholesky(P), weights, measured_on_the_sphere(), MAGNITUDE, 9e4, 9e4)
    _, updated = innovation.apply(STATE, P)
    assert np.array_equal(updated, updated.T)


def test_a_covariance_that_lost_definiteness_to_rounding_is_restored() -> None:
    mixed = np.random.default_rng(6).normal(size=(9, 8)) * SIGMA[:, None]
    singular = mixed @ mixed.T - np.diag(1e-14 * SIGMA**2)
    factor = cholesky(singular)
    assert np.allclose(factor @ factor.T / np.outer(SIGMA, SIGMA), singular / np.outer(SIGMA, SIGMA), atol=1e-4)


def test_what_is_no_covariance_is_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        cholesky(-np.eye(9))
