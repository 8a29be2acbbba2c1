"""A whole run: equation (1) end to end, seeds, streams, and what is sent."""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magcal_service.wire.codec import encode
from magcal_service.wire.messages import (
    Clock,
    Frame,
    MagnetometerSample,
    PositionSample,
    ReferenceSample,
    TelemetrySample,
)
from sim_sensor import simulation as module
from sim_sensor.attitude import Spin
from sim_sensor.disturbances import Panel, Step, Thermal, Torquer
from sim_sensor.faults import FaultKind, LinkFault
from sim_sensor.field import FieldModel
from sim_sensor.scenario import Channel, PositionPlan, ReferenceForm, ReferencePlan, Scenario, TelemetryPlan
from sim_sensor.scenario_reader import load_scenario, shipped_scenarios
from sim_sensor.sensor import Effects, symmetric
from sim_sensor.simulation import Simulation
from sim_sensor.streams import Stream, generator
from sim_sensor.sunlight import lit_fraction

PAPER = load_scenario("paper")
THERMAL = Thermal(40.0, -10.0, 600.0, 10.0, 20.0, (5.0, 0.0, 0.0))
PANEL = Panel((1.0, 0.0, 0.0), 0.5, (100.0, 0.0, 0.0))
TORQUER = Torquer((0.1, 0.0, 0.0), 60.0, 6.0, (1e4, 0, 0, 0, 1e4, 0, 0, 0, 1e4))
FULL = replace(
    PAPER,
    effects=Effects(thermal=THERMAL, panels=(PANEL, PANEL), torquer=TORQUER),
    telemetry=TelemetryPlan(tuple(Channel), 0.5, (0.1,) * 5),
    position=PositionPlan(0.2, 0.01),
)


def run(scenario: Scenario = PAPER, seed: int = 1, duration_s: float = 600.0) -> Simulation:
    return Simulation(scenario, seed, duration_s)


def digest(simulation: Simulation) -> str:
    return hashlib.sha256(b"".join(encode(message) for message in simulation.messages())).hexdigest()


def magnetometer(simulation: Simulation) -> list[MagnetometerSample]:
    return [message for message in simulation.messages() if isinstance(message, MagnetometerSample)]


@pytest.mark.parametrize("name", shipped_scenarios())
def test_the_same_seed_gives_the_same_bytes(name: str) -> None:
    scenario = load_scenario(name)
    first = digest(run(scenario, duration_s=120.0))
    assert first == digest(run(scenario, duration_s=120.0))
    assert first != digest(run(scenario, seed=2, duration_s=120.0))


def test_one_simulation_can_be_run_twice() -> None:
    simulation = run(FULL)
    assert digest(simulation) == digest(simulation)


def test_how_a_run_is_cut_into_blocks_changes_no_number(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = replace(FULL, sensor=replace(PAPER.sensor, lag_s=0.2))
    whole = run(scenario).arrays()
    monkeypatch.setattr(module, "_BLOCK", 77)
    pieces = run(scenario).arrays()
    np.testing.assert_allclose(pieces.measured_nt, whole.measured_nt, rtol=0.0, atol=1e-7)
    np.testing.assert_array_equal(pieces.times_ns, whole.times_ns)


def test_a_shorter_run_is_the_beginning_of_a_longer_one() -> None:
    longer, shorter = magnetometer(run(FULL, duration_s=600.0)), magnetometer(run(FULL, duration_s=300.0))
    assert shorter == longer[: len(shorter)]
    assert len(shorter) == 300


def test_equation_1_holds_end_to_end_with_the_noise_of_the_scenario() -> None:
    block = Simulation(PAPER).arrays()
    D = symmetric(PAPER.sensor.D)
    np.testing.assert_allclose(
        np.einsum("nij,nj->ni", block.body_from_eci, block.true_eci_nt), block.ambient_body_nt, rtol=0.0, atol=1e-8
    )
    eps = block.measured_nt @ (np.eye(3) + D) - np.array(PAPER.sensor.bias_nt) - block.ambient_body_nt
    assert np.abs(eps.mean(axis=0)).max() < 4.0 * 300.0 / np.sqrt(18000)
    np.testing.assert_allclose(eps.std(axis=0), 300.0, rtol=4.0 / np.sqrt(2 * 18000))
    covariance = np.corrcoef(np.hstack([eps[1:], eps[:-1]]).T)
    assert np.abs(covariance - np.eye(6)).max() < 4.5 / np.sqrt(18000)


def test_noise_is_normal() -> None:
    block = Simulation(replace(PAPER, sensor=replace(PAPER.sensor, bias_nt=(0.0,) * 3, D=(0.0,) * 6))).arrays()
    eps = (block.measured_nt - block.ambient_body_nt) / 300.0
    assert np.mean(eps**4) == pytest.approx(3.0, abs=4.0 * np.sqrt(96.0 / eps.size))
    assert np.mean(np.abs(eps) > 3.0) == pytest.approx(0.0027, abs=4.0 * np.sqrt(0.0027 / eps.size))


@pytest.mark.parametrize(
    "changed",
    [
        replace(PAPER, effects=Effects(thermal=replace(THERMAL, bias_nt_per_k=(0.0,) * 3))),
        replace(PAPER, effects=Effects(steps=(Step(100.0),))),
        replace(PAPER, telemetry=TelemetryPlan((Channel.GYRO, Channel.SUN), 1.0, (1.0, 1.0))),
        replace(PAPER, position=PositionPlan(1.0, 0.5)),
        replace(PAPER, reference=ReferencePlan(noise_nt=50.0)),
        replace(PAPER, field=FieldModel(reference_time_offset_s=2.0)),
        replace(PAPER, faults=(LinkFault(FaultKind.CORRUPTION, probability=0.0),)),
    ],
    ids=["thermal", "step", "telemetry", "position", "reference-noise", "reference-offset", "fault"],
)
def test_switching_something_else_on_leaves_the_sensors_numbers(changed: Scenario) -> None:
    assert magnetometer(run(changed)) == magnetometer(run())


def test_no_two_streams_draw_the_same_numbers() -> None:
    first = [generator(1, stream).standard_normal() for stream in Stream]
    assert len(set(first)) == len(Stream)


def test_the_order_of_the_streams_is_part_of_the_format() -> None:
    """Inserting a stream would change every recording made before; a new one goes to the end."""
    names = ["PARAMETERS", "MAGNETOMETER", "TEMPERATURE", "CURRENT", "SUN", "GYRO", "REFERENCE", "POSITION"]
    assert [stream.name for stream in Stream][:10] == [*names, "TORQUER", "FAULTS"]


def test_messages_come_in_order_of_source_time_with_the_reference_first() -> None:
    messages = list(run(FULL).messages())
    assert [m.time_ns for m in messages] == sorted(m.time_ns for m in messages)
    assert isinstance(messages[0], ReferenceSample)
    assert isinstance(messages[7], MagnetometerSample)


def test_every_source_counts_its_own_messages() -> None:
    sequences: dict[str, list[int]] = {}
    for message in run(FULL).messages():
        sequences.setdefault(message.source, []).append(message.sequence)
    assert set(sequences) == {"mag", "ref", "gps", "temperature", "current", "torquer", "sun", "gyro"}
    assert all(numbers == list(range(len(numbers))) for numbers in sequences.values())


def test_rates_are_those_of_the_scenario() -> None:
    scenario = replace(FULL, sensor=replace(PAPER.sensor, rate_hz=10.0), reference=ReferencePlan(rate_hz=0.2))
    counts = Counter(type(message) for message in run(scenario, duration_s=100.0).messages())
    expected = {MagnetometerSample: 1000, ReferenceSample: 20, PositionSample: 20, TelemetrySample: 250}
    assert counts == expected


def test_an_uneven_rate_does_not_drift() -> None:
    scenario = replace(PAPER, sensor=replace(PAPER.sensor, rate_hz=3.0))
    times = [message.time_ns - PAPER.start_ns for message in magnetometer(run(scenario, duration_s=601.0))]
    assert times[:4] == [0, 333333333, 666666667, 10**9]
    assert times[1800] == 600 * 10**9


def test_the_reference_may_start_between_samples() -> None:
    references = [
        m for m in run(replace(PAPER, reference=ReferencePlan(offset_s=0.25))).messages() if m.source == "ref"
    ]
    assert references[0].time_ns == PAPER.start_ns + 250_000_000


def test_the_reference_is_the_true_field_in_eci() -> None:
    simulation = run()
    references = [message for message in simulation.messages() if isinstance(message, ReferenceSample)]
    np.testing.assert_array_equal([m.field_nt for m in references], simulation.arrays().true_eci_nt)
    assert {m.frame for m in references} == {Frame.ECI}
    assert {m.clock for m in references} == {Clock.UTC}


def test_a_magnitude_is_the_length_of_the_vector() -> None:
    scalar = replace(PAPER, reference=ReferencePlan(form=ReferenceForm.MAGNITUDE))
    got = [m.magnitude_nt for m in run(scalar).messages() if isinstance(m, ReferenceSample)]
    expected = np.linalg.norm(run().arrays().true_eci_nt, axis=1)
    np.testing.assert_allclose(got, expected, rtol=1e-14)


def test_a_node_without_reference_sends_none() -> None:
    silent = replace(PAPER, reference=ReferencePlan(form=ReferenceForm.NONE))
    assert not any(isinstance(message, ReferenceSample) for message in run(silent).messages())


def test_reference_noise_has_its_sigma_and_its_own_seed() -> None:
    noisy = replace(PAPER, reference=ReferencePlan(noise_nt=50.0))
    first, second = (
        np.concatenate([field for _, field in run(noisy, seed).references()]) - run().arrays().true_eci_nt
        for seed in (1, 2)
    )
    np.testing.assert_allclose(first.std(axis=0), 50.0, rtol=0.12)
    assert np.abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.1


def test_position_noise_has_its_sigma_and_its_own_seed() -> None:
    noisy = replace(PAPER, position=PositionPlan(1.0, 0.5))
    first, second = (
        run(noisy, seed).positions()[1] - PAPER.orbit.position_eci_km(run().arrays().times_ns) for seed in (1, 2)
    )
    np.testing.assert_allclose(first.std(axis=0), 0.5, rtol=0.12)
    assert np.abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.1


def test_the_true_errors_of_a_block_follow_a_step() -> None:
    block = run(replace(PAPER, effects=Effects(steps=(Step(300.0, (10.0, 0.0, 0.0)),)))).arrays()
    np.testing.assert_array_equal(block.bias_nt[:, 0], np.where(np.arange(600) < 300, 5000.0, 5010.0))


def channel(simulation: Simulation, name: Channel) -> np.ndarray:
    return np.array([m.values for m in simulation.messages() if isinstance(m, TelemetrySample) and m.channel == name])


def test_telemetry_tells_what_disturbs() -> None:
    """The channel, times its coefficient, is the disturbance itself; here for the panels' current."""
    quiet = replace(PAPER, sensor=replace(PAPER.sensor, noise_nt=(0.0,) * 3, bias_nt=(0.0,) * 3, D=(0.0,) * 6))
    told = replace(quiet, effects=Effects(panels=(PANEL,)), telemetry=TelemetryPlan((Channel.CURRENT,), 1.0, (0.0,)))
    added = run(told).arrays().measured_nt - run(quiet).arrays().measured_nt
    np.testing.assert_allclose(added, channel(run(told), Channel.CURRENT) * [[100.0, 0.0, 0.0]], rtol=0.0, atol=1e-8)
    assert added.max() > 10.0


def test_the_gyro_tells_the_spin() -> None:
    told = replace(PAPER, telemetry=TelemetryPlan((Channel.GYRO,), 1.0, (0.001,)))
    rates = channel(run(told), Channel.GYRO)
    np.testing.assert_allclose(rates.mean(axis=0), [0.0, 0.0, PAPER.spin.rate_rad_s], rtol=0.0, atol=2e-4)
    np.testing.assert_allclose(rates.std(axis=0), 0.001, rtol=0.15)


def test_the_sun_is_a_unit_vector_in_light_and_zero_in_shadow() -> None:
    told = replace(PAPER, telemetry=TelemetryPlan((Channel.SUN,), 0.1, (0.0,)))
    lengths = np.linalg.norm(channel(run(told, duration_s=6000.0), Channel.SUN), axis=1)
    assert set(np.round(lengths, 9)) == {0.0, 1.0}


def test_lag_turns_the_measured_field_back_by_its_angle() -> None:
    """Across the axis the gain is 1 / sqrt(1 + (w tau)^2); along it, 1; H itself moves 45 nT in the lag."""
    spin = Spin((0.0, 0.0, 1.0), (0.0, 0.0, 1.0), 0.785)
    ideal = replace(PAPER.sensor, noise_nt=(0.0,) * 3, bias_nt=(0.0,) * 3, D=(0.0,) * 6, lag_s=0.5)
    block = run(replace(PAPER, spin=spin, sensor=ideal)).arrays()
    got = block.measured_nt[:, 0] + 1j * block.measured_nt[:, 1]
    ambient = block.ambient_body_nt[:, 0] + 1j * block.ambient_body_nt[:, 1]
    np.testing.assert_allclose(got, ambient / (1.0 - 0.785j * 0.5), rtol=0.0, atol=60.0)
    assert np.abs(got - ambient).max() > 5000.0
    assert np.abs(block.measured_nt[:, 2] - block.ambient_body_nt[:, 2]).max() < 60.0


def test_scenarios_are_plain_files_in_the_package() -> None:
    assert all(path.parent == Path(module.__file__).parent / "scenarios" for path in shipped_scenarios().values())


def test_light_on_its_grid_is_that_of_the_orbit_to_a_step_of_5_s() -> None:
    run = Simulation(PAPER, 1, 7200.0)
    elapsed_s = np.arange(0.0, 7200.0, 1.0)
    times = run.truth.start_ns + (elapsed_s * 1e9).astype(np.int64)
    exact = lit_fraction(times, run.truth.orbit.position_eci_km(times))
    assert 0.0 < exact.mean() < 1.0
    assert np.count_nonzero(np.abs(run.environment.lit(elapsed_s) - exact) > 0.5) == 0
