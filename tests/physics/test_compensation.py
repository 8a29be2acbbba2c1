"""Live compensation: what a model holds is subtracted from each sample, and what cannot be is said."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magcal_service.daemon.commands import Commander
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.model import Array, calibrate, d_matrix
from magcal_service.physics.apply.compensation import Compensation
from magcal_service.physics.apply.live_drivers import stale_after_s
from magcal_service.physics.apply.model_file import ModelTerm, PhysicsModel, text_of
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.interface import Hypothesis
from magcal_service.trust.modes import MODES, Mode
from magcal_service.wire.codec import decode, encode
from magcal_service.wire.messages import (
    Command,
    Frame,
    MagnetometerSample,
    PositionSample,
    ReferenceSample,
    TelemetrySample,
    Vector,
    Verdict,
)
from sim_sensor.scenario import Scenario
from tests.physics.given_scene import X, flight
from tests.physics.live_models import NOISE_NT, THERMAL, craft, hot, last_estimate, model_of, physics, stream
from tests.physics.modelled import effects_on
from tests.physics.test_model_file import drawn, forms, ids

UNITS = {"temperature": "degC", "current": "A", "magnetic moment": "A m2", "angular rate": "rad/s", "counts": "counts"}
LIVE_ROWS = 180
NEEDS_COURSE = ("inferred:detumbling", "inferred:dumping")


def common(row: int) -> dict[str, object]:
    scene = flight()
    time_ns = scene.origin_ns + round(float(scene.time_s[row]) * 1e9)
    return {"craft": "hot", "source": "test", "sequence": row, "time_ns": time_ns}


def triple(values: Array) -> Vector:
    x, y, z = values.tolist()
    return x, y, z


def feed(compensation: Compensation, row: int) -> tuple[ReferenceSample, MagnetometerSample]:
    """Everything that the flight has at one row, in the order of a link; the reference and the sample that come out."""
    scene, shared = flight(), common(row)
    for name, channel in scene.channels.items():
        unit = UNITS.get(channel.quantity, "1")
        values = tuple(channel.values[row].tolist())
        compensation.telemetry(TelemetrySample(**shared, channel=name, unit=unit, values=values))  # type: ignore[arg-type]
    assert scene.position_ecef_km is not None
    assert scene.reference_eci_nt is not None
    place = triple(scene.position_ecef_km[row])
    compensation.position(PositionSample(**shared, position_km=place, frame=Frame.ECEF))  # type: ignore[arg-type]
    field = triple(scene.reference_eci_nt[row])
    reference = ReferenceSample(**shared, field_nt=field, frame=Frame.ECI)  # type: ignore[arg-type]
    sample = MagnetometerSample(**shared, field_body_nt=triple(scene.field_nt[row]))  # type: ignore[arg-type]
    return compensation.reference(reference), compensation.correct(sample)


def whole(term: ModelTerm) -> PhysicsModel:
    return model_of(term, origin_ns=flight().origin_ns, x=X)


LIVE = [
    h
    for h in forms()
    if not effect_named(h.effect).acts_on.is_reference and h.driver not in NEEDS_COURSE and "Sun" not in h.variant
    if not h.needs_vectors and not effect_named(h.effect).live_as(h.variant)  # live it acts otherwise, and says so
    if h.variant != "axis z behind"  # this craft turns about z, along which the field hardly changes
]
SUN = ("inferred:array_current", "inferred:sun_direction")


@pytest.mark.parametrize("hypothesis", [h for h in LIVE if h.driver not in SUN], ids=ids)
def test_what_is_taken_off_live_is_what_the_recording_would_be_given(hypothesis: Hypothesis) -> None:
    """Sample by sample, with every driver on the link, each form does what it does to the whole scene."""
    term, _, _ = drawn(hypothesis)
    early = {
        name: value
        for name, value in {"at_s": 200.0, "from_s": 200.0, "to_s": 700.0, "knee": 0.2, "expanded_at_s": 0.0}.items()
        if name in term.nonlinear
    }
    if np.ndim(term.nonlinear.get("at_s", 0.0)):
        early["at_s"] = 30.0 + np.arange(np.size(term.nonlinear["at_s"])) * 40.0
    term = replace(
        term, nonlinear={**term.nonlinear, **early}
    )  # so that it acts within these rows; live, a lag has no course
    if hypothesis.effect == "axis_skew":  # delays of one size: z alone hardly changes on this craft
        term = replace(term, amplitudes={"after_x_s": np.full(hypothesis.size, 0.01)})
    model = whole(term)
    scene = replace(flight(), body_from_eci=None)  # a rate as the gyro tells it, as on the link
    body, _ = effects_on(scene, model)
    compensation = Compensation(model)
    taken = np.zeros((LIVE_ROWS, 3))
    for row in range(LIVE_ROWS):
        _, sample = feed(compensation, row)
        assert compensation.missing == ()
        taken[row] = (np.eye(3) + d_matrix(X)) @ (scene.field_nt[row] - np.array(sample.field_body_nt))
    largest = np.abs(body[:LIVE_ROWS]).max()
    assert np.abs(taken - body[:LIVE_ROWS]).max() < 1e-3 * largest  # dH/dt along the field is left out of a slope


REFERENCES = ("external_field[storm]", "position_offset[three axes, growing along]", "reference_epoch")


@pytest.mark.parametrize("hypothesis", [h for h in LIVE if h.driver.startswith("channel:")], ids=ids)
def test_a_term_bound_to_its_channel_gives_the_bits_of_the_scene(hypothesis: Hypothesis) -> None:
    """The fast path of recorded drivers and the general one publish the same vector."""
    model = whole(drawn(hypothesis)[0])
    fast, general = Compensation(model), Compensation(model)
    general._terms = replace(general._terms, direct=(None,), needs_scene=True)
    for row in range(40):
        _, quick = feed(fast, row)
        _, thorough = feed(general, row)
        assert fast.missing == general.missing == ()
        assert quick.field_body_nt == thorough.field_body_nt


@pytest.mark.parametrize("hypothesis", [h for h in forms() if h.label in REFERENCES], ids=ids)
def test_a_reference_gets_the_magnitude_that_acts(hypothesis: Hypothesis) -> None:
    """Its vector grows along its own direction by what the model says, to 1 % of the largest growth."""
    term, _, _ = drawn(hypothesis)
    model = whole(term)
    _, growth = effects_on(flight(), model)
    compensation = Compensation(model)
    rows = [0, 1, 2, 3, 1500, 1501, 1502, 1503]
    for row in rows:
        reference, _ = feed(compensation, row)
        if row % 1500 > 2:  # the direction of flight takes two positions
            grown = float(np.linalg.norm(reference.field_nt)) - flight().magnitude_nt[row]
            assert abs(grown - growth[row]) < 0.01 * np.abs(growth).max()


def test_a_time_offset_moves_the_references_tag() -> None:
    """A reference that holds 2 s later is wanted 2 s earlier, drift included; the ticks wait as much longer."""
    term = ModelTerm("time_offset", "none", "with drift", {"offset_s": np.array(2.0), "drift_ppm": np.array(1000.0)})
    compensation = Compensation(whole(term))
    reference, _ = feed(compensation, 500)
    assert reference.time_ns == common(500)["time_ns"] - 3 * 10**9  # type: ignore[operator]
    assert compensation.wait_s == 2.0


def strong() -> Scenario:
    """The hot board with five times its coefficients, cooling and warming within the run."""
    scenario = hot()
    thermal = scenario.effects.thermal
    assert thermal is not None
    hotter = replace(thermal, bias_nt_per_k=(40.0, -30.0, 60.0), time_constant_s=600.0, start_degc=50.0)
    return replace(scenario, effects=replace(scenario.effects, thermal=hotter))


STRONG = (replace(THERMAL[0], amplitudes={"nt_per_k": np.array([40.0, -30.0, 60.0])}), THERMAL[1])


@pytest.fixture(scope="module")
def compensated() -> Pipeline:
    scenario = strong()
    pipeline = Pipeline(craft("hot", physics(*STRONG, origin_ns=scenario.start_ns)))
    last_estimate(pipeline, stream(scenario, 2500.0))
    return pipeline


def test_the_estimate_is_right_at_the_noise_with_the_model_and_wrong_without(compensated: Pipeline) -> None:
    """Without it the bias is off by the heat, a thousand nT; with it it is right and trusted, at the noise."""
    truth = np.array([5000.0, 1000.0, 4000.0])
    raw = last_estimate(Pipeline(craft("hot", None)), stream(strong(), 2500.0))
    assert np.abs(np.array(raw.bias_nt) - truth).max() > 500.0
    estimate = compensated.estimator.estimate()
    sigma = np.sqrt(np.diagonal(estimate.covariance))[:3]
    assert np.abs((estimate.x[:3] - truth) / sigma).max() < 4.0
    assert compensated.trust.verdict is Verdict.TRUSTED
    assert compensated.monitor.residual_rms_nt == pytest.approx(NOISE_NT, rel=0.08)  # of 300 samples: 2 sigma


def test_the_published_vector_is_the_corrected_one() -> None:
    """The answer to a sample is the calibrated vector of what is left of it."""
    scenario = strong()
    with_model = Pipeline(craft("hot", physics(*STRONG, origin_ns=scenario.start_ns)))
    without = Pipeline(craft("hot", None))
    messages = stream(scenario, 2500.0)[:4]
    first = [next(a for m in messages for a in p.answer(m)) for p in (with_model, without)]
    away = np.array(first[1].field_body_nt) - np.array(first[0].field_body_nt)  # type: ignore[attr-defined]
    expected = 30.0 * np.array([40.0, -30.0, 60.0])  # 50 degC against 20
    field = np.array(next(m for m in messages if isinstance(m, MagnetometerSample)).field_body_nt)
    expected -= 30.0 * 2e-4 * field
    assert away == pytest.approx(
        np.linalg.solve(np.eye(3) + d_matrix(model_of(origin_ns=0).x), expected), abs=20.0
    )  # a tenth of a kelvin of the channel is 7 nT


def test_a_missing_channel_is_said_and_counted_and_the_sample_left_alone() -> None:
    """Once the temperature is silent for longer than it may be, its effects are named and nothing is guessed."""
    scenario = hot()
    pipeline = Pipeline(craft("hot", physics(*THERMAL, origin_ns=scenario.start_ns)))
    messages = stream(scenario, 400.0)
    silent_from_ns = scenario.start_ns + 200 * 10**9
    kept = [m for m in messages if not (isinstance(m, TelemetrySample) and m.time_ns >= silent_from_ns)]
    estimate = last_estimate(pipeline, tuple(kept))
    assert MODES[Mode.DRIVER_MISSING].reason in estimate.reasons
    assert 179 <= pipeline.counters["uncompensated.thermal_bias"] <= 180  # from 30 s after the last value, at 190 s
    why = "the newest value of channel temperature was older than it may be"
    assert f"not compensated for want of a driver: thermal_bias, thermal_scale ({why}); " in pipeline.summary()


@pytest.mark.parametrize(
    ("pace_s", "quantity", "stale_s"),
    [(0.1, "current", 2.0), (10.0, "current", 30.0), (600.0, "current", 120.0), (1.0, "temperature", 30.0)],
)
def test_a_channel_is_stale_after_three_of_its_own_intervals(pace_s: float, quantity: str, stale_s: float) -> None:
    """But not before 2 s, a temperature not before 30 s, and none after 2 minutes."""
    assert stale_after_s(pace_s, quantity) == pytest.approx(stale_s)


@pytest.mark.parametrize("variant", ["answer to light", "settling"])
def test_a_stream_that_begins_later_waits_until_an_inferred_temperature_is_known(variant: str) -> None:
    """The state of something warm is not known at once: it is compensated after three time constants."""
    wanted = ("thermal_bias", "inferred:temperature", variant)
    hypothesis = next(h for h in forms() if (h.effect, h.driver, h.variant) == wanted)
    skin = {"skin_s": 0.0} if len(hypothesis.nonlinear) > 1 else {}
    term = replace(drawn(hypothesis)[0], nonlinear={"time_constant_s": 200.0, **skin})
    compensation = Compensation(whole(term))
    missing = [feed(compensation, row) and bool(compensation.missing) for row in range(100, 450)]
    assert missing == [row <= 300 for row in range(350)]


def test_a_restored_pipeline_goes_on_bit_for_bit(compensated: Pipeline) -> None:
    """What a compensation carries from sample to sample is in the state."""
    hypothesis = next(h for h in forms() if h.effect == "hysteresis")
    model = whole(drawn(hypothesis)[0])
    one, two = Compensation(model), Compensation(model)
    for row in range(50):
        feed(one, row)
    two.restore_state(one.export_state())
    assert [feed(one, row) for row in range(50, 80)] == [feed(two, row) for row in range(50, 80)]
    again = Pipeline(compensated.config)
    again.restore_state(compensated.export_state())
    assert again.export_state() == compensated.export_state()


def test_a_command_loads_another_model_from_beside_the_configured_one(tmp_path: Path) -> None:
    """It begins anew under the new model, which is in the state from then on; other folders are refused."""
    scenario = hot()
    config = physics(THERMAL[0], origin_ns=scenario.start_ns)
    pipeline = Pipeline(craft("hot", replace(config, path=tmp_path / "physics.toml")))
    other = text_of(model_of(*THERMAL, origin_ns=scenario.start_ns))
    (tmp_path / "second.toml").write_text(other, encoding="utf-8")
    commander = Commander(None, lambda: None)

    def ask(**arguments: object) -> str:
        command = Command(
            craft="hot",
            source="desk",
            sequence=0,
            time_ns=0,
            name="load_physics",
            arguments=arguments,  # type: ignore[arg-type]
        )
        reply = commander.carry_out(command, pipeline)
        assert reply is not None
        assert decode(encode(reply)) == reply
        return "" if reply.accepted else reply.text

    assert "beside" in ask(name="../second.toml")
    assert "there is no such file" in ask(name="third.toml")
    os.mkfifo(tmp_path / "pipe.toml")
    assert "not a file" in ask(name="pipe.toml")
    (tmp_path / "faults.toml").write_text(re.sub(r"[0-9]+\.[0-9]+", "nan", other), encoding="utf-8")
    assert ask(name="faults.toml").count("is refused") > 1
    (tmp_path / "second.toml").chmod(0o666)
    assert "mode 0666" in ask(name="second.toml")
    (tmp_path / "second.toml").chmod(0o644)
    assert ask(name="second.toml") == ""
    assert [event.what for event in pipeline.take_events()] == ["physics_loaded"]
    assert pipeline.compensation is not None
    assert len(pipeline.compensation.model.terms) == 2
    again = Pipeline(pipeline.config)
    again.restore_state(pipeline.export_state())
    assert again.compensation is not None
    assert len(again.compensation.model.terms) == 2


def fitted(effect: str, variant: str = "") -> ModelTerm:
    """A term of an effect that fits its form."""
    return drawn(next(h for h in forms() if (h.effect, h.variant) == (effect, variant)))[0]


UNFIT = {
    "torquer": replace(fitted("torquer"), amplitudes={"nt_per_am2": np.ones((1, 2))}),
    "cubic_response": replace(fitted("cubic_response"), amplitudes={"per_nt2": np.full(3, 1e300)}),
    "position_offset": replace(fitted("position_offset", "radial"), amplitudes={"radial_km": np.float64(1e9)}),
    "reference_epoch": replace(fitted("reference_epoch"), amplitudes={"share": np.float64(1.0)}),
    "time_offset": replace(fitted("time_offset"), amplitudes={"drift_ppm": np.float64(1.0)}),
    "tone": replace(fitted("tone"), nonlinear={}),
}


@pytest.mark.parametrize("effect", UNFIT)
def test_an_effect_that_fits_neither_its_form_nor_any_measure_is_left_out_and_named(effect: str) -> None:
    """What the catalogue has no use for changes no sample and no reference, and is said, like a missing driver."""
    sound = Compensation(model_of(origin_ns=flight().origin_ns, x=X))
    compensation = Compensation(whole(UNFIT[effect]))
    assert compensation.wait_s == 0.0
    for row in range(3):
        assert feed(compensation, row) == feed(sound, row)
        assert compensation.missing == (effect,)


def test_a_channel_that_sends_fewer_values_than_the_model_has_coils_costs_the_effect_alone() -> None:
    """A telemetry sample of another shape is a driver that is missing: the other effects stay compensated."""
    scene, shared = flight(), common(0)
    step = ModelTerm("bias_step", "none", "", {"step_nt": np.array([10.0, 0.0, 0.0])}, nonlinear={"at_s": -1.0})
    model = model_of(fitted("torquer"), step, origin_ns=scene.origin_ns, x=X)
    compensation = Compensation(model)
    coils = TelemetrySample(**shared, channel="torquer", unit="A m2", values=(0.1, 0.2))  # type: ignore[arg-type]
    compensation.telemetry(coils)
    sample = MagnetometerSample(**shared, field_body_nt=triple(scene.field_nt[0]))  # type: ignore[arg-type]
    wanted = scene.field_nt[0] - np.linalg.solve(np.eye(3) + d_matrix(X), [10.0, 0.0, 0.0])
    assert compensation.correct(sample).field_body_nt == pytest.approx(wanted, abs=1e-6)
    assert compensation.missing == ("torquer",)


@pytest.mark.parametrize("variant", ["", "of the field alone"])
def test_a_cube_is_taken_off_as_one_of_the_field_without_it(variant: str) -> None:
    """Of the measured field's it would be too much or too little, by 3 d / |B|: 5 % here."""
    scene, per_nt2 = flight(), np.array([1.5e-11, -1.5e-11, 1.5e-11])
    cube = ModelTerm("cubic_response", "none", variant, {"per_nt2": per_nt2})
    compensation = Compensation(model_of(cube, origin_ns=scene.origin_ns, x=X))
    clean = np.array([30_000.0, -25_000.0, 40_000.0])
    bent = (calibrate(X, clean[None])[0] if variant else clean) ** 3
    added = np.linalg.solve(np.eye(3) + d_matrix(X), per_nt2 * bent)
    sample = MagnetometerSample(**common(0), field_body_nt=triple(clean + added))  # type: ignore[arg-type]
    left = np.array(compensation.correct(sample).field_body_nt) - clean
    assert np.linalg.norm(added) > 700.0
    assert np.linalg.norm(left) < 0.01 * np.linalg.norm(added)
