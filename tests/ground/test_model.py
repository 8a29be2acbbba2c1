"""The measurement model against its own equations, numeric derivatives and simulated noise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_service.model import (
    BIAS,
    D_ALL,
    D_SCALE,
    STATE_NAMES,
    STATE_SIZE,
    adjugate_product,
    calibrate,
    calibrated_components,
    d_matrix,
    field_jacobian,
    largest_variance,
    magnitude_jacobian,
    mean_of_v,
    measure,
    scalar_innovation_value,
    scalar_residual,
    state_of,
    variance_of_v,
    vector_jacobian,
    without_radial_noise,
)
from tests.equations import predicted_scalar, scalar_jacobian, scalar_measurement

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


def test_a_magnitudes_jacobian_is_the_vectors_along_its_direction() -> None:
    rng = np.random.default_rng(8)
    fields, unit = rng.uniform(-60_000.0, 60_000.0, size=(20, 3)), directions(rng, 20)
    expected = np.einsum("ni,nij->nj", unit, field_jacobian(fields))
    assert np.allclose(magnitude_jacobian(fields, unit), expected, rtol=1e-12, atol=1e-9)


X = np.array([1000.0, -2000.0, 3000.0, 0.1, -0.2, 0.3, 0.04, -0.05, 0.06])
B = np.array([20_000.0, -30_000.0, 10_000.0])
MATRIX = np.array([[1.1, 0.04, -0.05], [0.04, 0.8, 0.06], [-0.05, 0.06, 1.3]])
"""I + D of ``X``, written out."""


def test_the_state_is_three_of_the_bias_and_six_of_a_symmetric_matrix_by_name() -> None:
    named = dict(zip(STATE_NAMES, X.tolist(), strict=True))
    assert (STATE_SIZE, X[BIAS].tolist(), X[D_SCALE].tolist(), X[D_ALL].tolist()) == (
        9,
        [named[name] for name in ("bx", "by", "bz")],
        [named[name] for name in ("D11", "D22", "D33")],
        [named[name] for name in ("D11", "D22", "D33", "D12", "D13", "D23")],
    )
    np.testing.assert_allclose(np.eye(3) + d_matrix(X), MATRIX, rtol=1e-15)
    assert np.array_equal(state_of(X[:3], d_matrix(np.array([X, 2.0 * X])))[1], np.r_[X[:3], 2.0 * X[3:]])


def test_the_calibrated_vector_by_hand() -> None:
    """(I + D) B - b of round numbers."""
    expected = (
        22_000.0 - 1200.0 - 500.0 - 1000.0,
        800.0 - 24_000.0 + 600.0 + 2000.0,
        -1000.0 - 1800.0 + 13_000.0 - 3000.0,
    )
    np.testing.assert_allclose(calibrate(X, B), expected, rtol=1e-12)
    matrix, w = calibrated_components(X.tolist(), B.tolist())
    np.testing.assert_allclose(w, expected, rtol=1e-12)
    np.testing.assert_allclose(matrix, MATRIX[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]], rtol=1e-15)


def test_the_adjugate_is_the_inverse_times_the_determinant() -> None:
    matrix, w = calibrated_components(X.tolist(), B.tolist())
    product, determinant = adjugate_product(matrix, w)
    assert determinant == pytest.approx(np.linalg.det(MATRIX), rel=1e-13)
    np.testing.assert_allclose(np.array(product) / determinant, np.linalg.solve(MATRIX, w), rtol=1e-12)


def test_the_measured_vector_by_equation_1() -> None:
    field = np.array([[4000.0, 5000.0, -6000.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(measure(X, field), (np.linalg.inv(MATRIX) @ (field + X[:3]).T).T, rtol=1e-12)
    assert measure(X, field[0]).shape == (3,)


def test_scalars_of_one_sample_by_hand() -> None:
    """|B|^2 = 1.4e9, so equation (2) at |H| = 30 000 is 5e8, and the residual is the difference of the lengths."""
    assert scalar_measurement(B, np.float64(30_000.0)) == 5e8
    w = calibrate(X, B)
    assert scalar_residual(X, B, np.float64(30_000.0)) == pytest.approx(np.sqrt(w @ w) - 30_000.0, rel=1e-12)


def test_the_innovation_is_equation_4_less_the_measurement() -> None:
    magnitude, variance = np.float64(21_000.0), 300.0**2
    length = float(np.linalg.norm(calibrate(X, B)))
    expected = predicted_scalar(X, B) + 3.0 * variance - scalar_measurement(B, magnitude)
    value = scalar_innovation_value(length - magnitude, length, magnitude, variance)
    assert value == pytest.approx(expected, rel=1e-9)


def test_moments_of_v_by_hand() -> None:
    """s = 100 nT, |H| = 20 000 nT: 3 s^2, and 4 |H|^2 s^2 + 6 s^4 = 1.6e13 + 6e8."""
    assert mean_of_v(1e4) == 3e4
    assert variance_of_v(20_000.0, 1e4) == 16_000_600_000_000.0


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_so_much_of_the_residual_is_taken_out_as_is_noise(share: float) -> None:
    """The direction stays, the length moves by the share of the residual, and B_hat belongs to it."""
    w = calibrate(X, B)
    length, magnitude = np.linalg.norm(w), 21_000.0
    w_hat, b_hat = without_radial_noise(X, B[None], np.array([magnitude]), share)
    expected = w / length * (length - share * (length - magnitude))
    np.testing.assert_allclose(w_hat[0], expected, rtol=1e-12)
    np.testing.assert_allclose(b_hat[0], np.linalg.solve(MATRIX, expected + X[:3]), rtol=1e-12)


def test_the_largest_variance_of_a_vector_by_hand() -> None:
    """Biases of 3, 4, 5 nT, and D33 of 1e-3 at 20 uT along z: 25 and 400 nT^2 there, more than along x and y."""
    covariance = np.diag([9.0, 16.0, 25.0, 0.0, 0.0, 1e-6, 0.0, 0.0, 0.0])
    assert largest_variance(covariance, np.array([0.0, 0.0, 2e4])) == pytest.approx(425.0)
