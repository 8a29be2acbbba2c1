"""Finding a spin from scratch: axis, rate, attitude; its twin, its mirror, and no spin at all."""

import math

import numpy as np
import pytest

from magcal_service.config.settings import FilterConfig
from magcal_service.estimators.parts.start import prior_sigma
from magcal_service.estimators.steady_spin.fit import Prior, Samples, fit_spin
from magcal_service.estimators.steady_spin.start import SpinGuess, best_rotation, find_axis, find_spin
from magcal_service.estimators.steady_spin.state import SPIN_STATE_SIZE, SpinState, turned_once
from magcal_service.model import calibrate
from tests.estimators.estimator_ticks import TABLE_1, Craft, triad

PRIOR = Prior(np.zeros(9), np.diag(prior_sigma(FilterConfig()) ** 2))
ROUGH = TABLE_1 * 0.97 + np.repeat([300.0, 0.005], [3, 6])


def samples_of(craft: Craft, seconds: int) -> Samples:
    times, measured, reference = craft.arrays(seconds)
    return Samples(times - times[-1], measured, reference)


def true_attitude(craft: Craft, seconds: int) -> np.ndarray:
    """R at the last sample, from how the simulated craft turns."""
    phase = np.random.default_rng(craft.seed).uniform(0.0, 2.0 * math.pi)
    phase += craft.rate_rpm * 2.0 * math.pi / 60.0 * (seconds * craft.rate_hz - 1) / craft.rate_hz
    cos, sin = math.cos(phase), math.sin(phase)
    turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    body, inertial = (triad(np.array(v) / np.linalg.norm(v)) for v in (craft.spin_body, craft.spin_eci))
    return body.T @ turn @ inertial


def angle(a: np.ndarray, b: np.ndarray) -> float:
    return math.acos(min(1.0, (np.trace(a.T @ b) - 1.0) / 2.0))


def true_one(guesses: list[SpinGuess], craft: Craft, seconds: int) -> SpinGuess:
    return min(guesses, key=lambda guess: angle(guess.body_from_eci, true_attitude(craft, seconds)))


def test_the_axis_is_found_through_a_rough_calibration() -> None:
    samples = samples_of(Craft(seed=1, spin_body=(0.2, 0.1, 1.0)), 240)
    axis = find_axis(calibrate(ROUGH, samples.field_nt), samples.reference_eci_nt)
    truth = np.array([0.2, 0.1, 1.0]) / np.linalg.norm([0.2, 0.1, 1.0])
    assert axis is not None
    assert abs(axis @ truth) > math.cos(math.radians(5.0))


def test_noise_alone_has_no_axis() -> None:
    rng = np.random.default_rng(2)
    assert find_axis(rng.normal(size=(240, 3)) * 30_000.0, samples_of(Craft(seed=2), 240).reference_eci_nt) is None


@pytest.mark.parametrize("rate_rpm", [7.5, -7.5, 0.8, 25.0])
def test_rate_and_attitude_are_found_with_their_sign(rate_rpm: float) -> None:
    craft = Craft(seed=3, rate_rpm=rate_rpm)
    found = true_one(find_spin(samples_of(craft, 240), ROUGH, 0.03, 3.0), craft, 240)
    assert angle(found.body_from_eci, true_attitude(craft, 240)) < math.radians(15.0)
    assert found.rate_rad_s[2] == pytest.approx(rate_rpm * 2.0 * math.pi / 60.0, abs=0.003)


def test_a_configured_range_picks_the_alias() -> None:
    craft = Craft(seed=4, rate_rpm=40.0)
    guesses = find_spin(samples_of(craft, 240), ROUGH, 0.8 * 4.19, 1.25 * 4.19)
    found = true_one(guesses, craft, 240)
    assert found.rate_rad_s[2] == pytest.approx(40.0 * 2.0 * math.pi / 60.0, abs=0.003)


def test_the_twin_moves_the_field_about_its_axis_the_other_way() -> None:
    samples = samples_of(Craft(seed=5), 240)
    best, twin = find_spin(samples, ROUGH, 0.6, 1.0)
    axis_of = [guess.body_from_eci.T @ guess.rate_rad_s / np.linalg.norm(guess.rate_rad_s) for guess in (best, twin)]
    moved = [np.cross(samples.reference_eci_nt[0], samples.reference_eci_nt[-1]) @ axis for axis in axis_of]
    assert moved[0] * moved[1] < 0.0


def test_a_mirrored_calibration_is_seen() -> None:
    samples = samples_of(Craft(seed=6, noise_nt=50.0), 1500)
    left_handed = calibrate(TABLE_1, samples.field_nt) * np.array([1.0, 1.0, -1.0])
    mirrored = Samples(samples.times_s, left_handed, samples.reference_eci_nt)
    assert find_spin(mirrored, np.zeros(9), 0.6, 1.0)[0].mirrored


@pytest.mark.parametrize("count", [0, 1, 3])
def test_samples_that_any_axis_follows_give_no_guess(count: int) -> None:
    """After the clock has hopped and the gate has taken the rest, one sample is left of the stretch: no time spans."""
    samples = samples_of(Craft(seed=3, rate_rpm=7.5), 240)
    samples = samples.where(np.arange(len(samples.times_s)) < count)
    assert find_spin(samples, ROUGH, 0.6, 1.0) == []


def test_a_sound_calibration_is_not_called_mirrored() -> None:
    assert not find_spin(samples_of(Craft(seed=6, noise_nt=50.0), 1500), ROUGH, 0.6, 1.0)[0].mirrored


def test_the_best_rotation_is_proper_even_where_a_reflection_fits_better() -> None:
    assert np.linalg.det(best_rotation(np.diag([1.0, 2.0, -3.0]))) == pytest.approx(1.0)


def near_truth(craft: Craft, seconds: int) -> SpinState:
    rate = np.array([0.0, 0.0, craft.rate_rpm * 2.0 * math.pi / 60.0])
    attitude = turned_once(np.array([0.05, -0.03, 0.04]), 1.0)[0] @ true_attitude(craft, seconds)
    return SpinState(ROUGH, attitude, rate, np.zeros((SPIN_STATE_SIZE, SPIN_STATE_SIZE)))


def test_the_fit_is_consistent_over_runs() -> None:
    squared = []
    for seed in range(24):
        craft = Craft(seed=100 + seed)
        fit = fit_spin(samples_of(craft, 1200), near_truth(craft, 1200), PRIOR, 300.0)
        assert fit is not None
        error = fit.state.x - TABLE_1
        squared.append(float(error @ np.linalg.solve(fit.state.covariance[:9, :9], error)))
    assert 9.0 - 4.0 * math.sqrt(18.0 / 24.0) < np.mean(squared) < 9.0 + 4.0 * math.sqrt(18.0 / 24.0)


def test_the_fit_leaves_the_noise_and_nothing_else() -> None:
    craft = Craft(seed=7)
    fit = fit_spin(samples_of(craft, 1200), near_truth(craft, 1200), PRIOR, 300.0)
    assert fit is not None
    assert np.sqrt(np.mean(fit.residual_nt**2)) == pytest.approx(300.0, rel=0.04)


def test_the_fit_does_not_change_its_start() -> None:
    craft = Craft(seed=8)
    start = near_truth(craft, 600)
    before = start.body_from_eci.copy()
    fit_spin(samples_of(craft, 600), start, PRIOR, 300.0)
    assert (start.body_from_eci == before).all()


def test_noise_in_the_samples_does_not_bias_the_fit() -> None:
    z = []
    for seed in range(12):
        craft = Craft(seed=200 + seed, noise_nt=2000.0)
        fit = fit_spin(samples_of(craft, 2400), near_truth(craft, 2400), PRIOR, 2000.0)
        assert fit is not None
        z.append((fit.state.x - TABLE_1) / np.sqrt(np.diagonal(fit.state.covariance)[:9]))
    assert np.abs(np.mean(z, axis=0)).max() < 3.5 / math.sqrt(12.0)
