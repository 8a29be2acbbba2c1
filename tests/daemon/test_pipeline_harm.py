"""A ``physics.toml`` that does not fit the flight: said, stopped, and from then on as if there were none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from magcal_service.config.settings import TrustConfig
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.trust.modes import MODES, Mode
from magcal_service.trust.reasons import Reason
from magcal_service.wire.messages import CalibratedVector, Command, Estimate, Message
from tests.physics.live_models import THERMAL, craft, hot, physics, stream

ORBIT_S = 5500
DURATION_S = 2100.0
WRONG = (replace(THERMAL[0], amplitudes={"nt_per_k": np.array([40.0, 30.0, -60.0])}),)
"""Five times as strong and the other way round."""


def heating() -> tuple[Message, ...]:
    scenario = hot()
    thermal = scenario.effects.thermal
    assert thermal is not None
    warmer = replace(thermal, time_constant_s=900.0, start_degc=-5.0)
    return stream(replace(scenario, effects=replace(scenario.effects, thermal=warmer)), DURATION_S)


@cache
def flown() -> tuple[Pipeline, list[tuple[int, Message]], list[tuple[int, Message]]]:
    """The pipeline after the flight; what it published and what one without physics did, with the samples before."""
    wrong = physics(*WRONG, origin_ns=hot().start_ns)
    unwatched = (replace(craft("hot", one), trust=TrustConfig(watch=False)) for one in (wrong, None))
    with_it, without = map(Pipeline, unwatched)  # the watch begins anew with a stop
    sent: tuple[list[tuple[int, Message]], list[tuple[int, Message]]] = ([], [])
    for message in heating():
        for pipeline, out in zip((with_it, without), sent, strict=True):
            out += [(pipeline.ticks.counters["accepted"], one) for one in pipeline.handle(message)]
    return with_it, *sent


def test_it_is_said_within_an_orbit_in_every_place_where_people_look() -> None:
    pipeline, sent, _ = flown()
    events = [event for event in pipeline.take_events() if event.what == "compensation_stopped"]
    assert len(events) == 1
    assert "more residual with it than without" in events[0].cause
    assert (events[0].time_ns - pipeline.first_time_ns) * 1e-9 < ORBIT_S
    assert not pipeline.compensates
    assert "physics.toml is not compensated any more: " in pipeline.summary()
    assert pipeline.status(0.0, pipeline.counters).counters.get("compensating", 0) == 0
    last = [one for _, one in sent if isinstance(one, Estimate)][-1]
    row = MODES[Mode.COMPENSATION_STOPPED]
    assert (row.reason in last.reasons, pipeline.counters[row.counter]) == (True, 1)


def test_from_then_on_everything_published_is_that_of_a_craft_without_the_file() -> None:
    """Vectors with covariance and verdict, and estimates, bit for bit, but for the reason that says it."""
    _, with_it, without = flown()
    estimates = [(n, one) for n, one in with_it if isinstance(one, Estimate)]
    stopped = next(n for n, one in estimates if "compensation_stopped" in one.reasons)
    kinds = (CalibratedVector, Estimate)
    ours, theirs = ([one for n, one in sent if n > stopped and isinstance(one, kinds)] for sent in (with_it, without))
    assert len(ours) > 300
    for one, other in zip(ours, theirs, strict=True):
        if isinstance(one, Estimate) and isinstance(other, Estimate):
            reasons = tuple(reason for reason in one.reasons if reason != Reason.COMPENSATION_STOPPED)
            assert other == replace(one, reasons=reasons, remedy=other.remedy)
        else:
            assert one == other


def test_before_it_was_stopped_the_vectors_were_others() -> None:
    _, with_it, without = flown()
    ours, theirs = (
        [one for n, one in sent if n < 1000 and isinstance(one, CalibratedVector)] for sent in (with_it, without)
    )
    assert all(one.field_body_nt != other.field_body_nt for one, other in zip(ours, theirs, strict=True))


def test_it_stays_off_over_a_restart_and_a_reset_until_the_file_is_loaded_again() -> None:
    pipeline, _, _ = flown()
    again = Pipeline(pipeline.config)
    again.restore_state(pipeline.export_state())
    assert again.export_state() == pipeline.export_state()
    again.handle(Command(craft="hot", source="desk", sequence=0, time_ns=0, name="reset"))
    assert not again.compensates
    assert (
        "compensation_stopped" in again.trust.reasons
        or Reason.COMPENSATION_STOPPED in again.monitor.judge(again.estimator.estimate()).reasons
    )
    again.load_physics(pipeline.config.physics.text)  # type: ignore[union-attr]
    assert again.compensates
    assert Reason.COMPENSATION_STOPPED not in again.monitor.judge(again.estimator.estimate()).reasons


def test_the_craft_beside_has_the_process_noise_of_a_command_after_another_file_and_a_restart() -> None:
    """It is what the craft goes on with where compensation is stopped."""
    pipeline, without = Pipeline(flown()[0].config), Pipeline(craft("hot", None))
    noise = Command(
        craft="hot", source="desk", sequence=0, time_ns=0, name="process_noise", arguments={"bias_nt": 20.0}
    )
    for one in (pipeline, without):
        one.handle(noise)
    pipeline.load_physics(physics(*THERMAL, origin_ns=hot().start_ns).text)
    messages = heating()
    for message in messages[:900]:
        pipeline.handle(message)
        without.handle(message)
    again = Pipeline(pipeline.config)
    again.restore_state(pipeline.export_state())
    for message in messages[900:1000]:
        pipeline.handle(message)
        again.handle(message)
        without.handle(message)
    assert without.estimator.estimate().samples > 0
    for one in (pipeline, again):
        assert one.plain is not None
        assert one.plain.estimator.export_state() == without.estimator.export_state()


def test_a_craft_that_compensates_is_restored_with_the_one_beside_it() -> None:
    """Bit for bit, in the middle of the comparison; rolled back to before the stop it compares anew."""
    one = Pipeline(flown()[0].config)
    messages = heating()
    for message in messages[:1500]:
        one.handle(message)
    two = Pipeline(one.config)
    two.restore_state(one.export_state())
    for message in messages[1500:1800]:
        assert one.handle(message) == two.handle(message)
    assert one.export_state() == two.export_state()
    stopped = Pipeline(one.config)
    stopped.restore_state(flown()[0].export_state())
    saved = Pipeline(one.config)
    saved.restore_state(one.export_state())
    stopped.restore_estimate(saved)
    assert stopped.compensates
    assert stopped.plain is not None
    two.restore_estimate(flown()[0])
    assert not two.compensates
