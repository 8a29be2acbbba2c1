"""Every level of the verdict from both sides, and every running mean against its formula: ticks put in by hand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.config.settings import FilterConfig, SensorConfig, SpinConfig, TrustConfig
from magcal_service.estimators.interface import Phase, TickOutcome
from magcal_service.residuals import white_floor
from magcal_service.trust.monitor import TrustMonitor
from magcal_service.trust.protector import UNLOOKED_S
from magcal_service.trust.reasons import Reason
from magcal_service.trust.verdict import NOT_STARTED
from magcal_service.wire.messages import Verdict
from tests.trust.trust_ticks import CONFIG, SETTLED, observed, outcome, reasons, tick

# Before anything was seen


def test_a_fresh_watch_has_seen_nothing() -> None:
    monitor = TrustMonitor(CONFIG)
    assert monitor.residual_rms_nt == monitor.innovation == monitor.rejected_share == monitor.white_noise_nt == 0.0
    assert monitor.judge(replace(SETTLED, phase=Phase.STARTING)) == NOT_STARTED
    assert not monitor.observe_unchecked(UNLOOKED_S)


def test_a_reset_watch_is_as_a_fresh_one() -> None:
    monitor = observed([outcome((1400.0,), rejected=1, innovation=9.0)] * 700)
    monitor.observe_skipped(100.0)
    monitor.observe_driver(missing=True)
    monitor.observe_model(doubtful=True)
    monitor.observe_unchecked(7000.0)
    monitor.observe_frozen()
    monitor.reset()
    assert monitor.export_state() == TrustMonitor(CONFIG).export_state()


# Running means


def running_mean(values: Sequence[float]) -> list[float]:
    """The mean of the first 300, then a memory of 300."""
    means, mean = [], 0.0
    for number, value in enumerate(values):
        mean = float(np.mean(values[: number + 1])) if number < 300 else mean + (value - mean) / 300.0
        means.append(mean)
    return means


def test_the_running_means_are_means_of_300_ticks_and_forget_after_that() -> None:
    rng = np.random.default_rng(1)
    innovation, degrees = rng.uniform(0.0, 9.0, 700), rng.integers(1, 4, 700)
    residual = rng.uniform(-1000.0, 1000.0, (700, 2))
    rejected = rng.integers(0, 3, 700)
    monitor = TrustMonitor(CONFIG)
    found = []
    for index in range(700):
        one = outcome(residual[index].tolist(), int(rejected[index]), float(innovation[index]), int(degrees[index]))
        monitor.observe(tick(index), one, SETTLED)
        found.append((monitor.innovation, monitor.rejected_share, monitor.residual_rms_nt))
    np.testing.assert_allclose([row[0] for row in found], running_mean(innovation / degrees), rtol=1e-9)
    np.testing.assert_allclose([row[1] for row in found], running_mean(rejected / 2.0), rtol=1e-9, atol=1e-12)
    rms = np.sqrt(running_mean(np.mean(residual**2, axis=1)))
    np.testing.assert_allclose([row[2] for row in found], rms, rtol=1e-9)


def test_a_tick_without_a_scalar_update_leaves_the_innovation_alone() -> None:
    monitor = observed([outcome(innovation=3.0), outcome(innovation=99.0, degrees=0)])
    assert monitor.innovation == 3.0


@pytest.mark.parametrize(
    "unused",
    [replace(outcome((500.0,)), phase=Phase.STARTING), TickOutcome(Phase.RUNNING, np.empty(0), 0, 0, 5.0, 1)],
    ids=["starting", "no sample"],
)
def test_a_tick_that_updates_nothing_is_no_part_of_the_means(unused: TickOutcome) -> None:
    monitor = observed([outcome((100.0,), innovation=2.0), unused, outcome((300.0,), innovation=4.0)])
    assert monitor.innovation == 3.0
    assert monitor.residual_rms_nt == pytest.approx(math.sqrt((1e4 + 9e4) / 2.0), rel=1e-12)


@pytest.mark.parametrize("residual_nt", [1e6, -1e6])
@pytest.mark.parametrize(("noise_nt", "gate_nt"), [(300.0, 1800.0), (20.0, 120.0), (0.0, 6e-9)])
def test_an_absurd_residual_counts_as_one_at_the_gate(residual_nt: float, noise_nt: float, gate_nt: float) -> None:
    config = replace(CONFIG, filter=FilterConfig(gate_sigma=6.0))
    monitor = observed([outcome((residual_nt,))], replace(SETTLED, noise_nt=noise_nt), config)
    assert monitor.residual_rms_nt == pytest.approx(gate_nt, rel=1e-12)


def test_the_white_noise_level_is_that_of_the_newest_512_every_64_ticks() -> None:
    residual = np.random.default_rng(2).normal(size=900) * 200.0
    monitor = TrustMonitor(CONFIG)
    for index in range(900):
        monitor.observe(tick(index), outcome((float(residual[index]),)), SETTLED)
        count = (index + 1) // 64 * 64
        expected = white_floor(residual[max(0, count - 512) : count]) if count >= 256 else 0.0
        assert monitor.white_noise_nt == pytest.approx(expected, rel=1e-12)


def test_the_white_noise_level_needs_256_residuals_however_many_a_tick_has() -> None:
    residual = np.random.default_rng(3).normal(size=(64, 4)) * 200.0
    monitor = observed(outcome(row.tolist()) for row in residual)
    assert monitor.white_noise_nt == pytest.approx(white_floor(residual.reshape(-1)), rel=1e-12)


# Levels


@pytest.mark.parametrize(("innovation", "ticks", "bad"), [(1.61, 100, True), (1.61, 99, False), (1.59, 400, False)])
def test_innovations_beyond_1_6_times_their_expectation_are_inconsistent(
    innovation: float, ticks: int, bad: bool
) -> None:
    monitor = observed([outcome(innovation=innovation)] * ticks)
    assert (Reason.INCONSISTENT in reasons(monitor)) is bad


@pytest.mark.parametrize(
    ("rms_nt", "ratio", "ticks", "bad"),
    [
        (451.0, 1.5, 100, True),
        (451.0, 1.5, 99, False),
        (449.0, 1.5, 200, False),
        (601.0, 2.0, 200, True),
        (599.0, 2.0, 200, False),
    ],
)
def test_a_residual_beyond_the_configured_ratio_to_the_noise_is_structured(
    rms_nt: float, ratio: float, ticks: int, bad: bool
) -> None:
    config = replace(CONFIG, trust=TrustConfig(residual_ratio=ratio))
    monitor = observed((outcome((rms_nt * (-1.0) ** n,)) for n in range(ticks)), config=config)
    assert (Reason.STRUCTURED_RESIDUAL in reasons(monitor)) is bad


@pytest.mark.parametrize(("noise_nt", "bad"), [(290.0, True), (310.0, False)])
def test_where_the_noise_is_not_told_the_filters_own_stands_in_until_there_is_a_floor(
    noise_nt: float, bad: bool
) -> None:
    config = replace(CONFIG, sensor=SensorConfig(None))
    estimate = replace(SETTLED, noise_nt=noise_nt)
    monitor = observed([outcome((450.0 * (-1.0) ** n,)) for n in range(200)], estimate, config)
    assert monitor.white_noise_nt == 0.0
    assert (Reason.STRUCTURED_RESIDUAL in reasons(monitor, estimate)) is bad


def test_a_filter_that_says_its_noise_is_zero_is_not_divided_by() -> None:
    """The gate is then 5e-9 nT, and what is at it is far above the level."""
    estimate, config = replace(SETTLED, noise_nt=0.0), replace(CONFIG, sensor=SensorConfig(None))
    monitor = observed([outcome((100.0,))] * 200, estimate, config)
    assert Reason.STRUCTURED_RESIDUAL in reasons(monitor, estimate)
    sure = replace(estimate, covariance=np.zeros((9, 9)))
    assert Reason.DRIFTING_RESIDUAL in reasons(observed([outcome((100.0,))] * 1000, sure, config), sure)


def with_white_noise(floor_nt: float) -> TrustMonitor:
    monitor = observed([outcome()] * 300, config=replace(CONFIG, sensor=SensorConfig(None)))
    monitor.restore_state({**monitor.export_state(), "_floor_nt": floor_nt})
    return monitor


@pytest.mark.parametrize(("noise_nt", "bad"), [(2001.0, True), (1999.0, False)])
def test_noise_beyond_a_twentieth_of_the_field_is_too_high(noise_nt: float, bad: bool) -> None:
    """|H| is 40 000 nT on the mean; the noise is the one that is told, or the floor."""
    told = observed([outcome()] * 300, config=replace(CONFIG, sensor=SensorConfig(noise_nt)))
    assert (Reason.NOISE_TOO_HIGH in reasons(told)) is bad
    assert (Reason.NOISE_TOO_HIGH in reasons(with_white_noise(noise_nt))) is bad


SPREADS = {
    "none": (np.zeros((9, 9)), 0.0),
    "bias": (np.diag([400.0, 900.0, 100.0] + [0.0] * 6), 900.0),
    "D11": (np.diag([0.0] * 3 + [1e-6] + [0.0] * 5), 900.0),  # at B = 30 000 nT along x: sigma 1e-3 makes 30 nT
    "D12": (np.diag([0.0] * 6 + [1e-6] + [0.0] * 2), 900.0),  # across x
}


@pytest.mark.parametrize("spread", SPREADS)
@pytest.mark.parametrize(("ratio", "ticks", "bad"), [(4.04, 1000, True), (4.04, 999, False), (3.96, 2000, False)])
def test_means_of_100_residuals_at_twice_their_sigma_drift(spread: str, ratio: float, ticks: int, bad: bool) -> None:
    """Noise of 300 nT makes 30 nT of a mean, and the estimate's own uncertainty adds to that."""
    covariance, variance_nt2 = SPREADS[spread]
    estimate = replace(SETTLED, covariance=covariance)
    level_nt = math.sqrt(ratio * (900.0 + variance_nt2))
    monitor = observed([outcome((level_nt,))] * ticks, estimate)
    assert (Reason.DRIFTING_RESIDUAL in reasons(monitor, estimate)) is bad


@pytest.mark.parametrize(("blocks", "bad"), [(16, False), (17, True)])
def test_drift_is_averaged_over_40_blocks(blocks: int, bad: bool) -> None:
    """Blocks at a ratio of 9.9 after 60 at 0: the mean passes 4 with the 17th of them; white in between."""
    level_nt = 30.0 * math.sqrt(9.9)
    monitor = observed([outcome((0.0,))] * 6000 + [outcome((level_nt,))] * (100 * blocks))
    assert (Reason.DRIFTING_RESIDUAL in reasons(monitor)) is bad


@pytest.mark.parametrize(("rejected", "bad"), [(0.16, True), (0.14, False)])
def test_more_than_15_of_100_rejected_are_many(rejected: float, bad: bool) -> None:
    one = outcome([0.0] * 100, rejected=round(100 * rejected))
    assert (Reason.MANY_REJECTED in reasons(observed([one] * 100))) is bad
    assert Reason.MANY_REJECTED not in reasons(observed([one] * 99))


@pytest.mark.parametrize(
    ("per_tick", "rejected", "ticks", "bad"),
    [
        (1, 1, 6, False),
        (1, 1, 7, True),
        (5, 5, 1, False),
        (5, 5, 2, True),
        (10, 5, 1, False),
        (10, 6, 1, True),
        (50, 26, 1, True),
    ],
)
def test_half_of_the_newest_ten_rejected_are_many_at_once(per_tick: int, rejected: int, ticks: int, bad: bool) -> None:
    """A memory of ten samples: 1 - 0.9^n passes a half with the seventh in a row."""
    good = [outcome([0.0] * per_tick)] * 5
    monitor = observed(good + [outcome([0.0] * per_tick, rejected=rejected)] * ticks)
    assert (Reason.MANY_REJECTED in reasons(monitor)) is bad


def test_a_fault_that_is_over_is_forgotten_within_ten_samples() -> None:
    spoiled = [outcome([0.0] * 10, rejected=10)]
    assert Reason.MANY_REJECTED in reasons(observed([outcome()] * 200 + spoiled))
    assert Reason.MANY_REJECTED not in reasons(observed([outcome()] * 200 + spoiled + [outcome()] * 7))


@pytest.mark.parametrize(
    ("D", "collapsed"),
    [
        ([-0.499, 0, 0, 0, 0, 0], False),
        ([-0.501, 0, 0, 0, 0, 0], True),
        ([0, 0.999, 0, 0, 0, 0], False),
        ([0, 1.001, 0, 0, 0, 0], True),
        ([-0.166] * 6, False),  # D = -0.166 in all elements has an eigenvalue of three times that
        ([-0.168] * 6, True),
        ([0.33] * 6, False),
        ([0.34] * 6, True),
    ],
)
def test_eigenvalues_from_a_half_to_two_are_sound(D: list[float], collapsed: bool) -> None:
    estimate = replace(SETTLED, x=np.array([0.0, 0.0, 0.0, *D]))
    assert (Reason.COLLAPSED in reasons(TrustMonitor(CONFIG), estimate)) is collapsed


def test_a_bias_is_no_collapse() -> None:
    estimate = replace(SETTLED, x=np.array([30_000.0, -30_000.0, 9000.0, *[0.0] * 6]))
    assert Reason.COLLAPSED not in reasons(TrustMonitor(CONFIG), estimate)


@pytest.mark.parametrize(
    ("half_nt", "ticks", "constant"), [(277.0, 300, True), (277.0, 299, False), (279.0, 300, False)]
)
def test_a_magnitude_within_half_a_percent_is_constant(half_nt: float, ticks: int, constant: bool) -> None:
    """Half of a percent over the width between the tails that counts as one standard deviation, 0.36."""
    monitor = TrustMonitor(CONFIG)
    for index in range(ticks):
        monitor.observe(tick(index, 40_000.0 + half_nt * (-1.0) ** index), outcome(), SETTLED)
    assert (Reason.CONSTANT_REFERENCE in reasons(monitor)) is constant


@pytest.mark.parametrize(("seconds", "stale"), [(6000.0, False), (6000.1, True)])
def test_an_estimate_is_stale_after_an_orbit_without_samples(seconds: float, stale: bool) -> None:
    monitor = observed([outcome()] * 300)
    assert monitor.observe_unchecked(UNLOOKED_S + 0.1)  # there is no protection level from then on
    assert monitor.observe_unchecked(seconds) is stale
    assert (Reason.STALE in reasons(monitor)) is stale
    assert not monitor.observe_unchecked(seconds)  # nothing has changed
    assert monitor.observe_unchecked(0.0)
    assert Reason.STALE not in reasons(monitor)


@pytest.mark.parametrize(
    ("turns", "aliased"),
    [
        (0.2501, False), (0.459, False), (0.461, True), (0.5, True), (0.539, True), (0.541, False), (0.75, False),
        (0.959, False), (0.961, True), (1.039, True), (1.041, False), (3.0, True), (0.01, False),
    ],
)  # fmt: skip
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_phase_step_near_a_half_or_whole_turn_is_aliasing(turns: float, aliased: bool, sign: float) -> None:
    """Of the pause between the last sample of a tick and the first of the next, which is half a second here."""
    config = replace(CONFIG, spin=SpinConfig(rate_rpm=sign * turns * 60.0 / 0.5))
    monitor = TrustMonitor(config)
    for index in range(31):
        monitor.observe(tick(index, times_s=(index - 0.25, index + 0.25)), outcome(), SETTLED)
    assert (Reason.SPIN_ALIASING in reasons(monitor)) is aliased
    starting = replace(SETTLED, phase=Phase.STARTING)
    assert (Reason.SPIN_ALIASING in reasons(monitor, starting)) is aliased


@pytest.mark.parametrize(("ticks", "aliased"), [(29, False), (30, True)])
def test_aliasing_is_told_after_30_ticks(ticks: int, aliased: bool) -> None:
    monitor = observed([outcome()] * ticks, config=replace(CONFIG, spin=SpinConfig(rate_rpm=30.0)))
    assert (Reason.SPIN_ALIASING in reasons(monitor)) is aliased


@pytest.mark.parametrize(("near", "aliased"), [(17, False), (25, True)])
def test_aliasing_is_told_where_it_is_so_for_more_than_half_of_the_ticks(near: int, aliased: bool) -> None:
    """60 rpm, samples 1 s apart at first and 0.7 s after that: near a whole turn, and not."""
    monitor = TrustMonitor(replace(CONFIG, spin=SpinConfig(rate_rpm=60.0)))
    times = np.cumsum([0.0] + [1.0] * near + [0.7] * (40 - near)).tolist()
    for index, time_s in enumerate(times):
        monitor.observe(tick(index, times_s=(time_s,)), outcome(), SETTLED)
    assert (Reason.SPIN_ALIASING in reasons(monitor)) is aliased


def test_over_a_gap_no_phase_step_is_looked_at() -> None:
    monitor = TrustMonitor(replace(CONFIG, spin=SpinConfig(rate_rpm=60.0)))
    for index in range(60):
        monitor.observe(tick(index, after_gap=True), outcome(), SETTLED)
    assert Reason.SPIN_ALIASING not in reasons(monitor)


@pytest.mark.parametrize(
    ("index", "sigma", "verdict"),
    [
        (0, 100.0, Verdict.TRUSTED), (2, 100.1, Verdict.CONVERGING), (1, 40.0, Verdict.TRUSTED),
        (3, 0.005, Verdict.TRUSTED), (3, 0.00501, Verdict.CONVERGING), (8, 0.00501, Verdict.CONVERGING),
        (8, 0.00499, Verdict.TRUSTED),
    ],
)  # fmt: skip
def test_each_sigma_has_its_limit(index: int, sigma: float, verdict: Verdict) -> None:
    variances = np.array([1.0] * 3 + [1e-12] * 6)
    variances[index] = sigma * sigma
    estimate = replace(SETTLED, covariance=np.diag(variances))
    assert observed([outcome()] * 300, estimate).judge(estimate).verdict is verdict


@pytest.mark.parametrize(("ticks", "reason"), [(12_000, Reason.NOT_SETTLED), (12_001, Reason.POOR_COVERAGE)])
def test_what_is_not_sure_after_two_orbits_has_too_few_directions(ticks: int, reason: Reason) -> None:
    estimate = replace(SETTLED, covariance=np.diag([200.0**2] * 3 + [1e-12] * 6))
    monitor = observed([outcome()] * 10, estimate)
    monitor.restore_state({**monitor.export_state(), "_ticks": ticks - 10, "_since_start": ticks - 10})
    for index in range(10):
        monitor.observe(tick(index), outcome(), estimate)
    assert monitor.judge(estimate).reasons == (reason,)


@pytest.mark.parametrize(("ticks", "verdict"), [(299, Verdict.CONVERGING), (300, Verdict.TRUSTED)])
def test_300_ticks_are_waited_for(ticks: int, verdict: Verdict) -> None:
    assert observed([outcome()] * ticks).judge(SETTLED).verdict is verdict
