"""The spin filter's state: kinematics, derivatives and what its covariance says."""

import numpy as np
import pytest

from magcal_service.estimators.steady_spin.state import (
    ATTITUDE,
    RATE,
    SPIN_STATE_SIZE,
    SpinState,
    spin_estimate,
    turned,
    turned_once,
)
from magcal_service.model import d_matrix, measure
from tests.estimators.estimator_ticks import TABLE_1

RATE_RAD_S = np.array([0.1, -0.5, 0.7])
REFERENCE = np.array([21_000.0, -14_000.0, 33_000.0])


def state(covariance: np.ndarray | None = None) -> SpinState:
    attitude = turned_once(np.array([0.4, 1.1, -0.7]), 1.0)[0]
    return SpinState(TABLE_1, attitude, RATE_RAD_S, np.eye(SPIN_STATE_SIZE) if covariance is None else covariance)


def moved(by: np.ndarray) -> SpinState:
    changed = state()
    changed.correct(by)
    return changed


def random_covariance(seed: int) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(SPIN_STATE_SIZE, SPIN_STATE_SIZE))
    scale = np.concatenate([np.full(3, 10.0), np.full(6, 1e-3), np.full(3, 1e-3), np.full(3, 1e-4)])
    return root @ root.T * np.outer(scale, scale)


def test_the_jacobian_is_the_derivative_of_the_predicted_vector() -> None:
    matrix = np.eye(3) + d_matrix(TABLE_1)
    numeric = np.empty((3, SPIN_STATE_SIZE))
    for i, step in enumerate(np.repeat([1.0, 1e-5, 1e-6, 1e-6], [3, 6, 3, 3])):
        by = np.zeros(SPIN_STATE_SIZE)
        by[i] = step
        plus, minus = (measure(s.x, s.body_from_eci @ REFERENCE) for s in (moved(by), moved(-by)))
        numeric[:, i] = matrix @ (plus - minus) / (2.0 * step)
    assert state().jacobian(REFERENCE) == pytest.approx(numeric, rel=1e-5, abs=1e-3)


@pytest.mark.parametrize("part", [ATTITUDE, RATE], ids=["attitude", "rate"])
def test_the_prediction_carries_an_attitude_or_rate_error_as_the_kinematics_do(part: slice) -> None:
    by = np.zeros(SPIN_STATE_SIZE)
    by[part] = [1e-6, -2e-6, 1.5e-6]
    start = np.outer(by, by)
    straight, off = state(start), moved(by)
    straight.predict(7.3, None, 0.0)
    off.predict(7.3, None, 0.0)
    skew = np.eye(3) - off.body_from_eci @ straight.body_from_eci.T  # [theta x]
    theta = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    assert straight.covariance[ATTITUDE, ATTITUDE] == pytest.approx(np.outer(theta, theta), rel=1e-3, abs=1e-16)


@pytest.mark.parametrize("seconds", [0.0, 1e-6, 0.02, 1.0, -50.0])
def test_the_fast_rotation_equals_the_plain_one(seconds: float) -> None:
    for fast, plain in zip(turned_once(RATE_RAD_S, seconds), turned(RATE_RAD_S, seconds), strict=True):
        assert fast == pytest.approx(plain, rel=1e-12, abs=1e-13)


def test_the_integral_is_that_of_the_rotation() -> None:
    times = np.linspace(0.0, 5.0, 20_001)
    rotations, integrals = turned(RATE_RAD_S, times)
    trapezoid = (rotations[:-1] + rotations[1:]).sum(axis=0) * 0.5 * (times[1] - times[0])
    assert integrals[-1] == pytest.approx(trapezoid, abs=1e-7)


def test_the_attitude_stays_a_rotation_over_a_day() -> None:
    turning = state()
    for _ in range(86_400):
        turning.body_from_eci = turned_once(RATE_RAD_S, 1.0)[0] @ turning.body_from_eci
    turning.predict(1.0, None, 0.0)
    assert turning.body_from_eci @ turning.body_from_eci.T == pytest.approx(np.eye(3), abs=1e-14)


def test_a_vector_without_noise_is_predicted_to_the_last_digits() -> None:
    truth = state()
    field = measure(TABLE_1, truth.body_from_eci @ REFERENCE)
    assert truth.innovation(field, REFERENCE, 1.0).value == pytest.approx(np.zeros(3), abs=1e-9)


def test_an_update_leaves_what_the_information_form_leaves() -> None:
    covariance = random_covariance(1)
    updated = state(covariance)
    innovation = updated.innovation(np.array([100.0, 200.0, 300.0]), REFERENCE, 300.0**2)
    rows = updated.jacobian(REFERENCE)
    updated.apply(innovation)
    expected = np.linalg.inv(np.linalg.inv(covariance) + rows.T @ rows / 300.0**2)
    assert updated.covariance == pytest.approx(expected, rel=1e-5, abs=1e-14)


def test_process_noise_of_the_rate_turns_into_attitude() -> None:
    walking = state(np.zeros((SPIN_STATE_SIZE, SPIN_STATE_SIZE)))
    for _ in range(100):
        walking.predict(1.0, None, 1e-6)
    along = RATE_RAD_S / np.linalg.norm(RATE_RAD_S)
    variance = float(along @ walking.covariance[ATTITUDE, ATTITUDE] @ along)
    assert variance == pytest.approx(1e-12 * 100.0**3 / 3.0, rel=0.02)


@pytest.mark.parametrize("frame", ["body", "eci"])
def test_the_sigma_of_the_axis_is_the_spread_of_the_axis(frame: str) -> None:
    covariance = random_covariance(2)
    root = np.linalg.cholesky(covariance)
    rng = np.random.default_rng(3)
    nominal = spin_estimate(state(covariance), 0.0, consistent=True)
    drawn = [spin_estimate(moved(root @ rng.normal(size=SPIN_STATE_SIZE)), 0.0, consistent=True) for _ in range(4000)]
    off = np.array([getattr(one, f"axis_{frame}") - getattr(nominal, f"axis_{frame}") for one in drawn])
    spread = np.sqrt(np.linalg.eigvalsh(off.T @ off / len(off))[-1])
    assert getattr(nominal, f"axis_{frame}_sigma_rad") == pytest.approx(spread, rel=0.05)
