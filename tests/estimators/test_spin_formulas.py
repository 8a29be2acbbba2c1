"""The parts of the spin estimator against their formulas written out, and its limits from both sides."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magcal_service.base.snapshot import SnapshotError
from magcal_service.estimators.steady_spin import fit as fit_module
from magcal_service.estimators.steady_spin.fit import AxisTie, Prior, Samples, SpinFit, contradiction, fit_spin
from magcal_service.estimators.steady_spin.sample_buffer import CAPACITY, SampleBuffer
from magcal_service.estimators.steady_spin.start import _motion_about as motion_about
from magcal_service.estimators.steady_spin.start import (
    best_rotation,
    find_axis,
    rate_grid,
    wahba_gains,
)
from magcal_service.estimators.steady_spin.state import (
    Innovation,
    SpinState,
    cross_matrix,
    spin_estimate,
    turned,
    turned_once,
    walk_variance,
)
from magcal_service.estimators.steady_spin.watch import FitQuality, SpinGate, SpinWatch, fit_quality
from magcal_service.model import field_jacobian, measure

X = np.array([900.0, -1400.0, 2100.0, 0.05, -0.08, 0.11, 0.03, -0.04, 0.06])
MATRIX = np.eye(3) + X[np.array([[3, 6, 7], [6, 4, 8], [7, 8, 5]])]
RATE = np.array([0.1, -0.5, 0.7])
H = np.array([21_000.0, -14_000.0, 33_000.0])
SCALE = np.concatenate([np.full(3, 10.0), np.full(6, 1e-3), np.full(3, 1e-3), np.full(3, 1e-4)])


def covariance(seed: int = 1) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(15, 20)) * SCALE[:, None]
    return root @ root.T


def attitude() -> np.ndarray:
    return Rotation.from_rotvec([0.4, 1.1, -0.7]).as_matrix().T


def state(seed: int = 1) -> SpinState:
    return SpinState(X, attitude(), RATE, covariance(seed))


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


# Watch


def watched(value: np.ndarray, spread: np.ndarray, field: np.ndarray) -> Innovation:
    return Innovation(value, field, spread, np.zeros((15, 3)), np.linalg.solve(spread, value))


def test_the_watch_compares_across_with_along_by_running_means() -> None:
    """Its recursions written out, for 700 samples: a memory of 300, blocks of 128 means in space, 8 of them."""
    rng = np.random.default_rng(4)
    watch = SpinWatch()
    along = across = drift = 1.0
    total, variance, blocks = np.zeros(3), 0.0, 0
    for count in range(1, 701):
        mixed = rng.normal(size=(3, 4)) * 100.0
        spread, field, value = mixed @ mixed.T + 1e4 * np.eye(3), rng.normal(size=3) * 3e4, rng.normal(size=3) * 200.0
        turn = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
        unit = field / np.linalg.norm(field)
        weight = 1.0 / min(count, 300)
        along_now, along_expected = float(unit @ value) ** 2, float(unit @ spread @ unit)
        along += weight * (along_now / along_expected - along)
        across += weight * ((value @ value - along_now) / (np.trace(spread) - along_expected) - across)
        total, variance = total + turn.T @ value, variance + np.trace(spread)
        if count % 128 == 0:
            blocks = min(blocks + 1, 8)
            drift += (total @ total / (variance * along) - drift) / blocks
            total, variance = np.zeros(3), 0.0
        watch.accepted(watched(value, spread, field), turn)
        np.testing.assert_allclose([watch._along, watch._across, watch._drift], [along, across, drift], rtol=1e-9)
        assert watch._blocks == blocks


NOISE = 100.0
ISOTROPIC = NOISE**2 * np.eye(3)
FIELD = np.array([0.0, 0.0, 4e4])


def fed(watch: SpinWatch, count: int, along: float, across: float, turn: np.ndarray | None = None) -> int | None:
    """Samples of so many sigmas along and across the field, signs that alternate; which of them loses the spin."""
    for number in range(count):
        sign = (-1.0) ** number
        value = NOISE * np.array([sign * across, sign * across, sign * along])
        if watch.accepted(watched(value, ISOTROPIC, FIELD), np.eye(3) if turn is None else turn) is not None:
            return number + 1
    return None


@pytest.mark.parametrize(("ratio", "lost"), [(1.59, None), (1.61, 300)])
def test_more_across_than_along_by_1_6_loses_the_spin_after_300_samples(ratio: float, lost: int | None) -> None:
    assert fed(SpinWatch(), 400, 1.0, math.sqrt(ratio)) == lost


@pytest.mark.parametrize(("squares", "lost"), [(9.9, None), (10.1, 128)])
def test_a_block_mean_of_more_than_ten_times_its_variance_loses_the_spin(squares: float, lost: int | None) -> None:
    """A third of the mean's square over its variance: 128 samples of 1 sigma along; a constant across beside it."""
    watch = SpinWatch()
    offset = math.sqrt(3.0 * squares / 128.0)
    for number in range(130):
        value = NOISE * np.array([offset, 0.0, (-1.0) ** number])
        found = watch.accepted(watched(value, ISOTROPIC, FIELD), np.eye(3))
        if found is not None:
            assert (found, number + 1) == (SpinGate.INCONSISTENT, lost)
            return
    assert lost is None


@pytest.mark.parametrize(("squares", "lost"), [(2.75, None), (2.85, 8 * 128)])
def test_eight_blocks_at_2_8_lose_the_spin(squares: float, lost: int | None) -> None:
    watch = SpinWatch()
    offset = math.sqrt(3.0 * squares / 128.0)
    for number in range(9 * 128):
        value = NOISE * np.array([offset, 0.0, (-1.0) ** number])
        if watch.accepted(watched(value, ISOTROPIC, FIELD), np.eye(3)) is not None:
            assert number + 1 == lost
            return
    assert lost is None


def test_a_gap_begins_the_block_anew() -> None:
    watch = SpinWatch()
    fed(watch, 100, 1.0, 1.0)
    watch.gap()
    assert (watch._in_block, watch._sum_variance, watch._sum.tolist()) == (0, 0.0, [0.0, 0.0, 0.0])


@pytest.mark.parametrize(("good", "gates"), [(0, [None, None, "phase_lost"]), (1, [None, None, None])])
def test_three_rejections_right_after_a_gap_are_a_lost_phase(good: int, gates: list[str | None]) -> None:
    watch = SpinWatch()
    watch.gap()
    fed(watch, good, 1.0, 1.0)
    assert [watch.rejected() for _ in range(3)] == gates


def test_an_accepted_sample_ends_a_row_of_rejections() -> None:
    watch = SpinWatch()
    for _ in range(29):
        assert watch.rejected() is None
    fed(watch, 1, 1.0, 1.0)
    assert [watch.rejected() for _ in range(30)] == [None] * 29 + [SpinGate.INCONSISTENT]


@pytest.mark.parametrize("count", [100, 300, 1500])
def test_the_quality_of_a_fit_by_brute_force(count: int) -> None:
    """Mean squares along and across; block means of the newest whole blocks over what noise along the field leaves."""
    rng = np.random.default_rng(5)
    y, space, field = (
        rng.normal(size=(count, 3)) * 100.0,
        rng.normal(size=(count, 3)) * 120.0,
        rng.normal(size=(count, 3)) * 3e4,
    )
    found = fit_quality(SpinFit(state(), y, space, field))
    unit = field / np.linalg.norm(field, axis=1)[:, None]
    along = float(np.mean((y * unit).sum(axis=1) ** 2))
    total = float(np.mean((y**2).sum(axis=1)))
    assert found.residual_nt == pytest.approx(math.sqrt(total / 3.0), rel=1e-12)
    assert found.ratio == pytest.approx((total - along) / 2.0 / along, rel=1e-12)
    blocks = count // 128
    means = [space[count - 128 * (k + 1) : count - 128 * k].mean(axis=0) for k in range(blocks)]
    assert found.drift == pytest.approx(float(np.mean(np.square(means))) * 128.0 / along if blocks else 1.0, rel=1e-9)
    assert found.squared_sum_nt2 == pytest.approx(float((y**2).sum()), rel=1e-9)


@pytest.mark.parametrize("count", [100, 1280])
def test_a_fit_is_steady_within_five_sigmas_of_chance_and_a_margin(count: int) -> None:
    blocks = max(count // 128, 1)
    ratio, drift = 1.2 + 5.0 * math.sqrt(3.0 / count), 1.5 + 5.0 * math.sqrt(2.0 / (3.0 * blocks))
    assert FitQuality(100.0, ratio - 0.01, drift - 0.01, count).steady
    assert not FitQuality(100.0, ratio + 0.01, 1.0, count).steady
    assert not FitQuality(100.0, 1.0, drift + 0.01, count).steady


# Buffer


def rows(first: int, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    times = np.arange(first, first + count, dtype=float)
    return times, np.outer(times, [1.0, 2.0, 3.0]), np.outer(times, [4.0, 5.0, 6.0])


def test_a_buffer_gives_back_what_it_was_given_with_times_before_the_newest() -> None:
    buffer = SampleBuffer()
    for first in range(0, 1000, 7):
        buffer.add(*rows(first, 7))
    found = buffer.samples()
    assert (buffer.count, found.times_s[0], found.times_s[-1]) == (1001, -1000.0, 0.0)
    np.testing.assert_array_equal(found.field_nt, rows(0, 1001)[1])
    np.testing.assert_array_equal(found.reference_eci_nt, rows(0, 1001)[2])


def test_a_full_buffer_gives_up_its_oldest_quarter() -> None:
    buffer = SampleBuffer()
    buffer.add(*rows(0, CAPACITY - 1))
    assert not buffer.full
    buffer.add(*rows(CAPACITY - 1, 1))
    assert buffer.full
    buffer.add(*rows(CAPACITY, 2))
    assert (buffer.count, CAPACITY) == (12_288 + 2, 16_384)
    np.testing.assert_array_equal(buffer.samples().field_nt[:, 0], np.arange(4096.0, CAPACITY + 2))


def test_a_buffer_is_restored_whole() -> None:
    buffer, other = SampleBuffer(), SampleBuffer()
    buffer.add(*rows(5, 300))
    other.add(*rows(0, 9))
    other.restore_state(buffer.export_state())
    np.testing.assert_array_equal(other.samples().field_nt, buffer.samples().field_nt)
    assert other.count == 300


@pytest.mark.parametrize(
    ("shape", "fits"), [((2 * CAPACITY, 7), True), ((2 * CAPACITY + 1, 7), False), ((5, 6), False), ((7,), False)]
)
def test_a_saved_buffer_has_rows_of_seven_and_is_not_endless(shape: tuple[int, ...], fits: bool) -> None:
    saved = {"rows": [list(shape), np.zeros(shape).tobytes()]}
    if fits:
        SampleBuffer().restore_state(saved)
    else:
        with pytest.raises(SnapshotError, match="state has the shape"):
            SampleBuffer().restore_state(saved)
    with pytest.raises(SnapshotError):
        SampleBuffer().restore_state(3)


# The search from nothing


@pytest.mark.parametrize(("contrast", "found"), [(2.05, True), (1.95, False)])
def test_an_axis_stands_out_by_a_factor_of_two(contrast: float, found: bool) -> None:
    """What is left across it over what is left along it; H has no part in these vectors."""
    rng = np.random.default_rng(6)
    basis = np.linalg.qr(rng.normal(size=(60, 6)))[0]
    reference, rest = basis[:, :3] * 1e4, basis[:, 3:] * np.array([5.0, 1.0, contrast]) * 100.0
    axis = find_axis(reference @ rng.normal(size=(3, 3)) + rest, reference)
    assert (axis is not None) is found
    if axis is not None:
        np.testing.assert_allclose(np.abs(axis), [0.0, 1.0, 0.0], atol=1e-6)


@pytest.mark.parametrize(("span_s", "count"), [(100.0, 41), (99.0, 41), (1.0, 3), (102.6, 43)])
def test_trial_rates_are_a_radian_over_the_span_apart(span_s: float, count: int) -> None:
    rates = rate_grid(0.1, 0.5, span_s)
    assert (len(rates), rates[0], rates[-1]) == (count, pytest.approx(0.1), pytest.approx(0.5))
    assert count == 3 or np.diff(rates).max() * span_s <= 1.0 + 1e-9


def test_wahbas_gain_is_that_of_the_vectors_turned_back() -> None:
    """For each rate: the sum of w_k H_k' turned back by the phase; singular values with the sign of its hand."""
    rng = np.random.default_rng(7)
    axis = RATE / np.linalg.norm(RATE)
    some = Samples(-np.arange(30.0)[::-1], rng.normal(size=(30, 3)), rng.normal(size=(30, 3)))
    rates = np.array([0.3, -0.8, 0.05])
    gains, matrices = wahba_gains(some, some.field_nt, axis, rates)
    for number, rate in enumerate(rates):
        back = [Rotation.from_rotvec(axis * rate * t).as_matrix() for t in some.times_s]
        matrix = sum(
            turn @ np.outer(w, h) for turn, w, h in zip(back, some.field_nt, some.reference_eci_nt, strict=True)
        )
        np.testing.assert_allclose(matrices[number], matrix, atol=1e-9)
        one, two, three = np.linalg.svd(matrix)[1] * [1.0, 1.0, np.sign(np.linalg.det(matrix))]
        np.testing.assert_allclose(gains[number], [one + two + three, one + two - three], rtol=1e-9)
        rotation = best_rotation(matrix)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        assert np.trace(rotation.T @ matrix) == pytest.approx(one + two + three, rel=1e-9)


def test_the_motion_of_the_field_about_an_axis() -> None:
    times = np.linspace(-50.0, 0.0, 80)
    axis = np.array([0.0, 0.6, 0.8])
    start = np.array([3e4, 1e4, -2e4])
    turned_field = Rotation.from_rotvec(np.outer(0.13 * times, axis)).apply(start)
    some = Samples(times, turned_field, turned_field)
    assert motion_about(axis, some) == pytest.approx(0.13, rel=1e-9)
    assert motion_about(-axis, some) == pytest.approx(-0.13, rel=1e-9)
