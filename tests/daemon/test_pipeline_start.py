"""A stream that begins where the model's recording did not: the temperature at the start is known within minutes.

The flight is the simulator's: its light, its warmth and what that does share no code with the catalogue.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from magcal_service.daemon import settling
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.model import Array
from magcal_service.physics.apply.compensation import Compensation
from magcal_service.physics.apply.model_file import ModelSpin, ModelTerm
from magcal_service.wire.messages import (
    CalibratedVector,
    MagnetometerSample,
    PositionSample,
    ReferenceSample,
    TelemetrySample,
    Verdict,
)
from sim_sensor.scenario import PositionPlan, Scenario
from sim_sensor.simulation import Simulation
from tests.physics.live_models import HOT_X, NOISE_NT, craft, hot, model_of, physics

DURATION_S = 1200.0
DAY_NS = 86_400 * 10**9
NT_PER_K = np.array([40.0, -30.0, 60.0])
HOT_DEGC, COLD_DEGC, TAU_S, MEAN_LIGHT = 45.0, -10.0, 1200.0, 0.6
SWING_K = HOT_DEGC - COLD_DEGC


def warming(start_degc: float) -> Scenario:
    """The hot board with five times its bias and no gain that follows; nobody sends its temperature, but places."""
    scenario = hot(position=PositionPlan(rate_hz=0.1))
    thermal = scenario.effects.thermal
    assert thermal is not None
    k = tuple(NT_PER_K.tolist())
    thermal = replace(thermal, bias_nt_per_k=k, scale_per_k=(0.0, 0.0, 0.0), start_degc=start_degc)
    return replace(scenario, effects=replace(scenario.effects, thermal=thermal))


def model() -> tuple[ModelTerm, ...]:
    """What a diagnosis of another day would have found: the swing right, the start of that day."""
    amplitudes = {"nt_swing": SWING_K * NT_PER_K, "start_nt_swing": np.array([100.0, 200.0, -300.0])}
    numbers = {"time_constant_s": TAU_S, "skin_s": 0.0}
    constants = {"mean_light": MEAN_LIGHT}
    name, driver = "thermal_bias", "inferred:temperature"
    return (ModelTerm(name, driver, "answer to light", amplitudes, nonlinear=numbers, constants=constants),)


def start_of(start_degc: float) -> float:
    """The start in units of the swing, from where the mean light would hold it."""
    return (start_degc - (COLD_DEGC + SWING_K * MEAN_LIGHT)) / SWING_K


MOVED = np.array([300.0, -300.0, 300.0, 0.004, 0.004, -0.004, 0.003, 0.003, -0.003])
"""Of the nine errors since the file's day."""


@cache
def flown(start_degc: float, moved: float = 0.0) -> tuple[Pipeline, list[tuple[float, str]], Array, Array, Array]:
    """The pipeline, its events with their times [s], each vector's error (n, 3), variance (n,), whether doubted."""
    scenario = warming(start_degc)
    simulation = Simulation(scenario, 5, DURATION_S)
    truth = simulation.arrays().ambient_body_nt
    file = physics(*model(), origin_ns=scenario.start_ns - DAY_NS, x=HOT_X + moved * MOVED)
    pipeline = Pipeline(craft("hot", file))
    error, variance, doubtful, events = [], [], [], []
    for message in simulation.messages():
        if isinstance(message, TelemetrySample):
            continue
        for out in pipeline.handle(message):
            if isinstance(out, CalibratedVector):
                error.append(np.array(out.field_body_nt) - truth[len(error)])
                variance.append((out.covariance_nt2[0] + out.covariance_nt2[3] + out.covariance_nt2[5]) / 3.0)
                doubtful.append(out.verdict in (Verdict.DOUBTFUL, Verdict.NOT_STARTED))
        now_s = (pipeline.last_time_ns - pipeline.first_time_ns) * 1e-9
        events += [(now_s, event.what) for event in pipeline.take_events()]
    return pipeline, events, np.array(error), np.array(variance), np.array(doubtful)


FLIGHTS = ((45.0, 0.0), (45.0, 1.0))


@pytest.mark.parametrize(("start_degc", "moved"), FLIGHTS)
def test_the_start_is_known_in_minutes_and_within_its_sigma(start_degc: float, moved: float) -> None:
    """Three time constants, which it was waited for once, are an hour; beside nine free errors it takes 13 minutes."""
    pipeline, events, _, _, _ = flown(start_degc, moved)
    known_s = next(time_s for time_s, what in events if what == "start_known")
    assert known_s < 500.0
    assert pipeline.compensates
    assert pipeline.compensation is not None
    sigma = float(np.sqrt(pipeline.compensation._start_covariance[0, 0]))
    assert sigma < 0.15
    assert abs(pipeline.compensation.start[0] - start_of(start_degc)) < 4.0 * sigma
    assert pipeline.estimator.estimate().samples < DURATION_S - known_s + 5.0  # it went on, and was given none again


@pytest.mark.parametrize(("start_degc", "moved"), FLIGHTS)
def test_from_then_on_the_vectors_are_right_to_what_they_say(start_degc: float, moved: float) -> None:
    """The heat moves the field by up to 4 uT; what is left of it is within the published sigma."""
    _, events, error, variance, doubtful = flown(start_degc, moved)
    known = round(next(time_s for time_s, what in events if what == "start_known")) + 2
    square = (error[known:] ** 2).mean(axis=1)
    assert 0.4 < float(np.mean(square / variance[known:])) < 1.3  # one start, one error: mostly less than 1 sigma
    assert np.sqrt(square[-200:].mean()) < 1.2 * NOISE_NT
    assert doubtful[: known - 2].all()
    assert (variance[known:] > NOISE_NT**2).all()


def test_a_start_that_is_being_estimated_is_restored_bit_for_bit() -> None:
    scenario = warming(45.0)
    one = Pipeline(craft("hot", physics(*model(), origin_ns=scenario.start_ns - DAY_NS)))
    messages = [m for m in Simulation(scenario, 5, 260.0).messages() if not isinstance(m, TelemetrySample)]
    for message in messages[:300]:
        one.handle(message)
    assert one.settling is not None
    assert "temperature at the start is being estimated" in one.summary()
    two = Pipeline(one.config)
    two.restore_state(one.export_state())
    assert [one.handle(m) for m in messages[300:]] == [two.handle(m) for m in messages[300:]]
    assert one.export_state() == two.export_state()


@pytest.mark.parametrize(("most", "starts"), [(1800, False), (460, True)])
def test_a_filter_does_not_start_anew_from_few_ticks(monkeypatch: pytest.MonkeyPatch, most: int, starts: bool) -> None:
    """While nine errors are not sure it waits, until there is no room for more ticks; then it is given them again."""
    monkeypatch.setattr(settling, "vector_sigma", lambda *_: np.inf)
    monkeypatch.setattr(settling, "_MOST", most)
    scenario = warming(45.0)
    pipeline = Pipeline(craft("hot", physics(*model(), origin_ns=scenario.start_ns - DAY_NS)))
    for message in Simulation(scenario, 5, 560.0).messages():
        if not isinstance(message, TelemetrySample):
            pipeline.handle(message)
    assert (pipeline.settling is None) is starts


def test_while_frozen_what_it_remembers_of_samples_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """No tick is kept then, nor without a reference: all samples of that time were."""
    monkeypatch.setattr(settling, "_MOST_OPEN", 20)
    scenario = warming(45.0)
    pipeline = Pipeline(craft("hot", physics(*model(), origin_ns=scenario.start_ns - DAY_NS)))
    messages = [m for m in Simulation(scenario, 5, 200.0).messages() if not isinstance(m, TelemetrySample)]
    pipeline.freeze(True)
    for message in messages[:300]:
        pipeline.handle(message)
    assert pipeline.settling is not None
    assert len(pipeline.settling._fields) == len(pipeline.settling._raw) == 20
    pipeline.freeze(False)
    for message in messages[300:]:
        pipeline.handle(message)
    assert pipeline.settling._seen > 30


def test_at_the_models_own_start_nothing_is_waited_for() -> None:
    scenario = warming(45.0)
    pipeline = Pipeline(craft("hot", physics(*model(), origin_ns=scenario.start_ns)))
    for message in Simulation(scenario, 5, 30.0).messages():
        pipeline.handle(message)
    assert pipeline.settling is None
    assert pipeline.compensates


def test_the_spin_axis_in_space_is_that_of_the_day() -> None:
    """The model's is of another day, at a right angle; until this one is known, panels are not compensated."""
    scenario = warming(20.0)
    spin = ModelSpin((0.0, 0.0, 1.0), (-(0.5**0.5), 0.5**0.5, 0.0), 2.0 * np.pi * 7.5 / 60.0)
    numbers = {f"face_{index}": float(index) for index in range(3)}
    driver, form = "inferred:array_current", "every panel its own circuit"
    panels = ModelTerm("current_loop", driver, form, {"nt_full_sun": np.full((3, 3), 50.0)}, constants=numbers)
    compensation = Compensation(model_of(panels, origin_ns=scenario.start_ns - DAY_NS, spin=spin))
    missing = []
    for message in Simulation(scenario, 5, 400.0).messages():
        if isinstance(message, ReferenceSample):
            compensation.reference(message)
        elif isinstance(message, PositionSample):
            compensation.position(message)
        elif isinstance(message, MagnetometerSample):
            compensation.correct(message)
            missing.append(bool(compensation.missing))
    assert all(missing[:100])
    assert not any(missing[200:])
    assert compensation._axis == pytest.approx(np.full(3, 3.0**-0.5), abs=0.1)


def test_without_places_the_effect_is_left_out_and_said_and_others_are_compensated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Light needs a place; after some time without, the file's other effects are compensated."""
    scenario = warming(20.0)
    loop = ModelTerm("bias_step", "none", "", {"step_nt": np.array([10.0, 0.0, 0.0])}, nonlinear={"at_s": -1.0})
    pipeline = Pipeline(craft("hot", physics(*model(), loop, origin_ns=scenario.start_ns - DAY_NS)))
    monkeypatch.setattr(settling, "_SKIPPED", 300)
    bare = replace(scenario, position=PositionPlan())
    for message in Simulation(bare, 5, 900.0).messages():
        if not isinstance(message, TelemetrySample):
            pipeline.handle(message)
    assert pipeline.compensates
    assert "not compensated for want of a driver: thermal_bias" in pipeline.summary()


def test_a_model_that_fits_with_no_start_is_given_up_within_an_orbit(monkeypatch: pytest.MonkeyPatch) -> None:
    """As long as none is found, and after it was given up, the craft is one without the file, and says so."""
    monkeypatch.setattr(settling, "_LATEST", 400)
    monkeypatch.setattr(settling, "_WORSE", 0.1)
    monkeypatch.setattr(settling, "BAD_FIT", 0.1)
    scenario = warming(45.0)
    pipeline = Pipeline(craft("hot", physics(*model(), origin_ns=scenario.start_ns - DAY_NS)))
    bare = Pipeline(craft("hot", None))
    for message in Simulation(scenario, 5, 500.0).messages():
        if not isinstance(message, TelemetrySample):
            vectors = [[m for m in one.handle(message) if isinstance(m, CalibratedVector)] for one in (pipeline, bare)]
            assert [m.field_body_nt for m in vectors[0]] == [m.field_body_nt for m in vectors[1]]
    assert "no temperature at the start" in pipeline.stopped
    assert "compensation_stopped" in pipeline.trust.reasons
    assert "driver_missing" not in pipeline.trust.reasons
