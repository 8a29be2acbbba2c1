"""The parts of the spin estimator against their formulas written out, and its limits from both sides."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magcal_service.estimators.steady_spin import fit as fit_module
from magcal_service.estimators.steady_spin.fit import AxisTie, Prior, Samples, contradiction, fit_spin
from magcal_service.estimators.steady_spin.state import (
    SpinState,
    cross_matrix,
    spin_estimate,
    turned,
    turned_once,
    walk_variance,
)
from magcal_service.model import field_jacobian, measure
from tests.estimators.spin_states import RATE, SCALE, X, attitude, covariance, state

MATRIX = np.eye(3) + X[np.array([[3, 6, 7], [6, 4, 8], [7, 8, 5]])]


H = np.array([21_000.0, -14_000.0, 33_000.0])


# State


def test_a_cross_matrix_multiplies_as_the_cross_product() -> None:
    rng = np.random.default_rng(2)
    v, u = rng.normal(size=(2, 4, 3))
    np.testing.assert_allclose(np.einsum("nij,nj->ni", cross_matrix(v), u), np.cross(v, u), atol=1e-12)


@pytest.mark.parametrize("seconds", [0.0, 1e-5, 0.7, -3.0, 40.0])
def test_turns_are_rotations_and_their_integral(seconds: float) -> None:
    """exp(-[w t x]) is the inverse of the rotation by w t; its integral by Simpson's rule over 2000 steps."""
    rotation, integral = turned(RATE, seconds)
    np.testing.assert_allclose(rotation, Rotation.from_rotvec(RATE * seconds).as_matrix().T, atol=1e-12)
    grid = np.linspace(0.0, seconds, 2001)
    values = Rotation.from_rotvec(RATE * grid[:, None]).as_matrix().transpose(0, 2, 1)
    weights = np.r_[1.0, np.tile([4.0, 2.0], 999), 4.0, 1.0] * seconds / 6000.0
    np.testing.assert_allclose(integral, np.einsum("n,nij->ij", weights, values), atol=1e-9)
    for fast, plain in zip(turned_once(RATE, seconds), (rotation, integral), strict=True):
        np.testing.assert_allclose(fast, plain, atol=1e-12)


def test_a_craft_that_hardly_turns_stays_and_integrates_time() -> None:
    rotation, integral = turned_once(np.zeros(3), 5.0)
    np.testing.assert_allclose(rotation, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(integral, 5.0 * np.eye(3), atol=1e-9)
    rotation, integral = turned(np.zeros(3), np.array([5.0]))
    np.testing.assert_allclose(integral[0], 5.0 * np.eye(3), atol=1e-9)


@pytest.mark.parametrize(("seconds", "walks"), [(2.0, True), (-2.0, False), (0.0, False)])
def test_walks_add_to_the_covariance_of_the_turned_state(seconds: float, walks: bool) -> None:
    """Errors by their variance per second; the rate by q^2 t, and the attitude by q^2 t^3 / 3."""
    error_walk, rate_walk = np.arange(1.0, 10.0) * 1e-3, 1e-5
    plain, walking = state(), state()
    plain.predict(seconds, None, 0.0)
    walking.predict(seconds, error_walk, rate_walk)
    gained = np.concatenate([error_walk * seconds, np.full(3, 1e-10 * seconds**3 / 3.0), np.full(3, 1e-10 * seconds)])
    np.testing.assert_allclose(
        (walking.covariance - plain.covariance) / np.outer(SCALE, SCALE),
        np.diag(gained if walks else np.zeros(15)) / np.outer(SCALE, SCALE),
        atol=1e-9,
    )
    np.testing.assert_allclose(walk_variance(2.0, error_walk, rate_walk)[:9], error_walk * 2.0, rtol=1e-12)
    assert not walk_variance(2.0, None, 0.0).any()
    np.testing.assert_allclose(walking.body_from_eci, turned_once(RATE, seconds)[0] @ attitude(), atol=1e-12)


def test_a_rate_walk_alone_is_added_too() -> None:
    plain, walking = state(), state()
    plain.predict(3.0, None, 0.0)
    walking.predict(3.0, None, 1e-3)
    assert walking.covariance[12, 12] - plain.covariance[12, 12] == pytest.approx(3e-6, rel=1e-6)


def jacobian(one: SpinState, reference: np.ndarray) -> np.ndarray:
    """(I + D) [-J(B_pred), [R H x], 0] with the sign of dB_pred: (3, 15)."""
    in_body = one.body_from_eci @ reference
    predicted = np.linalg.solve(MATRIX, in_body + X[:3])
    return np.hstack([-field_jacobian(predicted), cross_matrix(in_body), np.zeros((3, 3))])


def test_an_innovation_and_its_update_by_the_kalman_formulas() -> None:
    one, field, noise = state(), measure(X, attitude() @ H + [100.0, -200.0, 50.0]), 300.0**2
    before = one.covariance.copy()
    found = one.innovation(field, H, noise)
    g = jacobian(one, H)
    spread = g @ before @ g.T + noise * np.eye(3)
    np.testing.assert_allclose(one.jacobian(H), g, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.value, [100.0, -200.0, 50.0], atol=1e-6)
    np.testing.assert_allclose(found.field_body_nt, attitude() @ H, rtol=1e-12)
    np.testing.assert_allclose(found.covariance, spread, rtol=1e-9)
    np.testing.assert_allclose(found.cross, before @ g.T, rtol=1e-9, atol=1e-9)
    assert found.squared_norm() == pytest.approx(float(found.value @ np.linalg.solve(spread, found.value)), rel=1e-9)
    gain = before @ g.T @ np.linalg.inv(spread)
    step = gain @ found.value
    one.apply(found)
    np.testing.assert_allclose((one.x - X) / SCALE[:9], step[:9] / SCALE[:9], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(one.rate_rad_s, RATE + step[12:], rtol=1e-9)
    np.testing.assert_allclose(
        one.body_from_eci, Rotation.from_rotvec(step[9:12]).as_matrix().T @ attitude(), atol=1e-12
    )
    np.testing.assert_allclose(
        one.covariance / np.outer(SCALE, SCALE), (before - gain @ g @ before) / np.outer(SCALE, SCALE), atol=1e-7
    )
    assert np.array_equal(one.covariance, one.covariance.T)


def test_what_a_covariance_says_of_the_spin() -> None:
    """Rate along the axis; the axis in the body by the rate across it, and in space by the attitude beside it."""
    one = state()
    found = spin_estimate(one, 7.0, consistent=False)
    rate = float(np.linalg.norm(RATE))
    axis = RATE / rate
    across = np.eye(3) - np.outer(axis, axis)
    P = one.covariance
    assert (found.time_s, found.consistent, found.rate_rad_s) == (7.0, False, pytest.approx(rate, rel=1e-12))
    assert found.rate_sigma_rad_s == pytest.approx(math.sqrt(axis @ P[12:, 12:] @ axis), rel=1e-9)
    np.testing.assert_allclose(found.axis_body, axis, rtol=1e-12)
    np.testing.assert_allclose(found.axis_eci, attitude().T @ axis, rtol=1e-12)
    in_body = across @ P[12:, 12:] @ across / rate**2
    assert found.axis_body_sigma_rad == pytest.approx(math.sqrt(np.linalg.eigvalsh(in_body)[-1]), rel=1e-9)
    rows = np.hstack([-cross_matrix(axis), across / rate])
    in_space = rows @ P[9:, 9:] @ rows.T
    assert found.axis_eci_sigma_rad == pytest.approx(math.sqrt(np.linalg.eigvalsh(in_space)[-1]), rel=1e-9)
    assert found.attitude_sigma_rad == pytest.approx(math.sqrt(np.linalg.eigvalsh(P[9:12, 9:12])[-1]), rel=1e-12)


# Fit


def samples(count: int = 50, noise_nt: float = 0.0) -> Samples:
    """Vectors of a craft that is in ``state`` at the end."""
    rng = np.random.default_rng(3)
    times = np.sort(rng.uniform(-60.0, 0.0, count))
    times[-1] = 0.0
    reference = H + 9000.0 * np.stack([np.sin(times / 20.0), np.cos(times / 30.0), np.sin(times / 15.0)], axis=1)
    turns = turned(RATE, times)[0] @ attitude()
    field = np.einsum("nij,nj->ni", turns, reference) + noise_nt * rng.normal(size=(count, 3))
    return Samples(times, measure(X, field), reference)


def test_the_sums_of_a_fit_are_those_of_its_rows() -> None:
    """Rows (I + D) dB_pred / dstate at each sample's own attitude, an error of the rate carried to its time."""
    one, some = state(), samples(noise_nt=300.0)
    pieces = fit_module._pieces(some)
    turned_samples = fit_module._Turned.of(one, *pieces[0])
    rotations, integrals = turned(RATE, some.times_s)
    expected = np.zeros((16, 16))
    for row in range(50):
        in_body = rotations[row] @ attitude() @ some.reference_eci_nt[row]
        predicted = np.linalg.solve(MATRIX, in_body + X[:3])
        y = MATRIX @ some.field_nt[row] - X[:3] - in_body
        g = np.hstack(
            [
                -field_jacobian(predicted),
                cross_matrix(in_body) @ rotations[row],
                cross_matrix(in_body) @ integrals[row],
                y[:, None],
            ]
        )
        expected += g.T @ g
        np.testing.assert_allclose(turned_samples.residual_nt[:, row], y, atol=1e-6)
        np.testing.assert_allclose(
            turned_samples.residual_eci_nt(attitude())[:, row], (rotations[row] @ attitude()).T @ y, atol=1e-6
        )
    scale = np.sqrt(np.diagonal(expected))
    np.testing.assert_allclose(
        turned_samples.sums() / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-9
    )


def test_a_craft_at_rest_stays_where_it_is_and_an_error_of_its_rate_turns_it_with_time() -> None:
    some = samples()
    rest = SpinState(X, attitude(), np.zeros(3), covariance())
    times, measured, reference = fit_module._pieces(some)[0]
    found = fit_module._Turned.of(rest, times, measured, reference)
    np.testing.assert_allclose(found.field_nt, attitude() @ some.reference_eci_nt.T, atol=1e-9)
    np.testing.assert_allclose(found.turns[0], np.broadcast_to(np.eye(3)[:, :, None], found.turns[0].shape), atol=1e-9)
    np.testing.assert_allclose(found.turns[1], np.eye(3)[:, :, None] * some.times_s, atol=1e-9)


def test_a_fit_to_clean_samples_finds_their_state_and_the_covariance_of_its_rows() -> None:
    some = samples(400)
    start = state()
    start.correct(np.concatenate([[300.0, -200.0, 100.0], np.full(6, 3e-3), [0.02, -0.03, 0.01], [1e-4, -2e-4, 1e-4]]))
    prior = Prior(np.zeros(9), np.diag([3e6**2] * 3 + [20.0**2] * 6))
    found = fit_spin(some, start, prior, 300.0)
    assert found is not None
    np.testing.assert_allclose((found.state.x - X) / SCALE[:9], 0.0, atol=1e-2)
    np.testing.assert_allclose(found.state.body_from_eci, attitude(), atol=1e-5)
    np.testing.assert_allclose(found.state.rate_rad_s, RATE, atol=1e-7)
    assert np.abs(found.residual_nt).max() < 1.0
    sums = np.zeros((15, 15))
    for piece in fit_module._pieces(some):
        sums += fit_module._Turned.of(found.state, *piece).sums()[:15, :15]
    sums /= 300.0**2
    sums[:9, :9] += np.linalg.inv(prior.covariance)
    scale = np.sqrt(np.diagonal(found.state.covariance))
    np.testing.assert_allclose(found.state.covariance @ sums * scale / scale[:, None], np.eye(15), atol=1e-4)


def test_a_fit_weighs_the_prior_against_the_samples() -> None:
    """Where both are linear: the state moves from the samples' to the prior's by their covariances."""
    some = samples(400)
    free = fit_spin(some, state(), Prior(np.zeros(9), np.diag([3e6**2] * 3 + [20.0**2] * 6)), 300.0)
    assert free is not None
    shift = np.array([30.0, -20.0, 10.0] + [1e-4] * 6)
    prior = Prior(X + shift, np.diag([20.0**2] * 3 + [2e-4**2] * 6))
    tied = fit_spin(some, state(), prior, 300.0)
    assert tied is not None
    own = free.state.covariance[:9, :9]
    expected = X + own @ np.linalg.solve(own + prior.covariance, shift)
    np.testing.assert_allclose((tied.state.x - expected) / SCALE[:9], 0.0, atol=0.05)
    left = np.linalg.inv(np.linalg.inv(own) + np.linalg.inv(prior.covariance))
    sigma = np.sqrt(np.diagonal(left))
    np.testing.assert_allclose(np.sqrt(np.diagonal(tied.state.covariance)[:9]) / sigma, 1.0, rtol=0.02)


def test_a_fit_over_many_pieces_is_that_of_one(monkeypatch: pytest.MonkeyPatch) -> None:
    some, prior = samples(100, 100.0), Prior(np.zeros(9), np.diag([3e4**2] * 3 + [0.2**2] * 6))
    whole = fit_spin(some, state(), prior, 300.0)
    monkeypatch.setattr(fit_module, "_PIECE", 7)
    parts = fit_spin(some, state(), prior, 300.0)
    assert whole is not None
    assert parts is not None
    np.testing.assert_allclose(parts.state.x, whole.state.x, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(parts.residual_nt, whole.residual_nt, atol=1e-3)
    np.testing.assert_allclose(parts.field_body_nt, whole.field_body_nt, atol=1e-3)
    assert len(fit_module._pieces(some)) == 15


def test_a_known_axis_ties_the_rate_across_it() -> None:
    """A hundredth of a radian at |w|: the rate's components across the axis are that small, one sigma."""
    tie = AxisTie(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), 0.01)
    rate = np.array([0.0, 0.0, 0.5])
    np.testing.assert_allclose(tie.information(rate), np.diag([1.0, 1.0, 0.0]) / (0.01 * 0.5) ** 2, rtol=1e-12)
    off = SpinState(X, attitude(), np.array([0.01, 0.0, 0.5]), np.diag([0.0] * 12 + [0.003**2] * 3))
    allowed = 0.003**2 + 0.01**2 * (0.01**2 + 0.5**2)
    assert contradiction(off, tie) == pytest.approx(0.01**2 / allowed, rel=1e-9)


def test_a_tie_pulls_a_fit_to_the_axis() -> None:
    """Much stronger than the samples: the rate ends on the axis."""
    axis = RATE / np.linalg.norm(RATE)
    off = np.cross(axis, [1.0, 0.0, 0.0])
    off /= np.linalg.norm(off)
    tilted = axis + 1e-4 * off
    tilted /= np.linalg.norm(tilted)
    first = np.cross(tilted, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first)
    tie = AxisTie(np.stack([first, np.cross(tilted, first)]), 1e-9)
    found = fit_spin(samples(200), state(), Prior(X, np.diag([1e2] * 3 + [1e-6] * 6)), 300.0, tie)
    assert found is not None
    turned_axis = found.state.rate_rad_s / np.linalg.norm(found.state.rate_rad_s)
    assert float(np.linalg.norm(np.cross(turned_axis, tilted))) < 1e-8


@pytest.mark.parametrize(
    ("step", "expected"),
    [
        ([0.1, -0.3, 0.2, 0.0, 0.0, 0.0], 0.3),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 0.01], 0.6),  # along the axis: it adds up over 60 s
        ([0.0, 0.0, 0.0, 0.01, 0.0, 0.0], 0.04),  # across: at most 2 / |w| of it
        ([0.0, 0.0, 0.0, 0.03, 0.04, 0.0], 0.2),
        ([0.0, 0.0, 0.0, 0.04, 0.0, 0.001], 0.16),
        ([0.0, 0.0, 0.0, 0.003, 0.004, -0.01], 0.6),
    ],
)
def test_how_far_a_step_turns_the_attitude(step: list[float], expected: float) -> None:
    whole = np.concatenate([np.zeros(9), step])
    assert fit_module._turn_of(whole, np.array([0.0, 0.0, 0.5]), 60.0) == pytest.approx(expected, rel=1e-9)


def test_across_a_slow_axis_a_rate_tilts_for_the_span_alone() -> None:
    step = np.concatenate([np.zeros(12), [0.01, 0.0, 0.0]])
    assert fit_module._turn_of(step, np.array([0.0, 0.0, 0.5]), 3.0) == pytest.approx(0.03, rel=1e-9)


def test_parts_of_samples() -> None:
    some = Samples(
        np.array([-9.0, -6.0, -3.0, -1.0, 0.0]), np.arange(15.0).reshape(5, 3), -np.arange(15.0).reshape(5, 3)
    )
    assert some.newest(3.0).times_s.tolist() == [-3.0, -1.0, 0.0]
    assert some.newest(3.1).field_nt.tolist() == some.field_nt[2:].tolist()
    assert some.thinned(5).times_s.tolist() == some.times_s.tolist()
    assert some.thinned(4).times_s.tolist() == [-9.0, -3.0, 0.0]
    assert some.thinned(2).reference_eci_nt.tolist() == some.reference_eci_nt[::3].tolist()
    assert some.where(some.times_s > -4.0).times_s.tolist() == [-3.0, -1.0, 0.0]
    assert (some.period_s(), some.span_s) == (2.5, 9.0)
    one, none = some.newest(0.0), some.where(np.zeros(5, dtype=bool))
    assert (one.period_s(), one.span_s, none.span_s) == (1.0, 0.0, 0.0)
