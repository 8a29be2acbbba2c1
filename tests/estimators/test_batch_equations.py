"""The batches' equations against sums over samples written out: costs, gradients, normal matrices, linear starts."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magcal_service.estimators.parts.magnitude_sums import (
    SCALE_NT,
    MagnitudeSums,
    coefficient_jacobian,
    coefficients,
    scaled,
    unscaled,
    unscaled_covariance,
    unscaled_information,
)
from magcal_service.estimators.parts.spin_window import Window, across_axis
from magcal_service.estimators.parts.start_problem import (
    FIRST_DAMPING,
    BatchProblem,
    WindowMeans,
    gauss_newton,
    linear_states,
)
from magcal_service.model import calibrate, field_jacobian, measure, without_radial_noise
from tests.equations import scalar_measurement

X = np.array([900.0, -1400.0, 2100.0, 0.05, -0.08, 0.11, 0.03, -0.04, 0.06])
PRIOR = np.array([30_000.0] * 3 + [0.2] * 6)


def samples(count: int = 60, noise_nt: float = 0.0, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Measured vectors B (n, 3) and |H| (n,) [nT] of a craft with the errors ``X``, in every direction."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    magnitude = rng.uniform(25_000.0, 50_000.0, count)
    return measure(X, direction * magnitude[:, None] + noise_nt * rng.normal(size=(count, 3))), magnitude


def sums_of(field: np.ndarray, magnitude: np.ndarray) -> MagnitudeSums:
    sums = MagnitudeSums()
    sums.add(field, magnitude)
    return sums


# Sums of TWO-STEP.  A residual is (|w|^2 - |H|^2) / (2 |H|) in units of SCALE_NT.


def residuals(y: np.ndarray, field: np.ndarray, magnitude: np.ndarray) -> np.ndarray:
    w = calibrate(unscaled(y), field)
    return ((w * w).sum(axis=1) - magnitude**2) / (2.0 * magnitude) / SCALE_NT


def test_a_state_is_scaled_by_30_000_nt_and_the_covariance_with_it() -> None:
    y = scaled(X)
    np.testing.assert_allclose(y, [0.03, -0.14 / 3.0, 0.07, *X[3:]], rtol=1e-12)
    mixed = np.random.default_rng(2).normal(size=(9, 9))
    covariance = mixed @ mixed.T
    unit = np.diag([30_000.0] * 3 + [1.0] * 6)
    np.testing.assert_allclose(unscaled_covariance(covariance), unit @ covariance @ unit, rtol=1e-12)
    information = unscaled_information(np.linalg.inv(covariance), 300.0)
    expected = np.linalg.inv(unit @ covariance @ unit) * (30_000.0 / 300.0) ** 2
    np.testing.assert_allclose(information, expected, rtol=1e-6)


def test_sums_are_those_over_the_samples() -> None:
    field, magnitude = samples()
    sums = sums_of(field, magnitude)
    b, h = field / 30_000.0, magnitude / 30_000.0
    b1, b2, b3 = b.T
    rows = np.stack([b1 * b1, b2 * b2, b3 * b3, b1 * b2, b1 * b3, b2 * b3, b1, b2, b3, np.ones(60)], axis=1)
    np.testing.assert_allclose(sums.normal, (rows / (4.0 * h**2)[:, None]).T @ rows, rtol=1e-10)
    np.testing.assert_allclose(sums.target, rows.sum(axis=0) / 4.0, rtol=1e-10)
    assert (sums.count, sums.square) == (60.0, pytest.approx((h**2).sum() / 4.0, rel=1e-12))
    halves = sums_of(field[:25], magnitude[:25]) + sums_of(field[25:], magnitude[25:]).times(1.0)
    for name in ("count", "normal", "target", "square"):
        np.testing.assert_allclose(getattr(halves, name), getattr(sums, name), rtol=1e-12)
        np.testing.assert_allclose(getattr(sums.times(0.3), name), 0.3 * np.array(getattr(sums, name)), rtol=1e-12)


def test_the_mean_square_is_that_of_the_residuals() -> None:
    field, magnitude = samples()
    y = scaled(X + np.array([200.0, -100.0, 50.0, 1e-3, 2e-3, -1e-3, 2e-3, 1e-3, -3e-3]))
    expected = float(np.mean(residuals(y, field, magnitude) ** 2)) * SCALE_NT**2
    assert sums_of(field, magnitude).mean_square_nt(y) == pytest.approx(expected, rel=1e-6)
    assert MagnitudeSums().mean_square_nt(y) == 0.0


def test_the_coefficients_give_the_squared_length() -> None:
    """q'l(B) = |w|^2, for any B; and their derivative is the numerical one."""
    field, y = samples(5)[0], scaled(X)
    b1, b2, b3 = (field / SCALE_NT).T
    monomials = np.stack([b1 * b1, b2 * b2, b3 * b3, b1 * b2, b1 * b3, b2 * b3, b1, b2, b3, np.ones(5)], axis=1)
    lengths = np.linalg.norm(calibrate(X, field), axis=1) / SCALE_NT
    np.testing.assert_allclose(monomials @ coefficients(y), lengths**2, rtol=1e-12)
    step = 1e-6 * np.eye(9)
    numeric = np.stack([(coefficients(y + s) - coefficients(y - s)) / 2e-6 for s in step], axis=1)
    np.testing.assert_allclose(coefficient_jacobian(y), numeric, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("noise_nt", [0.0, 900.0])
def test_the_published_gradient_is_half_the_derivative_of_the_cost(noise_nt: float) -> None:
    """Cost: sum of (|w|^2 - |H|^2 - 3 s^2)^2 / 4 |H|^2; and the normal matrix is that of its rows."""
    field, magnitude = samples()
    y, s = scaled(X + 0.01 * PRIOR), noise_nt / SCALE_NT

    def cost(at: np.ndarray) -> float:
        shifted = residuals(at, field, magnitude) - 3.0 * s * s / (2.0 * magnitude / SCALE_NT)
        return float(shifted @ shifted)

    numeric = [(cost(y + step) - cost(y - step)) / 4e-6 for step in 1e-6 * np.eye(9)]
    sums = sums_of(field, magnitude)
    found = sums.gradient(y, noise_nt, corrected=False)
    np.testing.assert_allclose(found, numeric, rtol=1e-6, atol=1e-6 * np.abs(numeric).max())
    b, w = field / SCALE_NT, calibrate(unscaled(y), field) / SCALE_NT
    unit = np.array([SCALE_NT] * 3 + [1.0] * 6)
    jacobian = field_jacobian(field) * unit / SCALE_NT
    rows = np.einsum("ni,nij->nj", w, jacobian) / (magnitude / SCALE_NT)[:, None]
    np.testing.assert_allclose(sums.information(y, noise_nt, corrected=False), rows.T @ rows, rtol=1e-9, atol=1e-9)
    assert b.shape == w.shape


def brute_corrections(
    y: np.ndarray, field: np.ndarray, magnitude: np.ndarray, s: float
) -> tuple[np.ndarray, np.ndarray]:
    """What noise inside B adds to gradient and normal matrix, by the formulas of the module, sample by sample."""
    unit = np.array([SCALE_NT] * 3 + [1.0] * 6)
    a = np.eye(3) + y[np.array([[3, 6, 7], [6, 4, 8], [7, 8, 5]])]
    gradient, information = np.zeros(9), np.zeros((9, 9))
    only_d = np.array([0.0] * 3 + [1.0] * 6)
    for b, h in zip(field, magnitude / SCALE_NT, strict=True):
        w = calibrate(unscaled(y), b) / SCALE_NT
        jacobian = field_jacobian(b) * unit / SCALE_NT
        back = field_jacobian(np.linalg.solve(a, w)) * only_d
        gradient += (10.0 * s * s * (w @ jacobian) + 4.0 * s * s * (w @ back)) / (4.0 * h * h)
        for i in range(3):
            e = np.eye(3)[i]
            row = e @ jacobian + w @ (field_jacobian(np.linalg.solve(a, e)) * only_d)
            information += 4.0 * s * s * np.outer(row, row) / (4.0 * h * h)
    return gradient, information


def test_the_corrections_are_those_of_the_noise_inside_the_vector() -> None:
    field, magnitude = samples(20)
    y, noise_nt = scaled(X), 900.0
    sums = sums_of(field, magnitude)
    gradient, information = brute_corrections(y, field, magnitude, noise_nt / SCALE_NT)
    plain = sums.gradient(y, 0.0, corrected=False)
    np.testing.assert_allclose(plain - sums.gradient(y, noise_nt, corrected=True), gradient, rtol=1e-7, atol=1e-9)
    full, less = (sums.information(y, noise_nt, corrected=corrected) for corrected in (False, True))
    np.testing.assert_allclose(full - less, information, rtol=1e-6, atol=1e-9)


def test_second_moments_are_those_of_the_vectors() -> None:
    field, magnitude = samples(20)
    extended = np.c_[field / SCALE_NT, np.ones(20)]
    expected = (extended / (4.0 * (magnitude / SCALE_NT) ** 2)[:, None]).T @ extended
    np.testing.assert_allclose(sums_of(field, magnitude).second_moments(), expected, rtol=1e-12)


def test_the_sigma_of_a_calibrated_vector_is_its_rms_over_the_samples() -> None:
    """With weights 1 / 4 |H|^2; largest eigenvalue of the mean of J P J'."""
    field, _ = samples(20)
    magnitude = np.full(20, 30_000.0)
    mixed = np.random.default_rng(3).normal(size=(9, 12)) * np.array([50.0] * 3 + [2e-3] * 6)[:, None]
    covariance = mixed @ mixed.T
    mean = np.mean([j @ covariance @ j.T for j in field_jacobian(field)], axis=0)
    expected = math.sqrt(np.linalg.eigvalsh(mean)[-1])
    assert sums_of(field, magnitude).vector_sigma_nt(covariance) == pytest.approx(expected, rel=1e-9)


def test_the_linear_solution_is_ridge_regression_with_the_constant_free() -> None:
    field, magnitude = samples(40, noise_nt=300.0)
    noise_nt, prior = 300.0, scaled(PRIOR)
    b1, b2, b3 = (field / SCALE_NT).T
    monomials = np.stack([b1 * b1, b2 * b2, b3 * b3, b1 * b2, b1 * b3, b2 * b3, b1, b2, b3, np.ones(40)], axis=1)
    h, s = magnitude / SCALE_NT, noise_nt / SCALE_NT
    sigma = np.array([0.4, 0.4, 0.4, 0.8, 0.8, 0.8, 2.0, 2.0, 2.0, 3.0])  # of q at prior: 2 x 0.2, 4 x 0.2, 2 b, |b|^2
    rows = np.concatenate([monomials / (2.0 * h * s)[:, None], np.diag(1.0 / sigma)])
    at_zero = np.array([1.0, 1.0, 1.0] + [0.0] * 7)
    target = np.concatenate([(h**2 + 3.0 * s * s) / (2.0 * h * s), at_zero / sigma])
    expected = np.linalg.lstsq(rows, target, rcond=None)[0]
    found = sums_of(field, magnitude).linear_solution(noise_nt, prior)
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9)


# The batch start


def spin_windows(count: int = 3, seed: int = 5) -> list[Window]:
    rng = np.random.default_rng(seed)
    found = []
    for number in range(count):
        field, magnitude = samples(8, 200.0, seed + number)
        weights = rng.uniform(0.5, 1.5, 8)
        axis = rng.normal(size=3)
        across = across_axis(axis / np.linalg.norm(axis))
        found.append(
            Window(weights / weights.sum(), field, magnitude, across, 20.0 + 10.0 * number, 1.0 + 0.5 * number)
        )
    return found


def window_residuals(x: np.ndarray, windows: list[Window], noise_nt: float) -> np.ndarray:
    """Means of the calibrated vectors across the axis over their own sigma (m, 2)."""
    found = []
    for window in windows:
        variance = noise_nt**2 * window.share * float(window.weights @ window.weights) + window.leak_nt**2
        found.append(window.across @ (window.weights @ calibrate(x, window.field_body_nt)) / math.sqrt(variance))
    return np.array(found)


def test_windows_in_a_batch_are_their_weighted_means() -> None:
    windows = spin_windows()
    means = WindowMeans.of(windows)
    np.testing.assert_allclose(means.residuals(X, 250.0), window_residuals(X, windows, 250.0), rtol=1e-9)
    rows, zero = means.rows(250.0)
    np.testing.assert_allclose(zero.reshape(3, 2), window_residuals(np.zeros(9), windows, 250.0), rtol=1e-9)
    np.testing.assert_allclose((zero + X @ rows).reshape(3, 2), window_residuals(X, windows, 250.0), rtol=1e-9)
    kept = means.only(np.array([True, False, True]))
    np.testing.assert_allclose(kept.residuals(X, 250.0), window_residuals(X, windows[::2], 250.0), rtol=1e-9)
    stacked = means.residuals(np.array([X, 2.0 * X]), 250.0)
    np.testing.assert_allclose(stacked[1], means.residuals(2.0 * X, 250.0), rtol=1e-12)


def problem(noise_nt: float = 300.0, sigma_nt: float = 400.0, windows: int = 3) -> BatchProblem:
    field, magnitude = samples(60, 300.0, 7)
    return BatchProblem(field, magnitude, WindowMeans.of(spin_windows(windows)), PRIOR, sigma_nt, noise_nt)


def test_cost_and_gradient_of_a_start_by_brute_force() -> None:
    """e = |w| - |H| - s^2 / |H|, weighted by sigma; windows; the prior.  Rows at vectors without their radial noise."""
    one, at = problem(), X + 0.01 * PRIOR
    residual = np.linalg.norm(calibrate(at, one.field_nt), axis=1) - one.magnitude_nt
    np.testing.assert_allclose(one.residuals(at), residual, rtol=1e-9, atol=1e-6)
    centred = residual - one.noise_nt**2 / one.magnitude_nt
    w_hat, b_hat = without_radial_noise(at, one.field_nt, one.magnitude_nt, (one.noise_nt / one.sigma_nt) ** 2)
    unit = w_hat / np.linalg.norm(w_hat, axis=1)[:, None]
    rows = np.einsum("ni,nij->nj", unit, field_jacobian(b_hat)) / one.sigma_nt
    windows = spin_windows()
    of_windows = window_residuals(at, windows, one.sigma_nt).reshape(-1)
    step = np.eye(9) * PRIOR
    window_rows = np.stack(
        [(window_residuals(at + s, windows, one.sigma_nt) - window_residuals(at, windows, one.sigma_nt)).reshape(-1) / p
         for s, p in zip(step, PRIOR, strict=True)], axis=1,
    )  # fmt: skip
    tie = np.diag(PRIOR**-2.0)
    normal, gradient, cost = one.normal_equations(at)
    scale = np.sqrt(np.diagonal(normal))
    expected = rows.T @ rows + window_rows.T @ window_rows + tie
    np.testing.assert_allclose(normal / np.outer(scale, scale), expected / np.outer(scale, scale), rtol=1e-6, atol=1e-9)
    slope = rows.T @ centred / one.sigma_nt + window_rows.T @ of_windows + tie @ at
    np.testing.assert_allclose(gradient / scale, slope / scale, rtol=1e-6, atol=1e-6)
    total = float(centred @ centred) / one.sigma_nt**2 + float(of_windows @ of_windows) + float(at @ tie @ at)
    assert cost == pytest.approx(total, rel=1e-9)


def test_a_stack_of_problems_is_each_of_them() -> None:
    one = problem()
    field = np.stack([one.field_nt, one.field_nt + 100.0, one.field_nt - 50.0])
    means = one.windows.field_nt
    stack = BatchProblem(
        field,
        one.magnitude_nt,
        replace(one.windows, field_nt=np.stack([means, means + 9.0, means - 9.0])),
        PRIOR, 400.0, 300.0,
    )  # fmt: skip
    states = np.stack([X, X + 0.01 * PRIOR, X - 0.01 * PRIOR])
    together = stack.normal_equations(states)
    linear, positive = linear_states(stack)
    for number in range(3):
        alone = stack.run(number)
        for whole, part in zip(together, alone.normal_equations(states[number]), strict=True):
            np.testing.assert_allclose(whole[number], part, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(linear[number], linear_states(alone)[0], rtol=1e-6, atol=1e-9)
    assert positive.all()
    chosen = stack.runs(np.array([True, False, True]))
    np.testing.assert_allclose(chosen.residuals(states[::2])[1], stack.residuals(states)[2], rtol=1e-12)
    part = one.only(np.arange(60) < 40, np.array([False, True, True]))
    assert (len(part.field_nt), len(part.magnitude_nt), len(part.windows.weight)) == (40, 40, 2)


def test_the_linear_start_is_exact_without_noise() -> None:
    field, magnitude = samples(60)
    clean = BatchProblem(field, magnitude, WindowMeans.of([]), 1e6 * PRIOR, 300.0, 0.0)
    found, positive = linear_states(clean)
    np.testing.assert_allclose(found / PRIOR, X / PRIOR, rtol=1e-6, atol=1e-9)
    assert positive


def test_the_linear_start_takes_off_the_mean_of_v_and_is_tied_to_the_prior() -> None:
    """Ridge regression in (E, c, s), written out."""
    one = problem()
    scale = float(one.magnitude_nt.mean())
    b1, b2, b3 = (one.field_nt / scale).T
    z = (scalar_measurement(one.field_nt, one.magnitude_nt) - 3.0 * one.noise_nt**2) / scale**2
    rows = np.stack(
        [-b1 * b1, -b2 * b2, -b3 * b3, -2 * b1 * b2, -2 * b1 * b3, -2 * b2 * b3, 2 * b1, 2 * b2, 2 * b3, -np.ones(60)],
        axis=1,
    )
    weight = scale**2 / (2.0 * one.sigma_nt * one.magnitude_nt)
    sigma = np.array([0.4] * 6 + [30_000.0 / scale] * 3 + [3.0 * (30_000.0 / scale) ** 2])
    stacked = np.concatenate([rows * weight[:, None], np.diag(1.0 / sigma)])
    theta = np.linalg.lstsq(stacked, np.concatenate([z * weight, np.zeros(10)]), rcond=None)[0]
    square = np.eye(3) + theta[np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])]
    values, vectors = np.linalg.eigh(square)
    root = vectors @ np.diag(np.sqrt(values)) @ vectors.T
    found = linear_states(one)[0]
    expected = np.concatenate(
        [np.linalg.solve(root, theta[6:9] * scale), (root - np.eye(3))[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]]
    )
    np.testing.assert_allclose(found / PRIOR, expected / PRIOR, rtol=1e-6, atol=1e-8)


def test_samples_that_no_state_explains_have_no_positive_root() -> None:
    """|H| that falls where |B| grows: I + E has a negative eigenvalue."""
    field, _ = samples(60)
    length = np.linalg.norm(field, axis=1)
    odd = BatchProblem(field, 90_000.0 - length, WindowMeans.of([]), 1e6 * PRIOR, 300.0, 0.0)
    found, positive = linear_states(odd)
    assert not positive
    assert np.isfinite(found).all()


def test_gauss_newton_ends_where_the_gradient_is_zero() -> None:
    one = problem(windows=0)
    result = gauss_newton(one, np.zeros(9))
    assert result is not None
    x, covariance = result
    normal, gradient, _ = one.normal_equations(x)
    step = np.linalg.solve(normal, gradient)
    assert float(step @ normal @ step) < 1e-6
    np.testing.assert_allclose(covariance @ normal, np.eye(9), atol=1e-6)
    assert np.abs((x - X) / np.sqrt(np.diagonal(covariance))).max() < 5.0


@pytest.mark.parametrize(("rise", "next_share"), [(5e-10, 0.75), (2e-9, 0.5 / (1.0 + FIRST_DAMPING))])
def test_gauss_newton_takes_a_rise_of_the_cost_by_rounding_and_no_larger_one(rise: float, next_share: float) -> None:
    """A step that is taken is followed by one of half the rest; one that is not is made anew, damped."""
    truth, looks = np.linspace(-0.4, 0.4, 9), []

    def equations(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        looks.append(x)
        return 1e6 * np.eye(9), 0.5e6 * (x - truth), 1.0 if len(looks) == 1 else 1.0 + rise

    scripted: Any = SimpleNamespace(normal_equations=equations)
    gauss_newton(scripted, np.zeros(9))
    np.testing.assert_allclose(looks[:3], np.outer([0.0, 0.5, next_share], truth), atol=1e-12)


def test_gauss_newton_damps_no_step_after_a_good_one() -> None:
    """With a gradient of half its size each step goes half of the way that is left."""
    truth, root, looks = np.linspace(-0.4, 0.4, 9), np.random.default_rng(4).normal(size=(9, 12)), []
    normal = 1e4 * root @ root.T

    def equations(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        looks.append(x)
        return normal, 0.5 * normal @ (x - truth), float((x - truth) @ normal @ (x - truth))

    halved: Any = SimpleNamespace(normal_equations=equations)
    result = gauss_newton(halved, np.zeros(9))
    assert result is not None
    np.testing.assert_allclose(looks[:4], np.outer([0.0, 0.5, 0.75, 0.875], truth), atol=1e-12)
    np.testing.assert_allclose(result[1], np.linalg.inv(normal), rtol=1e-9)


def test_gauss_newton_does_not_change_its_start() -> None:
    start = np.zeros(9)
    gauss_newton(problem(), start)
    assert not start.any()


@pytest.mark.parametrize(("D", "found"), [(1.8, True), (2.2, False)])
def test_gauss_newton_gives_up_beyond_a_gain_of_three(D: float, found: bool) -> None:
    """The minimum is there all the same, and without noise."""
    x = np.array([100.0, 200.0, -100.0, D, 0.0, 0.0, 0.0, 0.0, 0.0])
    field, magnitude = samples(60)
    field = measure(x, calibrate(X, field))
    result = gauss_newton(BatchProblem(field, magnitude, WindowMeans.of([]), 1e6 * PRIOR, 300.0, 0.0), np.zeros(9))
    assert (result is not None) is found
    if result is not None:
        np.testing.assert_allclose(result[0], x, rtol=1e-3, atol=1e-2)


def test_the_advantage_counts_costs_and_the_thickness_of_the_noise() -> None:
    """Of a state against one that makes every length 0.8 of it: 2 n log(0.8) of thickness beside the costs."""
    field, magnitude = samples(60)
    one = BatchProblem(field, magnitude, WindowMeans.of([]), 1e9 * PRIOR, 400.0, 300.0)
    matrix = 0.8 * (np.eye(3) + X[np.array([[3, 6, 7], [6, 4, 8], [7, 8, 5]])]) - np.eye(3)
    shrunk = np.concatenate([0.8 * X[:3], matrix[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]])
    costs = float(one.normal_equations(X)[2] - one.normal_equations(shrunk)[2])
    thickness = 2.0 * (300.0 / 400.0) ** 2 * 60.0 * math.log(0.8)
    assert one.advantage(shrunk, X) == pytest.approx(costs + thickness, rel=1e-9)
    assert one.advantage(X, shrunk) == pytest.approx(-costs - thickness, rel=1e-9)
    assert one.advantage(X, X) == pytest.approx(0.0, abs=1e-6)


def test_a_mirrored_or_flat_direction_counts_as_a_quarter() -> None:
    """Of its own mirror image -w every slope is -1: the least that the logarithm is taken of is a quarter."""
    field, magnitude = samples(60)
    one = BatchProblem(field, magnitude, WindowMeans.of([]), 1e9 * PRIOR, 300.0, 300.0)
    a = np.eye(3) + X[np.array([[3, 6, 7], [6, 4, 8], [7, 8, 5]])]
    tenth = 0.1 * a - np.eye(3)
    flat = np.concatenate([0.1 * X[:3], tenth[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]])
    costs = float(one.normal_equations(X)[2] - one.normal_equations(flat)[2])
    assert one.advantage(flat, X) == pytest.approx(costs + 2.0 * 60.0 * math.log(0.25), rel=1e-9)
