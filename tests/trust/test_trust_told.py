"""What is told beside the levels of the verdict: silence, restarts, starts and modes, by ticks put in by hand."""

from __future__ import annotations

import runpy
from dataclasses import replace

import pytest

from magcal_service.estimators.interface import Phase, StartGate
from magcal_service.trust import modes
from magcal_service.trust.modes import MODES, markdown
from magcal_service.trust.monitor import TrustMonitor, reason_of
from magcal_service.trust.reasons import REMEDIES, Reason
from magcal_service.wire.messages import Verdict
from tests.trust.trust_ticks import CONFIG, SETTLED, observed, outcome, reasons, tick

# What else is told


@pytest.mark.parametrize(
    ("tell", "reason", "verdict"),
    [
        (lambda m: m.observe_driver(missing=True), Reason.DRIVER_MISSING, Verdict.DOUBTFUL),
        (lambda m: m.observe_model(doubtful=True), Reason.MODEL_DOUBTFUL, Verdict.DOUBTFUL),
        (lambda m: m.observe_fault(Reason.SATURATED), Reason.SATURATED, Verdict.DOUBTFUL),
        (lambda m: m.observe_frozen(), Reason.FROZEN, Verdict.TRUSTED),
        (lambda m: m.observe_skipped(60.0), Reason.NO_REFERENCE, Verdict.TRUSTED),
        (lambda m: m.observe_skipped(60.1), Reason.NO_REFERENCE, Verdict.DOUBTFUL),
    ],
)
def test_what_is_told_by_others_is_in_the_verdict(tell: object, reason: Reason, verdict: Verdict) -> None:
    monitor = observed([outcome()] * 300)
    tell(monitor)  # type: ignore[operator]
    trust = monitor.judge(SETTLED)
    assert (trust.verdict, trust.reasons, trust.remedy) == (verdict, (reason,), REMEDIES[reason])


def test_a_tick_that_is_learned_from_ends_silence_freeze_and_staleness() -> None:
    monitor = observed([outcome()] * 300)
    monitor.observe_skipped(100.0)
    monitor.observe_frozen()
    monitor.observe_unchecked(7000.0)
    assert reasons(monitor) == {Reason.FROZEN, Reason.STALE}  # a frozen tick had its reference
    monitor.observe_skipped(5.0)
    assert reasons(monitor) == {Reason.FROZEN, Reason.STALE, Reason.NO_REFERENCE}
    monitor.observe(tick(0), outcome(), SETTLED)
    assert monitor.judge(SETTLED).reasons == ()


def test_silence_begins_with_the_first_tick_without_reference_after_a_frozen_one() -> None:
    monitor = observed([outcome()] * 300)
    monitor.observe_frozen()
    monitor.observe_skipped(0.5)
    assert Reason.NO_REFERENCE in reasons(monitor)


def test_silence_adds_up() -> None:
    monitor = observed([outcome()] * 300)
    for _ in range(3):
        monitor.observe_skipped(20.0)
    assert monitor.judge(SETTLED).verdict is Verdict.TRUSTED
    monitor.observe_skipped(1.0)
    assert monitor.judge(SETTLED).verdict is Verdict.DOUBTFUL


def test_a_restart_forgets_the_residuals_of_the_estimate_before() -> None:
    """Half a block of large residuals before it: the block, the blocks and the means begin anew."""
    monitor = observed([outcome((1400.0,), innovation=9.0)] * 1050)
    again = replace(SETTLED, restarts=1)
    for index in range(300):
        monitor.observe(tick(index), outcome((100.0 * (-1.0) ** index,)), again)
    trust = monitor.judge(again)
    assert (trust.verdict, trust.reasons) == (Verdict.TRUSTED, ())
    assert monitor.residual_rms_nt == pytest.approx(100.0, rel=1e-9)
    assert monitor.innovation == pytest.approx(1.0, rel=1e-9)
    state = monitor.export_state()
    assert (len(state["_blocks"]), len(state["_block"]), len(state["_residuals"])) == (3, 0, 300)


@pytest.mark.parametrize(("ticks", "bad"), [(299, True), (300, False)])
def test_a_restart_is_told_until_min_ticks_have_passed(ticks: int, bad: bool) -> None:
    again = replace(SETTLED, restarts=2)
    assert (Reason.RESTARTED in reasons(observed([outcome()] * ticks, again), again)) is bad


@pytest.mark.parametrize(("ticks", "settled"), [(0, False), (599, False), (600, True)])
def test_a_jump_that_was_followed_has_to_have_been_the_right_one(ticks: int, settled: bool) -> None:
    """For 600 ticks: one that is taken for another is followed again within them."""
    monitor = observed([outcome()] * 400)
    assert monitor.judge(SETTLED).verdict is Verdict.TRUSTED
    followed = replace(SETTLED, followed=1)
    for index in range(400, 401 + ticks):
        monitor.observe(tick(index), outcome(), followed)
    trust = monitor.judge(followed)
    assert trust.reasons == (() if settled else (Reason.NOT_SETTLED,))
    assert trust.verdict is (Verdict.TRUSTED if settled else Verdict.CONVERGING)


def test_an_estimator_that_starts_anew_is_judged_and_one_that_starts_first_is_not() -> None:
    starting = replace(SETTLED, phase=Phase.STARTING)
    monitor = observed([replace(outcome(), phase=Phase.STARTING)] * 3)
    assert monitor.judge(starting).verdict is Verdict.NOT_STARTED
    trust = monitor.judge(replace(starting, restarts=1))
    assert (trust.verdict, trust.reasons) == (
        Verdict.DOUBTFUL,
        (Reason.RESTARTED, Reason.COLLECTING, Reason.NOT_SETTLED),
    )


def test_before_the_start_what_keeps_samples_from_being_learned_from_is_said_first() -> None:
    """The remedy is that of the first reason: no wait for directions helps a frozen craft."""
    monitor = TrustMonitor(CONFIG)
    monitor.observe_frozen()
    frozen = monitor.judge(replace(SETTLED, phase=Phase.STARTING, waiting_for=StartGate.POOR_COVERAGE))
    assert (frozen.reasons[0], frozen.remedy) == (Reason.FROZEN, REMEDIES[Reason.FROZEN])
    monitor.observe_freeze(False)
    monitor.observe_skipped(1.0)
    monitor.observe_fault(Reason.STUCK)
    starting = replace(SETTLED, phase=Phase.STARTING, waiting_for=StartGate.BAD_FIT)
    assert monitor.judge(starting).reasons == (
        Reason.NO_REFERENCE, Reason.STUCK, Reason.INCONSISTENT, Reason.COLLECTING,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("gate", "reason"),
    [
        (StartGate.POOR_COVERAGE, Reason.POOR_COVERAGE),
        (StartGate.NOT_POSITIVE, Reason.NO_SOLUTION),
        (StartGate.COLLAPSED, Reason.NO_SOLUTION),
        (StartGate.NO_CONVERGENCE, Reason.NO_SOLUTION),
        (StartGate.BAD_FIT, Reason.INCONSISTENT),
    ],
)
def test_what_a_gate_of_the_start_means(gate: StartGate, reason: Reason) -> None:
    assert reason_of(gate) is reason


def test_each_mode_has_its_row_on_the_page() -> None:
    rows = [line.split(" | ") for line in markdown().splitlines() if line.startswith("| ")][1:]
    assert [row[0].removeprefix("| ") for row in rows] == list(MODES)
    for cells, row in zip(rows, MODES.values(), strict=True):
        reason, counter = f"`{row.reason}`" if row.reason else "-", f"`{row.counter}`" if row.counter else "-"
        expected = [row.when, row.vectors, row.covariance, f"`{row.verdict}`", reason, counter, f"{row.after} |"]
        assert cells[1:] == expected


@pytest.mark.parametrize(("name", "printed"), [("__main__", True), ("modes", False)])
def test_the_page_is_printed_where_it_is_asked_for(
    name: str, printed: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    runpy.run_path(modes.__file__, run_name=name)
    assert capsys.readouterr().out == (markdown() if printed else "")
