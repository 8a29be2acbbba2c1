"""When the spin is searched, where, and how long it has to hold: the numbers of the search from both sides."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.config.settings import CraftConfig, SensorConfig, SpinConfig
from magcal_service.estimators.interface import Phase, StateEstimate
from magcal_service.estimators.spin import SpinFilter, SpinTracker, configured_tie
from magcal_service.estimators.steady_spin.candidates import Candidate, Candidates
from magcal_service.estimators.steady_spin.fit import SpinFit
from magcal_service.estimators.steady_spin.search import SpinSearch, SpinStart, retry_at
from magcal_service.estimators.steady_spin.state import SpinState
from magcal_service.estimators.steady_spin.watch import FitQuality, SpinGate
from magcal_service.ticks.assembler import Tick

CONFIG = CraftConfig("c", SensorConfig(100.0))
SCALAR = StateEstimate(np.zeros(9), np.diag([1.0] * 3 + [1e-8] * 6), Phase.RUNNING, 100.0, 500, 0, 0, None, False)
RPM = 2.0 * math.pi / 60.0


def tick(index: int, *, vectors: bool = True, after_gap: bool = False) -> Tick:
    reference = np.array([[30_000.0, 0.0, 0.0]]) if vectors else None
    return Tick(
        index, np.array([float(index)]), np.array([[30_000.0, 0.0, 0.0]]), np.array([30_000.0]), reference, after_gap
    )


@pytest.mark.parametrize(("seconds", "expected"), [(100.0, 130.0), (199.0, 229.0), (201.0, 231.15), (1000.0, 1150.0)])
def test_an_attempt_is_put_off_by_15_percent_and_at_least_half_a_minute(seconds: float, expected: float) -> None:
    assert retry_at(seconds) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("spin", "period_s", "ranges"),
    [
        (None, 0.1, [(0.3 * RPM, 35.0 * RPM)]),
        (None, 2.0, [(0.3 * RPM, 0.49 * math.pi)]),
        (None, 200.0, []),
        (SpinConfig(rate_rpm=-7.5), 0.1, [(6.0 * RPM, 9.375 * RPM), (0.3 * RPM, 35.0 * RPM)]),
        (SpinConfig(rate_rpm=40.0), 2.0, [(32.0 * RPM, 50.0 * RPM), (0.3 * RPM, 0.49 * math.pi)]),
    ],
)
def test_rates_are_searched_around_the_configured_one_and_then_up_to_nyquists(
    spin: SpinConfig | None, period_s: float, ranges: list[tuple[float, float]]
) -> None:
    found = Candidates(replace(CONFIG, spin=spin)).rate_ranges(period_s)
    assert len(found) == len(ranges)
    for one, expected in zip(found, ranges, strict=True):
        assert one == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("rate_rpm", "span_s"), [(None, 240.0), (7.5, 240.0), (-0.4, 300.0), (0.5, 240.0)])
def test_the_first_fit_has_two_turns_of_a_configured_slow_spin(rate_rpm: float | None, span_s: float) -> None:
    spin = None if rate_rpm is None else SpinConfig(rate_rpm=rate_rpm)
    assert Candidates(replace(CONFIG, spin=spin)).first_span_s() == pytest.approx(span_s)


@pytest.mark.parametrize(
    ("held_s", "walk"),
    [(4000.0, 1e-7), (2000.0, 1e-7), (1900.0, 1e-6), (430.0, 1e-6), (400.0, 1e-5), (10.0, 1e-5)],
)
def test_a_spin_that_was_lost_is_allowed_what_turns_it_noticeably_in_the_time_it_held(
    held_s: float, walk: float
) -> None:
    """5e-3 rad by a random walk q of the rate: q^2 t^3 / 3; two steps more where it held for an hour."""
    search = SpinSearch(CONFIG)
    search._allow_more_walk(held_s)
    needed = 5e-3 * math.sqrt(3.0) / held_s**1.5
    ladder = [1e-8, 1e-7, 1e-6, 1e-5]
    assert search.rate_walk == next((step for step in ladder if step >= needed), ladder[-1]) == walk


def test_at_least_a_step_more_is_allowed_each_time_up_to_the_largest() -> None:
    search, walks = SpinSearch(CONFIG, rate_walk=5e-8), []
    for _ in range(5):
        walks.append(search.rate_walk)
        search._allow_more_walk(1e9)
    assert walks == [5e-8, 1e-7, 1e-6, 1e-5, 1e-5]


def test_each_loss_asks_for_twice_as_long_a_proof_up_to_an_hour() -> None:
    search, asked = SpinSearch(CONFIG), []
    for _ in range(7):
        asked.append(search.first_attempt_s)
        search.demand_longer_proof(1e6)
    assert asked == [120.0, 240.0, 480.0, 960.0, 1920.0, 3600.0, 3600.0]


def test_an_attempt_waits_for_its_time_and_for_the_scalar_filter(monkeypatch: pytest.MonkeyPatch) -> None:
    search, tried = SpinSearch(CONFIG), []
    monkeypatch.setattr(search, "start_of", lambda samples, scalar, now_s: tried.append(now_s) or SpinGate.NO_AXIS)
    starting = replace(SCALAR, phase=Phase.STARTING)
    for index in range(200):
        search.add(tick(index))
        assert search.attempt(starting if index < 130 else SCALAR) is None
        if index in (119, 120):
            assert search.gate is (SpinGate.COLLECTING if index == 119 else SpinGate.NO_SCALAR_START)
    assert tried == [130.0, 160.0, 190.0]
    assert search.gate is SpinGate.NO_AXIS


@pytest.mark.parametrize(("residual_nt", "growth"), [(50.0, 1.0), (100.0, 1.0), (300.0, 3.0)])
def test_a_spin_that_is_seen_is_no_surer_than_what_its_fit_leaves(residual_nt: float, growth: float) -> None:
    """Sigmas grow with a residual above the noise of 100 nT, and never shrink below the fit's own."""
    state = SpinState(np.zeros(9), np.eye(3), np.array([0.0, 0.0, 0.1]), np.diag([1.0] * 9 + [1e-4] * 3 + [4e-8] * 3))
    none = np.zeros((0, 3))
    search = SpinSearch(CONFIG)
    search._record_spin(
        Candidate(SpinFit(state, none, none, none), FitQuality(residual_nt, 1.0, 1.0, 500), 240.0), 100.0, 7.0
    )
    assert search.seen is not None
    assert (search.seen.time_s, search.seen.rate_rad_s) == (7.0, 0.1)
    assert search.seen.rate_sigma_rad_s == pytest.approx(2e-4 * growth)
    assert search.seen.axis_body_sigma_rad == pytest.approx(2e-3 * growth)


def test_a_gap_loses_what_was_collected_and_ticks_without_vectors_are_not_kept() -> None:
    search = SpinSearch(CONFIG)
    for index in range(10):
        search.add(tick(index))
    search.add(tick(10, vectors=False))
    assert (search._buffer.count, search._seconds) == (10, 9.0)
    search.add(tick(500, after_gap=True))
    assert (search._buffer.count, search._seconds, search._began_s) == (1, 0.0, 500.0)
    assert search.gate is SpinGate.COLLECTING


# The running filter


def tracker(attitude_variance: float = 1e-12, config: CraftConfig = CONFIG, noise_nt: float = 100.0) -> SpinTracker:
    """A craft at rest whose body axes are inertial, known to nearly nothing; it began at second 0."""
    covariance = np.diag([1e-6] * 3 + [1e-18] * 6 + [attitude_variance] * 3 + [1e-24] * 3)
    state = SpinState(np.zeros(9), np.eye(3), np.array([0.0, 0.0, 1e-9]), covariance)
    return SpinTracker(config, SpinStart(state, noise_nt, 0.0, 100), None, 0.0)


def off(index: int, sigmas: float, *, after_gap: bool = False) -> Tick:
    one = tick(index, after_gap=after_gap)
    return replace(one, field_body_nt=one.field_body_nt + np.array([0.0, 100.0 * sigmas, 0.0]))


@pytest.mark.parametrize(("squared", "used"), [(38.9, 1), (39.1, 0)])
def test_a_vector_beyond_the_gate_is_left_out(squared: float, used: int) -> None:
    """The gate is that of a scalar, 36, and one more for each of the three components."""
    target = tracker()
    one = off(1, math.sqrt(squared))
    outcome = target.handle(one, one.reference_eci_nt)  # type: ignore[arg-type]
    assert (outcome.used, outcome.rejected, outcome.degrees) == (used, 1 - used, 3 * used)
    assert outcome.squared_innovation == pytest.approx(squared * used, rel=1e-3)
    length = math.hypot(30_000.0, 100.0 * math.sqrt(squared))
    assert outcome.residual_nt == pytest.approx([length - 30_000.0], rel=1e-6)
    assert target.time_s == 1.0


@pytest.mark.parametrize(("sigma_rad", "lost"), [(0.29, None), (0.31, SpinGate.PHASE_LOST)])
def test_after_a_gap_an_attitude_that_is_not_known_is_a_lost_phase(sigma_rad: float, lost: SpinGate | None) -> None:
    for after_gap in (True, False):
        target = tracker(sigma_rad**2)
        one = off(1, 0.0, after_gap=after_gap)
        target.handle(one, one.reference_eci_nt)  # type: ignore[arg-type]
        assert target.lost is (lost if after_gap else None)


def test_an_unknown_noise_follows_the_normalised_innovations() -> None:
    """Its recursion: a factor 1 + (norm / 3 - 1) / n, n up to 600, on noise and covariance alike."""
    target = tracker(config=replace(CONFIG, sensor=SensorConfig(None)))
    variance, covariance = 1e4, target.state.covariance.copy()
    for number in range(101, 800):
        norm = 3.0 + 2.0 * math.sin(number)
        factor = 1.0 + (norm / 3.0 - 1.0) / min(number, 600)
        variance, covariance = variance * factor, covariance * factor
        target._learn_noise(norm)
        assert target.noise_variance == pytest.approx(variance, rel=1e-12)
    np.testing.assert_allclose(target.state.covariance, covariance, rtol=1e-9)


@pytest.mark.parametrize(("given", "sigma"), [(0.01, 0.01), (0.0, 1e-6)])
def test_a_configured_axis_is_known_to_a_microradian_at_best(given: float, sigma: float) -> None:
    tie = configured_tie(replace(CONFIG, spin=SpinConfig(axis=(0.0, 0.0, 1.0))), given)
    assert tie is not None
    assert tie.sigma_rad == sigma
    np.testing.assert_allclose(tie.across @ [0.0, 0.0, 1.0], 0.0, atol=1e-15)
    assert configured_tie(CONFIG, given) is None


@pytest.mark.parametrize(("silent_s", "fallback"), [(60.0, None), (61.0, SpinGate.NO_VECTOR)])
def test_a_minute_without_reference_vectors_is_borne(silent_s: float, fallback: SpinGate | None) -> None:
    target = SpinFilter(CONFIG)
    target._tracker = tracker()
    target.handle(tick(round(silent_s), vectors=False))
    assert target.fallback is fallback
    assert (target.estimate().phase is Phase.RUNNING) is (fallback is None)
    one = off(62, 0.0)
    target.handle(one)
    assert target.fallback is None


def test_a_lost_spin_gives_its_errors_to_the_search_after_a_gap_and_the_scalars_else() -> None:
    """What is dropped is gone: tracker and samples; what was known without them is the next fit's prior."""
    for why in (SpinGate.PHASE_LOST, SpinGate.INCONSISTENT):
        target = SpinFilter(CONFIG)
        running = tracker()
        running.time_s = 10.0
        target._tracker = running
        target._search.add(tick(0))
        target._lose(running, why)
        assert (target._tracker, target.fallbacks, target.fallback) == (None, 1, why)
        assert target._search._buffer.count == 0
        known = target._search._prior
        expected = (
            running.state.covariance[:9, :9] if why is SpinGate.PHASE_LOST else np.diag([3e4**2] * 3 + [0.2**2] * 6)
        )
        np.testing.assert_allclose(known.covariance, expected, rtol=1e-12)
        assert target._search.first_attempt_s == (120.0 if why is SpinGate.PHASE_LOST else 240.0)
