"""A folder of sessions: when a file ends and the next begins, and which are deleted."""

from __future__ import annotations

import os
import stat
from collections.abc import Sequence
from pathlib import Path

import pytest

from magcal_service.base.errors import InputRefusedError, RecordingError
from magcal_service.recordings.recorder import Recorder, open_recorder
from magcal_service.recordings.session import read_session
from magcal_service.recordings.session_files import SessionFolder
from magcal_service.recordings.session_info import session_info
from magcal_service.wire.messages import Message
from tests.recordings.sessions import craft, record, settings, stream, until

SAMPLES = stream(300)


def inputs(parts: Sequence[Path]) -> list[Message]:
    """What came in, file by file; the last one may have been begun after the last sample, and is refused as empty."""
    found: list[Message] = []
    for part in parts:
        try:
            found += read_session(part).messages
        except RecordingError as error:
            if part != parts[-1] or "no samples" not in str(error):
                raise
    return found


def test_a_file_that_is_large_enough_is_ended_and_nothing_is_lost_between(tmp_path: Path) -> None:
    parts = record(tmp_path, SAMPLES, file_mb=0.01, flush_s=0.0005)
    assert len(parts) > 2
    assert all(session_info(part).sound for part in parts)
    assert inputs(parts) == list(SAMPLES)
    assert [session_info(part).about["part"] for part in parts] == [str(n + 1) for n in range(len(parts))]
    assert len({session_info(part).about["session"] for part in parts}) == 1


def test_a_file_that_is_old_enough_is_ended(tmp_path: Path) -> None:
    with Recorder(settings(tmp_path, file_h=0.2 / 3600.0, flush_s=0.05), [craft()]) as recorder:
        until(lambda: recorder.counters["record.files"])
        for message in SAMPLES[:3]:
            recorder.add(message)
            count = recorder.counters["record.files"]
            until(lambda before=count: recorder.counters["record.files"] > before)
    held = [len(read_session(path).messages) for path in sorted(tmp_path.glob("*.mcap")) if path.stat().st_size > 1500]
    assert held == [1, 1, 1]


def test_an_empty_file_is_never_too_old(tmp_path: Path) -> None:
    with Recorder(settings(tmp_path, file_h=1e-9, flush_s=0.01), [craft()]) as recorder:
        until(lambda: recorder.counters["record.files"] == 1)
        with pytest.raises(AssertionError):
            _soon(lambda: recorder.counters["record.files"] > 1)


def test_an_idle_recorder_does_not_touch_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    syncs: list[int] = []
    monkeypatch.setattr(os, "fdatasync", syncs.append)
    with Recorder(settings(tmp_path, flush_s=0.01), [craft()]) as recorder:
        recorder.add(SAMPLES[0])
        until(lambda: recorder.counters["record.written"])
        with pytest.raises(AssertionError):
            _soon(lambda: len(syncs) > 1)


def _soon(done: object) -> None:
    import time

    deadline = time.monotonic() + 0.3
    while not done():  # type: ignore[operator]
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_the_oldest_files_give_way_to_the_total_limit(tmp_path: Path) -> None:
    parts = record(tmp_path, SAMPLES, file_mb=0.01, total_mb=0.05, flush_s=0.0005)
    assert sum(part.stat().st_size for part in parts) < 70_000
    assert int(parts[0].name[:8]) > 1
    messages = inputs(parts)
    assert messages == list(SAMPLES[-len(messages) :])


def test_without_a_total_limit_nothing_is_deleted(tmp_path: Path) -> None:
    record(tmp_path, SAMPLES[:20])
    record(tmp_path, SAMPLES[:20])
    assert [path.name[:8] for path in sorted(tmp_path.glob("*.mcap"))] == ["00000001", "00000002"]


def test_the_order_of_files_does_not_depend_on_the_clock(tmp_path: Path) -> None:
    folder = SessionFolder(tmp_path)
    for now_ns in (2 * 10**18, 1, 10**18):
        folder.create(now_ns)[1].close()
    stamps = [path.name.split("-")[1][:4] for path in folder.files()]
    assert stamps == ["2033", "1970", "2001"]


def test_other_files_in_the_folder_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "flight.mcap").write_bytes(b"x" * 1000)
    record(tmp_path, SAMPLES, file_mb=0.01, total_mb=0.02, flush_s=0.0005)
    assert (tmp_path / "flight.mcap").read_bytes() == b"x" * 1000


def test_a_folder_that_cannot_be_made_is_refused_at_the_start(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputRefusedError, match=r"record\.directory"):
        open_recorder(settings(tmp_path / "file" / "rec"), [craft()])


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written_to_is_refused_at_the_start(tmp_path: Path) -> None:
    tmp_path.chmod(stat.S_IRUSR | stat.S_IXUSR)
    with pytest.raises(InputRefusedError, match="written to"):
        open_recorder(settings(tmp_path), [craft()])


def test_a_pipe_a_folder_and_a_link_with_the_name_of_a_recording_are_left_alone(tmp_path: Path) -> None:
    """A pipe without a writer would hold the recorder for good, and nobody would say so."""
    os.mkfifo(tmp_path / "00000001-20260101T000000Z.mcap")
    os.mkfifo(tmp_path / "00000001-20260101T000000Z.recovered.mcap.partial")
    (tmp_path / "00000002-20260101T000000Z.mcap").mkdir()
    (tmp_path / "00000003-20260101T000000Z.mcap").symlink_to("/dev/zero")
    planted = set(tmp_path.iterdir())
    parts = [path for path in record(tmp_path, SAMPLES) if path not in planted]
    assert [path.name[:9] for path in parts] == ["00000004-"]
    assert (session_info(parts[0]).sound, inputs(parts)) == (True, list(SAMPLES))
    assert planted < set(tmp_path.iterdir())
