"""The measurement model against its own equations, numeric derivatives and simulated noise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_service.model import (
    calibrate,
    d_matrix,
    field_jacobian,
    mean_of_v,
    measure,
    predicted_scalar,
    scalar_jacobian,
    scalar_measurement,
    scalar_residual,
    state_of,
    variance_of_v,
    vector_jacobian,
    without_radial_noise,
)

TABLE_1 = np.array([5000.0, 3000.0, 4000.0, 0.05, 0.10, 0.05, 0.05, 0.05, 0.05])


def directions(rng: np.random.Generator, n: int) -> np.ndarray:
    vectors = rng.normal(size=(n, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


states = st.tuples(
    *[st.floats(-30_000.0, 30_000.0)] * 3,
    *[st.floats(-0.2, 0.2)] * 6,
).map(np.array)
fields = st.tuples(*[st.floats(-60_000.0, 60_000.0)] * 3).map(np.array)


@given(states, fields)
def test_calibration_undoes_the_measurement(x: np.ndarray, field: np.ndarray) -> None:
    assert np.allclose(calibrate(x, measure(x, field)), field, atol=1e-6)


@given(states, fields)
def test_equation_4_is_the_difference_of_squared_lengths(x: np.ndarray, field: np.ndarray) -> None:
    w = calibrate(x, field)
    assert np.isclose(predicted_scalar(x, field), field @ field - w @ w, rtol=1e-9, atol=1e-2)


@given(states, fields)
def test_the_calibrated_vector_is_affine_in_the_state(x: np.ndarray, field: np.ndarray) -> None:
    assert np.allclose(field + field_jacobian(field) @ x, calibrate(x, field), atol=1e-6)


@given(states)
def test_state_and_matrices_convert_both_ways(x: np.ndarray) -> None:
    assert np.array_equal(state_of(x[:3], d_matrix(x)), x)


def test_scalar_jacobian_equals_the_numeric_derivative() -> None:
    field = np.array([21_000.0, -13_000.0, 34_000.0])
    steps = np.array([1e-2] * 3 + [1e-6] * 6)
    numeric = [
        (predicted_scalar(TABLE_1 + s * e, field) - predicted_scalar(TABLE_1 - s * e, field)) / (2.0 * s)
        for s, e in zip(steps, np.eye(9), strict=True)
    ]
    assert np.allclose(scalar_jacobian(TABLE_1, field), numeric, rtol=1e-6)


@pytest.mark.parametrize("noise_nt", [300.0, 2000.0, 20_000.0])
def test_mean_and_variance_of_v_hold_for_simulated_noise(noise_nt: float) -> None:
    rng = np.random.default_rng(11)
    truth = 40_000.0 * directions(rng, 400_000)
    measured = measure(TABLE_1, truth + noise_nt * rng.normal(size=truth.shape))
    magnitude = np.full(len(truth), 40_000.0)
    v = scalar_measurement(measured, magnitude) - predicted_scalar(TABLE_1, measured)
    mean, variance = mean_of_v(noise_nt**2), variance_of_v(magnitude, noise_nt**2)
    assert v.mean() == pytest.approx(mean, abs=4.0 * np.sqrt(variance[0] / len(v)))
    assert v.var() == pytest.approx(variance[0], rel=0.01)


def test_projected_vectors_have_the_known_magnitude_and_belong_to_their_measured_vectors() -> None:
    rng = np.random.default_rng(12)
    truth = 40_000.0 * directions(rng, 50)
    measured = measure(TABLE_1, truth + 300.0 * rng.normal(size=truth.shape))
    w_hat, b_hat = without_radial_noise(TABLE_1, measured, np.full(50, 40_000.0))
    assert np.allclose(np.linalg.norm(w_hat, axis=1), 40_000.0)
    assert np.allclose(calibrate(TABLE_1, b_hat), w_hat)


def test_a_sensitivity_at_projected_vectors_does_not_correlate_with_the_residual() -> None:
    """At measured vectors the mean product is the radial noise variance, 90 000 nT^2; projected, it is gone."""
    rng = np.random.default_rng(13)
    truth = np.tile([0.0, 0.0, 40_000.0], (400_000, 1))
    measured = measure(TABLE_1, truth + 300.0 * rng.normal(size=truth.shape))
    magnitude = np.full(len(truth), 40_000.0)
    residual = scalar_residual(TABLE_1, measured, magnitude)
    plain = np.mean(calibrate(TABLE_1, measured)[:, 2] * (residual - residual.mean()))
    clean = np.mean(without_radial_noise(TABLE_1, measured, magnitude)[0][:, 2] * (residual - residual.mean()))
    assert plain == pytest.approx(300.0**2, rel=0.02)
    assert abs(clean) < 0.02 * 300.0**2


@given(fields)
def test_the_jacobian_of_one_vector_is_that_of_many(field: np.ndarray) -> None:
    assert np.array_equal(vector_jacobian(*field.tolist()), field_jacobian(field))
