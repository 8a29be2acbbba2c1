"""The filter's gates and its ways of starting anew, from both sides: a running filter that is sure of itself.

With a covariance of nearly nothing an update moves nothing, so that the normalised square of a sample whose calibrated
vector is c sigmas too long is c^2 (plus what the noise inside it adds), and everything that counts is known by hand.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig, SpinConfig
from magcal_service.estimators import ukf
from magcal_service.estimators.interface import Phase, TickOutcome
from magcal_service.estimators.parts.spin_window import Window, across_axis
from magcal_service.estimators.parts.start import BatchSolution
from magcal_service.estimators.ukf import Ukf
from magcal_service.model import field_jacobian, measure
from magcal_service.ticks.assembler import Tick

NOISE_NT = 100.0
H_NT = 50_000.0
X = np.array([900.0, -1400.0, 2100.0, 0.05, -0.08, 0.11, 0.03, -0.04, 0.06])
SURE = np.diag([1e-6] * 3 + [1e-18] * 6)
CONFIG = CraftConfig("c", SensorConfig(NOISE_NT), filter=FilterConfig(gate_sigma=6.0))


def running(config: CraftConfig = CONFIG, covariance: np.ndarray = SURE, noise_nt: float = NOISE_NT) -> Ukf:
    """A filter that has just been handed a solution."""
    target = Ukf(config)
    target._x, target._covariance, target._phase = X.copy(), covariance.copy(), Phase.RUNNING
    target._noise_variance = target._white_variance = noise_nt**2
    target._time_s = 0.0
    return target


def tick(index: int, *sigmas: float, after_gap: bool = False, seed: int = 0, vectors: bool = False) -> Tick:
    """Samples whose calibrated vectors are longer than |H| by so many sigmas, less the mean s^2 / |H| of noise."""
    rng = np.random.default_rng([seed, index])
    direction = rng.normal(size=(len(sigmas), 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    magnitude = np.full(len(sigmas), H_NT)
    length = H_NT + NOISE_NT * np.array(sigmas) + 1.5 * NOISE_NT**2 / H_NT
    times = index + 0.01 * np.arange(len(sigmas))
    reference = np.tile([[H_NT, 0.0, 0.0]], (len(sigmas), 1)) if vectors else None
    return Tick(index, times, measure(X, direction * length[:, None]), magnitude, reference, after_gap=after_gap)


# Scalar updates


@pytest.mark.parametrize(("sigmas", "used"), [(5.95, True), (-5.95, True), (6.1, False), (-6.1, False)])
def test_a_sample_beyond_the_gate_is_left_out(sigmas: float, used: bool) -> None:
    target = running()
    outcome = target.handle(tick(1, sigmas))
    assert (outcome.used, outcome.rejected, outcome.degrees) == (int(used), int(not used), int(used))
    assert outcome.squared_innovation == pytest.approx(sigmas**2 if used else 0.0, rel=0.02)
    assert (target.estimate().samples, target.estimate().rejected) == (int(used), int(not used))


def test_one_update_is_the_kalman_filters_for_a_linear_measurement() -> None:
    """Residual e = u'J dx + noise / |w|: with 10 nT and 1e-4 of uncertainty second order does not count."""
    covariance = np.diag(np.array([10.0, 20.0, 5.0, 1e-4, 2e-4, 1e-4, 3e-4, 1e-4, 2e-4]) ** 2)
    target, one = running(covariance=covariance), tick(1, 2.0)
    outcome = target.handle(one)
    w = one.field_body_nt[0] + field_jacobian(one.field_body_nt[0]) @ X
    row = (w / np.linalg.norm(w)) @ field_jacobian(one.field_body_nt[0])
    residual = float(np.linalg.norm(w)) - H_NT
    variance = row @ covariance @ row + NOISE_NT**2
    gain = covariance @ row / variance
    assert outcome.residual_nt == pytest.approx([residual], rel=1e-9)
    moved = np.sqrt(np.diagonal(covariance))
    np.testing.assert_allclose(
        (target.estimate().x - X) / moved, -gain * (residual - NOISE_NT**2 / H_NT) / moved, atol=0.01
    )
    left = covariance - np.outer(gain, gain) * variance
    np.testing.assert_allclose(
        target.estimate().covariance / np.outer(moved, moved), left / np.outer(moved, moved), atol=0.01
    )


def test_samples_of_a_tick_are_taken_one_after_the_other() -> None:
    many, single = running(), running()
    many.handle(tick(1, 1.0, -2.0, 9.0, 0.5))
    whole = tick(1, 1.0, -2.0, 9.0, 0.5)
    for row in range(4):
        part = slice(row, row + 1)
        single.handle(
            replace(
                whole,
                times_s=whole.times_s[part],
                field_body_nt=whole.field_body_nt[part],
                reference_magnitude_nt=whole.reference_magnitude_nt[part],
            )
        )
    np.testing.assert_array_equal(many.estimate().x, single.estimate().x)
    assert (many.estimate().samples, many.estimate().rejected) == (3, 1)


# Starting anew


def test_42_rejected_samples_in_a_row_start_anew() -> None:
    """A memory of 60: 1 - (59/60)^n passes a half with the 42nd; the estimate stays, a new start begins."""
    target = running(replace(CONFIG, spin=SpinConfig()))
    for index in range(1, 42):
        target.handle(tick(index, 20.0))
        assert (target.estimate().restarts, target.estimate().phase) == (0, Phase.RUNNING)
    target.handle(tick(42, 20.0))
    assert (target.estimate().restarts, target.estimate().phase) == (1, Phase.STARTING)
    np.testing.assert_array_equal(target.estimate().x, X)
    assert not target.estimate().spin_given_up


def test_a_new_start_keeps_the_estimate_and_the_account_and_forgets_everything_else() -> None:
    """A residual of 20 sigmas in 42 ticks; before that samples that fit, and half a spin window."""
    config = replace(CONFIG, spin=SpinConfig(), sensor=SensorConfig(None))
    target = running(config)
    for index in range(1, 10):
        target.handle(tick(index, 1.0))
    target._begin()
    fresh = Ukf(config)
    kept = {"_x", "_covariance", "_samples"}
    old, new = target.export_state(), fresh.export_state()
    assert {name for name in old if old[name] != new[name]} == kept


@pytest.mark.parametrize(("sigmas", "restarts"), [(math.sqrt(2.6), 1), (math.sqrt(2.4), 0)])
def test_a_hundred_samples_at_2_5_times_their_expectation_start_anew(sigmas: float, restarts: int) -> None:
    target = running()
    for index in range(1, 100):
        target.handle(tick(index, sigmas * (-1.0) ** index))
        assert target.estimate().restarts == 0
    target.handle(tick(100, sigmas))
    assert target.estimate().restarts == restarts


def test_after_a_hundred_samples_the_innovations_are_forgotten_slowly() -> None:
    """99 at 0, then at 9: the mean of the first hundred is 0.09; after that 9 (1 - 0.99^n), past 2.5 with n = 32."""
    target = running()
    for index in range(1, 100):
        target.handle(tick(index, 0.0))
    count = 0
    while not target.estimate().restarts:
        count += 1
        target.handle(tick(100 + count, 3.0))
    mean, expected = 0.0, 0
    while mean <= 2.5:
        expected += 1
        mean += (9.0 - mean) / 100.0
    assert abs(count - expected) <= 1


def test_a_filter_that_learns_its_noise_is_not_inconsistent_but_runs_away() -> None:
    """Residuals of 3 sigmas change the noise; at a level of 0.3 of |H| it is none."""
    config = replace(CONFIG, sensor=SensorConfig(None))
    target = running(config)
    for index in range(1, 150):
        target.handle(tick(index, 3.0 * (-1.0) ** index))
    assert target.estimate().restarts == 0
    for level, restarts in ((0.29, 0), (0.31, 1)):
        target = running(config, noise_nt=level * H_NT)
        target._noise_samples = 10**6
        target.handle(tick(1, 0.0))
        assert target.estimate().restarts == restarts


def test_a_covariance_beyond_repair_starts_anew_from_the_prior() -> None:
    target = running(covariance=-np.eye(9))
    outcome = target.handle(tick(1, 0.0, 0.0))
    state = target.estimate()
    assert (state.restarts, state.phase, outcome.used, outcome.rejected) == (1, Phase.STARTING, 0, 2)
    assert not state.x.any()
    np.testing.assert_array_equal(state.covariance, np.diag([3e4**2] * 3 + [0.2**2] * 6))


# Noise


def test_an_unknown_noise_is_followed_by_running_means_and_the_covariance_with_it() -> None:
    """Its recursion written out: mean square, second differences over 6, no more than 9 times the level."""
    target = running(replace(CONFIG, sensor=SensorConfig(None)))
    target._noise_samples = 50
    rng = np.random.default_rng(3)
    total = white = NOISE_NT**2
    covariance, before, last = SURE.copy(), 0.0, 0.0
    for number in range(700):
        e = float(rng.normal()) * 150.0 + 100.0 * math.sin(number / 30.0)
        count = min(50 + number + 1, 600)
        new = max(total + (e * e - total) / count, 1e-4)
        covariance *= new / total
        total = new
        rough = min((e - 2.0 * last + before) ** 2 / 6.0, 9.0 * total)
        before, last = last, e
        white = min(white + (rough - white) / count, total)
        target._learn_noise(e)
        assert target._noise_variance == pytest.approx(total, rel=1e-9)
        assert target._white_variance == pytest.approx(white, rel=1e-9)
    np.testing.assert_allclose(target._covariance, covariance, rtol=1e-9)
    assert target.estimate().noise_nt == pytest.approx(math.sqrt(total), rel=1e-9)


def test_a_learnt_noise_has_a_floor_of_10_pt() -> None:
    target = running(replace(CONFIG, sensor=SensorConfig(None)), noise_nt=1e-2)
    for _ in range(5):
        target._learn_noise(0.0)
    assert target._noise_variance == 1e-4


def test_a_given_noise_is_not_learnt() -> None:
    target = running()
    for index in range(1, 20):
        target.handle(tick(index, 2.0))
    assert target.estimate().noise_nt == NOISE_NT


# Prediction


def test_process_noise_grows_with_time() -> None:
    """Random walks of 2 nT and 1e-5 per root second over 9 s; a sample far beyond the gate adds nothing."""
    walks = FilterConfig(process_noise_bias_nt=(2.0, 2.0, 0.0), process_noise_D=(1e-5, 0.0, 0.0, 0.0, 0.0, 0.0))
    target = running(replace(CONFIG, filter=walks))
    target.handle(tick(9, 1000.0))
    expected = np.diagonal(SURE) + np.array([36.0, 36.0, 0.0, 9e-10, 0.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(np.diagonal(target.estimate().covariance), expected, rtol=1e-9)


# Spin windows


QUIET = TickOutcome(Phase.RUNNING, np.zeros(1), 1)


def spin_window(off_nt: float, share: float = 1.0, leak_nt: float = 0.0) -> Window:
    """16 calibrated vectors across z that turn once, moved by ``off_nt`` along x."""
    phase = 2.0 * math.pi * np.arange(16) / 16
    w = H_NT * np.stack([np.cos(phase), np.sin(phase), np.zeros(16)], axis=1) + [off_nt, 0.0, 0.0]
    across = across_axis(np.array([0.0, 0.0, 1.0]))
    return Window(np.full(16, 1.0 / 16.0), measure(X, w), np.full(16, H_NT), across, leak_nt, share)


def spun(window: Window, **state: object) -> tuple[Ukf, float, bool]:
    """What a window does to a filter that is sure of itself: its normalised square, and whether it was stopped."""
    target = running(replace(CONFIG, spin=SpinConfig()))
    for name, value in state.items():
        setattr(target, name, value)
    outcome = target._spin_update(window, target.handle(tick(1, 0.0)))
    assert outcome.spin_squared_innovation is not None
    return target, outcome.spin_squared_innovation, outcome.spin_rejected


@pytest.mark.parametrize(
    ("share", "leak_nt", "variance_nt2"),
    [(1.0, 0.0, 312.5), (4.0, 0.0, 1250.0), (1.0, 30.0, 1212.5), (2.0, 10.0, 725.0)],
)
@pytest.mark.parametrize(("squared", "rejected"), [(37.5, False), (38.5, True), (16.0, False), (152.0, True)])
def test_a_window_beyond_the_gate_is_left_out(
    share: float, leak_nt: float, variance_nt2: float, squared: float, rejected: bool
) -> None:
    """Tangential noise alone makes s^2 / 32 of a mean over 16; of an offset the projection leaves a half.

    The gate is that of a scalar, 36, and one more for each component: four times that is far beyond it.
    """
    off_nt = 2.0 * math.sqrt(squared * variance_nt2)
    _, found, stopped = spun(spin_window(off_nt, share, leak_nt))
    assert found == pytest.approx(squared, rel=5e-3)
    assert stopped is rejected


def test_a_window_moves_the_bias_across_the_axis_as_a_kalman_filter_would() -> None:
    """Bias known to 20 nT: the mean of the projected vectors is half of what the bias moves."""
    covariance = SURE.copy()
    covariance[:3, :3] = np.diag([400.0, 400.0, 400.0])
    target = running(replace(CONFIG, spin=SpinConfig()), covariance)
    outcome = target._spin_update(spin_window(30.0), target.handle(tick(1, 1000.0)))
    variance = 0.25 * 400.0 + 312.5
    assert outcome.spin_squared_innovation == pytest.approx(15.0**2 / variance, rel=0.01)
    gain = 0.5 * 400.0 / variance
    np.testing.assert_allclose(target.estimate().x[:3] - X[:3], [gain * 15.0, 0.0, 0.0], atol=0.1)
    left = 400.0 - gain**2 * variance
    np.testing.assert_allclose(np.diagonal(target.estimate().covariance)[:3], [left, left, 400.0], rtol=0.01)


@pytest.mark.parametrize(("count", "given_up"), [(15, False), (16, True)])
def test_sixteen_windows_at_more_than_three_times_their_expectation_give_the_spin_up(
    count: int, given_up: bool
) -> None:
    target = running(replace(CONFIG, spin=SpinConfig()))
    window = spin_window(2.0 * math.sqrt(6.2 * 312.5))
    for _ in range(count):
        target._spin_update(window, QUIET)
    target._guard_consistency(H_NT)
    assert (target.estimate().spin_given_up, target.estimate().restarts) == (given_up, int(given_up))
    assert (target._windows is None) is given_up


def test_windows_at_less_than_three_times_their_expectation_are_borne() -> None:
    target = running(replace(CONFIG, spin=SpinConfig()))
    for _ in range(40):
        target._spin_update(spin_window(2.0 * math.sqrt(5.8 * 312.5)), QUIET)
        target._guard_consistency(H_NT)
    assert target.estimate().restarts == 0


@pytest.mark.parametrize(("bad", "given_up"), [(3, False), (4, False), (5, True)])
def test_a_single_window_counts_as_a_quarter_of_what_is_too_much(bad: int, given_up: bool) -> None:
    """Sixteen windows, some of them absurd and the others at 0.5: four times 24 and the rest are just enough."""
    target = running(replace(CONFIG, spin=SpinConfig()))
    for index in range(16):
        squared = 1e4 if index < bad else 0.0
        target._spin_update(spin_window(2.0 * math.sqrt(squared * 312.5)), QUIET)
    assert target._spin_norm == pytest.approx(24.0 * bad / 16.0, rel=1e-3, abs=1e-3)
    target._guard_consistency(H_NT)
    assert target.estimate().spin_given_up is given_up


@pytest.mark.parametrize(("share", "given_up"), [(0.09, True), (0.11, False)])
def test_the_spin_is_not_to_blame_where_samples_are_rejected_too(share: float, given_up: bool) -> None:
    target = running(replace(CONFIG, spin=SpinConfig()))
    target._rejected_share, target._spin_count, target._spin_norm = share, 16, 6.1
    target._guard_consistency(H_NT)
    assert (target.estimate().spin_given_up, target.estimate().restarts) == (given_up, 1)


def test_samples_that_the_gate_stops_are_kept_out_of_the_window() -> None:
    """Ticks of four samples, of which one, none or all are stopped."""
    target = running(replace(CONFIG, spin=SpinConfig()))
    counts = []
    for index, sigmas in enumerate([(0.0,) * 4, (0.0, 50.0, 0.0, 0.0), (50.0,) * 4, (0.0,) * 4]):
        target.handle(tick(index + 1, *sigmas, vectors=True))
        assert target._windows is not None
        counts.append(target._windows._samples)
    assert counts == [4, 7, 7, 11]
    target.handle(tick(6, 50.0, after_gap=True))
    assert target._windows is not None
    assert target._windows._samples == 0


# The handover


def test_what_the_start_has_found_is_taken_over(monkeypatch: pytest.MonkeyPatch) -> None:
    covariance = np.diag([4.0] * 3 + [1e-10] * 6)
    solution = BatchSolution(X, covariance, 150.0, 120.0, 150.0)
    target = Ukf(replace(CONFIG, spin=SpinConfig(), filter=FilterConfig(start_inflation=3.0)))
    start = target._start
    monkeypatch.setattr(start, "push", lambda one, window: solution)
    start.spin_contradicted = True
    outcome = target.handle(tick(5, 0.0, 0.0))
    state = target.estimate()
    assert (state.phase, outcome.phase, outcome.used, state.samples) == (Phase.RUNNING, Phase.RUNNING, 2, 2)
    np.testing.assert_array_equal(state.x, X)
    np.testing.assert_allclose(state.covariance, 9.0 * covariance, rtol=1e-12)
    assert (state.noise_nt, target._white_variance) == (150.0, 120.0**2)
    assert (state.spin_given_up, target._windows) == (True, None)
    assert target._time_s == 5.01
    assert target._start is not start
    assert not target._learning
    assert outcome.residual_nt == pytest.approx([0.3, 0.3], abs=0.01)


def test_a_noise_that_the_start_has_contradicted_is_learnt_from_then_on(monkeypatch: pytest.MonkeyPatch) -> None:
    target = Ukf(CONFIG)
    monkeypatch.setattr(target._start, "push", lambda one, window: BatchSolution(X, SURE, 150.0, 120.0, 150.0))
    target._start.noise_contradicted = True
    target.handle(tick(5, 0.0))
    assert target._learning
    assert target._windows is None


def test_what_is_kept_of_a_tick_keeps_its_references() -> None:
    some = replace(tick(1, 0.0, 0.0, 0.0), reference_eci_nt=np.diag([1.0, 2.0, 3.0]))
    kept = ukf._only(some, np.array([True, False, True]))
    np.testing.assert_array_equal(kept.reference_eci_nt, [[1.0, 0.0, 0.0], [0.0, 0.0, 3.0]])
    np.testing.assert_array_equal(kept.field_body_nt, some.field_body_nt[[0, 2]])
    assert ukf._only(tick(1, 0.0, 0.0), np.array([True, False])).reference_eci_nt is None


def test_the_fourth_measurement_goes_on_from_the_last_sample_of_a_tick() -> None:
    target, some = running(replace(CONFIG, spin=SpinConfig(fourth=True))), tick(1, 0.0, 0.0, 0.0)
    target._fourth_update(some, SpinConfig(fourth=True))
    np.testing.assert_array_equal(target._last_field, some.field_body_nt[2])
