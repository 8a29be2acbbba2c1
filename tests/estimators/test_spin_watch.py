"""The watch over a running spin: quiet on noise, and each way of losing the spin is named."""

import numpy as np
import pytest

from magcal_service.estimators.steady_spin.fit import SpinFit
from magcal_service.estimators.steady_spin.state import Innovation, SpinState, turned, turned_once
from magcal_service.estimators.steady_spin.watch import SpinGate, SpinWatch, fit_quality

NOISE_NT = 300.0
RATE = np.array([0.0, 0.0, 0.785])
FIELD_ECI = np.array([20_000.0, -15_000.0, 30_000.0])


def attitude(index: int) -> np.ndarray:
    return turned_once(RATE, float(index))[0]


def innovation(value: np.ndarray, body_from_eci: np.ndarray) -> Innovation:
    covariance = NOISE_NT**2 * np.eye(3)
    return Innovation(value, body_from_eci @ FIELD_ECI, covariance, np.zeros((15, 3)), value / NOISE_NT**2)


def lost_after(watch: SpinWatch, count: int, tilt_eci_rad: np.ndarray, across: float = 1.0) -> int | None:
    """Samples until the spin is lost: attitude tilted in space, noise ``across`` times larger off the field."""
    rng = np.random.default_rng(1)
    unit = FIELD_ECI / np.linalg.norm(FIELD_ECI)
    for index in range(count):
        noise = NOISE_NT * rng.normal(size=3)
        along = unit * (noise @ unit)
        space = along + across * (noise - along) + np.cross(FIELD_ECI, tilt_eci_rad)
        turn = attitude(index)
        if watch.accepted(innovation(turn @ space, turn), turn) is SpinGate.INCONSISTENT:
            return index
    return None


def test_noise_is_left_alone_for_hours() -> None:
    assert lost_after(SpinWatch(), 10_000, np.zeros(3)) is None


def test_noise_of_another_level_is_left_alone() -> None:
    watch, rng = SpinWatch(), np.random.default_rng(2)
    gates = {
        watch.accepted(innovation(3.0 * NOISE_NT * rng.normal(size=3), attitude(i)), attitude(i)) for i in range(5000)
    }
    assert gates == {None}


def test_more_noise_across_the_field_than_along_it_loses_the_spin() -> None:
    index = lost_after(SpinWatch(), 2000, np.zeros(3), across=1.7)
    assert index is not None
    assert index < 400


def test_an_attitude_that_stays_tilted_in_space_loses_the_spin() -> None:
    assert lost_after(SpinWatch(), 2000, np.array([0.0, 3e-3, 0.0])) is not None


def test_a_strong_tilt_is_found_in_the_first_block() -> None:
    assert lost_after(SpinWatch(), 2000, np.array([0.0, 8e-3, 0.0])) == 127


def test_thirty_rejections_in_a_row_lose_the_spin() -> None:
    watch = SpinWatch()
    assert [watch.rejected() for _ in range(30)] == [None] * 29 + [SpinGate.INCONSISTENT]


def test_rejections_right_after_a_gap_mean_a_lost_phase() -> None:
    watch = SpinWatch()
    watch.gap()
    assert [watch.rejected() for _ in range(3)] == [None, None, SpinGate.PHASE_LOST]


def test_a_phase_that_held_over_the_gap_is_not_lost_by_later_rejections() -> None:
    watch = SpinWatch()
    watch.gap()
    watch.accepted(innovation(np.zeros(3) + 1.0, attitude(0)), attitude(0))
    assert [watch.rejected() for _ in range(3)] == [None] * 3


def fit_with(tilt_eci_rad: np.ndarray) -> SpinFit:
    times = np.arange(2000.0)
    attitudes = turned(RATE, times)[0]
    noise = NOISE_NT * np.random.default_rng(3).normal(size=(2000, 3))
    residual = noise + attitudes @ np.cross(FIELD_ECI, tilt_eci_rad)
    residual_eci = np.einsum("nji,nj->ni", attitudes, residual)
    state = SpinState(np.zeros(9), np.eye(3), RATE, np.eye(15))
    return SpinFit(state, residual, residual_eci, attitudes @ FIELD_ECI)


@pytest.mark.parametrize(("tilt_rad", "steady"), [(0.0, True), (3e-3, False)])
def test_a_fit_is_steady_when_its_residual_is_noise(tilt_rad: float, steady: bool) -> None:
    assert fit_quality(fit_with(np.array([tilt_rad, 0.0, 0.0]))).steady is steady
