"""Each row of the table of degraded modes, played through a pipeline; and the page that is written from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magcal_service.config.settings import (
    Config,
    CraftConfig,
    FilterConfig,
    ReferenceConfig,
    ReferenceModel,
    SensorConfig,
)
from magcal_service.daemon.health.figures import troubles
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.daemon.service import Service
from magcal_service.links import Role, open_link
from magcal_service.trust.modes import MODES, Mode, markdown
from magcal_service.trust.reasons import Reason
from magcal_service.wire.messages import (
    CalibratedVector,
    Command,
    Estimate,
    MagnetometerSample,
    Message,
    ReferenceSample,
    Status,
    TelemetrySample,
    Verdict,
)
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.daemon.pipeline_streams import handle_all, paper, paper_craft

BEGIN_S = 900  # by then the craft is trusted
WALK_NT = 1.0
SECOND_NS = 10**9


def craft() -> CraftConfig:
    sensor = SensorConfig(noise_nt=300.0, range_nt=80_000.0)
    return paper_craft(sensor=sensor, filter=FilterConfig(process_noise_bias_nt=(WALK_NT,) * 3))


@cache
def flight() -> tuple[Message, ...]:
    """The paper's scenario, a reference and a sample a second, long enough for an estimate to grow old."""
    return tuple(paper(11, BEGIN_S + 6200).messages())


def messages(end_s: int, first_s: int = BEGIN_S) -> list[Message]:
    return list(flight()[2 * first_s : 2 * end_s])


def test_a_vector_that_is_not_as_long_as_the_field_leaves_as_doubtful() -> None:
    """One that is a third too long is told at once, the vectors before and after it are trusted; it is counted."""
    pipeline = Pipeline(craft())
    pipeline.restore_state(trusted_state())
    found = []
    for message in messages(BEGIN_S + 6):
        if isinstance(message, MagnetometerSample) and len(found) == 3:
            x, y, z = message.field_body_nt
            message = replace(message, field_body_nt=(1.3 * x, 1.3 * y, 1.3 * z))
        found += [one.verdict for one in pipeline.handle(message) if isinstance(one, CalibratedVector)]
    assert found == [Verdict.DOUBTFUL if number == 3 else Verdict.TRUSTED for number in range(6)]
    assert pipeline.counters["strayed"] == 1


@cache
def trusted_state() -> dict[str, Any]:
    pipeline = Pipeline(craft())
    handle_all(pipeline, messages(BEGIN_S, 0))
    assert pipeline.trust.verdict is Verdict.TRUSTED
    return pipeline.export_state()


@pytest.fixture
def pipeline() -> Pipeline:
    """A craft that has been trusted for a while."""
    pipeline = Pipeline(craft())
    pipeline.restore_state(trusted_state())
    return pipeline


def samples_changed(end_s: int, change: Callable[[MagnetometerSample, int], MagnetometerSample]) -> list[Message]:
    return [
        change(message, i // 2) if isinstance(message, MagnetometerSample) else message
        for i, message in enumerate(messages(end_s))
    ]


def with_axis(sample: MagnetometerSample, axis: int, value: float) -> MagnetometerSample:
    field = list(sample.field_body_nt)
    field[axis] = value
    return replace(sample, field_body_nt=(field[0], field[1], field[2]))


def no_reference(pipeline: Pipeline) -> list[Message]:
    return handle_all(pipeline, [m for m in messages(BEGIN_S + 80) if isinstance(m, MagnetometerSample)])


def no_position(pipeline: Pipeline) -> list[Message]:
    """References come, which a craft that computes its own does not use."""
    pipeline.config = replace(pipeline.config, reference=ReferenceConfig(ReferenceModel.IGRF))
    return handle_all(pipeline, messages(BEGIN_S + 80))


def no_magnetometer(pipeline: Pipeline) -> list[Message]:
    assert troubles(pipeline, 61.0) == ["no sample for 61 s"]
    return handle_all(pipeline, messages(BEGIN_S + 310, BEGIN_S + 300))


def saturated_axis(pipeline: Pipeline) -> list[Message]:
    return handle_all(
        pipeline, samples_changed(BEGIN_S + 20, lambda m, i: with_axis(m, 0, 80_000.0) if i % 8 < 2 else m)
    )


def stuck_sensor(pipeline: Pipeline) -> list[Message]:
    return handle_all(pipeline, samples_changed(BEGIN_S + 40, lambda m, i: replace(m, field_body_nt=(1e4, 2e4, 3e4))))


def stuck_axis(pipeline: Pipeline) -> list[Message]:
    return handle_all(pipeline, samples_changed(BEGIN_S + 40, lambda m, i: with_axis(m, 2, 12_345.0)))


def dead_axis(pipeline: Pipeline) -> list[Message]:
    return handle_all(pipeline, samples_changed(BEGIN_S + 40, lambda m, i: with_axis(m, 1, 0.0)))


def reference_jumps(pipeline: Pipeline) -> list[Message]:
    jumping = [
        replace(m, time_ns=m.time_ns + 2000 * SECOND_NS) if isinstance(m, ReferenceSample) and i % 8 == 0 else m
        for i, m in enumerate(messages(BEGIN_S + 60))
    ]
    return handle_all(pipeline, jumping)


def reference_wrong(pipeline: Pipeline) -> list[Message]:
    def stronger(m: Message) -> Message:
        if not isinstance(m, ReferenceSample) or m.field_nt is None:
            return m
        return replace(m, field_nt=tuple(1.3 * value for value in m.field_nt))

    return handle_all(pipeline, [stronger(m) for m in messages(BEGIN_S + 25)])


def time_steps(pipeline: Pipeline) -> list[Message]:
    return handle_all(pipeline, [replace(m, time_ns=m.time_ns - 7200 * SECOND_NS) for m in messages(BEGIN_S + 30)])


def outliers(pipeline: Pipeline) -> list[Message]:
    rng = np.random.default_rng(7)
    hit = rng.random(300) < 0.1

    def corrupted(m: MagnetometerSample, i: int) -> MagnetometerSample:
        return with_axis(m, i % 3, -m.field_body_nt[i % 3] + 15_000.0) if hit[i] else m

    return handle_all(pipeline, samples_changed(BEGIN_S + 300, corrupted))


def estimator_failed(pipeline: Pipeline) -> list[Message]:
    def fail(_: object) -> None:
        raise np.linalg.LinAlgError("not positive definite")

    pipeline.estimator.handle = fail  # type: ignore[method-assign, assignment]
    return handle_all(pipeline, messages(BEGIN_S + 3))


def ask(pipeline: Pipeline, name: str) -> None:
    pipeline.handle(Command(craft="paper", source="ops", sequence=0, time_ns=0, name=name))


def frozen(pipeline: Pipeline) -> list[Message]:
    ask(pipeline, "freeze")
    return handle_all(pipeline, messages(BEGIN_S + 60))


def stale(pipeline: Pipeline) -> list[Message]:
    ask(pipeline, "freeze")
    return handle_all(pipeline, messages(BEGIN_S + 6150))


def model_doubtful(pipeline: Pipeline) -> list[Message]:
    """A coil nearby is driven for 6 s of every 60 s, and its command is on the link."""
    played: list[Message] = []
    for i, message in enumerate(messages(BEGIN_S + 1500)):
        driven = float(i // 2 % 60 < 6)
        if isinstance(message, MagnetometerSample):
            telemetry = {"source": "bus", "channel": "coil", "unit": "A m2", "values": (0.1 * driven,)}
            played.append(TelemetrySample(craft="paper", sequence=i, time_ns=message.time_ns, **telemetry))
            x, y, z = message.field_body_nt
            message = replace(message, field_body_nt=(x + 450.0 * driven, y, z - 300.0 * driven))
        played.append(message)
    return handle_all(pipeline, played)


def axes_changed(pipeline: Pipeline) -> list[Message]:
    def swapped(sample: MagnetometerSample, _: int) -> MagnetometerSample:
        x, y, z = sample.field_body_nt
        return replace(sample, field_body_nt=(y, x, z))

    return handle_all(pipeline, samples_changed(BEGIN_S + 60, swapped))


def spin_changed(pipeline: Pipeline) -> list[Message]:
    """The same flight, from 100 s later on with the spin reversed."""
    scenario = load_scenario("paper")
    turned = replace(scenario, spin=replace(scenario.spin, rate_rad_s=-scenario.spin.rate_rad_s))
    stream = list(Simulation(turned, 11, BEGIN_S + 500.0).messages())
    return handle_all(pipeline, stream[2 * (BEGIN_S + 100) :])


def gyro_disagrees(pipeline: Pipeline) -> list[Message]:
    """A gyro is switched on that has the spin's sense wrong."""
    played: list[Message] = []
    for i, message in enumerate(messages(BEGIN_S + 400)):
        rate = {"source": "bus", "channel": "gyro", "unit": "deg/s", "values": (0.0, 0.0, -45.0)}
        played.append(TelemetrySample(craft="paper", sequence=i, time_ns=message.time_ns, clock=message.clock, **rate))
        played.append(message)
    return handle_all(pipeline, played)


def reference_held(pipeline: Pipeline) -> list[Message]:
    first = next(m for m in messages(BEGIN_S + 1) if isinstance(m, ReferenceSample))

    def held(m: Message) -> Message:
        return replace(m, field_nt=first.field_nt) if isinstance(m, ReferenceSample) else m

    return handle_all(pipeline, [held(m) for m in messages(BEGIN_S + 60)])


def held_readings(pipeline: Pipeline) -> list[Message]:
    """Three samples of each reading."""
    readings = [m.field_body_nt for m in messages(BEGIN_S + 300) if isinstance(m, MagnetometerSample)]
    return handle_all(
        pipeline, samples_changed(BEGIN_S + 300, lambda m, i: replace(m, field_body_nt=readings[i - i % 3]))
    )


PLAYS = {
    Mode.NO_REFERENCE: no_reference,
    Mode.NO_POSITION: no_position,
    Mode.NO_MAGNETOMETER: no_magnetometer,
    Mode.SATURATED_AXIS: saturated_axis,
    Mode.STUCK_SENSOR: stuck_sensor,
    Mode.STUCK_AXIS: stuck_axis,
    Mode.DEAD_AXIS: dead_axis,
    Mode.REFERENCE_JUMPS: reference_jumps,
    Mode.REFERENCE_WRONG: reference_wrong,
    Mode.TIME_STEPS: time_steps,
    Mode.OUTLIERS: outliers,
    Mode.ESTIMATOR_FAILED: estimator_failed,
    Mode.FROZEN: frozen,
    Mode.STALE: stale,
    Mode.MODEL_DOUBTFUL: model_doubtful,
    Mode.AXES_CHANGED: axes_changed,
    Mode.SPIN_CHANGED: spin_changed,
    Mode.GYRO_DISAGREES: gyro_disagrees,
    Mode.REFERENCE_HELD: reference_held,
    Mode.HELD_READINGS: held_readings,
}
OF_THE_SERVICE = (Mode.UNKNOWN_CRAFT, Mode.OVERLOAD)
ELSEWHERE = {
    Mode.COMMANDS_LIMITED: "daemon/test_command_limit.py",
    Mode.SOURCE_REFUSED: "daemon/test_magnetometers.py",
    Mode.LOCAL_DISTURBANCE: "daemon/test_magnetometers.py",
    Mode.UNPROTECTED: "trust/test_protection.py",
    Mode.POSITIONS_WRONG: "daemon/test_own_reference.py",
    Mode.DRIVER_MISSING: "physics/test_compensation.py",
    Mode.COMPENSATION_STOPPED: "daemon/test_pipeline_harm.py",
}
TESTS = Path(__file__).resolve().parents[1]


def test_every_mode_is_played() -> None:
    assert set(PLAYS) | set(OF_THE_SERVICE) | set(ELSEWHERE) == set(Mode) == set(MODES)
    for mode, file in ELSEWHERE.items():
        assert f"MODES[Mode.{mode.name}]" in (TESTS / file).read_text(encoding="utf-8")


@pytest.mark.parametrize("mode", PLAYS)
def test_the_verdict_and_its_reason_are_those_of_the_table(pipeline: Pipeline, mode: Mode) -> None:
    PLAYS[mode](pipeline)
    row = MODES[mode]
    assert pipeline.trust.verdict is row.verdict
    assert row.reason is None or row.reason in pipeline.trust.reasons


@pytest.mark.parametrize("mode", [mode for mode in PLAYS if MODES[mode].counter not in ("", "troubles")])
def test_it_is_counted_under_the_name_of_the_table(pipeline: Pipeline, mode: Mode) -> None:
    before = pipeline.ticks.counters + pipeline.counters
    PLAYS[mode](pipeline)
    counter = MODES[mode].counter
    assert (pipeline.ticks.counters + pipeline.counters)[counter] > before[counter]


@pytest.mark.parametrize("mode", [mode for mode in PLAYS if mode is not Mode.SPIN_CHANGED])  # it has another truth
def test_no_vector_that_is_trusted_is_worse_than_it_says(pipeline: Pipeline, mode: Mode) -> None:
    """Errors of trusted vectors in units of their own covariance: 16 samples at most are beyond 5 sigma.

    Those are what no one can know at once: the samples until a stuck axis, a wrong reference or a change of axes shows,
    and the corrupted samples themselves.
    """
    truth_nt = paper(11, BEGIN_S + 6200).arrays().ambient_body_nt
    upper = np.triu_indices(3)
    bad = 0
    for vector in PLAYS[mode](pipeline):
        if not isinstance(vector, CalibratedVector) or vector.verdict is not Verdict.TRUSTED:
            continue
        covariance = np.zeros((3, 3))
        covariance[upper] = vector.covariance_nt2
        covariance += np.triu(covariance, 1).T
        error = np.array(vector.field_body_nt) - truth_nt[vector.sequence]
        bad += float(error @ np.linalg.solve(covariance, error)) > 25.0 + 3.0
    allowed = {Mode.STUCK_AXIS: 12, Mode.DEAD_AXIS: 12, Mode.STUCK_SENSOR: 12, Mode.AXES_CHANGED: 16, Mode.OUTLIERS: 45}
    assert bad <= allowed.get(mode, 0)


@pytest.mark.parametrize("mode", [Mode.SATURATED_AXIS, Mode.STUCK_SENSOR, Mode.STUCK_AXIS, Mode.DEAD_AXIS])
def test_samples_of_a_faulty_sensor_are_not_answered_and_not_learned_from(pipeline: Pipeline, mode: Mode) -> None:
    published = PLAYS[mode](pipeline)
    vectors = [m for m in published if isinstance(m, CalibratedVector)]
    refused = pipeline.ticks.counters[MODES[mode].counter]
    assert refused >= 5
    assert len(vectors) == (20 if mode is Mode.SATURATED_AXIS else 40) - refused


@pytest.mark.parametrize("mode", [Mode.NO_REFERENCE, Mode.FROZEN, Mode.STALE, Mode.NO_MAGNETOMETER])
def test_what_is_not_learned_from_makes_the_covariance_grow(pipeline: Pipeline, mode: Mode) -> None:
    """By the process noise, 1 nT/sqrt(s) here: the variance of a bias by at least half the seconds that have passed."""
    before_nt2 = pipeline.estimator.estimate().covariance[2, 2]
    published = PLAYS[mode](pipeline)
    first = next(m for m in published if isinstance(m, CalibratedVector)).time_ns
    last = [m for m in published if isinstance(m, Estimate | CalibratedVector)]
    if mode is Mode.NO_MAGNETOMETER:
        grown_nt2 = next(m for m in published if isinstance(m, CalibratedVector)).covariance_nt2[5] - 300.0**2
        assert grown_nt2 > 0.5 * 300 * WALK_NT**2
        return
    estimate = next(m for m in reversed(last) if isinstance(m, Estimate))
    seconds = (estimate.time_ns - first) / SECOND_NS
    assert estimate.covariance[17] - before_nt2 > 0.5 * seconds * WALK_NT**2


@pytest.mark.parametrize(
    "mode",
    [
        Mode.NO_REFERENCE,
        Mode.SATURATED_AXIS,
        Mode.STUCK_SENSOR,
        Mode.STUCK_AXIS,
        Mode.DEAD_AXIS,
        Mode.FROZEN,
        Mode.STALE,
    ],
)
def test_it_is_over_when_its_cause_is(pipeline: Pipeline, mode: Mode) -> None:
    """Trusted again, without the reason, after 100 s of sound samples."""
    PLAYS[mode](pipeline)
    ask(pipeline, "resume")
    newest_s = round(pipeline.ticks.newest_s)
    handle_all(pipeline, messages(newest_s + 100, newest_s + 1))
    assert (pipeline.trust.verdict, pipeline.trust.reasons) == (Verdict.TRUSTED, ())


@pytest.mark.parametrize("mode", OF_THE_SERVICE)
def test_strangers_and_floods_leave_a_craft_as_it_is(pipeline: Pipeline, mode: Mode) -> None:
    row = MODES[mode]
    with (
        open_link(f"loop:{mode}?queue=64", Role.SERVICE) as end,
        open_link(f"loop:{mode}", Role.NODE) as node,
    ):
        service = Service(Config(crafts=(craft(),)), end)
        service.pipelines["paper"] = pipeline
        for message in messages(BEGIN_S + 60):
            strange = mode is Mode.UNKNOWN_CRAFT
            for _ in range(1 if strange else 200):
                node.send(replace(message, craft="other") if strange else message)
            for received in end.receive(0.0):
                service.handle(received)
        service.publish_status()
        status = [m for m in node.receive(1.0) if isinstance(m, Status)][-1]
    counted = status.counters.get(row.counter, 0) + status.counters.get(f"link.{row.counter}", 0)
    assert counted >= 100
    assert (status.verdict, Reason.STALE in pipeline.trust.reasons) == (row.verdict, False)


def test_the_page_is_written_from_the_table() -> None:
    page = TESTS.parent / "docs/degraded-modes.md"
    assert page.read_text(encoding="utf-8") == markdown(), "write it: python -m magcal_service.trust.modes"
