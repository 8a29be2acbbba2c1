"""Equation (6) as a measurement: the same numbers for one filter and for many, with the sensitivity of the formula."""

import numpy as np
import pytest

from magcal_service.estimators.parts.spin_innovation import spin_innovation
from magcal_service.estimators.parts.spin_window import Window, across_axis
from magcal_service.estimators.parts.unscented import UnscentedWeights
from magcal_service.model import STATE_SIZE, Array, calibrate, measure

WEIGHTS = UnscentedWeights.scaled(1.0, 2.0, 0.0)
SCALE = np.array([300.0] * 3 + [0.01] * 6)  # [nT] and [-]
AXIS = np.array([2.0, -1.0, 2.0]) / 3.0


def turning(count: int, turns: float = 1.0) -> Array:
    """A field of 30 uT with 10 uT along the axis that turns about it (count, 3) [nT]."""
    first, second = across_axis(AXIS)
    phase = 2.0 * np.pi * turns * np.arange(count) / count
    return 1e4 * AXIS + 28e3 * (np.cos(phase)[:, None] * first + np.sin(phase)[:, None] * second)


def window_of(field_nt: Array, truth_nt: Array, leak_nt: float = 0.0) -> Window:
    count = len(field_nt)
    magnitude = np.linalg.norm(truth_nt, axis=1)
    return Window(np.full(count, 1.0 / count), field_nt, magnitude, across_axis(AXIS), leak_nt, 1.0)


def random_states(runs: int) -> tuple[Array, Array]:
    """States (runs, 9) and factors of covariances (runs, 9, 9)."""
    rng = np.random.default_rng(3)
    mixed = rng.normal(size=(runs, STATE_SIZE, STATE_SIZE))
    covariance = mixed @ mixed.swapaxes(1, 2) * np.outer(SCALE, SCALE)
    return rng.normal(size=(runs, STATE_SIZE)) * SCALE, np.linalg.cholesky(covariance)


def test_many_runs_give_the_numbers_of_each_alone_to_the_last_bit() -> None:
    x, root = random_states(4)
    fields = turning(37, 1.3) + np.random.default_rng(4).normal(0.0, 300.0, (4, 37, 3))
    window = window_of(fields[0], turning(37), leak_nt=20.0)
    together = spin_innovation(x, root, WEIGHTS, window, fields, 300.0**2)
    for run in range(4):
        alone = spin_innovation(x[run], root[run], WEIGHTS, window, fields[run], 300.0**2)
        for part in ("value", "covariance", "cross"):
            assert np.array_equal(getattr(together, part)[run], getattr(alone, part))
        assert np.array_equal(together.gain()[run], alone.gain())


def test_a_bias_across_the_axis_is_the_innovation_and_one_along_it_is_not() -> None:
    truth = turning(40)
    bias = 200.0 * across_axis(AXIS)[0] + 500.0 * AXIS
    x = np.concatenate([bias, np.zeros(6)])
    root = np.diag(1e-4 * SCALE)
    field = measure(x, truth)
    right = spin_innovation(x, root, WEIGHTS, window_of(field, truth), field, 0.0)
    assert right.value == pytest.approx([0.0, 0.0], abs=1e-3)
    unknown = spin_innovation(np.zeros(9), root, WEIGHTS, window_of(field, truth), field, 0.0)
    projected = field * (np.linalg.norm(truth, axis=1) / np.linalg.norm(field, axis=1))[:, None]
    assert unknown.value == pytest.approx(-across_axis(AXIS) @ projected.mean(axis=0), abs=1e-2)
    assert np.linalg.norm(unknown.value) > 90.0  # what the projection leaves of 200 nT


def test_the_cross_covariance_is_that_of_the_formula_s_derivative() -> None:
    truth = turning(40)
    x, covariance = np.concatenate([np.array([300.0, -200.0, 100.0]), np.full(6, 0.01)]), np.diag((1e-3 * SCALE) ** 2)
    field = measure(x, truth)

    def mean_across(state: Array) -> Array:
        w = calibrate(state, field)
        unit = w / np.linalg.norm(w, axis=1)[:, None]
        return across_axis(AXIS) @ (unit * np.linalg.norm(truth, axis=1)[:, None]).mean(axis=0)

    steps = np.diag(1e-4 * SCALE)
    slope = np.stack([(mean_across(x + h) - mean_across(x - h)) / (2.0 * h.sum()) for h in steps], axis=1)  # (2, 9)
    found = spin_innovation(x, np.sqrt(covariance), WEIGHTS, window_of(field, truth, 7.0), field, 0.0)
    assert found.cross == pytest.approx(covariance @ slope.T, rel=1e-4, abs=1e-8)
    assert found.covariance == pytest.approx(slope @ covariance @ slope.T + 49.0 * np.eye(2), rel=1e-5)


def test_the_noise_of_the_mean_is_tangential() -> None:
    """Vectors up and down the first direction across the axis: their mean has no noise there, in the other s^2 / k."""
    field = np.outer(np.tile([3e4, -3e4], 12), across_axis(AXIS)[0])
    found = spin_innovation(np.zeros(9), 1e-9 * np.diag(SCALE), WEIGHTS, window_of(field, field), field, 100.0**2)
    assert found.covariance == pytest.approx(np.diag([0.0, 100.0**2 / 24.0]), abs=1e-6)
