"""Disks that are full, slow or broken: recording gives way, calibration never does, and every loss is counted."""

from __future__ import annotations

import errno
import io
import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import pytest

from magcal_service.recordings import recorder as module
from magcal_service.recordings import session_file
from magcal_service.recordings.mcap import DROPPED
from magcal_service.recordings.mcap_reader import McapReader
from magcal_service.recordings.recorder import Recorder
from magcal_service.recordings.session import read_session
from magcal_service.recordings.session_files import SessionFolder
from magcal_service.recordings.session_info import session_info
from magcal_service.wire.messages import CalibratedVector
from tests.recordings.sessions import Live, craft, live, settings, stream, until

SAMPLES = stream(300)


class FullDisk(io.FileIO):
    """A file on a disk with a certain room: the write that finds none takes a part first, as the system's does."""

    room = 0

    def write(self, data: Any) -> int:
        taken = min(len(data), FullDisk.room)
        if not taken:
            raise OSError(errno.ENOSPC, "No space left on device")
        FullDisk.room -= taken
        written: int = super().write(bytes(data)[:taken])
        return written


class StuckDisk(io.FileIO):
    """A file whose writes wait until the disk comes back."""

    back = threading.Event()

    def write(self, data: Any) -> int:
        StuckDisk.back.wait(60.0)
        written: int = super().write(data)
        return written


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Callable[[type[io.FileIO]], None]:
    """Puts every new session file on another kind of disk."""

    def use(kind: type[io.FileIO]) -> None:
        def create(folder: SessionFolder, now_ns: int) -> tuple[Path, BinaryIO]:
            path, file = original(folder, now_ns)
            file.close()
            return path, kind(path, "r+b")  # type: ignore[return-value]

        monkeypatch.setattr(SessionFolder, "create", create)

    original = SessionFolder.create
    return use


@pytest.fixture
def run(tmp_path: Path, disk: object) -> Iterator[Callable[..., tuple[Recorder, Live]]]:
    """Starts a recorded service."""
    started: list[tuple[Recorder, Live]] = []

    def start(**changes: float) -> tuple[Recorder, Live]:
        config = settings(tmp_path / "rec", **changes)
        crafts = (craft(),)
        recorder = Recorder(config, crafts)
        started.append((recorder, live(f"disk{id(recorder)}", crafts, recorder)))
        return started[-1]

    yield start
    for recorder, service in started:
        service.close()
        recorder.close()
        service.node.close()


def answers(service: Live, count: int) -> int:
    """How many vectors came back for samples that were sent."""
    found, deadline = 0, time.monotonic() + 120.0
    while found < count and time.monotonic() < deadline:
        found += sum(isinstance(message, CalibratedVector) for message in service.node.receive(0.1))
    return found


def test_a_full_disk_stops_the_recording_and_not_the_calibration(
    run: Callable[..., tuple[Recorder, Live]],
    disk: Callable[[type[io.FileIO]], None],
    caplog: pytest.LogCaptureFixture,
    tmp_path: Path,
) -> None:
    disk(FullDisk)
    FullDisk.room = 20_000
    with caplog.at_level(logging.INFO, "magcal.recorder"):
        recorder, service = run(flush_s=0.01, retry_s=0.3)
        service.send(SAMPLES)
        assert answers(service, 300) == 300
        until(lambda: recorder.trouble)
    assert recorder.trouble == "no space is left on the disk"
    assert f"not recording in {recorder.config.directory}: no space is left on the disk; calibration" in caplog.text
    status = service.status()
    assert "; not recording: no space is left on the disk" in status.text
    assert status.counters["record.stopped"] >= 1
    assert status.counters["record.dropped"] > 0


def test_recording_goes_on_when_there_is_room_again_and_every_message_is_accounted_for(
    run: Callable[..., tuple[Recorder, Live]], disk: Callable[[type[io.FileIO]], None], tmp_path: Path
) -> None:
    disk(FullDisk)
    FullDisk.room = 20_000
    recorder, service = run(flush_s=0.01, retry_s=0.2)
    service.send(SAMPLES[:400])
    until(lambda: recorder.trouble)
    FullDisk.room = 10_000_000
    until(lambda: not recorder.trouble)
    service.send(SAMPLES[400:])
    service.close()
    recorder.close()
    paths = sorted((tmp_path / "rec").glob("*.mcap"))
    infos = [session_info(path) for path in paths]
    assert all(info.sound for info in infos)
    held = sum(kind.count for info in infos for kind in info.kinds)
    sent = 600 + sum(count for name, count in service.service.link.counters.items() if name in ("sent", "dropped"))
    assert held == recorder.counters["record.written"]
    assert held + recorder.counters["record.dropped"] == sent
    assert 0 < sum(info.dropped for info in infos) <= recorder.counters["record.dropped"]


def test_a_file_that_met_a_full_disk_holds_a_whole_beginning(
    run: Callable[..., tuple[Recorder, Live]], disk: Callable[[type[io.FileIO]], None], tmp_path: Path
) -> None:
    disk(FullDisk)
    FullDisk.room = 20_000
    recorder, service = run(flush_s=0.01, retry_s=0.1)
    service.send(SAMPLES[:10])
    until(lambda: recorder.counters["record.written"])
    service.send(SAMPLES[10:])
    until(lambda: recorder.trouble)
    FullDisk.room = 10_000_000
    until(lambda: recorder.counters["record.recovered"])
    path = min((tmp_path / "rec").glob("*.recovered.mcap"))
    messages = read_session(path).messages
    assert messages == SAMPLES[: len(messages)]


def test_room_that_others_need_is_left(run: Callable[..., tuple[Recorder, Live]], tmp_path: Path) -> None:
    recorder, _ = run(min_free_mb=1e9)
    until(lambda: recorder.trouble)
    assert recorder.trouble == "the disk has less than min_free_mb = 1e+09 MB left"
    assert list((tmp_path / "rec").iterdir()) == []


def test_a_disk_without_room_is_tried_again_after_retry_s_and_said_once(
    run: Callable[..., tuple[Recorder, Live]], caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, "magcal.recorder"):
        recorder, _ = run(min_free_mb=1e9, retry_s=0.5)
        until(lambda: recorder.counters["record.stopped"] >= 1)
        began_s = time.monotonic()
        until(lambda: recorder.counters["record.stopped"] >= 3)
    assert time.monotonic() - began_s > 0.8  # two pauses, less what the first was seen late
    assert [text.partition(" in ")[0] for text in caplog.messages] == ["not recording"]


def test_that_recording_goes_on_is_said_once_and_not_of_its_start(
    run: Callable[..., tuple[Recorder, Live]],
    disk: Callable[[type[io.FileIO]], None],
    caplog: pytest.LogCaptureFixture,
) -> None:
    disk(FullDisk)
    FullDisk.room = 20_000
    with caplog.at_level(logging.INFO, "magcal.recorder"):
        recorder, service = run(flush_s=0.01, retry_s=0.2)
        service.send(SAMPLES)
        until(lambda: recorder.trouble)
        assert "recording again" not in caplog.messages
        FullDisk.room = 10_000_000
        until(lambda: not recorder.trouble)
        until(lambda: recorder.counters["record.files"] >= 2)
    assert caplog.messages.count("recording again") == 1


def test_a_disk_that_hangs_does_not_hold_the_service_up(
    run: Callable[..., tuple[Recorder, Live]],
    disk: Callable[[type[io.FileIO]], None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "MOST_WAITING", 100)
    disk(StuckDisk)
    StuckDisk.back.clear()
    recorder, service = run()
    try:
        service.send(SAMPLES)
        assert answers(service, 300) == 300
        assert recorder.counters["record.dropped"] > 0
    finally:
        StuckDisk.back.set()
    until(lambda: recorder.counters["record.written"])


def test_adding_never_waits(disk: Callable[[type[io.FileIO]], None], tmp_path: Path) -> None:
    disk(StuckDisk)
    StuckDisk.back.clear()
    try:
        recorder = Recorder(settings(tmp_path), [craft()])
        longest = 0.0
        for _ in range(3):
            begin = time.process_time()
            for message in SAMPLES * 6:
                recorder.add(message)
            longest = max(longest, (time.process_time() - begin) / (6 * len(SAMPLES)))
        assert longest < 100e-6
        assert recorder.counters["record.dropped"] >= 3 * 6 * len(SAMPLES) - module.MOST_WAITING - 1
    finally:
        StuckDisk.back.set()
        recorder.close()


def test_a_hole_is_marked_at_its_place(
    disk: Callable[[type[io.FileIO]], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MOST_WAITING", 10)
    disk(StuckDisk)
    StuckDisk.back.clear()
    recorder = Recorder(settings(tmp_path), [craft()])
    try:
        for message in SAMPLES[:30]:
            recorder.add(message)
    finally:
        StuckDisk.back.set()
    until(recorder._queue.empty)
    recorder.add(SAMPLES[30])
    recorder.close()
    with next(tmp_path.glob("*.mcap")).open("rb") as file:
        reader = McapReader(file, "file")
        seen = [(raw.sequence, raw.topic.kind, len(reader.metadata)) for raw in reader.messages()]
    (hole,) = (content for name, content in reader.metadata if name == DROPPED)
    kept = len(seen) - 1
    assert int(hole["messages"]) == 30 - kept == recorder.counters["record.dropped"]
    assert [entry[2] for entry in seen] == [2] * kept + [3]


def test_a_file_that_cannot_be_mended_does_not_keep_the_next_from_being_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(path: Path) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(module, "recover_in_place", broken)
    (tmp_path / "00000001-20260101T000000Z.mcap").write_bytes(b"half")
    with Recorder(settings(tmp_path), [craft()]) as recorder:
        recorder.add(SAMPLES[0])
    assert recorder.counters["record.written"] == 1
    assert "could not be made sound" in caplog.text


def test_the_end_of_the_service_does_not_wait_for_a_disk_that_hangs(
    disk: Callable[[type[io.FileIO]], None],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(module, "PATIENCE_S", 0.2)
    disk(StuckDisk)
    StuckDisk.back.clear()
    try:
        recorder = Recorder(settings(tmp_path), [craft()])
        recorder.add(SAMPLES[0])
        begin = time.monotonic()
        recorder.close()
        assert time.monotonic() - begin < 10.0
        assert "does not take the end of the recording" in caplog.text
    finally:
        StuckDisk.back.set()


def test_what_is_flushed_is_brought_to_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each flush asks the kernel to write: a power cut costs what came after the last one."""
    synced: set[int] = set()  # inodes: the recorder of a test before may still be writing to its own file
    monkeypatch.setattr(session_file.os, "fdatasync", lambda number: synced.add(os.fstat(number).st_ino))
    recorder = Recorder(settings(tmp_path, flush_s=0.01), [craft()])
    recorder.add(SAMPLES[0])
    until(lambda: any(path.stat().st_ino in synced for path in tmp_path.glob("*.mcap")))
    recorder.close()


def test_a_folder_is_made_with_all_above_it(tmp_path: Path) -> None:
    recorder = Recorder(settings(tmp_path / "not" / "there", retry_s=0.1), [craft()])
    recorder.add(SAMPLES[0])
    recorder.close()
    assert recorder.counters["record.written"] == 1
    assert list((tmp_path / "not" / "there").glob("*.mcap"))


def test_a_defect_in_the_recorder_ends_a_file_and_not_the_recorder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(message: object) -> bytes:
        raise RuntimeError("a defect")

    recorder = Recorder(settings(tmp_path, retry_s=0.1), [craft()])
    with monkeypatch.context() as patch:
        patch.setattr(session_file, "to_json", broken)
        recorder.add(SAMPLES[0])
        until(lambda: recorder.counters["record.stopped"])
    until(lambda: not recorder.trouble)
    recorder.add(SAMPLES[1])
    recorder.close()
    assert recorder.counters["record.written"] == 1
    assert "the recorder failed" in caplog.text


def test_a_message_that_json_cannot_hold_is_dropped_alone(tmp_path: Path) -> None:
    spoilt = replace(SAMPLES[1], field_body_nt=(float("nan"), 0.0, 0.0))
    with Recorder(settings(tmp_path), [craft()]) as recorder:
        for message in (SAMPLES[1], spoilt, SAMPLES[3]):
            recorder.add(message)
    assert (recorder.counters["record.written"], recorder.counters["record.dropped"]) == (2, 1)
