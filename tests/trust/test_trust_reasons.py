"""Each reason is given to the stream that earns it, and none to a good one."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from magcal_service.config.settings import CraftConfig, SensorConfig, SpinConfig
from magcal_service.estimators.interface import Phase, StartGate, StateEstimate, TickOutcome
from magcal_service.model import STATE_SIZE
from magcal_service.ticks.assembler import Tick
from magcal_service.trust.monitor import TrustMonitor
from magcal_service.trust.reasons import REMEDIES, Reason
from magcal_service.wire.codec import encode
from magcal_service.wire.messages import Estimate, Verdict
from tests.trust.trust_runs import Run, added, craft, errors_in_sigma, from_second, good, run, stretched

CHANGE = 1000  # tick from which a good stream is spoiled: it is trusted by then
START = {Reason.COLLECTING, Reason.POOR_COVERAGE, Reason.NO_SOLUTION, Reason.NOT_SETTLED}


@cache
def flown(seed: int) -> Run:
    """A good stream, judged."""
    return run(good(seed))


@pytest.mark.parametrize("seed", range(5))
def test_the_papers_scenario_is_trusted_without_a_doubt_on_the_way(seed: int) -> None:
    result = flown(seed)
    assert result.last.verdict is Verdict.TRUSTED
    assert result.last.reasons == ()
    assert result.reasons() <= START
    assert Verdict.DOUBTFUL not in result.verdicts()


@pytest.mark.parametrize("seed", range(5))
def test_what_is_trusted_is_right(seed: int) -> None:
    assert np.abs(errors_in_sigma(flown(seed).state)).max() < 4.5


@pytest.mark.parametrize("seed", range(2))
def test_with_the_noise_unknown_it_is_trusted_as_well(seed: int) -> None:
    result = run(good(seed, 1500), craft(noise_nt=None))
    assert result.last.verdict is Verdict.TRUSTED
    assert result.reasons() <= START
    assert result.state.noise_nt == pytest.approx(300.0, rel=0.1)


@pytest.mark.parametrize("absurd", [(3e5, 0.0, 0.0), (0.0, 0.0, -40_000.0), (-20_000.0, 20_000.0, 0.0)])
@pytest.mark.parametrize("at", [CHANGE, CHANGE + 3])
def test_one_absurd_sample_costs_neither_the_trust_nor_the_spin(absurd: tuple[float, float, float], at: int) -> None:
    spoiled = [replace(tick, field_body_nt=np.array([absurd])) if tick.index == at else tick for tick in good()]
    result = run(spoiled)
    assert result.verdicts(CHANGE) == {Verdict.TRUSTED}
    assert (result.state.rejected, result.state.spin_given_up, result.state.restarts) == (1, False, 0)
    assert result.windows_rejected == 0


def test_an_absurd_sample_does_not_take_its_tick_along() -> None:
    """Ticks of two samples, of which one is absurd: the other goes on into the spin window."""
    single = good()
    pairs = [joined(single[row], single[row + 1]) for row in range(0, len(single), 2)]
    absurd = np.array([1.0, 0.0]) * np.array([[-20_000.0], [20_000.0], [0.0]])
    spoiled = [
        replace(tick, field_body_nt=absurd.T + tick.field_body_nt) if i == 501 else tick for i, tick in enumerate(pairs)
    ]
    result = run(spoiled)
    assert (result.state.rejected, result.windows_rejected) == (1, 0)


def joined(first: Tick, second: Tick) -> Tick:
    """Two ticks as one."""
    names = ("times_s", "field_body_nt", "reference_magnitude_nt", "reference_eci_nt")
    return replace(second, **{name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in names})


def test_a_spike_in_a_hundred_is_no_reason_for_a_doubt() -> None:
    rng = np.random.default_rng(3)
    hit = rng.random(2000) < 0.01
    spikes = rng.normal(size=(2000, 3)) * 20_000.0
    result = run(from_second(CHANGE, good(), added(lambda tick: spikes[tick.index] * hit[tick.index])))
    assert result.last.verdict is Verdict.TRUSTED
    assert result.state.restarts == 0


def test_many_spikes_are_many_rejected() -> None:
    """A fifth of the samples is absurd: the rest still carries the estimate."""
    rng = np.random.default_rng(4)
    hit = rng.random(2000) < 0.2
    spikes = rng.normal(size=(2000, 3)) * 40_000.0
    result = run(from_second(CHANGE, good(1, 1700), added(lambda tick: spikes[tick.index] * hit[tick.index])))
    assert (result.last.verdict, Reason.MANY_REJECTED in result.last.reasons) == (Verdict.DOUBTFUL, True)


@pytest.fixture(scope="module")
def stepped() -> object:
    """A step of 5000 nT in the bias."""
    step = np.array([3000.0, -3000.0, 2650.0])
    return run(from_second(CHANGE, good(1, 2600), added(lambda tick: step)))


def test_a_step_of_the_bias_is_doubted_and_then_followed_by_a_restart(stepped: object) -> None:
    judged = stepped.judged  # type: ignore[attr-defined]
    doubtful = [trust.verdict is Verdict.DOUBTFUL for trust in judged[CHANGE:]]
    assert doubtful.index(True) <= 60
    assert any(Reason.RESTARTED in trust.reasons for trust in judged[CHANGE : CHANGE + 120])


def test_after_a_step_the_new_errors_are_found_and_trusted(stepped: object) -> None:
    """w = (I + D)(B + step) - b: the bias has become b + (I + D) step."""
    state, last = stepped.state, stepped.last  # type: ignore[attr-defined]
    matrix = np.eye(3) + np.array([[0.05, 0.05, 0.05], [0.05, 0.10, 0.05], [0.05, 0.05, 0.05]])
    moved = np.array([5000.0, 3000.0, 4000.0]) + matrix @ np.array([3000.0, -3000.0, 2650.0])
    assert last.verdict is Verdict.TRUSTED
    assert np.abs((state.x[:3] - moved) / np.sqrt(np.diagonal(state.covariance))[:3]).max() < 4.5


def test_a_step_of_the_bias_is_not_blamed_on_the_spin(stepped: object) -> None:
    assert Reason.SPIN_CONTRADICTED not in stepped.reasons()  # type: ignore[attr-defined]


def test_a_noise_told_too_small_is_inconsistent_and_never_trusted() -> None:
    result = run(good(1, 1500), craft(noise_nt=100.0))
    assert Reason.INCONSISTENT in result.reasons()
    assert Verdict.TRUSTED not in result.verdicts()


def test_a_noise_that_trebles_is_doubted() -> None:
    rng = np.random.default_rng(6)
    extra = rng.normal(size=(2000, 3)) * 850.0
    result = run(from_second(CHANGE, good(1, 1600), added(lambda tick: extra[tick.index])))
    assert Verdict.DOUBTFUL in result.verdicts(CHANGE)
    assert result.last.verdict is not Verdict.TRUSTED


@pytest.mark.parametrize(
    ("noise_nt", "reason"), [(300.0, Reason.INCONSISTENT), (None, Reason.STRUCTURED_RESIDUAL)], ids=["told", "unknown"]
)
def test_a_tone_in_the_residual_is_doubted(noise_nt: float | None, reason: Reason) -> None:
    """800 nT at 37 s on 300 nT of noise: rms 640, twice what was told, and twice the white level."""
    tone = stretched(lambda second: 800.0 * math.sin(math.tau * second / 37.0))
    result = run(from_second(CHANGE, good(1, 1800), tone), craft(noise_nt))
    assert reason in result.reasons(CHANGE)
    assert result.last.verdict is Verdict.DOUBTFUL


def test_a_residual_that_wanders_is_drifting() -> None:
    """300 nT over 25 minutes is no more than the noise, but its means over 100 samples are 10 times theirs."""
    drift = stretched(lambda second: 300.0 * math.sin(math.tau * (second - CHANGE) / 1500.0))
    result = run(from_second(CHANGE, good(1, 2600), drift))
    assert Reason.DRIFTING_RESIDUAL in result.reasons(CHANGE)


@pytest.mark.parametrize("rate_rpm", [60.0, 30.0, 90.0, 61.0])
def test_a_sample_period_of_whole_half_turns_is_aliasing(rate_rpm: float) -> None:
    result = run(good(1, 200, rate_rpm), craft(rate_rpm=rate_rpm))
    assert Reason.SPIN_ALIASING in result.last.reasons
    assert Verdict.TRUSTED not in result.verdicts()


@pytest.mark.parametrize("rate_rpm", [7.5, 12.0, 22.0, 1.0])
def test_other_spin_rates_are_no_aliasing(rate_rpm: float) -> None:
    assert Reason.SPIN_ALIASING not in run(good(1, 200, rate_rpm), craft(rate_rpm=rate_rpm)).reasons()


def test_a_wrong_spin_axis_is_contradicted_and_the_estimate_holds_without_it() -> None:
    """30 deg off: the windows are given up, and what the scalar measurement alone gives is right."""
    axis = (0.5, 0.0, math.sqrt(0.75))
    result = run(good(1, 2500), craft(axis=axis))
    assert Reason.SPIN_CONTRADICTED in result.reasons()
    assert result.state.spin_given_up
    assert np.abs(errors_in_sigma(result.state)).max() < 4.5


def test_at_3000_nt_of_noise_the_covariance_is_said_to_be_inconsistent() -> None:
    result = run(good(1, 2000, noise_nt=3000.0), craft(noise_nt=3000.0))
    assert Reason.NOISE_TOO_HIGH in result.last.reasons
    assert Verdict.TRUSTED not in result.verdicts()


# The others need a state that no good stream has; they are put to the watch directly.


def state(**changes: object) -> StateEstimate:
    """A settled estimate."""
    settled = {
        "x": np.zeros(STATE_SIZE),
        "covariance": np.diag([1.0] * 3 + [1e-8] * 6),
        "phase": Phase.RUNNING,
        "noise_nt": 300.0,
        "samples": 1000,
        "rejected": 0,
        "restarts": 0,
        "waiting_for": None,
        "spin_given_up": False,
    }
    return StateEstimate(**settled | changes)


def watched(
    ticks: int,
    estimate: StateEstimate,
    magnitude_nt: float | None = None,
    config: CraftConfig | None = None,
    offset_nt: float = 0.0,
) -> TrustMonitor:
    """A watch that has seen so many consistent ticks of white noise."""
    rng = np.random.default_rng(7)
    monitor = TrustMonitor(config or CraftConfig("c", SensorConfig(300.0)))
    for index in range(ticks):
        strength = 40_000.0 + 5000.0 * math.sin(index / 100.0) if magnitude_nt is None else magnitude_nt
        tick = Tick(index, np.array([float(index)]), np.ones((1, 3)), np.array([strength]))
        residual = rng.normal(size=1) * 300.0 + offset_nt
        outcome = TickOutcome(estimate.phase, residual, 1, 0, float(residual[0] / 300.0) ** 2, 1)
        monitor.observe(tick, outcome, estimate)
    return monitor


def test_white_noise_and_a_settled_state_are_trusted() -> None:
    assert watched(1000, state()).judge(state()).verdict is Verdict.TRUSTED


@pytest.mark.parametrize(
    ("D", "collapsed"), [(-0.45, False), (-0.55, True), (0.95, False), (1.05, True), (-1.5, True), (0.1, False)]
)
def test_a_solution_that_shrinks_or_blows_up_an_axis_is_collapsed(D: float, collapsed: bool) -> None:
    found = state(x=np.array([0.0, 0.0, 0.0, D, 0.0, 0.0, 0.0, 0.0, 0.0]))
    trust = watched(1000, found).judge(found)
    assert (Reason.COLLAPSED in trust.reasons) is collapsed
    assert trust.verdict is (Verdict.DOUBTFUL if collapsed else Verdict.TRUSTED)


@pytest.mark.parametrize(("shear", "collapsed"), [(0.3, False), (0.6, True), (-0.2, False), (-0.3, True)])
def test_a_collapse_along_a_slanted_axis_is_seen_as_well(shear: float, collapsed: bool) -> None:
    """Eigenvalues of I + D with three equal off-diagonals s: 1 - s twice, and 1 + 2 s."""
    found = state(x=np.array([0.0] * 6 + [shear] * 3))
    assert (Reason.COLLAPSED in watched(1000, found).judge(found).reasons) is collapsed


def test_an_estimate_that_runs_at_an_aliased_rate_is_doubted() -> None:
    config = CraftConfig("c", SensorConfig(300.0), SpinConfig(rate_rpm=60.0))
    trust = watched(1000, state(), config=config).judge(state())
    assert (trust.verdict, trust.reasons) == (Verdict.DOUBTFUL, (Reason.SPIN_ALIASING,))


@pytest.mark.parametrize(("sigma_nt", "drifting"), [(1.0, True), (90.0, False)])
def test_an_offset_within_the_estimates_own_uncertainty_is_no_drift(sigma_nt: float, drifting: bool) -> None:
    """Residuals 80 nT too high: 2.7 times what noise makes of a mean over 100, and less than the estimate's sigma."""
    found = state(covariance=np.diag([sigma_nt**2] * 3 + [1e-12] * 6))
    monitor = watched(1000, found, offset_nt=80.0)
    assert (Reason.DRIFTING_RESIDUAL in monitor.judge(found).reasons) is drifting


def test_a_reference_of_one_magnitude_is_said_to_allow_a_collapse() -> None:
    trust = watched(1000, state(), magnitude_nt=40_000.0).judge(state())
    assert (trust.verdict, trust.reasons) == (Verdict.DOUBTFUL, (Reason.CONSTANT_REFERENCE,))


def test_a_short_while_without_reference_is_said_and_a_long_one_is_doubted() -> None:
    monitor = watched(1000, state())
    verdicts = []
    for _ in range(61):
        monitor.observe_skipped(1.0)
        verdicts.append(monitor.judge(state()))
    assert {trust.reasons for trust in verdicts} == {(Reason.NO_REFERENCE,)}
    assert [trust.verdict for trust in verdicts] == [Verdict.TRUSTED] * 60 + [Verdict.DOUBTFUL]


def test_a_stuck_sensor_is_doubted_until_it_changes() -> None:
    monitor = watched(1000, state())
    monitor.observe_fault(Reason.STUCK)
    assert (monitor.judge(state()).verdict, monitor.judge(state()).reasons) == (Verdict.DOUBTFUL, (Reason.STUCK,))
    monitor.observe_fault(None)
    assert monitor.judge(state()).verdict is Verdict.TRUSTED


@pytest.mark.parametrize(("ticks", "reason"), [(1000, Reason.NOT_SETTLED), (12_500, Reason.POOR_COVERAGE)])
def test_a_sigma_that_stays_large_is_waited_for_and_after_two_orbits_poor_coverage(ticks: int, reason: Reason) -> None:
    vague = state(covariance=np.diag([200.0**2] * 3 + [1e-8] * 6))
    trust = watched(ticks, vague).judge(vague)
    assert (trust.verdict, trust.reasons) == (Verdict.CONVERGING, (reason,))


@pytest.mark.parametrize(("sigma_nt", "verdict"), [(99.0, Verdict.TRUSTED), (101.0, Verdict.CONVERGING)])
def test_the_limits_of_the_configuration_decide(sigma_nt: float, verdict: Verdict) -> None:
    found = state(covariance=np.diag([sigma_nt**2, 1.0, 1.0] + [1e-8] * 6))
    assert watched(1000, found).judge(found).verdict is verdict


def test_a_restarted_estimator_is_doubted_until_it_has_settled() -> None:
    again = state(restarts=1)
    monitor = watched(1000, state())
    verdicts = []
    for index in range(1000, 1400):
        outcome = TickOutcome(Phase.RUNNING, np.zeros(1), 1, 0, 1.0, 1)
        tick = Tick(index, np.array([float(index)]), np.ones((1, 3)), np.array([4e4 + 1e3 * (-1.0) ** index]))
        monitor.observe(tick, outcome, again)
        verdicts.append(monitor.judge(again).verdict)
    assert verdicts == [Verdict.DOUBTFUL] * 299 + [Verdict.TRUSTED] * 101


def test_a_reset_watch_knows_nothing_any_more() -> None:
    monitor = watched(1000, state(), magnitude_nt=40_000.0)
    monitor.observe_fault(Reason.STUCK)
    monitor.reset()
    assert monitor.judge(state(phase=Phase.STARTING)).reasons == (Reason.COLLECTING,)


@pytest.mark.parametrize("gate", StartGate)
def test_before_the_start_the_gate_that_holds_it_up_is_named(gate: StartGate) -> None:
    waiting = state(phase=Phase.STARTING, waiting_for=gate)
    trust = TrustMonitor(CraftConfig("c")).judge(waiting)
    assert (trust.verdict, len(trust.reasons)) == (Verdict.NOT_STARTED, 2)
    assert trust.remedy == REMEDIES[next(reason for reason in trust.reasons if reason is not Reason.COLLECTING)]


@pytest.mark.parametrize("reason", Reason)
def test_every_reason_has_a_remedy_that_passes_the_wire(reason: Reason) -> None:
    message = Estimate(
        craft="c",
        source="magcal",
        sequence=0,
        time_ns=0,
        method="ukf",
        tick=0,
        bias_nt=(0.0, 0.0, 0.0),
        D=(0.0,) * 6,
        covariance=(0.0,) * 45,
        verdict=Verdict.DOUBTFUL,
        reasons=(str(reason),),
        remedy=REMEDIES[reason],
    )
    assert len(REMEDIES[reason].encode()) <= 512
    assert REMEDIES[reason].encode() in encode(message)


def test_reasons_that_a_message_cannot_hold_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monitor = TrustMonitor(craft())
    running = StateEstimate(np.zeros(9), np.eye(9), Phase.RUNNING, 300.0, 0, 0, 0, None, False)
    monkeypatch.setattr(monitor, "_doubts", lambda estimate: list(Reason))
    assert monitor.judge(running).reasons == tuple(Reason)[:16]
