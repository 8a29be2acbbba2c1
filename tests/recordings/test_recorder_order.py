"""What the recorder promises of time, of room on the disk and of names that survive a power cut."""

from __future__ import annotations

import io
import os
import stat
import struct
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from magcal_service.recordings.mcap import MAGIC, RawMessage, Topic, dropped_messages
from magcal_service.recordings.mcap_reader import McapReader
from magcal_service.recordings.mcap_writer import McapWriter
from magcal_service.recordings.recorder import Recorder
from magcal_service.recordings.session_file import SessionFile
from magcal_service.recordings.session_files import Recovered, SessionFolder, recover_in_place
from magcal_service.wire.messages import Clock
from tests.recordings.sessions import craft, settings, stream, until

SAMPLES = stream(300)


def read(path: Path) -> tuple[McapReader, list[RawMessage]]:
    with path.open("rb") as file:
        reader = McapReader(file, path.name)
        return reader, list(reader.messages())


def test_log_time_never_goes_back_whatever_the_clock_does(tmp_path: Path) -> None:
    path, file = SessionFolder(tmp_path).create(0)
    session = SessionFile(path, file, {}, {})
    for now_ns, message in zip((100, 50, 101, 7), SAMPLES, strict=False):
        session.add(now_ns, message)
    session.close()
    assert [raw.log_time_ns for raw in read(path)[1]] == [100, 100, 101, 101]


def test_a_recording_begins_with_a_tenth_more_room_than_it_must_leave(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Begun, it goes on to the limit itself; stopped there, it waits for the tenth, so that no short files fill up."""
    free = [1_110_000]
    monkeypatch.setattr(SessionFolder, "free_bytes", lambda folder: free[0])
    with Recorder(settings(tmp_path, min_free_mb=1.0, flush_s=0.01, retry_s=0.02), [craft()]) as recorder:
        until(lambda: recorder.counters["record.files"] == 1)
        free[0] = 1_000_000
        recorder.add(SAMPLES[0])
        until(lambda: recorder.counters["record.written"] == 1)
        before = recorder._flush_s
        until(lambda: recorder._flush_s > before)
        assert recorder.trouble == ""
        free[0] = 999_999
        until(lambda: recorder.trouble)
        free[0] = 1_090_000
        stopped = recorder.counters["record.stopped"]
        until(lambda: recorder.counters["record.stopped"] > stopped + 1)
        assert recorder.counters["record.files"] == 1
        free[0] = 1_110_000
        until(lambda: recorder.counters["record.files"] == 2)
        assert recorder.trouble == ""


@pytest.fixture
def synced(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is synchronised: ``file`` or ``folder``, in order."""
    done: list[str] = []
    monkeypatch.setattr(
        os, "fsync", lambda number: done.append("folder" if stat.S_ISDIR(os.fstat(number).st_mode) else "file")
    )
    return done


def test_the_name_of_a_new_file_survives_a_power_cut(tmp_path: Path, synced: list[str]) -> None:
    SessionFolder(tmp_path).create(0)[1].close()
    assert synced == ["folder"]


def test_a_recovered_file_is_on_the_disk_with_its_name_before_the_other_one_goes(
    tmp_path: Path, synced: list[str]
) -> None:
    path, file = SessionFolder(tmp_path).create(0)
    session = SessionFile(path, file, {}, {})
    session.add(1, SAMPLES[0])
    session.flush()
    file.close()
    synced.clear()
    assert recover_in_place(path).messages == 1
    assert synced == ["file", "folder", "folder"]


def test_what_a_broken_recovery_left_is_deleted(tmp_path: Path) -> None:
    (tmp_path / "00000001-20260101T000000Z.recovered.mcap.partial").write_bytes(b"half")
    assert list(SessionFolder(tmp_path).unfinished()) == []
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("length", "damage"), [(1 << 26, "it ends within a record"), ((1 << 26) + 1, "a record has no sane length")]
)
def test_a_length_beyond_what_any_record_has_is_named(tmp_path: Path, length: int, damage: str) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(MAGIC + b"\x05" + length.to_bytes(8, "little"))
    assert read(path)[0].damage == damage


def test_channels_are_numbered_from_one_in_the_order_of_their_first_message(tmp_path: Path) -> None:
    topics = [Topic("alpha", kind, f"magcal.{kind}", b"{}") for kind in ("magnetometer", "reference")]
    with (tmp_path / "file").open("wb", buffering=0) as file:
        writer = McapWriter(file, "test")
        assert [writer.channel(topic) for topic in (*topics, *topics)] == [1, 2, 1, 2]


@pytest.mark.parametrize(
    ("content", "count"),
    [({"messages": "12"}, 12), ({}, 0), ({"messages": "-1"}, 0), ({"messages": "9" * 40}, 10**18 - 1)],
)
def test_a_holes_count_is_a_number_of_bounded_size(content: dict[str, str], count: int) -> None:
    assert dropped_messages(content) == count


class Hiccup(io.FileIO):
    """A file on a disk that takes a part of one write, then fails once, then works again."""

    broken = False

    def write(self, data: Any) -> int:
        if self.broken:
            self.broken = False
            super().write(bytes(data)[:10])
            raise OSError(5, "Input/output error")
        return int(super().write(data))


def test_a_file_that_is_abandoned_is_sound_up_to_the_chunk_that_failed(tmp_path: Path) -> None:
    """What was half-written is cut off, and the summary stands directly behind what is whole."""
    file = Hiccup(tmp_path / "file.mcap", "w+")
    session = SessionFile(tmp_path / "file.mcap", file, {}, {})  # type: ignore[arg-type]
    session.add(1, SAMPLES[0])
    assert session.flush() == 1
    session.add(2, SAMPLES[1])
    file.broken = True
    with pytest.raises(OSError, match="Input/output"):
        session.flush()
    assert session.abandon() == (0, 1)
    reader, messages = read(tmp_path / "file.mcap")
    assert (reader.sound, reader.good_bytes, len(messages)) == (True, reader.size, 1)


def test_a_folder_is_made_with_those_above_it(tmp_path: Path) -> None:
    path, file = SessionFolder(tmp_path / "a" / "b").create(0)
    file.close()
    assert path.parent == tmp_path / "a" / "b"


def test_a_recovery_is_reported_with_the_file_that_came_of_it(tmp_path: Path) -> None:
    source, result = tmp_path / "one.mcap", tmp_path / "one.recovered.mcap"
    assert (
        str(Recovered(source, None, 0, 7))
        == "0 records of one.mcap recovered, an unknown number gone, 7 bytes given up"
    )
    assert str(Recovered(source, result, 3, 7, gone=2)) == (
        "3 records of one.mcap recovered, at least 2 gone, 7 bytes given up: one.recovered.mcap"
    )
    assert "3 records of one.mcap recovered, 2 gone, " in str(Recovered(source, result, 3, 7, gone=2, all_known=True))
    assert "3 records of one.mcap recovered, 0 gone, 0 b" in str(Recovered(source, result, 3, 0, undamaged=True))


def test_the_footer_says_where_the_summary_is_and_has_its_checksum(tmp_path: Path) -> None:
    """CRC-32 from the beginning of the summary to the footer's own offsets, as https://mcap.dev/spec has it."""
    path, file = SessionFolder(tmp_path).create(0)
    session = SessionFile(path, file, {"session": "one"}, {})
    session.add(1, SAMPLES[0])
    session.close()
    content = path.read_bytes()
    at = len(content) - len(MAGIC) - 29
    opcode, length, start, offsets, checksum = struct.unpack_from("<BQQQI", content, at)
    assert (opcode, length) == (2, 20)
    assert 0 < start < offsets < at
    assert content[start - 13] == 15  # the end of the data stands before it
    assert checksum == zlib.crc32(content[start : at + 25])


@pytest.mark.parametrize(
    ("changes", "published"),
    [
        ({"time_ns": (1 << 63) - 1}, (1 << 63) - 1),
        ({"time_ns": 0}, 0),
        ({"time_ns": -1}, 77),
        ({"time_ns": 5, "clock": Clock.ELAPSED}, 77),
    ],
)
def test_a_source_time_is_published_where_it_is_utc_and_mcap_can_hold_it(
    tmp_path: Path, changes: dict[str, Any], published: int
) -> None:
    path, file = SessionFolder(tmp_path).create(0)
    session = SessionFile(path, file, {}, {})
    session.add(77, replace(SAMPLES[0], **changes))
    session.close()
    assert [raw.publish_time_ns for raw in read(path)[1]] == [published]


def test_files_are_deleted_oldest_first_and_only_beyond_the_limit(tmp_path: Path) -> None:
    paths = [tmp_path / f"0000000{number}-20260101T000000Z.mcap" for number in (1, 2, 3)]
    for path in paths:
        path.write_bytes(bytes(100))
    folder = SessionFolder(tmp_path)
    assert folder.delete_oldest(300, None) == []
    assert folder.delete_oldest(299, paths[0]) == [paths[1]]
    assert folder.delete_oldest(199, None) == [paths[0]]
    assert folder.files() == [paths[2]]
