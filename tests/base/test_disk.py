"""A file takes the place of another as a whole, on the disk before its name counts, or leaves it as it was."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from magcal_service.base.disk import beside, write_whole


def test_the_content_is_on_the_disk_before_its_name_and_the_name_before_it_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")
    done: list[tuple[str, bytes]] = []

    def fsync(descriptor: int) -> None:
        found = os.fstat(descriptor)
        done.append(("folder" if stat.S_ISDIR(found.st_mode) else f"file {found.st_size}", path.read_bytes()))

    monkeypatch.setattr(os, "fsync", fsync)
    opened = len(os.listdir("/proc/self/fd"))
    write_whole(path, b"newer")
    assert done == [("file 5", b"old"), ("folder", b"newer")]
    assert len(os.listdir("/proc/self/fd")) == opened
    assert list(tmp_path.iterdir()) == [path]


def _full(*_: object) -> None:
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("name", ["fsync", "replace"])
def test_where_the_disk_is_full_the_old_file_stays_and_nothing_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")
    monkeypatch.setattr(os, name, _full)
    with pytest.raises(OSError, match="No space"):
        write_whole(path, b"newer")
    assert (path.read_bytes(), list(tmp_path.iterdir())) == (b"old", [path])


@pytest.mark.parametrize("stop", [KeyboardInterrupt, ValueError])
def test_where_the_writer_stops_half_way_the_old_file_stays(tmp_path: Path, stop: type[BaseException]) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")

    def half() -> None:
        with beside(path) as part:
            part.write_bytes(b"ne")
            raise stop

    with pytest.raises(stop):
        half()
    assert (path.read_bytes(), list(tmp_path.iterdir())) == (b"old", [path])


def test_a_private_file_is_private_while_it_is_written(tmp_path: Path) -> None:
    with beside(tmp_path / "file", mode=0o600) as part:
        assert stat.S_IMODE(part.stat().st_mode) == 0o600
        part.write_bytes(b"secret")
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == 0o600


@pytest.mark.parametrize(
    ("mark", "name"), [(".new", lambda: "file.new"), ("", lambda: f".file.{os.getpid()}.part")], ids=["marked", "own"]
)
def test_what_a_crash_has_left_is_written_over(tmp_path: Path, mark: str, name: Callable[[], str]) -> None:
    (tmp_path / name()).write_bytes(b"half of something long")
    write_whole(tmp_path / "file", b"whole", mark=mark)
    assert [(one.name, one.read_bytes()) for one in tmp_path.iterdir()] == [("file", b"whole")]


@pytest.mark.parametrize("mark", [".new", ""])
@pytest.mark.parametrize("plant", [os.mkfifo, lambda part: part.symlink_to(part.with_name("other"))])
def test_a_pipe_or_a_link_where_the_file_is_written_is_neither_waited_for_nor_followed(
    tmp_path: Path, mark: str, plant: Callable[[Path], None]
) -> None:
    other = tmp_path / "other"
    other.write_bytes(b"kept")
    plant(tmp_path / (f"file{mark}" if mark else f".file.{os.getpid()}.part"))
    write_whole(tmp_path / "file", b"whole", mark=mark)
    assert {one.name: one.read_bytes() for one in tmp_path.iterdir()} == {"file": b"whole", "other": b"kept"}
