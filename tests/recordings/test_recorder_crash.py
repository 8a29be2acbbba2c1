"""What a crash leaves: nothing that was flushed is lost, and the next start makes a sound file of it."""

from __future__ import annotations

import fcntl
import io
import json
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from magcal_service.base.errors import RecordingError
from magcal_service.recordings.mcap import RawMessage
from magcal_service.recordings.mcap_reader import McapReader
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recorder import Recorder
from magcal_service.recordings.session import read_session
from magcal_service.recordings.session_file import SessionFile
from magcal_service.recordings.session_files import SessionFolder, recover, recover_in_place
from magcal_service.recordings.session_info import session_info
from magcal_service.wire.messages import MagnetometerSample
from tests.daemon.service_processes import Node, daemon, free_port, kill, wait_for, write_config
from tests.recordings.sessions import craft, stream, until
from tests.recordings.sessions import settings as record_settings

SAMPLES = stream(300)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A sound session file of ten chunks."""
    path, file = SessionFolder(tmp_path_factory.mktemp("whole")).create(0)
    session = SessionFile(path, file, {"session": "whole"}, {"paper": craft()})
    for number, message in enumerate(SAMPLES, 1):
        session.add(number, message)
        if number % (len(SAMPLES) // 10) == 0:
            session.flush()
    session.close()
    return path.read_bytes()


def read(content: bytes) -> tuple[McapReader, list[RawMessage]]:
    reader = McapReader(io.BytesIO(content), "file")
    return reader, list(reader.messages())


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0.0, 1.0))
def test_a_file_cut_anywhere_gives_all_that_stands_before_the_cut(whole: bytes, share: float) -> None:
    reader, before = read(whole)
    cut = max(8, int(share * len(whole)))
    short, found = read(whole[:cut])
    assert found == before[: len(found)]
    assert short.sound == (cut == len(whole))
    assert short.good_bytes <= cut
    assert len(found) == len(before) or short.good_bytes < reader.good_bytes


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.floats(0.01, 0.99), bit=st.integers(0, 7))
def test_a_flipped_bit_costs_its_chunk_at_most_or_what_comes_after(whole: bytes, place: float, bit: int) -> None:
    _, before = read(whole)
    spoilt = bytearray(whole)
    spoilt[int(place * len(whole))] ^= 1 << bit
    try:
        _, found = read(bytes(spoilt))
    except RecordingError:
        return
    wanted = {raw.data for raw in before}
    assert all(raw.data in wanted for raw in found)


def test_a_spoilt_chunk_in_the_middle_costs_no_other(whole: bytes) -> None:
    reader = make_reader(io.BytesIO(whole))
    summary = reader.get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[len(summary.chunk_indexes) // 2]
    spoilt = bytearray(whole)
    spoilt[chunk.chunk_start_offset + chunk.chunk_length - 5] ^= 0xFF
    _, before = read(whole)
    short, found = read(bytes(spoilt))
    assert short.bad_chunks == 1
    assert not short.sound
    lost = [raw for raw in before if raw not in found]
    assert {raw.log_time_ns for raw in lost} <= set(range(chunk.message_start_time, chunk.message_end_time + 1))
    assert found == [raw for raw in before if raw not in lost]


def test_a_recovered_file_is_sound_and_holds_what_could_be_read(whole: bytes, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    _, wanted = read(cut.read_bytes())
    recovered = recover(cut, tmp_path / "out.mcap")
    content = (tmp_path / "out.mcap").read_bytes()
    reader, found = read(content)
    assert (found, recovered.messages, reader.sound) == (wanted, len(wanted), True)
    assert sum(1 for _ in make_reader(io.BytesIO(content), validate_crcs=True).iter_messages()) == len(wanted)
    assert reader.metadata == read(whole)[0].metadata


def test_a_file_of_garbage_is_set_aside_and_not_deleted(tmp_path: Path) -> None:
    path = tmp_path / "00000001-20260101T000000Z.mcap"
    path.write_bytes(b"garbage" * 100)
    recovered = recover_in_place(path)
    assert (recovered.messages, recovered.lost_bytes) == (0, 700)
    assert [one.name for one in tmp_path.iterdir()] == ["00000001-20260101T000000Z.unreadable"]


def test_a_recording_that_another_daemon_is_writing_is_left_alone(whole: bytes, tmp_path: Path) -> None:
    path = tmp_path / "00000001-20260101T000000Z.mcap"
    path.write_bytes(whole[:10_000])
    with path.open("rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with Recorder(record_settings(tmp_path), [craft()]) as recorder:
            until(lambda: recorder.counters["record.files"])
    assert path.read_bytes() == whole[:10_000]


def test_leftovers_of_a_recovery_that_was_killed_itself_go_away(whole: bytes, tmp_path: Path) -> None:
    path = tmp_path / "00000001-20260101T000000Z.mcap"
    path.write_bytes(whole[:10_000])
    (tmp_path / "00000001-20260101T000000Z.recovered.mcap.partial").write_bytes(b"half")
    with Recorder(record_settings(tmp_path), [craft()]) as recorder:
        until(lambda: recorder.counters["record.files"])
    names = sorted(one.name for one in tmp_path.iterdir())
    assert names[0] == "00000001-20260101T000000Z.recovered.mcap"
    assert names[1].startswith("00000002-")
    assert len(names) == 2


def test_a_killed_daemon_loses_nothing_that_was_flushed_and_mends_the_file_when_it_starts_again(tmp_path: Path) -> None:
    link = f"zenoh:tcp/127.0.0.1:{free_port()}"
    config = write_config(tmp_path, link)
    folder = tmp_path / "rec"
    text = f"[record]\ndirectory = {json.dumps(str(folder))}\nflush_s = 0.2\nmin_free_mb = 0\n"
    config.write_text(config.read_text() + text)
    with daemon(config) as first, Node(link) as node:
        node.until_heard()
        node.send(SAMPLES[:400])
        node.settle()
        node.until("not recorded", lambda: node.counters().get("record.written", 0) >= 800)
        written = node.counters()["record.written"]
        kill(first)
    (path,) = folder.glob("*.mcap")
    assert not session_info(path).sound
    assert [one for one in read_session(path).messages if isinstance(one, MagnetometerSample)] == list(SAMPLES[1:400:2])
    with daemon(config, 2) as second:
        wait_for("recovered, ", second.log)
        wait_for("recording into", second.log)
        assert second.stop() == 0
    mended, new = sorted(folder.glob("*.mcap"))
    assert mended.name == path.name.replace(".mcap", ".recovered.mcap")
    assert session_info(mended).sound
    assert sum(kind.count for kind in session_info(mended).kinds) >= written
    assert session_info(new).sound
    assert len(read_recording(mended)) == 200


def test_a_length_beyond_all_bounds_costs_nothing_where_the_other_one_is_right(whole: bytes) -> None:
    summary = make_reader(io.BytesIO(whole)).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[0]
    length_at = chunk.chunk_start_offset + 9 + 8 + 8 + 8 + 4 + 4 + len("zstd")
    spoilt = bytearray(whole)
    spoilt[length_at : length_at + 8] = (0x871D_0000_0000_0000).to_bytes(8, "little")
    short, found = read(bytes(spoilt))
    assert (short.bad_chunks, found) == (0, read(whole)[1])
