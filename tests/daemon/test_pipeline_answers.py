"""Samples in, vectors and estimates out: who is answered, when, and with what covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.config.settings import SensorConfig
from magcal_service.daemon.events import Event
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.wire.messages import (
    CalibratedVector,
    Estimate,
    MagnetometerSample,
    Message,
    PositionSample,
    ReferenceSample,
    TelemetrySample,
    Verdict,
)
from tests.daemon.pipeline_streams import handle_all, paper, paper_craft

SECONDS = 2400
UPPER = np.triu_indices(3)


@pytest.fixture(scope="module")
def answers() -> list[CalibratedVector]:
    """The vectors of a run of the paper's scenario."""
    published = handle_all(Pipeline(paper_craft()), paper(11, SECONDS).messages())
    return [message for message in published if isinstance(message, CalibratedVector)]


@pytest.fixture(scope="module")
def truth_nt() -> np.ndarray:
    """The field that acted on the sensor, in its axes (n, 3) [nT]."""
    return paper(11, SECONDS).arrays().ambient_body_nt


def squared_errors(answers: list[CalibratedVector], truth_nt: np.ndarray) -> np.ndarray:
    """Errors of the vectors in units of their own covariance, squared (n,); 3 on average where that is right."""
    values = []
    for answer, true in zip(answers, truth_nt, strict=True):
        covariance = np.zeros((3, 3))
        covariance[UPPER] = answer.covariance_nt2
        covariance = covariance + np.triu(covariance, 1).T
        error = np.array(answer.field_body_nt) - true
        values.append(error @ np.linalg.solve(covariance, error))
    return np.array(values)


def test_each_vector_names_its_sample(answers: list[CalibratedVector]) -> None:
    samples = [m for m in paper(11, SECONDS).messages() if isinstance(m, MagnetometerSample)]
    named = [(m.craft, m.source, m.sequence, m.time_ns, m.clock) for m in samples]
    assert [(m.craft, m.source, m.sequence, m.time_ns, m.clock) for m in answers] == named


def test_after_convergence_the_covariance_fits_the_scatter_against_the_truth(
    answers: list[CalibratedVector], truth_nt: np.ndarray
) -> None:
    """1600 vectors of 3 components: their mean squared error is 3 with a sigma of 0.06."""
    assert np.mean(squared_errors(answers[800:], truth_nt[800:])) == pytest.approx(3.0, abs=0.25)


def test_after_convergence_no_component_is_biased(answers: list[CalibratedVector], truth_nt: np.ndarray) -> None:
    """1600 vectors at 300 nT: the mean error has a sigma of 7.5 nT, and the estimate's own is about as much."""
    errors = np.array([answer.field_body_nt for answer in answers[800:]]) - truth_nt[800:]
    assert np.abs(errors.mean(axis=0)).max() < 45.0


def test_before_the_start_the_covariance_says_how_little_is_known(
    answers: list[CalibratedVector], truth_nt: np.ndarray
) -> None:
    early = [answer for answer in answers if answer.verdict is Verdict.NOT_STARTED]
    assert len(early) > 100
    assert squared_errors(early, truth_nt[: len(early)]).max() < 9.0
    assert min(min(answer.covariance_nt2[i] for i in (0, 3, 5)) for answer in early) > 1000.0**2


def test_the_verdict_of_a_vector_is_that_of_the_newest_estimate() -> None:
    newest = Verdict.NOT_STARTED
    for message in handle_all(Pipeline(paper_craft()), paper(11, 1000).messages()):
        if isinstance(message, Estimate):
            newest = message.verdict
        elif isinstance(message, CalibratedVector):
            assert message.verdict is newest
    assert newest is Verdict.TRUSTED


def test_a_sample_is_answered_at_once_before_its_tick_closes() -> None:
    pipeline = Pipeline(paper_craft())
    for message in paper(11, 30).messages():
        published = pipeline.handle(message)
        if isinstance(message, MagnetometerSample):
            assert isinstance(published[0], CalibratedVector)
            assert published[0].sequence == message.sequence


def test_a_sample_without_reference_is_answered_all_the_same() -> None:
    samples = [m for m in paper(11, 30).messages() if isinstance(m, MagnetometerSample)]
    published = handle_all(Pipeline(paper_craft()), samples)
    assert sum(isinstance(message, CalibratedVector) for message in published) == 30


@pytest.mark.parametrize(
    ("reason", "spoil"),
    [
        ("doubled", lambda sample: sample),
        ("late", lambda sample: replace(sample, time_ns=sample.time_ns - 5_500_000_000)),
        ("time_behind", lambda sample: replace(sample, time_ns=0)),
        ("time_ahead", lambda sample: replace(sample, time_ns=2**62)),
    ],
)
def test_a_refused_sample_is_counted_and_not_answered(reason: str, spoil: object) -> None:
    pipeline = Pipeline(paper_craft())
    messages = list(paper(11, 30).messages())
    handle_all(pipeline, messages)
    assert callable(spoil)
    assert (pipeline.handle(spoil(messages[-1])), pipeline.ticks.counters[reason]) == ([], 1)


def test_one_estimate_for_each_tick_and_one_more_at_the_end() -> None:
    pipeline = Pipeline(paper_craft())
    published = handle_all(pipeline, paper(11, 60).messages())
    ticks = [message.tick for message in published if isinstance(message, Estimate)]
    last = [message.tick for message in pipeline.flush() if isinstance(message, Estimate)]
    assert (ticks, last) == (list(range(1, 60)), [60])


def test_estimates_count_their_own_sequence() -> None:
    published = handle_all(Pipeline(paper_craft()), paper(11, 60).messages())
    assert [m.sequence for m in published if isinstance(m, Estimate)] == list(range(59))


def test_a_skipped_tick_changes_nothing_and_says_so() -> None:
    messages = list(paper(11, 1000).messages())
    pipeline = Pipeline(paper_craft())
    without = [m for m in messages if isinstance(m, MagnetometerSample)][900:]
    before = [m for m in handle_all(pipeline, messages[:1800]) if isinstance(m, Estimate)][-1]
    skipped = [m for m in handle_all(pipeline, without) if isinstance(m, Estimate)]
    assert {m.covariance for m in skipped[5:]} == {skipped[-1].covariance}
    assert before.reasons == ()
    assert skipped[-1].reasons == ("no_reference",)


def test_a_stuck_sensor_is_told_at_once_and_until_it_changes() -> None:
    """With references 5 s apart, ticks from before go on closing while the sensor is stuck: that is no recovery."""
    messages = list(paper(11, 1020).messages())
    slow = [m for m in messages if not (isinstance(m, ReferenceSample) and m.time_ns % 5_000_000_000)]
    begin = messages[0].time_ns + 950 * 10**9
    stuck = [
        replace(m, field_body_nt=(1.0, 2.0, 3.0))
        if isinstance(m, MagnetometerSample) and begin <= m.time_ns < begin + 30 * 10**9
        else m
        for m in slow
    ]
    pipeline = Pipeline(paper_craft(sensor=SensorConfig(noise_nt=300.0, stuck_samples=5)))
    told = []
    for message in stuck:
        pipeline.handle(message)
        if isinstance(message, MagnetometerSample):
            told.append("stuck" in pipeline.trust.reasons)
    assert told == [False] * 954 + [True] * 26 + told[980:]
    assert told[980:990].count(True) <= 7
    assert not any(told[990:])


def test_position_and_telemetry_are_taken_in_and_counted() -> None:
    pipeline = Pipeline(paper_craft())
    common = {"craft": "paper", "source": "s", "sequence": 0, "time_ns": 0}
    messages: list[Message] = [
        PositionSample(**common, position_km=(7000.0, 0.0, 0.0), frame="eci"),
        TelemetrySample(**common, channel="temperature", unit="degC", values=(20.0,)),
    ]
    assert handle_all(pipeline, messages) == []
    assert (pipeline.counters["position"], pipeline.counters["telemetry"]) == (1, 1)


def test_a_message_that_only_the_daemon_sends_is_counted_as_unexpected() -> None:
    pipeline = Pipeline(paper_craft())
    echo = handle_all(Pipeline(paper_craft()), paper(11, 3).messages())
    assert handle_all(pipeline, echo) == []
    assert pipeline.counters["unexpected"] == len(echo)


def test_the_vector_is_out_before_the_tick_is_worked_through(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever takes the outputs one by one has the vector while the estimator has not been asked yet."""
    pipeline = Pipeline(paper_craft())
    order: list[str] = []
    own = pipeline.estimator.handle
    monkeypatch.setattr(pipeline.estimator, "handle", lambda tick: order.append("tick") or own(tick))
    for message in paper(7, 60.0).messages():
        order.append("message")
        for output in pipeline.outputs(message):
            if isinstance(output, CalibratedVector):
                order.append("vector")  # noqa: PERF401  (as it comes, not when all have come)
    with_both = " ".join(order).split("message")
    assert any("vector tick" in each for each in with_both)
    assert not any("tick vector" in each for each in with_both)


def test_a_craft_is_asked_once_and_gives_vector_estimates_events_in_that_order() -> None:
    pipeline = Pipeline(paper_craft())
    kinds = [[type(output) for output in pipeline.outputs(message)] for message in paper(7, 700.0).messages()]
    rank = {CalibratedVector: 0, Estimate: 1, Event: 2}
    assert all([rank[kind] for kind in each] == sorted(rank[kind] for kind in each) for each in kinds)
    assert any(Event in each for each in kinds)


@pytest.mark.parametrize("before", [0, 3])
def test_the_end_of_a_stream_is_no_alarm_about_the_reference(before: int) -> None:
    """Samples whose reference would have come next say nothing about it; one that was missing before stays missing."""
    pipeline, messages = Pipeline(paper_craft()), list(paper(11, SECONDS).messages())
    handle_all(pipeline, [message for message in messages if message.time_ns < messages[0].time_ns + 1500 * 10**9])
    late = [one for one in messages if isinstance(one, MagnetometerSample)][1500 : 1502 + 5 * before]
    handle_all(pipeline, late)
    assert pipeline.trust.verdict is Verdict.TRUSTED
    last = [message for message in pipeline.flush() if isinstance(message, Estimate)]
    assert last
    assert {message.reasons for message in last} == {("no_reference",) if before else ()}
    assert {message.verdict for message in last} == {Verdict.TRUSTED}
