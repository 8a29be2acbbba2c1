"""A craft that sends positions and no field has its reference from IGRF-14, and is calibrated as with one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magcal_service.config.reader import load_config
from magcal_service.config.settings import CraftConfig, ReferenceConfig, ReferenceModel, SensorConfig, SpinConfig
from magcal_service.daemon.own_reference import reference_at
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.daemon.service import Service
from magcal_service.earth.geomagnetic import ecef_from_eci
from magcal_service.links import Role, open_link
from magcal_service.trust.modes import MODES, Mode
from magcal_service.trust.reasons import Reason
from magcal_service.wire.messages import (
    Clock,
    Command,
    Estimate,
    Frame,
    MagnetometerSample,
    Message,
    PositionSample,
    ReferenceSample,
    Status,
    Verdict,
)
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.daemon.pipeline_streams import EARLY
from tests.main_field import igrf_ned_nt

CRAFT = CraftConfig(
    "paper", SensorConfig(noise_nt=300.0), SpinConfig(rate_rpm=7.5), reference=ReferenceConfig(ReferenceModel.IGRF)
)
AT = PositionSample(
    craft="a", source="gps", sequence=3, time_ns=1_750_000_000_000_000_000, clock=Clock.UTC,
    position_km=(6900.0, 0.0, 0.0), frame=Frame.ECI,
)  # fmt: skip


def test_a_craft_is_calibrated_by_positions_alone() -> None:
    """As with references, of which it has every fifth, for a position comes every 5 s."""
    simulation = Simulation(load_scenario("paper"), 12, 2400.0)
    told, own = Pipeline(replace(CRAFT, reference=ReferenceConfig())), Pipeline(CRAFT)
    last: dict[Pipeline, Estimate] = {}

    def give(pipeline: Pipeline, message: Message) -> None:
        for out in pipeline.handle(message):
            if isinstance(out, Estimate):
                last[pipeline] = out

    for message in simulation.messages():
        if isinstance(message, MagnetometerSample):
            give(told, message)
            give(own, message)
        elif isinstance(message, ReferenceSample):
            give(told, message)
            if message.sequence % 5 == 0:
                (place,) = simulation.truth.orbit.position_eci_km(np.array([message.time_ns])).tolist()
                give(own, replace(AT, craft="paper", time_ns=message.time_ns, position_km=tuple(place)))
    assert last[own].verdict in (Verdict.CONVERGING, Verdict.TRUSTED)
    assert last[own].samples_used > 2300
    np.testing.assert_allclose(last[own].bias_nt, last[told].bias_nt, rtol=0.0, atol=10.0)
    assert last[own].residual_rms_nt < 1.01 * last[told].residual_rms_nt
    assert own.counters["position"] == 480


def test_the_field_is_that_of_the_model_in_either_frame() -> None:
    time_ns = np.array([AT.time_ns])
    inertial = reference_at(AT)
    fixed = ecef_from_eci(time_ns, np.array([AT.position_km]))[0]
    turned = reference_at(replace(AT, position_km=tuple(fixed.tolist()), frame=Frame.ECEF))
    assert isinstance(inertial, ReferenceSample)
    assert isinstance(turned, ReferenceSample)
    assert (inertial.frame, inertial.time_ns, inertial.sequence) == (Frame.ECI, AT.time_ns, 3)
    np.testing.assert_allclose(inertial.field_nt, turned.field_nt, rtol=0.0, atol=1e-6)
    longitude = np.degrees(np.arctan2(fixed[1], fixed[0]))
    north, east, down = igrf_ned_nt(time_ns, np.zeros(1), np.array([longitude]), np.array([6900.0 - 6378.137]))[0]
    np.testing.assert_allclose(np.linalg.norm(inertial.field_nt), np.linalg.norm([north, east, down]), atol=0.01)


@pytest.mark.parametrize(
    ("wrong", "counted"),
    [
        (replace(AT, clock=Clock.ELAPSED), "position_without_utc"),
        (replace(AT, position_km=(6.9, 0.0, 0.0)), "position_out_of_range"),
        (replace(AT, time_ns=1_900_000_000_000_000_000), "position_out_of_range"),
        (ReferenceSample(craft="a", source="m", sequence=0, time_ns=AT.time_ns, clock=Clock.UTC, magnitude_nt=4e4),
         "reference_not_used"),
    ],
)  # fmt: skip
def test_what_gives_no_field_is_counted_by_its_reason(wrong: Message, counted: str) -> None:
    pipeline = Pipeline(CRAFT)
    pipeline.handle(AT)
    pipeline.handle(wrong)
    assert pipeline.counters[counted] == 1
    assert pipeline.ticks.references.newest(Clock.UTC)[0] == AT.time_ns  # type: ignore[index]


def placed(first_s: int, end_s: int, *, positions: bool) -> Iterator[Message]:
    """The paper's flight at 1 Hz, a position before each sample or none; no field."""
    simulation = Simulation(load_scenario("paper"), 12, 1200.0)
    samples = [message for message in simulation.messages() if isinstance(message, MagnetometerSample)]
    for sample in samples[first_s:end_s]:
        if positions:
            (place,) = simulation.truth.orbit.position_eci_km(np.array([sample.time_ns])).tolist()
            common = {"craft": "paper", "sequence": sample.sequence, "time_ns": sample.time_ns}
            yield replace(AT, position_km=tuple(place), **common)
        yield sample


def test_heights_in_miles_are_doubted_before_they_can_be_trusted() -> None:
    """And a position in kilometres is not; in either frame."""
    simulation = Simulation(load_scenario("paper"), 12, 500.0)
    for factor, doubted in ((1.0, False), (1.609344, True)):
        pipeline = Pipeline(CRAFT)
        for number in range(0, 500, 5):
            time_ns = AT.time_ns + number * 1_000_000_000
            place = simulation.truth.orbit.position_eci_km(np.array([time_ns]))
            radius = float(np.linalg.norm(place))
            place *= 1.0 + (factor - 1.0) * (radius - 6371.0) / radius
            frame = Frame.ECI if number % 2 else Frame.ECEF
            place = place if frame is Frame.ECI else ecef_from_eci(np.array([time_ns]), place)
            pipeline.handle(
                replace(AT, craft="paper", time_ns=time_ns, position_km=tuple(place[0].tolist()), frame=frame)
            )
        assert bool(pipeline.monitor.senses.height.said) is doubted


def test_a_trusted_craft_whose_positions_go_wrong_is_doubted_until_they_are_right_and_it_is_reset() -> None:
    """Heights in miles for 500 s, then right ones: as the table of degraded modes says."""
    simulation = Simulation(load_scenario("paper"), 12, 3000.0)
    samples = [message for message in simulation.messages() if isinstance(message, MagnetometerSample)]
    pipeline = Pipeline(replace(CRAFT, trust=EARLY))

    def fly(first_s: int, end_s: int, factor: float = 1.0) -> None:
        for number in range(first_s, end_s):
            time_ns = samples[number].time_ns
            if number % 5 == 0:
                place = simulation.truth.orbit.position_eci_km(np.array([time_ns]))[0]
                radius = float(np.linalg.norm(place))
                place *= 1.0 + (factor - 1.0) * (radius - 6371.0) / radius
                pipeline.handle(replace(AT, craft="paper", time_ns=time_ns, position_km=tuple(place.tolist())))
            pipeline.handle(samples[number])

    row = MODES[Mode.POSITIONS_WRONG]
    fly(0, 1000)
    assert pipeline.trust.verdict is Verdict.TRUSTED
    fly(1000, 1500, 1.609344)
    assert (pipeline.trust.verdict, pipeline.trust.reasons[0]) == (row.verdict, row.reason)
    fly(1500, 1680)
    assert row.reason not in pipeline.trust.reasons
    pipeline.handle(Command(craft="paper", source="ops", sequence=0, time_ns=0, name="reset"))
    fly(1680, 3000)
    assert (pipeline.trust.verdict, pipeline.trust.reasons) == (Verdict.TRUSTED, ())


def test_a_daemon_without_positions_recovers_when_they_come(tmp_path: Path) -> None:
    """None for 100 s, then one a second: it is trusted.  None for 90 s: as the page says.  They come again: trusted."""
    path = tmp_path / "magcal.toml"
    path.write_text(
        """
        version = 1
        [[craft]]
        name = "paper"
        [craft.sensor]
        noise_nt = 300.0
        [craft.spin]
        rate_rpm = 7.5
        [craft.reference]
        model = "igrf"
        [craft.trust]
        protection_nt = 100000.0  # trusted soon after its start
        sigma_bias_nt = 1000.0
        sigma_D = 0.05
        """
    )
    with open_link("loop:places", Role.SERVICE) as end, open_link("loop:places", Role.NODE) as node:
        service = Service(load_config(path), end)

        def flown(first_s: int, end_s: int, *, positions: bool) -> tuple[Verdict, tuple[str, ...], int, Counter[str]]:
            """The verdict in the status then, the reasons behind it, the ticks, and what it counts."""
            for message in placed(first_s, end_s, positions=positions):
                service.handle(message)
            service.publish_status()
            status = [message for message in node.receive(1.0) if isinstance(message, Status)][-1]
            counted = Counter(status.counters)
            return status.verdict, service.pipelines["paper"].trust.reasons, counted["ticks"], counted

        verdict, reasons, ticks, _ = flown(0, 100, positions=False)
        assert (verdict, ticks) == (Verdict.NOT_STARTED, 0)
        assert Reason.NO_REFERENCE in reasons
        verdict, reasons, _, before = flown(100, 1000, positions=True)
        assert (verdict, reasons) == (Verdict.TRUSTED, ())
        row = MODES[Mode.NO_POSITION]
        verdict, reasons, _, after = flown(1000, 1090, positions=False)
        assert (verdict, row.reason in reasons) == (row.verdict, True)
        assert after[row.counter] > before[row.counter]
        verdict, reasons, ticks, _ = flown(1090, 1200, positions=True)
        assert (verdict, reasons) == (Verdict.TRUSTED, ())
        assert ticks > 1000
