"""Spin and coning against numerical integration of the equations of motion."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_sensor.attitude import Spin, triad

Z = (0.0, 0.0, 1.0)
TILTED = (0.36, -0.48, 0.8)
RATE = 7.5 * math.tau / 60.0
axes = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: sum(x * x for x in v) > 0.01)


def unit(vector: tuple[float, ...]) -> tuple[float, float, float]:
    x, y, z = (np.array(vector) / np.linalg.norm(vector)).tolist()
    return x, y, z


spins = st.builds(
    Spin,
    axis_body=axes.map(unit),
    direction_eci=axes.map(unit),
    rate_rad_s=st.floats(-2.0, 2.0),
    phase_rad=st.floats(0.0, math.tau),
    nutation_rad=st.floats(0.0, 1.2),
    inertia_ratio=st.floats(0.1, 2.0),
)


def skew(w: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


@given(spins, st.floats(0.0, 1e4))
def test_an_attitude_is_a_rotation(spin: Spin, at_s: float) -> None:
    A = spin.body_from_eci(np.array([at_s]))[0]
    np.testing.assert_allclose(A @ A.T, np.eye(3), rtol=0.0, atol=1e-12)
    assert np.linalg.det(A) == pytest.approx(1.0, abs=1e-12)


@given(spins, st.floats(0.0, 1e3))
def test_attitude_and_rate_obey_the_kinematic_equation(spin: Spin, at_s: float) -> None:
    """dA/dt = -[w x] A, with w the gyro's reading (Wertz 1978, equation 16-14)."""
    h = 1e-4
    before, now, after = spin.body_from_eci(np.array([at_s - h, at_s, at_s + h]))
    w = spin.rate_body_rad_s(np.array([at_s]))[0]
    np.testing.assert_allclose((after - before) / (2 * h), -skew(w) @ now, rtol=0.0, atol=1e-4)


@given(spins, st.floats(0.0, 1e4))
def test_the_angle_between_axis_and_momentum_is_the_nutation(spin: Spin, at_s: float) -> None:
    A = spin.body_from_eci(np.array([at_s]))[0]
    cosine = np.array(spin.axis_body) @ A @ np.array(spin.direction_eci)
    assert cosine == pytest.approx(math.cos(spin.nutation_rad), abs=1e-12)


@given(spins)
def test_the_rate_about_the_axis_is_the_one_asked_for(spin: Spin) -> None:
    rates = spin.rate_body_rad_s(np.array([0.0, 77.0]))
    np.testing.assert_allclose(rates @ np.array(spin.axis_body), spin.rate_rad_s, rtol=0.0, atol=1e-12)


@given(st.floats(0.1, 1.9), st.floats(0.0, 1.0))
def test_coning_keeps_the_angular_momentum_fixed_in_space(ratio: float, nutation: float) -> None:
    spin = Spin(TILTED, unit((1.0, 2.0, -1.0)), RATE, 0.4, 0.0, nutation, ratio)
    at_s = np.linspace(0.0, 100.0, 40)
    w, A = spin.rate_body_rad_s(at_s), spin.body_from_eci(at_s)
    along = (w @ np.array(TILTED))[:, None] * np.array(TILTED)
    momentum_body = ratio * along + (w - along)
    momentum_eci = np.einsum("nji,nj->ni", A, momentum_body)
    expected = ratio * RATE / math.cos(nutation) * np.array(spin.direction_eci)
    np.testing.assert_allclose(momentum_eci, np.tile(expected, (40, 1)), rtol=0.0, atol=1e-12)


def test_coning_against_eulers_equations_integrated_numerically() -> None:
    from scipy.integrate import solve_ivp

    spin = Spin(Z, unit((1.0, 1.0, 1.0)), RATE, 0.3, 0.0, math.radians(12.0), 0.4)
    inertia = np.array([1.0, 1.0, 0.4])

    def motion(_: float, state: np.ndarray) -> np.ndarray:
        w, A = state[:3], state[3:].reshape(3, 3)
        return np.concatenate([-np.cross(w, inertia * w) / inertia, (-skew(w) @ A).ravel()])

    start = np.concatenate([spin.rate_body_rad_s(np.array([0.0]))[0], spin.body_from_eci(np.array([0.0]))[0].ravel()])
    at_s = np.linspace(0.0, 120.0, 13)
    states = solve_ivp(motion, (0.0, 120.0), start, "DOP853", at_s, rtol=1e-11, atol=1e-12).y.T
    np.testing.assert_allclose(spin.rate_body_rad_s(at_s), states[:, :3], rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(spin.body_from_eci(at_s), states[:, 3:].reshape(-1, 3, 3), rtol=0.0, atol=1e-7)


def test_a_spin_up_reaches_its_rate_and_angle() -> None:
    spin = Spin(Z, Z, 0.2, 0.0, 1e-3)
    A = spin.body_from_eci(np.array([100.0]))[0]
    angle = 0.2 * 100.0 + 0.5e-3 * 100.0**2
    np.testing.assert_allclose(A[0], [math.cos(angle), math.sin(angle), 0.0], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(spin.rate_body_rad_s(np.array([100.0]))[0], [0.0, 0.0, 0.3], rtol=0.0, atol=1e-12)


def test_a_positive_rate_turns_body_x_towards_body_y() -> None:
    """Spin about z in space: after a quarter turn body x points where inertial y does."""
    A = Spin(Z, Z, math.pi / 2.0).body_from_eci(np.array([1.0]))[0]
    np.testing.assert_allclose(A @ np.array([0.0, 1.0, 0.0]), [1.0, 0.0, 0.0], rtol=0.0, atol=1e-12)


def test_the_fastest_rate_bounds_the_gyro() -> None:
    spin = Spin(TILTED, Z, -0.3, 0.0, 0.0, 0.5, 1.6)
    rates = np.linalg.norm(spin.rate_body_rad_s(np.linspace(0.0, 100.0, 200)), axis=1)
    assert rates.max() == pytest.approx(spin.fastest_rad_s(100.0), rel=1e-12)


@given(axes)
def test_a_triad_is_right_handed_with_the_axis_as_its_third(axis: tuple[float, float, float]) -> None:
    rows = triad(axis)
    np.testing.assert_allclose(rows @ rows.T, np.eye(3), rtol=0.0, atol=1e-12)
    assert np.linalg.det(rows) > 0.0
    np.testing.assert_allclose(rows[2], unit(axis), rtol=0.0, atol=1e-12)
