"""The commands that a craft answers itself, and what is none of them."""

from __future__ import annotations

import re
from copy import deepcopy
from dataclasses import replace
from functools import cache

import pytest

from magcal_service.daemon.command_table import COMMANDS
from magcal_service.daemon.craft_commands import CRAFT_COMMANDS
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.trust.reasons import REMEDIES, Reason
from magcal_service.wire.codec import encode
from magcal_service.wire.messages import Command, CommandReply, Estimate, MagnetometerSample, Message, Verdict
from tests.daemon.pipeline_streams import handle_all, paper, paper_craft

SECONDS = 1400


@pytest.fixture(scope="module")
def flown() -> Pipeline:
    """A craft after 900 s of the paper's scenario: trusted."""
    pipeline = Pipeline(paper_craft())
    handle_all(pipeline, messages(0, 900))
    assert pipeline.trust.verdict is Verdict.TRUSTED
    return pipeline


@pytest.fixture
def pipeline(flown: Pipeline) -> Pipeline:
    """Such a craft for a test of its own."""
    return deepcopy(flown)


@cache
def sent() -> tuple[Message, ...]:
    """The paper's flight: a reference and a sample a second."""
    return tuple(paper(11, SECONDS).messages())


def messages(first_s: int, end_s: int, later_s: int = 0) -> list[Message]:
    """What the paper's craft sends in a stretch of time, so much later."""
    stretch = [*sent()][2 * first_s : 2 * end_s]
    return [replace(one, time_ns=one.time_ns + later_s * 10**9) for one in stretch] if later_s else stretch


def ask(pipeline: Pipeline, name: str, **arguments: float | str | bool) -> CommandReply:
    command = Command(craft="paper", source="ops", sequence=7, time_ns=0, name=name, arguments=arguments)
    (reply,) = pipeline.handle(command)
    assert isinstance(reply, CommandReply)
    return reply


@pytest.mark.parametrize("name", CRAFT_COMMANDS)
def test_every_command_is_answered_by_name(pipeline: Pipeline, name: str) -> None:
    reply = ask(pipeline, name, **({"bias_nt": 1.0} if name == "process_noise" else {}))
    assert (reply.name, reply.command_source, reply.command_sequence, reply.accepted) == (name, "ops", 7, True)


def test_status_says_verdict_and_ticks(pipeline: Pipeline) -> None:
    text = ask(pipeline, "status").text
    assert re.fullmatch(r"trusted, protected to \d+ nT \(reference_late\), 899 ticks", text)


def test_an_unknown_command_is_refused_and_told_what_is_known(pipeline: Pipeline) -> None:
    reply = ask(pipeline, "x" * 32)
    assert not reply.accepted
    assert reply.text.endswith("is not known; known: " + ", ".join(COMMANDS))
    encode(reply)


def test_commands_are_counted_by_whether_they_were_understood(pipeline: Pipeline) -> None:
    for name in ("status", "nonsense", "freeze"):
        ask(pipeline, name)
    assert (pipeline.counters["commands"], pipeline.counters["commands_refused"]) == (2, 1)


def estimates(pipeline: Pipeline, first_s: int, end_s: int) -> list[Estimate]:
    return [m for m in handle_all(pipeline, messages(first_s, end_s)) if isinstance(m, Estimate)]


def test_a_frozen_craft_learns_nothing_and_counts_its_ticks(pipeline: Pipeline) -> None:
    ask(pipeline, "freeze")
    during = estimates(pipeline, 900, 950)
    assert {(m.bias_nt, m.D, m.covariance, m.verdict) for m in during} == {
        (during[0].bias_nt, during[0].D, during[0].covariance, Verdict.TRUSTED)
    }
    assert pipeline.counters["ticks_frozen"] == 50


def test_a_resumed_craft_learns_again(pipeline: Pipeline) -> None:
    ask(pipeline, "freeze")
    frozen = estimates(pipeline, 900, 920)[-1]
    ask(pipeline, "resume")
    assert estimates(pipeline, 920, 940)[-1].covariance != frozen.covariance


def test_no_spin_window_reaches_over_a_freeze(pipeline: Pipeline) -> None:
    """Two turns take 16 s: after a pause the first window can end 15 s after the first tick that is used."""
    before = pipeline.counters["spin_windows"]
    ask(pipeline, "freeze")
    handle_all(pipeline, messages(900, 960))
    ask(pipeline, "resume")
    counts = []
    for second in range(960, 980):
        handle_all(pipeline, messages(second, second + 1))
        counts.append(pipeline.counters["spin_windows"] - before)
    assert counts.index(1) >= 15


def test_a_frozen_craft_whose_reference_comes_back_is_trusted_again(pipeline: Pipeline) -> None:
    ask(pipeline, "freeze")
    handle_all(pipeline, messages(900, 990)[1::2])
    assert pipeline.trust.verdict is Verdict.DOUBTFUL
    handle_all(pipeline, messages(990, 1000))
    assert pipeline.trust.verdict is Verdict.TRUSTED


def test_a_reset_craft_begins_anew(pipeline: Pipeline) -> None:
    ask(pipeline, "reset")
    first = estimates(pipeline, 900, 902)[0]
    assert (first.verdict, first.bias_nt, first.reasons) == (Verdict.NOT_STARTED, (0.0, 0.0, 0.0), ("collecting",))


def test_a_reset_craft_ends_where_a_new_one_does() -> None:
    used, new = Pipeline(paper_craft()), Pipeline(paper_craft())
    handle_all(used, messages(0, 300))
    used.flush()
    ask(used, "reset")
    stretch = messages(300, 1000)
    last_used = [m for m in handle_all(used, stretch) if isinstance(m, Estimate)][-1]
    last_new = [m for m in handle_all(new, stretch) if isinstance(m, Estimate)][-1]
    assert last_used.bias_nt == pytest.approx(last_new.bias_nt, abs=1e-6)


def test_a_sensor_that_is_stuck_during_a_reset_is_told_again(pipeline: Pipeline) -> None:
    frozen = messages(900, 930)[1::2]
    handle_all(pipeline, [replace(m, field_body_nt=(1.0, 2.0, 3.0)) for m in frozen[:15]])
    ask(pipeline, "reset")
    handle_all(pipeline, [replace(m, field_body_nt=(1.0, 2.0, 3.0)) for m in frozen[15:]])
    assert "stuck" in pipeline.trust.reasons


def test_process_noise_lets_the_covariance_grow_from_the_estimate_at_hand(pipeline: Pipeline) -> None:
    """100 nT/sqrt(s) on the bias, for the tick that closes next."""
    before = pipeline.estimator.estimate()
    assert ask(pipeline, "process_noise", bias_nt=100.0).accepted
    after = pipeline.estimator.estimate()
    assert (after.x.tolist(), after.samples) == (before.x.tolist(), before.samples)
    estimates(pipeline, 900, 902)
    grown = pipeline.estimator.estimate().covariance[2, 2] - before.covariance[2, 2]
    assert grown > 0.5 * 100.0**2


def test_process_noise_says_at_once_that_there_is_no_protection_level(pipeline: Pipeline) -> None:
    """While it is set, and after it was taken away until the filter starts anew; a reset brings one again."""
    assert pipeline.trust.protection_nt is not None
    text = ask(pipeline, "process_noise", bias_nt=0.5).text
    assert "; trusted, no protection level (process noise), " in text
    assert all(one.protection_nt is None for one in estimates(pipeline, 900, 910))
    text = ask(pipeline, "process_noise", bias_nt=0.0).text
    assert "; converging (unprotected), no protection level (until the filter's next start), " in text
    last = estimates(pipeline, 910, 920)[-1]
    assert (last.verdict, last.reasons) == (Verdict.CONVERGING, ("unprotected",))
    assert "reset" in last.remedy
    ask(pipeline, "reset")
    handle_all(pipeline, messages(0, 900, later_s=1000))
    assert pipeline.trust.protection_nt is not None


def test_a_rollback_brings_no_fault_back_that_is_over(pipeline: Pipeline) -> None:
    """A checkpoint of a time when the sensor was stuck: stuck, that craft would have stayed for ever."""
    still = [replace(m, field_body_nt=(1.0, 2.0, 3.0)) for m in messages(900, 930)[1::2]]
    handle_all(pipeline, still)
    assert "stuck" in pipeline.trust.reasons
    then = copied(pipeline)
    handle_all(pipeline, messages(930, 960))
    pipeline.restore_estimate(then)
    handle_all(pipeline, messages(960, 1030))
    assert pipeline.trust.reasons == ()


def test_a_rollback_does_not_forget_that_axes_have_changed_since(pipeline: Pipeline) -> None:
    then = copied(pipeline)
    swapped = [
        replace(m, field_body_nt=(m.field_body_nt[1], m.field_body_nt[0], m.field_body_nt[2]))
        if isinstance(m, MagnetometerSample)
        else m
        for m in messages(900, 1000)
    ]
    handle_all(pipeline, swapped[:80])
    assert "axes_changed" in pipeline.trust.reasons
    pipeline.restore_estimate(then)
    handle_all(pipeline, swapped[80:])
    assert "axes_changed" in pipeline.trust.reasons


def copied(pipeline: Pipeline) -> Pipeline:
    """What a checkpoint would keep."""
    other = Pipeline(pipeline.config)
    other.restore_state(pipeline.export_state())
    return other


def test_what_is_frozen_loses_its_protection_level_after_as_long_as_between_two_looks(pipeline: Pipeline) -> None:
    """Nobody looks meanwhile: a drift that began with the freeze was trusted for more than an hour."""
    ask(pipeline, "freeze")
    soon = estimates(pipeline, 900, 1210)[-1]
    assert (soon.verdict, soon.reasons) == (Verdict.TRUSTED, ("frozen",))
    assert soon.protection_nt is not None
    late = estimates(pipeline, 1210, 1240)[-1]
    assert (late.verdict, late.reasons) == (Verdict.CONVERGING, ("frozen", "unprotected"))
    assert (late.protection_nt, late.remedy) == (None, REMEDIES[Reason.FROZEN])
    assert "no protection level (nothing learned for 6 min)" in ask(pipeline, "status").text
    ask(pipeline, "resume")
    back = estimates(pipeline, 1240, 1330)
    assert back[0].protection_nt is None
    assert (back[-1].verdict, back[-1].reasons) == (Verdict.TRUSTED, ())


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({}, "bias_nt (nT/sqrt(s)) and D"),
        ({"bias": 1.0}, "bias_nt (nT/sqrt(s)) and D"),
        ({"bias_nt": -1.0}, "bias_nt is -1.0; 0 to 1000"),
        ({"D": 0.02}, "D is 0.02; 0 to 0.01"),
        ({"D": True}, "D is True"),
        ({"D": "much"}, "D is 'much'"),
    ],
)
def test_process_noise_that_is_not_accepted_changes_nothing(
    pipeline: Pipeline, arguments: dict[str, float | str | bool], told: str
) -> None:
    reply = ask(pipeline, "process_noise", **arguments)
    assert (reply.accepted, told in reply.text, pipeline.take_events()[1:]) == (False, True, [])


def test_every_change_is_an_event_with_its_source_and_time(pipeline: Pipeline) -> None:
    for name in ("freeze", "resume", "reset"):
        ask(pipeline, name)
    last_ns = messages(899, 900)[-1].time_ns
    told = [(event.what, event.source, event.time_ns) for event in pipeline.take_events()]
    assert told[0][:2] == ("started", "magcal")
    assert told[1:] == [(what, "ops", last_ns) for what in ("frozen", "resumed", "reset")]
    assert pipeline.take_events() == []
