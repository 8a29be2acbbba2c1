import itertools
import re
from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import RecordingError
from magcal_service.recordings import messages as module
from magcal_service.recordings.messages import messages
from magcal_service.recordings.reader import read_recording
from magcal_service.wire.codec import decode, encode
from magcal_service.wire.messages import (
    Clock,
    Frame,
    MagnetometerSample,
    PositionSample,
    ReferenceSample,
    TelemetrySample,
)
from tests.recordings.recording_logs import MAGNETOMETER, descriptor, row, write_log

CHANNELS = '[channels]\nheat = { column = "temp", unit = "degC" }\nat = { columns = ["q0", "q1"] }\n'
POSITION = '[position]\ncolumns = ["x", "y", "z"]\nunit = "km"\nframe = "eci"\n'
FULL = descriptor(POSITION, CHANNELS)
ROW_KINDS = [ReferenceSample, PositionSample, TelemetrySample, TelemetrySample, MagnetometerSample]


def test_a_row_is_reference_position_channels_and_last_the_magnetometer(tmp_path: Path) -> None:
    stream = list(messages(read_recording(write_log(tmp_path, FULL))))
    assert [type(message) for message in stream] == ROW_KINDS * 3


def test_all_messages_of_a_row_carry_its_time_and_clock(tmp_path: Path) -> None:
    stream = list(messages(read_recording(write_log(tmp_path, FULL))))
    assert {(m.time_ns, m.clock) for m in stream[5:10]} == {(1_700_000_001_000_000_000, Clock.UTC)}


def test_values_are_those_of_the_row(tmp_path: Path) -> None:
    reference, position, heat, _, magnetometer = itertools.islice(
        messages(read_recording(write_log(tmp_path, FULL))), 5
    )
    assert isinstance(reference, ReferenceSample)
    assert (reference.field_nt, reference.frame) == ((11000.0, -22000.0, 33000.0), Frame.ECI)
    assert isinstance(position, PositionSample)
    assert (position.position_km, position.frame) == ((6800.0, 100.0, -200.0), Frame.ECI)
    assert isinstance(heat, TelemetrySample)
    assert (heat.channel, heat.unit, heat.values) == ("heat", "degC", (21.5,))
    assert isinstance(magnetometer, MagnetometerSample)
    assert magnetometer.field_body_nt == (10000.0, -20500.0, 30000.0)


@pytest.mark.parametrize("form", ['magnitude = "f"\nunit = "nT"\n', 'constant = 41200.5\nunit = "nT"\n'])
def test_a_magnitude_is_sent_with_every_row(tmp_path: Path, form: str) -> None:
    recording = read_recording(write_log(tmp_path, descriptor(reference=f"[reference]\n{form}")))
    references = [m for m in messages(recording) if isinstance(m, ReferenceSample)]
    assert [(r.magnitude_nt, r.field_nt, r.frame) for r in references] == [(41200.5, None, None)] * 3


def test_each_kind_counts_its_sequence_without_gaps_over_rows_that_lack_it(tmp_path: Path) -> None:
    rows = [row(1), row(2, hx="nan", y="", temp=""), row(3)]
    stream = list(messages(read_recording(write_log(tmp_path, FULL, rows))))
    counted = {kind: [m.sequence for m in stream if type(m) is kind] for kind in ROW_KINDS}
    assert counted == {
        ReferenceSample: [0, 1],
        PositionSample: [0, 1],
        TelemetrySample: [0, 1, 2, 3, 4],
        MagnetometerSample: [0, 1, 2],
    }


def test_sequence_numbers_go_round_after_32_bits(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(module, "_SEQUENCE_END", 2)
    stream = messages(read_recording(write_log(tmp_path)))
    assert [m.sequence for m in stream if isinstance(m, MagnetometerSample)] == [0, 1, 0]


def test_a_channel_with_one_value_missing_gives_no_sample(tmp_path: Path) -> None:
    recording = read_recording(write_log(tmp_path, FULL, [row(1, q1="nan")]))
    assert [m.channel for m in messages(recording) if isinstance(m, TelemetrySample)] == ["heat"]


def test_channels_can_be_left_out(tmp_path: Path) -> None:
    stream = messages(read_recording(write_log(tmp_path, FULL)), telemetry=False)
    assert not any(isinstance(m, TelemetrySample) for m in stream)


def test_rows_out_of_order_are_sent_in_file_order(tmp_path: Path) -> None:
    recording = read_recording(write_log(tmp_path, None, [row(3), row(1), row(3)]))
    times = [m.time_ns // 10**9 for m in messages(recording) if isinstance(m, MagnetometerSample)]
    assert times == [3, 1, 3]


def test_the_same_recording_gives_the_same_messages(tmp_path: Path) -> None:
    path = write_log(tmp_path, FULL)
    assert list(messages(read_recording(path))) == list(messages(read_recording(path)))


def test_every_message_passes_the_wire_unchanged(tmp_path: Path) -> None:
    recording = read_recording(write_log(tmp_path, descriptor(POSITION, CHANNELS.replace("heat", '"heat 1.a"'))))
    for message in messages(recording, "alpha"):
        assert decode(encode(message)) == message


def test_the_numbers_of_a_message_are_plain_python_floats(tmp_path: Path) -> None:
    sample = next(m for m in messages(read_recording(write_log(tmp_path))) if isinstance(m, MagnetometerSample))
    assert [type(value) for value in sample.field_body_nt] == [float] * 3
    assert not isinstance(sample.field_body_nt[0], np.floating)


TWO = (
    MAGNETOMETER.replace("[magnetometer]", "[[magnetometer]]")
    + 'source = "mag1"\n[[magnetometer]]\nsource = "mag2"\ncolumns = ["x", "y", "z"]\nunit = "nT"\nnoise_nt = 7.0\n'
)


def test_further_magnetometers_of_a_row_are_sent_with_their_own_source(tmp_path: Path) -> None:
    """One that a row has no vector of is not sent, and counted; --source puts it in front."""
    path = write_log(tmp_path, descriptor(magnetometer=TWO), [row(1700000000), row(1700000001, y=""), row(1700000002)])
    recording = read_recording(path)
    sent = [one for one in messages(recording) if isinstance(one, MagnetometerSample)]
    assert [one.source for one in sent] == ["mag1", "mag2", "mag1", "mag1", "mag2"]
    assert sent[1].field_body_nt == (6800.0, 100.0, -200.0)
    assert [(one.part, one.kept) for one in recording.report.entries] == [("mag2", True)]
    other = read_recording(path, source="mag2")
    assert (other.source, other.others, other.descriptor.magnetometer.noise_nt) == ("mag2", ("mag1",), 7.0)
    assert other.field_body_nt.tolist() == [[6800.0, 100.0, -200.0]] * 2
    with pytest.raises(RecordingError, match="source: 'mag3' is refused; did you mean 'mag"):
        read_recording(path, source="mag3")


@pytest.mark.parametrize(
    ("before", "after", "fault"),
    [
        ('source = "mag1"\n', "", "magnetometer.source"),
        ('source = "mag1"', 'source = "mag2"', "magnetometer.source"),
        ('source = "mag1"', 'source = "magcal"', "magnetometer.source"),
        ('["x", "y", "z"]', '["mx", "y", "z"]', "magnetometer[1].columns"),
    ],
)
def test_further_magnetometers_are_refused_by_what_is_wrong(
    tmp_path: Path, before: str, after: str, fault: str
) -> None:
    path = write_log(tmp_path, descriptor(magnetometer=TWO.replace(before, after)))
    with pytest.raises(RecordingError, match=re.escape(fault)):
        read_recording(path)
