"""The other methods against filters and batches written out in a few lines of numpy, and their limits."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magcal_service.config.settings import FilterConfig, SensorConfig, SpinConfig
from magcal_service.estimators.ekf import Ekf
from magcal_service.estimators.interface import Phase
from magcal_service.estimators.parts.bias_only import BiasState
from magcal_service.estimators.plkf import Plkf
from magcal_service.estimators.rate_aided import RateAided, _RateNoise, rotation
from magcal_service.model import calibrate, field_jacobian
from magcal_service.ticks.assembler import Tick
from tests.equations import predicted_scalar
from tests.estimators.method_ticks import CONFIG, NOISE_NT, PRIOR, cloud, ticks

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
