"""The spin estimator: at its bound and consistent, and back to the scalar filter whenever its assumption fails."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magcal_service.config.settings import CraftConfig, SensorConfig, SpinConfig
from magcal_service.estimators import find_method
from magcal_service.estimators.interface import Phase, StateEstimate
from magcal_service.estimators.spin import SpinFilter
from magcal_service.estimators.steady_spin.watch import SpinGate
from magcal_service.estimators.ukf import Ukf
from magcal_service.model import STATE_SIZE, Array
from magcal_service.recordings.reader import read_recording
from magcal_service.ticks.assembler import Tick
from tests.estimators.estimator_ticks import TABLE_1, Craft
from tests.estimators.spin_motions import Motion, despinning, kicked, nutating, steady, ticks_of, tumbling

SECONDS = 2000
DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


def config_of(noise_nt: float | None = 300.0, spin: SpinConfig | None = SpinConfig()) -> CraftConfig:  # noqa: B008
    return CraftConfig("x", sensor=SensorConfig(noise_nt=noise_nt), spin=spin)


def play(ticks: Iterable[Tick], config: CraftConfig) -> SpinFilter:
    estimator = SpinFilter(config)
    for tick in ticks:
        estimator.handle(tick)
    return estimator


def normalised(estimate: StateEstimate) -> float:
    error = estimate.x - TABLE_1
    return float(error @ np.linalg.solve(estimate.covariance, error))


def degrees_between(a: Array, b: tuple[float, float, float]) -> float:
    return math.degrees(math.acos(min(1.0, float(a @ np.array(b)) / float(np.linalg.norm(b)))))


@pytest.fixture(scope="module")
def runs() -> list[SpinFilter]:
    """Eight runs of the paper's craft."""
    return [play(Craft(seed=seed).ticks(SECONDS), config_of()) for seed in range(8)]


def test_every_run_ends_on_the_spin(runs: list[SpinFilter]) -> None:
    assert [run.fallback for run in runs] == [None] * len(runs)


def test_the_covariance_is_consistent(runs: list[SpinFilter]) -> None:
    mean = np.mean([normalised(run.estimate()) for run in runs])
    assert abs(mean - STATE_SIZE) < 3.5 * math.sqrt(2.0 * STATE_SIZE / len(runs))


def test_the_mean_error_is_within_its_sampling_error(runs: list[SpinFilter]) -> None:
    estimates = [run.estimate() for run in runs]
    sigma = np.sqrt(np.mean([np.diagonal(estimate.covariance) for estimate in estimates], axis=0))
    error = np.mean([estimate.x - TABLE_1 for estimate in estimates], axis=0)
    assert np.abs(error / sigma).max() < 3.3 / math.sqrt(len(runs))


def test_the_spin_is_published_with_a_consistent_sigma(runs: list[SpinFilter]) -> None:
    off = []
    for run in runs:
        assert run.spin is not None
        sigma_deg = math.degrees(run.spin.axis_eci_sigma_rad)
        off.append(degrees_between(run.spin.axis_eci, (1.0, 1.0, 1.0)) / sigma_deg)
    assert 0.3 < math.sqrt(np.mean(np.square(off))) < 2.2  # two directions across, the sigma is the larger one's


def test_it_is_surer_than_the_scalar_filter(runs: list[SpinFilter]) -> None:
    scalar = Ukf(config_of(spin=None))
    for tick in Craft(seed=0).ticks(SECONDS):
        scalar.handle(tick)
    ratio = np.diagonal(runs[0].estimate().covariance) / np.diagonal(scalar.estimate().covariance)
    assert ratio.max() < 0.8


def test_before_it_starts_it_is_the_scalar_filter_bit_for_bit() -> None:
    estimator, scalar = SpinFilter(config_of()), Ukf(config_of(spin=None))
    for tick in Craft(seed=0).ticks(SECONDS):
        outcome, expected = estimator.handle(tick), scalar.handle(tick)
        if estimator.fallback is None:
            break
        assert outcome.used == expected.used
        assert (estimator.estimate().x == scalar.estimate().x).all()
        assert (estimator.estimate().covariance == scalar.estimate().covariance).all()
    assert estimator.fallback is None


CRAFTS = {
    "ten_samples_a_second": (Craft(seed=20, rate_hz=10), config_of(), 1200),
    "configured_rate_off_by_5_percent": (Craft(seed=21), config_of(spin=SpinConfig(rate_rpm=7.125)), SECONDS),
    "axis_off_by_11_degrees": (Craft(seed=22, spin_body=(0.19, 0.0, 0.98)), config_of(), SECONDS),
    "nothing_configured": (Craft(seed=23, spin_body=(0.5, -0.3, 0.8)), config_of(spin=None), SECONDS),
    "backwards": (Craft(seed=24, rate_rpm=-7.5), config_of(spin=None), SECONDS),
    "slow": (Craft(seed=25, rate_rpm=0.5), config_of(spin=SpinConfig(rate_rpm=0.5)), SECONDS),
    "fast": (Craft(seed=26, rate_rpm=28.0), config_of(spin=None), SECONDS),
    "noise_not_given": (Craft(seed=27), config_of(noise_nt=None), SECONDS),
    "near_the_orbit_normal": (Craft(seed=28, spin_eci=(0.0, -0.96, 0.28)), config_of(), 10_000),
}


@pytest.fixture(scope="module", params=CRAFTS, ids=list(CRAFTS))
def case(request: pytest.FixtureRequest) -> tuple[Craft, SpinFilter]:
    craft, config, seconds = CRAFTS[request.param]
    return craft, play(craft.ticks(seconds), config)


def test_it_ends_within_five_sigma_on_the_spin(case: tuple[Craft, SpinFilter]) -> None:
    estimate = case[1].estimate()
    assert case[1].fallback is None
    assert np.abs((estimate.x - TABLE_1) / np.sqrt(np.diagonal(estimate.covariance))).max() < 5.0


def test_it_finds_the_rate(case: tuple[Craft, SpinFilter]) -> None:
    craft, estimator = case
    assert estimator.spin is not None
    off = estimator.spin.rate_rad_s - abs(craft.rate_rpm) * 2.0 * math.pi / 60.0
    assert abs(off) < 5.0 * estimator.spin.rate_sigma_rad_s


def test_it_finds_the_axis_in_the_body(case: tuple[Craft, SpinFilter]) -> None:
    craft, estimator = case
    assert estimator.spin is not None
    truth = tuple(math.copysign(1.0, craft.rate_rpm) * part for part in craft.spin_body)
    assert math.radians(degrees_between(estimator.spin.axis_body, truth)) < 5.0 * estimator.spin.axis_body_sigma_rad


def test_an_unknown_noise_is_learnt() -> None:
    estimator = play(Craft(seed=27).ticks(SECONDS), config_of(noise_nt=None))
    assert estimator.estimate().noise_nt == pytest.approx(300.0, rel=0.08)


def test_a_configured_axis_that_is_right_makes_it_surer() -> None:
    given, free = (play(Craft(seed=28).ticks(SECONDS), config_of(spin=spin)) for spin in (SpinConfig(), None))
    assert np.trace(given.estimate().covariance[:2, :2]) < np.trace(free.estimate().covariance[:2, :2])


@pytest.mark.parametrize("motion", [tumbling, nutating], ids=["tumbling", "nutating"])
def test_a_craft_that_does_not_turn_about_an_axis_is_left_to_the_scalar_filter(motion: Motion) -> None:
    estimator = play(ticks_of(motion, 2000), config_of())
    assert estimator.fallback in (SpinGate.NO_AXIS, SpinGate.INCONSISTENT)
    assert estimator.estimate().phase is Phase.RUNNING


def test_a_despin_is_not_taken_for_a_steady_spin() -> None:
    estimate = play(ticks_of(despinning, SECONDS), config_of()).estimate()
    assert np.abs((estimate.x - TABLE_1) / np.sqrt(np.diagonal(estimate.covariance))).max() < 5.0


@pytest.fixture(scope="module")
def after_torque() -> list[tuple[float, SpinGate | None]]:
    """What is published second by second around a torque at 2000 s."""
    estimator, log = SpinFilter(config_of()), []
    for tick in ticks_of(kicked(2000.0), 3500, seed=3):
        estimator.handle(tick)
        log.append((float(tick.times_s[-1]), estimator.fallback))
    return log


def test_a_torque_ends_the_spin_within_two_minutes(after_torque: list[tuple[float, SpinGate | None]]) -> None:
    assert dict(after_torque)[1999.0] is None
    assert any(gate is SpinGate.INCONSISTENT for time, gate in after_torque if 2000.0 < time < 2120.0)


def test_after_a_torque_it_comes_back(after_torque: list[tuple[float, SpinGate | None]]) -> None:
    assert after_torque[-1][1] is None


def test_a_steady_spin_is_kept_once_found() -> None:
    estimator = play(ticks_of(steady, 2500, seed=4), config_of())
    assert (estimator.fallback, estimator.fallbacks) == (None, 0)


def without_vector(ticks: Iterable[Tick], start: int, end: int) -> Iterator[Tick]:
    for tick in ticks:
        yield replace(tick, reference_eci_nt=None) if start <= tick.index < end else tick


def test_a_magnitude_alone_gives_the_scalar_estimate() -> None:
    ticks = list(without_vector(Craft(seed=0).ticks(1500), 0, 1500))
    estimator, scalar = play(ticks, config_of()), Ukf(config_of(spin=None))
    for tick in ticks:
        scalar.handle(tick)
    assert estimator.fallback is SpinGate.NO_VECTOR
    assert (estimator.estimate().x == scalar.estimate().x).all()


def test_a_vector_that_stays_away_gives_the_scalar_estimate_meanwhile() -> None:
    estimator = play(without_vector(Craft(seed=0).ticks(2100), 2000, 2100), config_of())
    assert estimator.fallback is SpinGate.NO_VECTOR


def test_a_vector_that_comes_back_finds_the_phase_kept() -> None:
    estimator = play(without_vector(Craft(seed=0).ticks(2300), 2000, 2200), config_of())
    assert (estimator.fallback, estimator.fallbacks) == (None, 0)


def with_gap(ticks: Iterable[Tick], start: int, end: int, lost_s: float = 0.0) -> Iterator[Tick]:
    """Leave ticks out; ``lost_s``: the clock was set meanwhile, so that the samples' times are off."""
    for tick in ticks:
        if start <= tick.index < end:
            continue
        shift = lost_s if tick.index >= end else 0.0
        yield replace(tick, times_s=tick.times_s - shift, after_gap=tick.index == end)


def test_a_gap_is_bridged_by_the_spin() -> None:
    estimator = play(with_gap(Craft(seed=1).ticks(SECONDS), 1400, 1700), config_of())
    assert (estimator.fallback, estimator.fallbacks) == (None, 0)


def test_a_clock_step_costs_the_phase_and_not_the_errors() -> None:
    ticks = list(with_gap(Craft(seed=1).ticks(SECONDS), 1400, 1700, lost_s=297.0))
    estimator = SpinFilter(config_of())
    gates = set()
    for tick in ticks:
        before = estimator.estimate()
        estimator.handle(tick)
        gates.add(estimator.fallback)
        if tick.after_gap:
            known = np.diagonal(before.covariance)
    assert SpinGate.PHASE_LOST in gates
    assert estimator.fallback is None
    assert (np.diagonal(estimator.estimate().covariance) < 1.3 * known).all()


def test_spikes_are_rejected_and_counted() -> None:
    def spiked(ticks: Iterable[Tick]) -> Iterator[Tick]:
        for tick in ticks:
            hit = tick.index > 1200 and tick.index % 50 == 25
            yield replace(tick, field_body_nt=tick.field_body_nt + 40_000.0) if hit else tick

    estimator = play(spiked(Craft(seed=2).ticks(SECONDS)), config_of())
    estimate = estimator.estimate()
    assert estimator.fallback is None
    assert estimate.rejected == 16
    assert np.abs((estimate.x - TABLE_1) / np.sqrt(np.diagonal(estimate.covariance))).max() < 5.0


def test_a_reset_forgets_everything() -> None:
    ticks = list(Craft(seed=0).ticks(1500))
    once, twice = play(ticks, config_of()), play(ticks, config_of())
    twice.reset()
    for tick in ticks:
        twice.handle(tick)
    assert (once.estimate().x == twice.estimate().x).all()
    assert once.fallback is twice.fallback


def test_it_is_a_method() -> None:
    assert find_method("spin").build is SpinFilter


@pytest.fixture(scope="module")
def suchai() -> SpinFilter:
    """SUCHAI-3 without its gyro, with no spin configured."""
    path = DATA / "suchai3" / "2023-08-24.toml"
    if not path.exists():
        pytest.skip("the recording suchai3/2023-08-24 is not in ../shared/data")
    recording = read_recording(path).sorted_unique()
    times = (recording.time_ns - recording.time_ns[0]) * 1e-9
    reference = recording.reference.vector_nt
    assert reference is not None
    estimator = SpinFilter(config_of(noise_nt=None, spin=None))
    last = 0.0
    for i in range(2500):
        rows, now = slice(i, i + 1), float(times[i])
        magnitude = recording.reference.magnitude_nt[rows]
        estimator.handle(
            Tick(i, times[rows], recording.field_body_nt[rows], magnitude, reference[rows], now - last > 5.0)
        )
        last = now
    return estimator


def test_suchai_3_turns_at_the_rate_of_its_gyro(suchai: SpinFilter) -> None:
    assert suchai.spin is not None
    assert math.degrees(suchai.spin.rate_rad_s) == pytest.approx(46.27, abs=0.1)


def test_suchai_3_turns_about_the_axis_of_its_gyro(suchai: SpinFilter) -> None:
    assert suchai.spin is not None
    assert degrees_between(suchai.spin.axis_body, (-9.06, -45.35, -1.39)) < 10.0
