"""The other methods against filters and batches written out in a few lines of numpy, and their limits."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig, SpinConfig
from magcal_service.estimators import two_step as two_step_module
from magcal_service.estimators.ekf import Ekf
from magcal_service.estimators.interface import Phase, StartGate
from magcal_service.estimators.parts.bias_only import BiasState
from magcal_service.estimators.parts.magnitude_sums import MagnitudeSums, scaled
from magcal_service.estimators.parts.noise_level import NoiseLevel
from magcal_service.estimators.plkf import Plkf
from magcal_service.estimators.rate_aided import RateAided, _RateNoise, rotation
from magcal_service.estimators.sliding_batch import SlidingBatch
from magcal_service.estimators.two_step import Solution, TwoStep, correlation_of, two_step
from magcal_service.model import calibrate, field_jacobian, measure, scalar_residual
from magcal_service.ticks.assembler import Tick
from tests.equations import predicted_scalar

X = np.array([900.0, -1400.0, 2100.0, 0.05, -0.08, 0.11, 0.03, -0.04, 0.06])
PRIOR = np.array([30_000.0] * 3 + [0.2] * 6)
NOISE_NT = 300.0
CONFIG = CraftConfig("c", SensorConfig(NOISE_NT))


def cloud(count: int, noise_nt: float = NOISE_NT, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Measured vectors in all directions (n, 3) and |H| (n,) [nT]."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    magnitude = rng.uniform(25_000.0, 50_000.0, count)
    return measure(X, direction * magnitude[:, None] + noise_nt * rng.normal(size=(count, 3))), magnitude


def ticks(field: np.ndarray, magnitude: np.ndarray, per_tick: int = 1, period_s: float = 1.0) -> list[Tick]:
    found = []
    for index, first in enumerate(range(0, len(field), per_tick)):
        part = slice(first, first + per_tick)
        times = period_s * (index + np.arange(len(field[part])) / per_tick)
        found.append(Tick(index, times, field[part], magnitude[part]))
    return found


# EKF


@pytest.mark.parametrize("per_tick", [1, 3])
def test_the_ekf_is_the_textbooks(per_tick: int) -> None:
    """h of equation (4) with its own tangent, mean and variance of v at the estimate; walks between ticks."""
    walk = np.array([2.0, 0.0, 1.0, 1e-5, 0.0, 0.0, 0.0, 2e-5, 0.0])
    filters = FilterConfig(process_noise_bias_nt=(2.0, 0.0, 1.0), process_noise_D=(1e-5, 0.0, 0.0, 0.0, 2e-5, 0.0))
    target = Ekf(replace(CONFIG, filter=filters))
    x, P, before_s, s2 = np.zeros(9), np.diag(PRIOR**2), None, NOISE_NT**2
    field, magnitude = cloud(30)
    for tick in ticks(field, magnitude, per_tick, 2.0):
        if before_s is not None:
            P = P + np.diag(walk**2) * (tick.times_s[-1] - before_s)
        before_s = tick.times_s[-1]
        squares, residuals = 0.0, []
        for b, h in zip(tick.field_body_nt, tick.reference_magnitude_nt, strict=True):
            w = calibrate(x, b)
            residuals.append(np.linalg.norm(w) - h)
            row = -2.0 * w @ field_jacobian(b)
            innovation = b @ b - h * h - predicted_scalar(x, b) - 3.0 * s2
            spread = row @ P @ row + 4.0 * w @ w * s2 + 6.0 * s2 * s2
            squares += innovation**2 / spread
            gain = P @ row / spread
            x, P = x + gain * innovation, P - np.outer(gain, gain) * spread
        outcome = target.handle(tick)
        np.testing.assert_allclose(outcome.residual_nt, residuals, rtol=1e-6, atol=1e-3)
        assert outcome.squared_innovation == pytest.approx(squares, rel=1e-6)
        assert (outcome.phase, outcome.used, outcome.degrees) == (Phase.RUNNING, per_tick, per_tick)
    state = target.estimate()
    np.testing.assert_allclose(state.x / PRIOR, x / PRIOR, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(
        state.covariance / np.outer(PRIOR, PRIOR), P / np.outer(PRIOR, PRIOR), rtol=1e-4, atol=1e-9
    )
    assert (state.samples, state.rejected, state.restarts, state.noise_nt) == (30, 0, 0, NOISE_NT)


def test_the_ekf_takes_a_hundredth_of_the_field_for_an_unknown_noise_at_first() -> None:
    target = Ekf(replace(CONFIG, sensor=SensorConfig(None)))
    field, magnitude = cloud(1)
    given = Ekf(replace(CONFIG, sensor=SensorConfig(0.01 * float(magnitude[0]))))
    for one in (target, given):
        one.handle(ticks(field, magnitude)[0])
    np.testing.assert_allclose(target.estimate().x, given.estimate().x, rtol=1e-12)


# PLKF


def spun(index: int, bias_nt: tuple[float, float, float], **changes: object) -> Tick:
    phase = 2.0 * math.pi * index / 8.0
    field = 30_000.0 * np.array([[math.cos(phase), math.sin(phase), 0.5]]) + bias_nt
    return replace(Tick(index, np.array([float(index)]), field, np.array([33_541.0])), **changes)  # type: ignore[arg-type]


def window_share() -> float:
    """Variance of the harmonic constant of 16 samples over two turns, per variance of a sample: of least squares."""
    t = np.arange(16) - 7.5
    cos, sin = np.cos(math.pi / 4.0 * t), np.sin(math.pi / 4.0 * t)
    constant = np.linalg.pinv(np.stack([np.ones(16), cos, sin, t * cos, t * sin], axis=1))[0]
    return float(constant @ constant)


def test_a_window_is_a_linear_measurement_of_the_bias_across_the_axis() -> None:
    """The noise of the window's constant; the leak keeps its sign for 1500 s, as long as 93.75 windows of 16 s."""
    walk = FilterConfig(prior_bias_nt=5000.0, process_noise_bias_nt=(3.0, 3.0, 3.0))
    target = Plkf(replace(CONFIG, spin=SpinConfig(window_turns=2.0), filter=walk))
    variance = 25e6
    x = 0.0
    leak_nt = 3.0 * 33_541.0 * (2.3e-3 / (math.pi / 4.0)) ** 2
    noise_nt2 = NOISE_NT**2 * window_share()
    for index in range(48):
        outcome = target.handle(spun(index, (400.0, -300.0, 200.0)))
        variance += 9.0 if index else 0.0
        assert (outcome.used, target.estimate().samples) == (1, index + 1)
        if index % 16 < 15:
            assert outcome.spin_squared_innovation is None
            continue
        assert target._windows._samples == 0
        spread = variance + noise_nt2 + leak_nt**2 * 1500.0 / 16.0
        assert outcome.spin_squared_innovation == pytest.approx(
            ((400.0 - x) ** 2 + (300.0 - 0.75 * x) ** 2) / spread, rel=0.02
        )
        gain = variance / spread
        x, variance = x + gain * (400.0 - x), variance - gain * variance
        state = target.estimate()
        assert state.x[:2] == pytest.approx([x, -0.75 * x], rel=1e-3)
        assert np.diagonal(state.covariance)[:3] == pytest.approx([variance, variance, 25e6 + 9.0 * index], rel=1e-3)
        assert (state.phase, state.x[2]) == (Phase.RUNNING, pytest.approx(0.0, abs=1e-6))


@pytest.mark.parametrize(("factor", "rejected"), [(0.97, False), (1.03, True)])
def test_a_window_beyond_the_gate_is_left_out(factor: float, rejected: bool) -> None:
    """The gate is 36 and one more for each component; the first window is taken whatever it says."""
    target = Plkf(replace(CONFIG, spin=SpinConfig(window_turns=2.0)))
    for index in range(16):
        target.handle(spun(index, (20_000.0, 0.0, 0.0)))
    assert target.estimate().phase is Phase.RUNNING
    state = target.estimate()
    leak_nt = 3.0 * 33_541.0 * (2.3e-3 / (math.pi / 4.0)) ** 2
    noise_nt2 = NOISE_NT**2 * window_share()
    spread = state.covariance[0, 0] + noise_nt2 + leak_nt**2 * 1500.0 / 16.0
    off_nt = factor * math.sqrt(38.0 * spread)
    for index in range(16, 32):
        outcome = target.handle(spun(index, (float(state.x[0]) + off_nt, 0.0, 0.0)))
    assert outcome.spin_rejected is rejected
    assert target.estimate().rejected == (16 if rejected else 0)


def test_a_learnt_noise_weighs_the_windows() -> None:
    target = Plkf(replace(CONFIG, spin=SpinConfig(), sensor=SensorConfig(None)))
    window = None
    for index in range(16):
        window = target._windows.push(spun(index, (0.0, 0.0, 0.0)))
    assert window is not None
    plain = float(window.weights @ window.weights)
    target._state.noise.total_nt, target._state.noise.white_nt = 200.0, 0.0
    leak = target._variance(window) - 200.0**2 * plain
    assert leak == pytest.approx(window.leak_nt**2 * 1500.0 / 16.0, rel=1e-9)
    target._state.noise.white_nt = 50.0
    assert target._variance(window) == pytest.approx(leak + 50.0**2 * plain, rel=1e-9)


def test_a_long_window_holds_its_leak_once() -> None:
    target = Plkf(replace(CONFIG, spin=SpinConfig(rate_rpm=0.06, window_turns=2.0)))
    window = replace_leak(target)
    assert target._variance(window) == pytest.approx(NOISE_NT**2 / 16.0 + 100.0**2, rel=1e-9)


def replace_leak(target: Plkf) -> object:
    from magcal_service.estimators.parts.spin_window import Window

    return Window(np.full(16, 1.0 / 16.0), np.zeros((16, 3)), np.ones(16), np.eye(3)[:2], 100.0, 1.0)


def test_a_bias_with_its_covariance_is_embedded_in_the_nine_states() -> None:
    config = replace(
        CONFIG, filter=FilterConfig(prior_bias_nt=700.0, prior_D=0.1, process_noise_bias_nt=(1.0, 2.0, 3.0))
    )
    state = BiasState(config)
    state.add_process_noise(10.0)
    state.bias_nt = np.array([1.0, 2.0, 3.0])
    found = state.estimate()
    assert found.x.tolist() == [1.0, 2.0, 3.0] + [0.0] * 6
    assert np.diagonal(found.covariance).tolist() == pytest.approx([490_010.0, 490_040.0, 490_090.0] + [0.01] * 6)
    assert (found.phase, found.samples, found.rejected, found.restarts) == (Phase.STARTING, 0, 0, 0)


# Rate-aided


@pytest.mark.parametrize("angle", [0.0, 1e-10, 1e-3, 1.0, -2.5])
def test_a_rotation_is_the_exponential(angle: float) -> None:
    axis = np.array([0.6, -0.48, 0.64])
    np.testing.assert_allclose(
        rotation(axis * 0.5, angle / 0.5), Rotation.from_rotvec(axis * angle).as_matrix().T, atol=1e-12
    )


def gyro_ticks(count: int, *, vectors: bool = True, noise_nt: float = 0.0, start: int = 0) -> list[Tick]:
    """A coning craft with a bias of 900, -1400, 2100 nT and D = 0; rates that are exact."""
    rng = np.random.default_rng(2)
    found, attitude, before = [], np.eye(3), np.zeros(3)
    for index in range(start, start + count):
        rate = np.array([0.2 * math.sin(index / 7.0), 0.15 * math.cos(index / 5.0), 0.1])
        if index > start:
            attitude = rotation(0.5 * (rate + before), 1.0) @ attitude
        before = rate
        reference = np.array([30_000.0 + 3.0 * index, 10_000.0, -20_000.0 - 2.0 * index])
        field = attitude @ reference + [900.0, -1400.0, 2100.0] + noise_nt * rng.normal(size=3)
        found.append(
            Tick(
                index,
                np.array([float(index)]),
                field[None],
                np.array([np.linalg.norm(reference)]),
                reference[None] if vectors else None,
                rate_body_rad_s=rate[None],
            )
        )
    return found


@pytest.mark.parametrize("vectors", [True, False])
def test_the_rate_aided_filter_is_a_linear_kalman_filter_of_field_and_bias(vectors: bool) -> None:
    """Six states written out: turned by the mean of two rates, drift of H and of the gyro, walks of the bias."""
    config = replace(CONFIG, filter=FilterConfig(prior_bias_nt=8000.0, process_noise_bias_nt=(1.0, 2.0, 3.0)))
    target = RateAided(config)
    x, P, last = np.zeros(6), np.diag([0.0] * 3 + [8000.0**2] * 3), None
    norm = 1.0
    for number, tick in enumerate(gyro_ticks(120, vectors=vectors, noise_nt=300.0), start=1):
        rate, magnitude = tick.rate_body_rad_s[0], float(tick.reference_magnitude_nt[0])  # type: ignore[index]
        vector = tick.reference_eci_nt[0] if tick.reference_eci_nt is not None else None
        if last is None:
            P[:3, :3] = np.eye(3) * magnitude**2
        else:
            F = np.eye(6)
            F[:3, :3] = Rotation.from_rotvec(0.5 * (rate + last[0])).as_matrix().T
            drift = float(np.linalg.norm(vector - last[1])) if vector is not None else 2.3e-3 * magnitude
            Q = np.diag([drift**2 + (1e-3 * magnitude) ** 2] * 3 + [1.0, 4.0, 9.0])
            x, P = F @ x, F @ P @ F.T + Q
        last = (rate, vector)
        M = np.hstack([np.eye(3), np.eye(3)])
        S = M @ P @ M.T + NOISE_NT**2 * np.eye(3)
        v = tick.field_body_nt[0] - M @ x
        squared = float(v @ np.linalg.solve(S, v))
        norm += (min(squared / 3.0, 100.0) - norm) / min(number, 300)
        gain = P @ M.T @ np.linalg.inv(S)
        x, P = x + gain @ v, P - gain @ M @ P
        outcome = target.handle(tick)
        assert (outcome.used, outcome.rejected, outcome.degrees) == (1, 0, 1)
        assert outcome.squared_innovation == pytest.approx(squared / 3.0, rel=1e-6)
        assert target._norm == pytest.approx(norm, rel=1e-9)
        assert target.estimate().phase is (Phase.RUNNING if number >= 60 else Phase.STARTING)
    np.testing.assert_allclose(target._joint, x, rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(target._joint_covariance, P, rtol=1e-6, atol=1e-3)
    state = target.estimate()
    np.testing.assert_allclose(state.x[:3], x[3:], rtol=1e-6)
    np.testing.assert_allclose(state.covariance[:3, :3], max(1.0, norm) * P[3:, 3:], rtol=1e-5, atol=1e-3)
    assert (state.samples, state.rejected) == (120, 0)


def test_the_gyros_noise_is_that_of_its_second_differences() -> None:
    """Over 18 per component of three; what noise alone adds to the change of axis; and what is observed."""
    rng = np.random.default_rng(3)
    rates, noise = rng.normal(size=(50, 3)) * 0.01 + [0.0, 0.0, 0.3], _RateNoise()
    change, expected, level, count = np.zeros((3, 3)), 0.0, 0.0, 0
    for index, rate in enumerate(rates):
        turn = rotation(rate, 2.0)
        if index >= 2:
            count += 1
            second = rates[index] - 2.0 * rates[index - 1] + rates[index - 2]
            level += (float(second @ second) / 18.0 - level) / count
        away = np.eye(3) - turn
        change, expected = change + away.T @ away, expected + level * 4.0
        noise.add(rate, turn, 2.0)
    np.testing.assert_allclose(noise._change, change, rtol=1e-9)
    assert (noise._noise, noise._expected) == (pytest.approx(level, rel=1e-9), pytest.approx(expected, rel=1e-9))
    values, vectors = np.linalg.eigh(change)
    kept = vectors[:, 0.5 * values > expected]
    np.testing.assert_allclose(noise.observed(), kept @ kept.T, atol=1e-9)
    noise.clear()
    assert noise._last == []


@pytest.mark.parametrize(("share", "seen"), [(1.99, False), (2.01, True)])
def test_an_axis_is_observed_where_noise_explains_less_than_half_of_its_change(share: float, seen: bool) -> None:
    noise = _RateNoise()
    noise._change, noise._expected = np.diag([share, 100.0, 100.0]), 1.0
    assert noise.observed()[0, 0] == pytest.approx(float(seen))


@pytest.mark.parametrize(
    ("seconds", "rate_rad_s", "again"),
    [(60.0, 0.02, False), (60.1, 0.02, True), (10.0, 0.149, False), (10.0, 0.151, True)],
)
def test_after_too_long_or_too_far_a_turn_the_field_is_begun_anew(
    seconds: float, rate_rad_s: float, again: bool
) -> None:
    """More than a minute, or 1.5 rad: what is known of the bias stays, the field is as good as unknown."""
    target = RateAided(CONFIG)
    target.handle(gyro_ticks(1)[0])
    one = gyro_ticks(1)[0]
    rate = np.array([[0.0, 0.0, rate_rad_s]])
    target._last = (0.0, rate[0], None)
    cross = target._joint_covariance[:3, 3:].copy()
    target.handle(replace(one, times_s=np.array([seconds]), rate_body_rad_s=rate))
    assert cross.any()
    assert (target._rates._last == []) is again


def test_over_a_gap_the_field_is_begun_anew_and_without_rates_nothing_is_learned() -> None:
    target = RateAided(CONFIG)
    for tick in gyro_ticks(5):
        target.handle(tick)
    target.handle(replace(gyro_ticks(1, start=5)[0], after_gap=True))
    assert target._rates._last == []
    before = target.estimate()
    outcome = target.handle(replace(gyro_ticks(1, start=6)[0], rate_body_rad_s=None))
    assert (outcome.used, outcome.rejected, target.estimate().samples) == (0, 0, before.samples)


@pytest.mark.parametrize(("factor", "rejected"), [(0.98, 0), (1.02, 1)])
@pytest.mark.parametrize(("updates", "gated"), [(59, False), (60, True)])
def test_after_sixty_samples_the_gate_stops_what_is_six_sigmas_off(
    factor: float, rejected: int, updates: int, gated: bool
) -> None:
    """36 times three, in units of the innovations' own level."""
    target = RateAided(CONFIG)
    target._joint_covariance = np.zeros((6, 6))
    target._norm, target._updates = 1.0, updates
    size = math.sqrt(factor * 108.0) * NOISE_NT
    target._norm = 1.0 - (min(factor * 36.0, 100.0) - 1.0) / (updates)  # so that it is 1 with this sample
    found = target._update(np.array([size, 0.0, 0.0]))
    assert (found is None) is bool(rejected and gated)


def test_noise_below_a_nanotesla_is_taken_as_one() -> None:
    target = RateAided(replace(CONFIG, sensor=SensorConfig(0.1)))
    target._joint_covariance = np.zeros((6, 6))
    assert target._update(np.array([2.0, 0.0, 0.0])) == pytest.approx(4.0)


# TWO-STEP and the sliding batch


def sums_of(field: np.ndarray, magnitude: np.ndarray) -> MagnitudeSums:
    sums = MagnitudeSums()
    sums.add(field, magnitude)
    return sums


@pytest.mark.parametrize("corrected", [True, False])
def test_a_solution_is_where_the_gradient_of_the_batch_is_zero(corrected: bool) -> None:
    field, magnitude = cloud(2000)
    sums, noise = sums_of(field, magnitude), NoiseLevel(NOISE_NT)
    found = two_step(sums, noise, PRIOR, corrected=corrected)
    assert isinstance(found, Solution)
    y, s2 = scaled(found.x), (NOISE_NT / 30_000.0) ** 2
    tie = s2 * scaled(PRIOR) ** -2.0
    gradient = sums.gradient(y, NOISE_NT, corrected=corrected) + tie * y
    normal = sums.information(y, NOISE_NT, corrected=corrected) + np.diag(tie)
    assert float(gradient @ np.linalg.solve(normal, gradient)) / s2 < 1e-6
    unit = np.array([30_000.0] * 3 + [1.0] * 6)
    np.testing.assert_allclose(
        found.covariance / np.outer(unit, unit), s2 * np.linalg.inv(normal), rtol=1e-6, atol=1e-15
    )
    assert found.count == 2000.0
    assert found.residual_nt == pytest.approx(math.sqrt(sums.mean_square_nt(y)), rel=1e-9)
    assert float(np.abs((found.x - X) / np.sqrt(np.diagonal(found.covariance))).max()) < (4.5 if corrected else 20.0)
    warm = two_step(sums, noise, PRIOR, corrected=corrected, start=found.x + np.sqrt(np.diagonal(found.covariance)))
    assert isinstance(warm, Solution)
    np.testing.assert_allclose((warm.x - found.x) / np.sqrt(np.diagonal(found.covariance)), 0.0, atol=0.01)


def test_a_start_that_is_far_off_is_left_for_the_linear_one() -> None:
    field, magnitude = cloud(500)
    sums, noise = sums_of(field, magnitude), NoiseLevel(NOISE_NT)
    cold = two_step(sums, noise, PRIOR)
    far = two_step(sums, noise, PRIOR, start=X + 0.5 * PRIOR)
    assert isinstance(cold, Solution)
    assert isinstance(far, Solution)
    np.testing.assert_array_equal(far.x, cold.x)


def test_correlations_are_covariances_over_sigmas_and_need_positive_variances() -> None:
    mixed = np.random.default_rng(4).normal(size=(9, 12)) * PRIOR[:, None]
    covariance = mixed @ mixed.T
    sigma = np.sqrt(np.diagonal(covariance))
    np.testing.assert_allclose(correlation_of(covariance), covariance / np.outer(sigma, sigma), rtol=1e-12)
    for bad in (0.0, -1.0, math.nan):
        spoilt = covariance.copy()
        spoilt[4, 4] = bad
        with pytest.raises(np.linalg.LinAlgError):
            correlation_of(spoilt)


@pytest.mark.parametrize(
    ("residual_nt", "sigma_nt", "gate"),
    [(899.0, 1.0, None), (901.0, 1.0, StartGate.BAD_FIT), (100.0, 0.99, None), (100.0, 1.01, StartGate.POOR_COVERAGE)],
)
def test_gates_of_the_batch(residual_nt: float, sigma_nt: float, gate: StartGate | None) -> None:
    """Residual level within three times the noise; the worst component of w known to 3 % of |H|."""
    target = TwoStep(CONFIG)
    field = np.tile([[40_000.0, 0.0, 0.0]], (10, 1))
    target._all.add(field, np.full(10, 40_000.0))
    covariance = np.diag([(1200.0 * sigma_nt) ** 2] * 3 + [0.0] * 6)
    assert target._gate_of(Solution(X, covariance, residual_nt, 10.0)) is gate


def test_starts_are_tried_with_five_percent_more_and_runs_are_solved_with_half_a_percent_new(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[tuple[int, bool]] = []
    answers: list[Solution | StartGate] = []
    covariance = np.diag([1.0] * 3 + [1e-10] * 6)

    def solve(
        sums: MagnitudeSums, noise: object, prior: object, *, corrected: bool, start: np.ndarray | None = None
    ) -> object:
        asked.append((round(sums.count), start is not None))
        return answers[-1] if answers else Solution(X, covariance, 300.0, sums.count)

    monkeypatch.setattr(two_step_module, "two_step", solve)
    target = TwoStep(replace(CONFIG, filter=FilterConfig(start_s=100.0)))
    answers.append(StartGate.NOT_POSITIVE)
    stream = ticks(*cloud(2000))
    for tick in stream[:112]:
        target.handle(tick)
    assert [count for count, _ in asked] == [101, 106, 112]
    assert (target.estimate().waiting_for, target.estimate().phase) == (StartGate.NOT_POSITIVE, Phase.STARTING)
    answers.clear()
    for tick in stream[112:400]:
        target.handle(tick)
    assert asked[3:6] == [(118, False), (119, True), (120, True)]
    assert (target.estimate().phase, target.estimate().waiting_for) == (Phase.RUNNING, None)
    counts = [count for count, _ in asked]
    steps = {a: b - a for a, b in pairwise(counts)}
    assert {steps[count] for count in counts[4:-1] if count <= 200} == {1}  # half a percent of 200 is one sample
    assert {steps[count] for count in counts[4:-1] if count > 200} == {2}
    assert target.estimate().samples == 400
    answers.append(StartGate.COLLAPSED)
    for tick in stream[400:410]:
        target.handle(tick)
    state = target.estimate()
    assert (state.phase, state.restarts, state.waiting_for) == (Phase.STARTING, 1, StartGate.COLLAPSED)
    np.testing.assert_array_equal(state.x, X)


def test_a_batch_needs_more_than_twice_as_many_samples_as_states(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []

    def solve(sums: MagnitudeSums, *_: object, **__: object) -> StartGate:
        asked.append(sums.count)
        return StartGate.POOR_COVERAGE

    monkeypatch.setattr(two_step_module, "two_step", solve)
    target = TwoStep(replace(CONFIG, filter=FilterConfig(start_s=10.0)))
    for tick in ticks(*cloud(25)):
        target.handle(tick)
    assert asked[0] == 19.0


def test_a_running_batch_gives_the_normalised_squares_of_its_samples() -> None:
    target = TwoStep(replace(CONFIG, filter=FilterConfig(start_s=100.0)))
    field, magnitude = cloud(300)
    for tick in ticks(field, magnitude, 2):
        before = target.estimate()
        outcome = target.handle(tick)
        residual = scalar_residual(before.x, tick.field_body_nt, tick.reference_magnitude_nt)
        np.testing.assert_allclose(outcome.residual_nt, residual, rtol=1e-12)
        if before.phase is Phase.STARTING:
            assert (outcome.squared_innovation, outcome.degrees) == (0.0, 0)
            continue
        expected = 0.0
        for b, e in zip(tick.field_body_nt, residual, strict=True):
            w = calibrate(before.x, b)
            row = w @ field_jacobian(b) / np.linalg.norm(w)
            expected += (e - NOISE_NT**2 / np.linalg.norm(w)) ** 2 / (NOISE_NT**2 + row @ before.covariance @ row)
        assert (outcome.squared_innovation, outcome.degrees) == (pytest.approx(expected, rel=1e-6), 2)
    assert target.estimate().phase is Phase.RUNNING


def test_the_level_of_a_batch_counts_the_fitted_parameters() -> None:
    field, magnitude = cloud(40)
    sums = sums_of(field, magnitude)
    y = scaled(X)
    assert TwoStep._level(sums, y) == pytest.approx(math.sqrt(sums.mean_square_nt(y) * 40.0 / 31.0), rel=1e-12)
    few = sums_of(field[:5], magnitude[:5])
    assert TwoStep._level(few, y) == pytest.approx(math.sqrt(few.mean_square_nt(y) * 5.0), rel=1e-12)


def test_a_sliding_batch_weighs_blocks_of_a_minute_by_their_age_and_drops_those_beyond_its_window() -> None:
    """Window 600 s, decay 200 s: sums of each block times exp(-age of its first sample / decay)."""
    target = SlidingBatch(CONFIG, window_s=600.0, decay_s=200.0)
    field, magnitude = cloud(2000)
    stream = ticks(field, magnitude)
    for tick in stream[:1000]:
        target._take(tick)
    starts = [start for start, _ in target._blocks]
    assert starts == [float(second) for second in range(360, 1000, 60)]
    for power in (1.0, 2.0):
        weight = np.exp(-power * (999.0 - np.array(starts)) / 200.0)
        expected = MagnitudeSums()
        for start, each in zip(starts, weight.tolist(), strict=True):
            part = slice(int(start), min(int(start) + 60, 1000))
            expected = expected + sums_of(field[part], magnitude[part]).times(each)
        found = target._weighted(power)
        assert found.count == pytest.approx(expected.count, rel=1e-12)
        np.testing.assert_allclose(found.normal, expected.normal, rtol=1e-9)
    target._take(stream[1020])
    assert target._blocks[0][0] == 420.0


def test_the_covariance_of_a_weighted_batch_is_that_of_weighted_least_squares() -> None:
    """P (sum w^2 F) P with P = (sum w F + prior)^-1, F the information of a block."""
    target = SlidingBatch(CONFIG, window_s=600.0, decay_s=200.0)
    field, magnitude = cloud(600)
    for tick in ticks(field, magnitude):
        target._take(tick)
    solution = two_step(target._sums(), NoiseLevel(NOISE_NT), PRIOR)
    assert isinstance(solution, Solution)
    target._accept(solution)
    unit = np.array([30_000.0] * 3 + [1.0] * 6)
    y = scaled(solution.x)
    squared = target._weighted(2.0).information(y, NOISE_NT, corrected=False) / (NOISE_NT / 30_000.0) ** 2
    scatter = squared / np.outer(unit, unit) + np.diag(PRIOR**-2.0)
    expected = solution.covariance @ scatter @ solution.covariance
    scale = np.sqrt(np.diagonal(expected))
    np.testing.assert_allclose(
        target.estimate().covariance / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-9
    )
    assert (target._fresh, target._solved_count) == (0, solution.count)
