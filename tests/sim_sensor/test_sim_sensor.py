"""The sensor's equation and every effect: size, form, and silence at zero."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_sensor.disturbances import Panel, Step, Thermal, Torquer
from sim_sensor.sensor import Effects, Sensor, errors_at, lagged, measured_nt, symmetric

TIMES = np.arange(0.0, 200.0, 0.5)
PLAIN = Sensor(2.0, (5000.0, 3000.0, 4000.0), (0.05, 0.10, 0.05, 0.05, -0.04, 0.03), (0.0, 0.0, 0.0))
IDEAL = Sensor(2.0, (0.0, 0.0, 0.0), (0.0,) * 6, (0.0, 0.0, 0.0))
THERMAL = Thermal(40.0, -10.0, 300.0, 10.0, 20.0, (1.0, -2.0, 3.0), (1e-3, 0.0, -1e-3))
PANEL = Panel((1.0, 0.0, 0.0), 0.5, (100.0, -50.0, 20.0))
TORQUER = Torquer((0.1, 0.0, 0.0), 60.0, 6.0, (1e4, 0, 0, 0, 1e4, 0, 5e3, 0, 1e4), 0.5, (40.0, 0.0, 10.0))


class Craft:
    """A craft whose temperature, light and Sun are plain functions."""

    def temperature_degc(self, elapsed_s: np.ndarray) -> np.ndarray:
        return 20.0 + 0.1 * elapsed_s

    def sun_body(self, elapsed_s: np.ndarray) -> np.ndarray:
        return np.stack([np.cos(elapsed_s), np.sin(elapsed_s), 0.0 * elapsed_s], axis=-1)

    def lit(self, elapsed_s: np.ndarray) -> np.ndarray:
        return (elapsed_s < 100.0).astype(float)


def ambient() -> np.ndarray:
    return 30000.0 * np.stack([np.cos(TIMES), np.sin(TIMES), np.full_like(TIMES, 0.3)], axis=-1)


def output(sensor: Sensor = PLAIN, effects: Effects | None = None, noise: float = 0.0) -> np.ndarray:
    eps = noise * np.random.default_rng(5).standard_normal((len(TIMES), 3))
    return measured_nt(sensor, effects or Effects(), Craft(), TIMES, ambient(), eps)


def corrected(B: np.ndarray, sensor: Sensor = PLAIN) -> np.ndarray:
    return B @ (np.eye(3) + symmetric(sensor.D)) - np.array(sensor.bias_nt)


def test_an_ideal_sensor_reads_the_field() -> None:
    np.testing.assert_allclose(output(IDEAL), ambient(), rtol=0.0, atol=1e-9)


def test_equation_1_holds_row_by_row() -> None:
    D = np.array([[0.05, 0.05, -0.04], [0.05, 0.10, 0.03], [-0.04, 0.03, 0.05]])
    for B, H in zip(output(), ambient(), strict=True):
        np.testing.assert_allclose((np.eye(3) + D) @ B, H + np.array([5000.0, 3000.0, 4000.0]), rtol=0.0, atol=1e-8)


def test_noise_is_in_the_corrected_field() -> None:
    eps = 300.0 * np.random.default_rng(5).standard_normal((len(TIMES), 3))
    np.testing.assert_allclose(corrected(output(noise=300.0)) - ambient(), eps, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize(
    "effects",
    [
        Effects(thermal=replace(THERMAL, bias_nt_per_k=(0.0,) * 3, scale_per_k=(0.0,) * 3)),
        Effects(panels=(replace(PANEL, field_nt_per_a=(0.0,) * 3),)),
        Effects(panels=(replace(PANEL, max_a=0.0),)),
        Effects(torquer=replace(TORQUER, dipole_am2=(0.0,) * 3, remanence_nt=(0.0,) * 3)),
        Effects(torquer=replace(TORQUER, on_s=0.0, remanence_nt=(0.0,) * 3)),
        Effects(steps=(Step(10.0),)),
    ],
    ids=["thermal", "panel-field", "panel-current", "torquer-dipole", "torquer-duty", "step"],
)
def test_an_effect_of_size_zero_changes_nothing(effects: Effects) -> None:
    np.testing.assert_array_equal(output(effects=effects), output())


def test_a_thermal_bias_grows_with_the_temperature() -> None:
    effects = Effects(thermal=replace(THERMAL, scale_per_k=(0.0,) * 3))
    added = corrected(output(effects=effects)) - ambient()
    np.testing.assert_allclose(added, np.outer(0.1 * TIMES, [1.0, -2.0, 3.0]), rtol=0.0, atol=1e-8)


def test_a_thermal_scale_changes_the_diagonal() -> None:
    effects = Effects(thermal=replace(THERMAL, bias_nt_per_k=(0.0,) * 3))
    B = output(effects=effects)
    added = corrected(B) - ambient()
    np.testing.assert_allclose(added, -np.outer(0.1 * TIMES, [1e-3, 0.0, -1e-3]) * B, rtol=0.0, atol=1e-8)


def test_temperature_follows_light_with_its_time_constant() -> None:
    lit = np.concatenate([np.ones(1000), np.zeros(1000)])
    history = THERMAL.history_degc(lit, 5.0)
    after = np.arange(1000) * 5.0
    warming = 40.0 + (10.0 - 40.0) * np.exp(-after / 300.0)
    np.testing.assert_allclose(history[:1000], warming, rtol=0.0, atol=1e-9)
    cooling = -10.0 + (history[1000] + 10.0) * np.exp(-after / 300.0)
    np.testing.assert_allclose(history[1000:], cooling, rtol=0.0, atol=1e-9)


def test_a_panels_field_follows_sun_angle_and_shadow() -> None:
    added = corrected(output(effects=Effects(panels=(PANEL,)))) - ambient()
    current = 0.5 * np.maximum(0.0, np.cos(TIMES)) * (TIMES < 100.0)
    np.testing.assert_allclose(added, np.outer(current, [100.0, -50.0, 20.0]), rtol=0.0, atol=1e-8)


def test_the_torquer_is_commanded_with_alternating_sign() -> None:
    commanded = TORQUER.commanded_am2(np.array([0.0, 5.9, 6.0, 59.9, 60.0, 66.0, 120.0]))
    np.testing.assert_array_equal(commanded[:, 0], [0.1, 0.1, 0.0, 0.0, -0.1, 0.0, 0.1])


def test_the_torquers_field_against_its_differential_equation() -> None:
    """Coil current by small steps of tau di/dt = command - i, over three periods."""
    h = 5e-4
    at_s = np.arange(0.0, 190.0, h)
    drive = TORQUER.commanded_am2(at_s)[:, 0] / 0.1
    current, kept = [0.0], math.exp(-h / TORQUER.decay_s)
    for target in drive[:-1].tolist():
        current.append(target + (current[-1] - target) * kept)
    sign = np.where(np.floor(at_s / 60.0) % 2 == 0, 1.0, -1.0)
    expected = np.outer(current, [1000.0, 0.0, 500.0]) + np.outer(sign, [40.0, 0.0, 10.0])
    switching = np.abs((at_s + h) % 60.0 - 6.0) < 2 * h
    np.testing.assert_allclose(TORQUER.field_nt(at_s)[~switching], expected[~switching], rtol=0.0, atol=0.5)


def test_errors_step_at_their_time_and_stay() -> None:
    steps = (Step(10.0, (100.0, 0.0, 0.0)), Step(20.0, (0.0, 0.0, -5.0), (0.01, 0.0, 0.0, 0.0, 0.0, 0.0)))
    bias, D = errors_at(PLAIN, steps, np.array([9.999, 10.0, 20.0, 99.0]))
    np.testing.assert_array_equal(bias[:, 0], [5000.0, 5100.0, 5100.0, 5100.0])
    np.testing.assert_array_equal(bias[:, 2], [4000.0, 4000.0, 3995.0, 3995.0])
    np.testing.assert_allclose(D[:, 0], [0.05, 0.05, 0.06, 0.06], rtol=1e-12)


@given(st.floats(0.01, 1.0), st.floats(0.01, 1.0))
def test_lag_has_the_gain_and_phase_of_a_first_order_low_pass(lag_s: float, turn: float) -> None:
    """Response of exp(i w t) is exp(i w t) / (1 + i w tau), to 2e-4 up to w tau = 1."""
    w = turn / lag_s
    at_s = np.linspace(0.0, 20.0, 50)

    def turning(t: np.ndarray) -> np.ndarray:
        return np.stack([np.cos(w * t), np.sin(w * t), np.ones_like(t)], axis=-1)

    got = lagged(turning, at_s, lag_s)
    expected = np.exp(1j * w * at_s) / (1.0 + 1j * w * lag_s)
    np.testing.assert_allclose(got[:, 0] + 1j * got[:, 1], expected, rtol=0.0, atol=2e-4)
    np.testing.assert_allclose(got[:, 2], 1.0, rtol=0.0, atol=1e-9)


def test_no_lag_is_the_field_itself() -> None:
    np.testing.assert_array_equal(lagged(lambda t: np.outer(t, np.ones(3)), TIMES, 0.0)[:, 0], TIMES)


def test_output_comes_in_steps_of_the_least_bit() -> None:
    rounded = output(replace(PLAIN, lsb_nt=150.0), noise=300.0)
    np.testing.assert_allclose(np.remainder(rounded + 75.0, 150.0), 75.0, rtol=0.0, atol=1e-6)
    assert np.max(np.abs(rounded - output(noise=300.0))) <= 75.0 + 1e-6


def test_rounding_has_the_variance_of_a_uniform_error() -> None:
    error = output(replace(PLAIN, lsb_nt=150.0), noise=300.0) - output(noise=300.0)
    assert np.std(error) == pytest.approx(150.0 / math.sqrt(12.0), rel=0.06)


def test_output_is_clipped_at_full_scale_and_otherwise_unchanged() -> None:
    free, clipped = output(), output(replace(PLAIN, full_scale_nt=25000.0))
    inside = np.abs(free) <= 25000.0
    assert 0.0 < inside.mean() < 1.0
    np.testing.assert_array_equal(clipped[inside], free[inside])
    np.testing.assert_array_equal(np.abs(clipped[~inside]), 25000.0)
