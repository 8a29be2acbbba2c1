"""Nothing that passes the wire stops the pipeline, and all that it says passes the wire."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import chain

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig, SpinConfig
from magcal_service.daemon.outbox import calibrated_vector, unsendable
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.estimators import methods
from magcal_service.estimators.ekf import Ekf
from magcal_service.estimators.interface import TickOutcome
from magcal_service.ticks.assembler import Tick
from magcal_service.ticks.time_window import EARLIEST_NS, LATEST_NS
from magcal_service.trust.verdict import Trust
from magcal_service.wire.codec import decode, encode
from magcal_service.wire.messages import (
    Frame,
    MagnetometerSample,
    Message,
    PositionSample,
    ReferenceSample,
    TelemetrySample,
    Verdict,
)
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.daemon.pipeline_streams import FIELDS, REFERENCES, handle_all, paper, paper_craft, quick_craft, rows


def all_said(pipeline: Pipeline, stream: list[Message]) -> int:
    """How many messages were published; each has to come through the wire as it was."""
    published = [*handle_all(pipeline, stream), *pipeline.flush(), pipeline.status(1.0, Counter({"link.sent": 3}))]
    for message in published:
        assert decode(encode(message)) == message
    return len(published)


def test_everything_published_in_a_run_passes_the_wire() -> None:
    assert all_said(Pipeline(paper_craft()), list(paper(11, 700).messages())) == 2 * 700 + 1


def test_everything_published_on_a_bad_link_passes_the_wire() -> None:
    scenario = load_scenario("lossy-link")
    stream = list(Simulation(scenario, 3, 120.0).messages())
    pipeline = Pipeline(quick_craft(spin=SpinConfig(rate_rpm=7.5)))
    samples = sum(type(message).__name__ == "MagnetometerSample" for message in stream)
    said = all_said(pipeline, stream)
    counters = pipeline.ticks.counters
    refused = sum(counters[kind] for kind in ("late", "doubled", "stuck", "time_behind", "time_ahead", "zero"))
    assert counters["doubled"] > 0
    assert samples == counters["accepted"] + refused
    assert said == counters["accepted"] + counters["ticks"] + counters["ticks_skipped"] + 1


regimes = st.lists(
    st.tuples(st.sampled_from(sorted(FIELDS)), st.sampled_from(sorted(REFERENCES)), st.integers(1, 50)),
    min_size=1,
    max_size=4,
)


@settings(max_examples=40, deadline=None)
@given(
    regimes,
    st.sampled_from([None, 0.01, 300.0, 1e5]),
    st.sampled_from([None, SpinConfig(rate_rpm=7.5), SpinConfig(rate_rpm=-3000.0)]),
    st.integers(0, 2**32),
)
def test_no_field_or_reference_stops_the_pipeline(
    parts: list[tuple[str, str, int]], noise_nt: float | None, spin: SpinConfig | None, seed: int
) -> None:
    rng, stream, first = np.random.default_rng(seed), [], 0
    for field, reference, seconds in parts:
        stream.append(rows(FIELDS[field](rng, seconds), REFERENCES[reference](rng, seconds), first))
        first += seconds
    pipeline = Pipeline(quick_craft(noise_nt, spin))
    said = all_said(pipeline, list(chain(*stream)))
    assert said > pipeline.ticks.counters["accepted"] + pipeline.ticks.closed


@pytest.mark.parametrize("field", ["line", "zero", "tiny"])
@pytest.mark.parametrize("reference", ["limit", "constant", "mixed"])
@pytest.mark.parametrize("noise_nt", [None, 0.01, 1e5])
def test_samples_that_no_start_can_be_made_of_are_waited_with(
    field: str, reference: str, noise_nt: float | None
) -> None:
    """The start says no by itself: the pipeline's last resort is not needed."""
    rng = np.random.default_rng(1)
    pipeline = Pipeline(quick_craft(noise_nt))
    handle_all(pipeline, rows(FIELDS[field](rng, 60), REFERENCES[reference](rng, 60), 0))
    assert pipeline.counters["estimator_failed"] == 0
    assert pipeline.trust.verdict is Verdict.NOT_STARTED


@pytest.mark.parametrize("seed", range(3))
def test_a_sensor_that_reads_zeros_at_first_is_calibrated_all_the_same(seed: int) -> None:
    stream = list(paper(seed, 1000).messages())
    for row in (1, 3, 5):
        stream[row] = replace(stream[row], field_body_nt=(0.0, 0.0, 0.0))
    pipeline = Pipeline(paper_craft())
    handle_all(pipeline, stream)
    assert pipeline.ticks.counters["zero"] == 3
    assert pipeline.trust.verdict is Verdict.TRUSTED


@pytest.mark.parametrize("reference", ["zero", "zero_vector", "tiny"])
def test_a_reference_that_sends_zeros_is_refused_and_told(reference: str) -> None:
    rng = np.random.default_rng(1)
    pipeline = Pipeline(quick_craft())
    handle_all(pipeline, rows(FIELDS["usual"](rng, 30), REFERENCES[reference](rng, 30), 0))
    assert pipeline.ticks.counters["reference_zero"] == 30
    assert set(pipeline.trust.reasons) == {"collecting", "no_reference"}


@pytest.mark.parametrize("failure", ["raises", "not finite"])
def test_an_estimator_whose_arithmetic_fails_begins_anew_and_is_counted(
    failure: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pipeline = Pipeline(paper_craft())
    handle_all(pipeline, list(paper(11, 1000).messages())[:1800])
    assert pipeline.trust.verdict is Verdict.TRUSTED
    handle = pipeline.estimator.handle

    def fail(tick: Tick) -> TickOutcome:
        if failure == "raises":
            raise np.linalg.LinAlgError("singular")
        outcome = handle(tick)
        pipeline.estimator.estimate().x[0] = np.nan
        return outcome

    with monkeypatch.context() as context:
        context.setattr(pipeline.estimator, "handle", fail)
        handle_all(pipeline, list(paper(11, 1000).messages())[1800:1802])
    assert (pipeline.counters["estimator_failed"], pipeline.trust.verdict) == (1, Verdict.NOT_STARTED)
    assert all_said(pipeline, list(paper(11, 1000).messages())[1802:]) == 2 * 99 + 2


@pytest.mark.parametrize("time_ns", [-(1 << 63), EARLIEST_NS - 1, LATEST_NS + 1, (1 << 63) - 1])
def test_a_time_out_of_range_is_counted_by_kind_and_changes_nothing(time_ns: int) -> None:
    """Of each kind of sample one, in front of every good one: the answers are those of the good ones alone."""
    good = list(paper(11, 200).messages())
    common = {"craft": "paper", "source": "s", "sequence": 0, "time_ns": time_ns}
    strange: list[Message] = [
        MagnetometerSample(**common, field_body_nt=(20_000.0, 1.0, 2.0)),
        ReferenceSample(**common, magnitude_nt=30_000.0),
        PositionSample(**common, position_km=(7000.0, 0.0, 0.0), frame=Frame.ECI),
        TelemetrySample(**common, channel="gyro", unit="rad/s", values=(0.1, 0.2, 0.3)),
    ]
    alone, among = Pipeline(paper_craft()), Pipeline(paper_craft())
    answers = handle_all(alone, good)
    assert handle_all(among, [one for message in good for one in (*strange, message)]) == answers
    assert among.ticks.counters["time_out_of_range"] == len(good)
    kinds = ("reference", "position", "telemetry")
    assert [among.counters[f"{kind}_time_out_of_range"] for kind in kinds] == [len(good)] * 3


@pytest.mark.parametrize("method", [method.name for method in methods()])
@pytest.mark.parametrize("reference", ["usual", "limit"])
@pytest.mark.parametrize("field", ["small", "microtesla", "spikes", "limit"])
def test_whatever_a_method_makes_of_extreme_fields_can_be_sent(method: str, field: str, reference: str) -> None:
    """After half a minute of usual fields, or at once, by a sensor that is called almost free of noise."""
    for usual_s in (0, 30):
        rng = np.random.default_rng(1)
        craft = CraftConfig("paper", SensorConfig(noise_nt=0.01), SpinConfig(), FilterConfig(method, start_s=10.0))
        stream = rows(FIELDS["usual"](rng, usual_s), REFERENCES["usual"](rng, usual_s), 0)
        extreme = rows(FIELDS[field](rng, 12), REFERENCES[reference](rng, 12), usual_s)
        assert all_said(Pipeline(craft), [*stream, *extreme]) > 12


def test_an_estimate_that_no_message_can_carry_is_no_estimate() -> None:
    """The extended filter went to a bias of 10 mT and more, whose messages were held back."""
    rng = np.random.default_rng(1)
    pipeline = Pipeline(CraftConfig("paper", SensorConfig(noise_nt=0.01), filter=FilterConfig("ekf")))
    said = all_said(pipeline, list(rows(FIELDS["small"](rng, 12), REFERENCES["limit"](rng, 12), 0)))
    assert said == 12 + 12 + 1
    assert pipeline.counters["estimator_failed"] > 0
    causes = [event.cause for event in pipeline.take_events() if event.what == "estimator_failed"]
    assert all(cause.startswith("the estimate cannot be sent: the nine errors") for cause in causes)
    assert pipeline.trust.verdict is Verdict.NOT_STARTED


def test_results_are_within_the_wire_up_to_the_limits_of_what_may_be_sent() -> None:
    """The largest state that is no failure, with the longest sample that is calibrated: its messages pass the wire."""
    sample = MagnetometerSample(craft="a", source="m", sequence=0, time_ns=0, field_body_nt=(1e6, 1e6, 1e6))
    stretch = (1e7 - 1e6 * np.sqrt(3.0)) / (1e6 * np.sqrt(3.0)) - 1e-9
    x = np.zeros(9)
    x[3:6] = stretch / np.sqrt(3.0)
    sigma = np.full(9, 1e8)
    state = Ekf(CraftConfig("a", SensorConfig(noise_nt=1e5))).estimate()
    state = replace(state, x=x, covariance=np.outer(sigma, sigma), noise_nt=1e7)
    assert unsendable(state) == ""
    vector = calibrated_vector(sample, state, state.covariance, Trust(Verdict.DOUBTFUL, (), "", 1e7, "bias_step"))
    assert decode(encode(vector)) == vector
    nan, beyond = float("nan"), 1.0 + 1e-6
    wrong = [("x", nan), ("covariance", nan), ("x", 1e300), ("noise_nt", nan)]
    for part, more in [*wrong, ("x", beyond), ("covariance", beyond), ("covariance", -1e-300), ("noise_nt", beyond)]:
        assert unsendable(replace(state, **{part: getattr(state, part) * more}))
