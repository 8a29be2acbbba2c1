"""A session as arrays: the same as the simulator's own recording of the same run, and an account of what differs."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import RecordingError
from magcal_service.offline.calibrate import calibrate
from magcal_service.offline.replay import craft_of
from magcal_service.recordings.json_form import schema_name, to_json
from magcal_service.recordings.mcap import RawMessage, Topic
from magcal_service.recordings.mcap_writer import McapWriter
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.report import RowFault
from magcal_service.recordings.session_files import LIBRARY
from magcal_service.wire.kinds import kind_of
from magcal_service.wire.messages import (
    Clock,
    Frame,
    MagnetometerSample,
    Message,
    PositionSample,
    ReferenceSample,
    TelemetrySample,
)
from sim_sensor.recorder import record_simulation
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.recordings.sessions import craft, record, stream

S = 1_000_000_000


@pytest.mark.parametrize("scenario", ["hot-electronics", "torquer-duty", "stale-reference"])
def test_the_arrays_are_those_of_the_simulators_own_recording(scenario: str, tmp_path: Path) -> None:
    (file,) = record(tmp_path / "rec", stream(300, scenario))
    session = read_recording(file)
    rows = read_recording(record_simulation(Simulation(load_scenario(scenario), 5, 300.0), tmp_path / "csv"))
    assert np.array_equal(session.time_ns, rows.time_ns)
    assert np.array_equal(session.field_body_nt, rows.field_body_nt)
    both = np.isfinite(session.reference.magnitude_nt) & np.isfinite(rows.reference.magnitude_nt)
    assert both.sum() > 250
    assert np.allclose(session.reference.magnitude_nt[both], rows.reference.magnitude_nt[both], rtol=1e-12)
    assert set(session.channels) == set(rows.channels)
    for name, channel in session.channels.items():
        finite = np.isfinite(channel.values) & np.isfinite(rows.channels[name].values)
        assert finite.all(axis=1).sum() > 200
        assert np.allclose(channel.values[finite], rows.channels[name].values[finite], rtol=1e-9)
        assert channel.spec.quantity == rows.channels[name].spec.quantity


def message(kind: type[Message], second: float, **own: object) -> Message:
    common = {"craft": "demo", "source": "test", "sequence": int(second), "time_ns": int(second * S)}
    return kind(**(common | own))  # type: ignore[arg-type]


def b(second: float, **own: object) -> Message:
    return message(MagnetometerSample, second, **({"field_body_nt": (second, 2.0, 3.0)} | own))


def h(second: float, magnitude: float = 30_000.0, **own: object) -> Message:
    return message(ReferenceSample, second, **({"magnitude_nt": magnitude} | own))


def telemetry(second: float, *values: float, unit: str = "degC", channel: str = "temperature") -> Message:
    return message(TelemetrySample, second, channel=channel, unit=unit, values=values)


def written(path: Path, messages: list[Message]) -> Path:
    file = io.BytesIO()
    writer = McapWriter(file, LIBRARY)
    for one in messages:
        kind = kind_of(one)
        writer.add(RawMessage(Topic(one.craft, kind.name, schema_name(kind), b"{}"), one.sequence, 1, 1, to_json(one)))
    writer.finish()
    path.write_bytes(file.getvalue())
    return path


def recording(tmp_path: Path, *messages: Message) -> Recording:
    return read_recording(written(tmp_path / "session.mcap", list(messages)))


def test_a_reference_between_samples_is_interpolated_and_not_beyond_them(tmp_path: Path) -> None:
    got = recording(tmp_path, h(0.0, 100.0), b(0.0), b(2.5), h(5.0, 200.0), b(5.0), b(6.0))
    assert got.reference.magnitude_nt[:3].tolist() == [100.0, 150.0, 200.0]
    assert np.isnan(got.reference.magnitude_nt[3])


def test_a_gap_of_the_reference_is_not_bridged(tmp_path: Path) -> None:
    got = recording(tmp_path, *(h(float(n)) for n in range(10)), b(9.0), b(20.0), h(40.0), b(40.0))
    assert np.isfinite(got.reference.magnitude_nt).tolist() == [True, False, True]


def test_a_vector_in_turning_axes_keeps_the_interpolated_magnitude(tmp_path: Path) -> None:
    ned = {"magnitude_nt": None, "frame": Frame.NED}
    got = recording(
        tmp_path, h(0.0, field_nt=(100.0, 0.0, 0.0), **ned), b(1.0), h(2.0, field_nt=(0.0, 100.0, 0.0), **ned)
    )
    assert got.reference.magnitude_nt.tolist() == [100.0]
    assert got.reference.frame is Frame.NED


def test_states_and_commands_are_held_and_quantities_interpolated(tmp_path: Path) -> None:
    told = [
        telemetry(t, v, unit=u, channel=c) for c, u in (("t", "degC"), ("m", "A m2")) for t, v in ((0, 0.0), (4, 1.0))
    ]
    got = recording(tmp_path, h(0.0), h(4.0), *told, b(2.0), b(5.0))
    assert got.channels["t"].values[:, 0].tolist()[0] == 0.5
    assert np.isnan(got.channels["t"].values[1, 0])
    assert got.channels["m"].values[:, 0].tolist() == [0.0, 1.0]


def test_what_has_another_form_than_most_is_counted_and_left_out(tmp_path: Path) -> None:
    got = recording(
        tmp_path,
        *(h(float(n)) for n in range(4)),
        h(4.0, magnitude_nt=None, field_nt=(1.0, 2.0, 3.0), frame=Frame.ECI),
        telemetry(0.0, 20.0),
        telemetry(1.0, 20.0),
        telemetry(2.0, 20.0, 21.0),
        *(b(float(n)) for n in range(3)),
        b(3.0, clock=Clock.ELAPSED),
    )
    report = got.report
    assert report.count("reference", RowFault.OTHER_FORM) == 1
    assert report.count("channels.temperature", RowFault.OTHER_FORM) == 1
    assert report.count("magnetometer", RowFault.OTHER_FORM) == 1
    assert (report.rows, report.used, len(got)) == (4, 3, 3)


def test_an_unknown_unit_is_counted_and_its_values_kept(tmp_path: Path) -> None:
    got = recording(tmp_path, h(0.0), telemetry(0.0, 3.0, unit="furlong", channel="x"), b(0.0))
    assert got.channels["x"].values.tolist() == [[3.0]]
    assert got.report.count("channels.x", RowFault.UNKNOWN_UNIT) == 1


def test_doubled_and_late_rows_are_kept_in_their_order_and_counted(tmp_path: Path) -> None:
    got = recording(tmp_path, h(0.0), b(0.0), b(2.0), b(1.0), b(2.0))
    assert (got.time_ns // S).tolist() == [0, 2, 1, 2]
    assert got.report.count("time", RowFault.OUT_OF_ORDER) == 1
    assert got.report.count("time", RowFault.DOUBLED_TIME) == 1


def test_a_position_comes_with_its_frame(tmp_path: Path) -> None:
    at = message(PositionSample, 0.0, position_km=(7000.0, 0.0, 0.0), frame=Frame.ECEF)
    got = recording(tmp_path, h(0.0), at, b(0.0))
    assert got.position is not None
    assert (got.position.km.tolist(), got.position.frame) == ([[7000.0, 0.0, 0.0]], Frame.ECEF)


def test_several_craft_without_a_choice_are_refused_by_name(tmp_path: Path) -> None:
    path = written(tmp_path / "two.mcap", [h(0.0), b(0.0), b(0.0, craft="other"), h(0.0, craft="other")])
    with pytest.raises(RecordingError, match=r"2 craft.*demo, other"):
        read_recording(path)
    with pytest.raises(RecordingError, match="did you mean 'demo'"):
        read_recording(path, "dmeo")
    assert len(read_recording(path, "other")) == 1


def test_rows_have_the_craft_that_their_descriptor_names_and_no_choice(tmp_path: Path) -> None:
    path = record_simulation(Simulation(load_scenario("paper"), 5, 60.0), tmp_path)
    name = read_recording(path).descriptor.craft
    assert name == load_scenario("paper").craft
    assert read_recording(path, name).descriptor.craft == name
    with pytest.raises(RecordingError, match=rf"craft: 'other' is refused; samples.craft says '{name}'"):
        read_recording(path, "other")
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace(f'craft = "{name}"\n', ""), encoding="utf-8")
    with pytest.raises(RecordingError, match="only a recorded session"):
        read_recording(path, name)


def test_a_session_without_a_reference_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no usable value"):
        recording(tmp_path, b(0.0), b(1.0))


def test_a_file_of_another_program_is_refused(tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="other")
        channel = writer.register_channel("/imu", "cdr", 0)
        writer.add_message(channel, 1, b"x", 1)
        writer.finish()
    with pytest.raises(RecordingError, match="profile 'ros2'"):
        read_recording(path)


def test_a_descriptors_noise_range_and_spin_go_before_those_recorded(tmp_path: Path) -> None:
    record(tmp_path, stream(100))
    (file,) = tmp_path.glob("*.mcap")
    text = f'version = 1\n[samples]\nfile = "{file.name}"\n[magnetometer]\nnoise_nt = 7.0\nrange_nt = 6e4\n'
    (tmp_path / "R.toml").write_text(f'{text}[spin]\naxis = "x"\nrate_rpm = 3.0\n')
    recording = read_recording(tmp_path / "R.toml")
    got = craft_of(recording)
    assert recording.descriptor.magnetometer.range_nt == got.sensor.range_nt == 6e4
    assert (got.sensor.noise_nt, got.spin and got.spin.axis, got.spin and got.spin.rate_rpm) == (
        7.0,
        (1.0, 0.0, 0.0),
        3.0,
    )
    assert craft_of(read_recording(file)) == craft()


def test_a_selection_of_rows_is_no_session_any_more(tmp_path: Path) -> None:
    record(tmp_path, stream(100))
    got = read_recording(next(tmp_path.glob("*.mcap")))
    assert got.stream is not None
    part = got.select(np.arange(10))
    assert (len(part), part.stream) == (10, None)


def test_calibrate_reads_a_session_as_it_reads_the_simulators_recording(tmp_path: Path) -> None:
    own = replace(craft("craft"), spin=None)
    record(tmp_path / "rec", stream(700, "random-errors"), [replace(own, name="paper")])
    (file,) = (tmp_path / "rec").glob("*.mcap")
    session = calibrate(file, "two-step")
    rows = calibrate(
        record_simulation(Simulation(load_scenario("random-errors"), 5, 700.0), tmp_path / "csv"), "two-step"
    )
    assert session.samples == rows.samples
    assert session.residuals.before == pytest.approx(rows.residuals.before, rel=1e-9)
