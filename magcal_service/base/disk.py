"""Files on a disk: whole or not there at all, for readers at once and after a power cut as well."""

from __future__ import annotations

import os
import resource
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

_OTHER_FILES: Final = 256  # choice: a daemon has 30 open, and up to 64 readers of its metrics


@contextmanager
def beside(path: Path, *, mode: int = 0o666, mark: str = "") -> Iterator[Path]:
    """A name beside ``path`` to write its content under, which takes the place of ``path`` where the block ends.

    The file is brought to the disk, renamed, and its folder is brought to the disk, in this order: there is the old
    file or the new one at any time.  Where the block or the disk fails, the old one stays and nothing is left beside.

    Parameters
    ----------
    path: the file; its folder is there.
    mode: permissions from the first byte on, less those that the process masks.
    mark: ends the name beside, where only one process writes the file: what a crash has left is then written over.
        Else the name is this process's own.

    Raises OSError where the disk does not take it.
    """
    part = path.with_name(path.name + mark) if mark else path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.unlink(missing_ok=True)  # whatever it is: a link would be followed, and a pipe waited for
        os.close(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode))
        yield part
        _sync(part, os.O_RDONLY)
        os.replace(part, path)
    except BaseException:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def write_whole(path: Path, content: bytes, *, mode: int = 0o666, mark: str = "") -> None:
    """Write a file as a whole, over what is there; the parameters and errors of ``beside``."""
    with beside(path, mode=mode, mark=mark) as part:
        part.write_bytes(content)


def sync_folder(path: Path) -> None:
    """Make the names in a folder survive a power cut; ``OSError`` where the disk does not take them."""
    _sync(path, os.O_RDONLY | os.O_DIRECTORY)


def is_file(path: Path) -> bool:
    """Whether a file is there itself: no link, no pipe, no device, no folder."""
    with suppress(OSError):
        return stat.S_ISREG(path.lstat().st_mode)
    return False


def opened_at_once(path: str, flags: int) -> int:
    """For ``open``: without waiting for a pipe's other end."""
    return os.open(path, flags | os.O_NONBLOCK, 0o666)


def opened_itself(path: str, flags: int) -> int:
    """For ``open``: at once, and what is there itself, not what a link leads to."""
    return opened_at_once(path, flags | os.O_NOFOLLOW)


def allow_open_files(more: int) -> None:
    """Let this process open so many files more, as far as its limit may be raised; else opening them says so."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = _OTHER_FILES + more
    if soft != resource.RLIM_INFINITY and soft < needed:
        with suppress(OSError, ValueError):  # a service manager may forbid it
            most = needed if hard == resource.RLIM_INFINITY else min(needed, hard)
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def _sync(path: Path, flags: int) -> None:
    opened = os.open(path, flags)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)
