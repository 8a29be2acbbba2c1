"""A folder of recorded sessions: names in order, oldest deleted, what a crash left half-written made sound again."""

from __future__ import annotations

import fcntl
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO, Final

from magcal_service.base.disk import beside, is_file, sync_folder
from magcal_service.base.errors import Fault, RecordingError
from magcal_service.base.version import __version__
from magcal_service.recordings.mcap import DROPPED, MAGIC, RawMessage
from magcal_service.recordings.mcap_reader import McapReader
from magcal_service.recordings.mcap_writer import McapWriter

LIBRARY: Final = f"magcal {__version__}"
_NAME = re.compile(r"(\d{8})-\d{8}T\d{6}Z(\.recovered)?\.(mcap|unreadable)")
_UNFINISHED: Final = ".partial"


class SessionFolder:
    """The files of one folder; every method passes ``OSError`` on.

    Parameters
    ----------
    path: the folder, made where absent.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def files(self) -> list[Path]:
        """Everything recorded here, oldest first by its running number: a clock that was set does not disturb it."""
        return [path for path in self._named() if is_file(path)]

    def _named(self) -> list[Path]:
        """What has the name of a recording, whatever it is."""
        return sorted(path for path in self.path.iterdir() if _NAME.fullmatch(path.name))

    def create(self, now_ns: int) -> tuple[Path, BinaryIO]:
        """The next file, locked against another daemon's recovery for as long as it is open; ``now_ns`` labels it."""
        self.path.mkdir(parents=True, exist_ok=True)
        number = max((int(path.name[:8]) for path in self._named()), default=0) + 1
        stamp = datetime.fromtimestamp(now_ns / 1e9, UTC).strftime("%Y%m%dT%H%M%SZ")
        path = self.path / f"{number:08d}-{stamp}.mcap"
        file = path.open("xb", buffering=0)
        with suppress(OSError):  # some file systems know no locks
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        sync_folder(self.path)
        return path, file

    def free_bytes(self) -> int:
        """Room that the disk has left for this process."""
        disk = os.statvfs(self.path)
        return disk.f_bavail * disk.f_frsize

    def delete_oldest(self, most_bytes: float, keep: Path | None) -> list[Path]:
        """Delete the oldest files until all together have at most ``most_bytes``; never ``keep``."""
        sizes = {path: path.stat().st_size for path in self.files()}
        total, deleted = sum(sizes.values()), []
        for path, size in sizes.items():
            if total <= most_bytes:
                break
            if path != keep:
                path.unlink()
                total -= size
                deleted.append(path)
        return deleted

    def unfinished(self) -> Iterator[Path]:
        """Files without their closing mark that no running recorder holds; leftovers of a recovery are deleted."""
        for leftover in filter(is_file, self.path.glob(f"*{_UNFINISHED}")):
            leftover.unlink()
        for path in self.files():
            if path.suffix == ".mcap" and not _is_closed(path) and not _is_held(path):
                yield path


def _is_closed(path: Path) -> bool:
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - len(MAGIC)))
        return size > len(MAGIC) and file.read() == MAGIC


def _is_held(path: Path) -> bool:
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return True
    return False


@dataclass(frozen=True, slots=True)
class Recovered:
    """What became of a file that was half-written.

    Parameters
    ----------
    source: the file.
    result: the sound file with its messages; None where it had none.
    messages: how many there were.
    lost_bytes: what could not be read.
    gone: messages that were in it and could not be read.
    all_known: whether those are all; else the file does not say how many more there were.
    undamaged: whether the file lacked its end at most.
    """

    source: Path
    result: Path | None
    messages: int
    lost_bytes: int
    gone: int = 0
    all_known: bool = False
    undamaged: bool = False

    def __str__(self) -> str:
        gone = f"{self.gone} gone"
        if not (self.all_known or self.undamaged):
            gone = f"at least {gone}" if self.gone else "an unknown number gone"
        text = f"{self.messages} records of {self.source.name} recovered, {gone}, {self.lost_bytes} bytes given up"
        return text if self.result is None else f"{text}: {self.result.name}"


def recover_in_place(path: Path) -> Recovered:
    """Make a sound ``*.recovered.mcap`` of a half-written file and delete it; it keeps its place in the order.

    Where not one record can be read, an empty file is deleted and any other set aside as ``*.unreadable``.
    """
    try:
        recovered = recover(path, path.with_suffix(".recovered.mcap"))
    except RecordingError:  # not even the beginning of a recording
        recovered = Recovered(path, None, 0, path.stat().st_size)
    if recovered.result is None and recovered.lost_bytes:
        path.replace(path.with_suffix(".unreadable"))
    else:
        path.unlink()
    sync_folder(path.parent)
    return recovered


def recover(path: Path, out: Path) -> Recovered:
    """Write everything that can be read of a file into a sound one; nothing is written where that is nothing.

    Raises ``RecordingError`` where the file is no MCAP file at all, and ``OSError``.
    """
    with path.open("rb") as file:
        reader = McapReader(file, str(path))
        messages = rewrite([reader], out)
        lost = reader.size - reader.good_bytes
    result = out if messages else None
    return Recovered(path, result, messages, lost, reader.gone, reader.all_gone_known, reader.undamaged)


def rewrite(readers: Iterable[McapReader], out: Path) -> int:
    """All messages and metadata of some files, in their order, as one sound file; returns how many messages.

    ``out`` appears at once when it is whole; without a message it does not appear.  Raises ``RecordingError`` where a
    file is no recording of this service, and ``OSError``.
    """
    with suppress(_EmptyError), beside(out, mark=_UNFINISHED) as part:
        with part.open("wb", buffering=0) as file:
            writer = McapWriter(file, LIBRARY)
            for reader in readers:
                _copy(reader, writer)
            writer.finish()
        if not writer.messages:
            raise _EmptyError
    return writer.messages


class _EmptyError(Exception):
    """Not one message was there to be written."""


def _copy(reader: McapReader, writer: McapWriter) -> None:
    copied = 0
    for message in reader.messages():
        _refuse_foreign(reader, message)
        if len(reader.metadata) > copied:
            copied = _copy_metadata(reader, writer, copied)
        writer.add(message)
    _copy_metadata(reader, writer, copied)
    if reader.gone:
        writer.add_metadata(DROPPED, {"messages": str(reader.gone)})


def _copy_metadata(reader: McapReader, writer: McapWriter, copied: int) -> int:
    for name, content in reader.metadata[copied:]:
        writer.add_metadata(name, content)
    return len(reader.metadata)


def _refuse_foreign(reader: McapReader, message: RawMessage) -> None:
    if not (message.topic.craft and message.topic.kind):
        accepted = "a recording made by magcal is accepted, whose channels name craft and kind"
        raise RecordingError([Fault(reader.name, "a channel of another program", accepted)])
