"""The counter of sealed commands on the disk survives a power cut, and is believed only as it was written."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from magcal_service.links.counter_file import CounterFile
from magcal_service.wire.seal import MAX_COUNTER


def test_a_counter_begins_at_nought(tmp_path: Path) -> None:
    assert CounterFile(tmp_path / "counter").last == 0


def test_a_kept_value_is_on_the_disk_before_its_name_and_the_name_before_it_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file is synchronised, then renamed, then its folder is synchronised."""
    done: list[str] = []
    kept = CounterFile(tmp_path / "counter")

    def fsync(descriptor: int) -> None:
        is_folder = stat.S_ISDIR(os.fstat(descriptor).st_mode)
        done.append("folder" if is_folder else f"file {os.fstat(descriptor).st_size}")
        assert (tmp_path / "counter").exists() == is_folder
        assert kept.last == 0

    monkeypatch.setattr(os, "fsync", fsync)
    kept.keep(41)
    assert done == [f"file {(tmp_path / 'counter').stat().st_size}", "folder"]
    assert kept.last == 41


def test_only_the_owner_can_read_a_counter(tmp_path: Path) -> None:
    CounterFile(tmp_path / "counter").keep(1)
    assert stat.S_IMODE((tmp_path / "counter").stat().st_mode) == 0o600


def test_a_disk_that_does_not_take_it_leaves_the_old_value(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = CounterFile(tmp_path / "counter")
    kept.keep(41)

    def fsync(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(OSError, match="No space"):
        kept.keep(42)
    assert (kept.last, CounterFile(tmp_path / "counter").last) == (41, 41)


@pytest.mark.parametrize(("value", "believed"), [(MAX_COUNTER, MAX_COUNTER), (MAX_COUNTER + 1, None)])
def test_a_counter_that_no_line_can_carry_is_not_believed(tmp_path: Path, value: int, believed: int | None) -> None:
    CounterFile(tmp_path / "counter").keep(value)
    assert CounterFile(tmp_path / "counter").last == believed


def test_a_counter_that_cannot_be_read_is_not_taken_for_a_new_one(tmp_path: Path) -> None:
    (tmp_path / "counter").mkdir()
    assert CounterFile(tmp_path / "counter").last is None


def test_a_pipe_is_no_counter_and_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "counter")
    kept = CounterFile(tmp_path / "counter")
    assert kept.last is None
    kept.keep(7)
    assert CounterFile(tmp_path / "counter").last == 7
