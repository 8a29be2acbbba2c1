"""Every level of the change detector from both sides: estimates put in by hand, states that don't correlate.

With diagonal covariances each state is a scalar Kalman filter, so that T, the jump and the estimates that follow or
never followed have closed forms of one line.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from magcal_service.estimators.parts.adaptive import _LEVELS, EVERY_TICKS, OLDEST_TICKS, Change, ChangeDetector
from magcal_service.residuals import log_tail

BEFORE = np.array([50.0**2] * 3 + [1e-3**2] * 6)
NOW = 0.5 * BEFORE
JUMP = np.array([2000.0**2] * 3 + [0.03**2] * 6)  # variance of a jump's prior
BIAS, D, ALL = range(3), range(3, 9), range(9)
NOISE = 300.0**2


@pytest.mark.parametrize("degrees", _LEVELS)
def test_a_quiet_test_exceeds_its_level_once_in_1e8(degrees: int) -> None:
    assert log_tail(_LEVELS[degrees], degrees) / math.log(10.0) == pytest.approx(-8.0, abs=0.005)
    assert set(_LEVELS) == {1, 3, 6, 9}


def step_of(T: np.ndarray, before: np.ndarray = BEFORE, now: np.ndarray = NOW) -> np.ndarray:
    """Change of the estimate (9,) that gives each state its T: T = d^2 / (S + L), d = step / before."""
    information = 1.0 / before - now / before**2 + 1.0 / JUMP
    return np.sqrt(T * information) * before


def shares(states: range, T: float) -> np.ndarray:
    """T over the states, in equal parts."""
    return np.where(np.isin(np.arange(9), states), T / len(states), 0.0)


def pushed(
    detector: ChangeDetector, ticks: int, x: np.ndarray, variance: np.ndarray, noise: float = NOISE, rate_s: float = 1.0
) -> list[Change]:
    """The same estimate for so many ticks; what was found."""
    found = []
    for _ in range(ticks):
        change = detector.push(rate_s * (detector._tick + 1), x, np.diag(variance), noise)
        if change is not None:
            found.append(change)
    return found


def freed_states(change: Change) -> list[int]:
    """States whose variance the change has raised."""
    return np.flatnonzero(np.diagonal(change.covariance) > 1.01 * NOW).tolist()


def after_jump(T: np.ndarray, quiet: int = EVERY_TICKS) -> tuple[ChangeDetector, list[Change]]:
    """One candidate at the end of the quiet, and the estimate that has moved two looks later."""
    detector = ChangeDetector()
    assert pushed(detector, quiet, np.zeros(9), BEFORE) == []
    return detector, pushed(detector, 2 * EVERY_TICKS, step_of(T), NOW)


@pytest.mark.parametrize(("factor", "found"), [(1.001, True), (0.999, False)])
@pytest.mark.parametrize(
    ("states", "level"),
    [*((range(i, i + 1), 32.84) for i in range(9)), (BIAS, 40.13), (D, 48.36), (ALL, 55.45)],
)
def test_each_hypothesis_has_its_level(states: range, level: float, factor: float, found: bool) -> None:
    assert (len(after_jump(shares(states, factor * level))[1]) == 1) is found


def test_the_estimate_that_follows_is_that_of_a_scalar_filter_with_the_jumps_variance() -> None:
    """For each state: information of the samples since, with the prior grown by the jump's variance."""
    step = step_of(shares(BIAS, 90.0))
    change = after_jump(shares(BIAS, 90.0))[1][0]
    since = 1.0 / NOW - 1.0 / BEFORE
    mean = (step / NOW) / since  # of the samples since, as the estimate before was 0
    grown = np.where(np.isin(np.arange(9), BIAS), BEFORE + JUMP, BEFORE)
    variance = 1.0 / (1.0 / grown + since)
    np.testing.assert_allclose(np.diagonal(change.covariance), variance, rtol=1e-9)
    np.testing.assert_allclose(change.x, variance * since * mean, rtol=1e-9)
    information = 1.0 / BEFORE - NOW / BEFORE**2 + 1.0 / JUMP
    np.testing.assert_allclose(change.jump[:3], (step / BEFORE / information)[:3], rtol=1e-9)
    assert (change.ticks_ago, change.jump[3:].any()) == (2 * EVERY_TICKS, False)


def test_a_candidate_of_one_look_ago_is_too_young() -> None:
    detector = ChangeDetector()
    pushed(detector, EVERY_TICKS, np.zeros(9), BEFORE)
    moved = step_of(shares(BIAS, 90.0))
    assert pushed(detector, EVERY_TICKS, moved, NOW) == []
    assert [change.ticks_ago for change in pushed(detector, EVERY_TICKS, moved, NOW)] == [2 * EVERY_TICKS]


def test_it_looks_every_16_ticks() -> None:
    detector = ChangeDetector()
    pushed(detector, 3 * EVERY_TICKS - 1, np.zeros(9), BEFORE)
    assert pushed(detector, 1, step_of(shares(BIAS, 90.0)), NOW) != []


@pytest.mark.parametrize(
    ("bias", "d", "free"),
    [(60.0, 0.0, BIAS), (60.0, 78.0, BIAS), (60.0, 78.8, D), (0.0, 60.0, D), (50.0, 50.0, BIAS)],
)
def test_the_bias_is_set_free_unless_d_fits_better_by_18(bias: float, d: float, free: range) -> None:
    change = after_jump(shares(BIAS, bias) + shares(D, d))[1][0]
    assert freed_states(change) == list(free)


@pytest.mark.parametrize(("sign", "ticks_ago"), [(1.0, 2 * EVERY_TICKS), (-1.0, 3 * EVERY_TICKS)])
def test_the_likeliest_of_the_candidates_is_the_jumps_time(sign: float, ticks_ago: int) -> None:
    """The estimate moved a little before, the same way or back: from there it went less far, or further."""
    detector, middle = ChangeDetector(), 0.8 * BEFORE
    first, last = sign * step_of(shares(BIAS, 20.0), BEFORE, middle), step_of(shares(BIAS, 60.0), middle, NOW)
    assert pushed(detector, EVERY_TICKS, first, BEFORE) == []
    assert pushed(detector, 2 * EVERY_TICKS, np.zeros(9), middle) == []
    older = float(np.sum(((last - first) / BEFORE)[:3] ** 2 / (1.0 / BEFORE - NOW / BEFORE**2 + 1.0 / JUMP)[:3]))
    assert (older > 60.0) is (ticks_ago == 3 * EVERY_TICKS)
    assert pushed(detector, EVERY_TICKS, last, NOW)[0].ticks_ago == ticks_ago


def following(never: np.ndarray, free: range) -> tuple[np.ndarray, np.ndarray]:
    """Estimate and variance of the filter that follows a jump of ``free``; one that never did has ``never``."""
    since = 1.0 / NOW - 1.0 / BEFORE
    grown = np.where(np.isin(np.arange(9), free), BEFORE + JUMP, BEFORE)
    variance = 1.0 / (1.0 / grown + since)
    return variance * (never / NOW), variance


def reconsidered(
    first: range, bias: float, d: float, age: int = 3 * EVERY_TICKS
) -> tuple[ChangeDetector, list[Change]]:
    """After a jump put down to ``first`` the samples say T for bias and D; what is made of that at an age."""
    detector, found = after_jump(shares(first, 90.0))
    assert len(found) == 1
    jump = detector._open
    assert jump is not None
    detector._tick = jump.past.tick + age - 1
    never = step_of(shares(BIAS, bias) + shares(D, d))
    x, variance = following(never, first)
    return detector, pushed(detector, 1, x, variance)


@pytest.mark.parametrize("first", [BIAS, D])
@pytest.mark.parametrize(
    ("own", "other", "freed", "is_open"),
    [
        (50.0, 68.3, None, True),  # cannot be told apart
        (20.0, 38.5, "other", True),
        (50.0, 69.0, "all", False),  # both fit, and together by more than 30
        (29.9, 60.0, "other", True),
        (30.1, 60.0, "all", False),
        (60.0, 30.1, "all", False),
        (29.9, 11.6, None, True),
        (29.9, 11.4, None, False),  # ruled out
    ],
)
def test_a_jump_is_put_down_to_other_states_where_they_fit_better_by_far(
    first: range, own: float, other: float, freed: str | None, is_open: bool
) -> None:
    if (own, other) == (50.0, 68.3):
        own, other = 10.0, 28.3
    bias, d = (own, other) if first is BIAS else (other, own)
    detector, found = reconsidered(first, bias, d)
    expected = {None: None, "other": D if first is BIAS else BIAS, "all": ALL}[freed]
    freed_now = freed_states(found[0]) if found else None
    assert freed_now == (None if expected is None else list(expected))
    assert (detector._open is not None) is is_open
    if found:
        never = step_of(shares(BIAS, bias) + shares(D, d))
        x, variance = following(never, expected)  # type: ignore[arg-type]
        np.testing.assert_allclose(found[0].x, x, rtol=1e-6, atol=1e-9 * np.abs(x).max())
        np.testing.assert_allclose(np.diagonal(found[0].covariance), variance, rtol=1e-6)
        assert found[0].ticks_ago == 3 * EVERY_TICKS


@pytest.mark.parametrize(("age", "is_open"), [(6000, True), (6016, False)])
def test_after_an_orbit_a_jump_stays_what_it_was_taken_for(age: int, is_open: bool) -> None:
    detector, found = reconsidered(BIAS, 20.0, 20.0, age)
    assert found == []
    assert (detector._open is not None) is is_open


@pytest.mark.parametrize(("seconds", "found"), [(0.9, True), (1.1, False)])
def test_a_random_walk_that_is_known_explains_its_share(seconds: float, found: bool) -> None:
    """The walk's variance over the 32 ticks since the candidate is added to the variance before."""
    rate = BEFORE / 32.0
    detector = ChangeDetector(np.diag(rate))
    pushed(detector, EVERY_TICKS, np.zeros(9), BEFORE)
    grown = BEFORE + rate * 32.0
    step = step_of(shares(BIAS, 40.13), grown, NOW)
    assert (pushed(detector, 2 * EVERY_TICKS, step, NOW, rate_s=seconds) != []) is found


@pytest.mark.parametrize(("factor", "found"), [(0.9, True), (1.1, False)])
def test_a_past_covariance_is_one_for_the_noise_known_now(factor: float, found: bool) -> None:
    """Twice the noise variance now: the covariance before is taken twice as large."""
    detector = ChangeDetector()
    pushed(detector, EVERY_TICKS, np.zeros(9), BEFORE)
    step = step_of(shares(BIAS, 40.13), 2.0 * BEFORE, NOW)
    assert (pushed(detector, 2 * EVERY_TICKS, step, NOW, 2.0 * factor * NOISE) != []) is found


def test_candidates_are_an_eighth_of_their_age_apart_and_never_older_than_16384_ticks() -> None:
    detector = ChangeDetector()
    most = 0
    for _ in range(OLDEST_TICKS // EVERY_TICKS + 100):
        detector._tick += EVERY_TICKS - 1
        pushed(detector, 1, np.zeros(9), BEFORE)
        ages = detector._tick - np.array([past.tick for past in detector._past])
        assert ages[-1] == 0
        assert ages[0] < OLDEST_TICKS
        assert np.all(-np.diff(ages) <= np.maximum(EVERY_TICKS, ages[:-1] / 8.0))
        most = max(most, len(ages))
    assert ages[0] > 0.8 * OLDEST_TICKS
    assert 40 <= most <= 90


def test_a_change_and_a_start_forget_the_past() -> None:
    detector, found = after_jump(shares(BIAS, 90.0))
    assert (len(found), detector._past) == (1, [])
    detector.clear()
    assert (detector._tick, detector._past, detector._open) == (0, [], None)
