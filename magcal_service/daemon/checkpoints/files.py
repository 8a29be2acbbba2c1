"""Checkpoints: a craft's whole state on disk, so that a restarted daemon continues from it.

A file is replaced in one step (written beside, flushed, renamed, the folder flushed), so it is there whole or not at
all; a SHA-256 over its content detects a file that a failing disk has changed.  Its content is one msgpack map, as in
``SCHEMA``: whose it is (craft, version of magcal, digest of the craft's configuration), what went into it, and plain
data as ``snapshot`` has them.  It is restored only where craft, version and digest agree.

    magcal-state 10\\n    SHA-256 of the rest, 32 bytes        msgpack
    magcal-signed 9\\n   HMAC-SHA256 of the rest, 32 bytes    msgpack    where ``[state] key`` names a key

The key is not that of the configuration but one made from it, so that a line's key may be used here too.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import hmac
import json
import os
import re
import stat
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import msgpack

from magcal_service.base.disk import is_file, opened_itself, write_whole
from magcal_service.base.errors import Fault, FileFault, InputRefusedError, MagcalError, why_not
from magcal_service.base.version import __version__
from magcal_service.config.daemon_settings import StateConfig
from magcal_service.config.private_files import read_key
from magcal_service.config.settings import CraftConfig
from magcal_service.daemon.checkpoints.floor import Floor
from magcal_service.wire.fields import NAME

SIGNED_MAGIC: Final = b"magcal-signed 9\n"
MAGIC: Final = b"magcal-state 10\n"  # 10: since when a jump was followed
_DIGEST_BYTES: Final = 32  # of SHA-256
_LARGEST_BYTES: Final = 64 * 1024 * 1024
"""Far above any craft's state: 0.4 MB with 4096 samples collected towards a start."""

_MOST_NAMED: Final = 16
"""Named checkpoints of a craft; they stay until they are replaced, so their number has to be bounded."""

_UNFINISHED: Final = ".part"

_NUMBERED: Final = re.compile(r"([0-9]{10})\.state")

_LARGEST_NUMBER: Final = 10**10 - 2  # of ten digits, with room for one more

SCHEMA: Final = {
    "craft": str,
    "version": str,
    "config": str,  # hex digest
    "written_s": float,  # UTC, by this machine's clock
    "first_time_ns": int,  # source time of the first and the last sample accepted
    "last_time_ns": int,
    "samples": int,  # accepted since the state began
    "writes": int,  # of all checkpoints of this craft, this one included, since the folder was new
    "written_bytes": int,  # of all those before this one
    "state": dict,  # ``Pipeline.export_state``
}


class StateError(MagcalError):
    """A checkpoint that cannot be used, and why."""


def config_digest(config: CraftConfig) -> str:
    """SHA-256 (hex) of the whole configuration of a craft's magnetometer, defaults included."""
    settings = asdict(config)
    for others in ("magnetometers", "max_sources"):
        del settings[others]
    for name in ("hears", "source"):
        if not settings[name]:
            del settings[name]
    text = json.dumps(settings, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """What a file holds; the fields are those of ``SCHEMA``."""

    craft: str
    version: str
    config: str
    written_s: float
    first_time_ns: int
    last_time_ns: int
    samples: int
    writes: int
    written_bytes: int
    state: dict[str, Any]

    def refusal(self, config: CraftConfig) -> str:
        """Why this is not a state of a craft with this configuration; empty where it is."""
        marks = (
            ("craft", self.craft, config.name),
            ("version", self.version, __version__),
            ("configuration", self.config[:12], config_digest(config)[:12]),
        )
        return "; ".join(f"{what} is {found}, not {own}" for what, found, own in marks if found != own)


def encode(checkpoint: Checkpoint, key: bytes | None = None) -> bytes:
    """The bytes of a file, signed where there is a key."""
    body: bytes = msgpack.packb({name: getattr(checkpoint, name) for name in SCHEMA})
    return (MAGIC if key is None else SIGNED_MAGIC) + _digest(body, key) + body


def decode(raw: bytes, key: bytes | None = None) -> Checkpoint:
    """Decode a file's bytes; ``StateError`` where they are not a whole, unchanged checkpoint of this format.

    With a key, what is not signed by it is refused; without one, what is signed.
    """
    magic, other = (MAGIC, SIGNED_MAGIC) if key is None else (SIGNED_MAGIC, MAGIC)
    if raw.startswith(other):
        raise StateError("signed, and no key is configured" if key is None else "not signed, and a key is configured")
    if not raw.startswith(magic):
        raise StateError("not a checkpoint of this format")
    begin = len(magic) + _DIGEST_BYTES
    body = raw[begin:]
    if not hmac.compare_digest(_digest(body, key), raw[len(magic) : begin]):
        what = "checksum" if key is None else "signature"
        raise StateError(
            f"damaged{'' if key is None else ' or forged'}: the {what} of its {len(body)} bytes does not fit"
        )
    try:
        content = msgpack.unpackb(body, strict_map_key=False)
    except (ValueError, TypeError, msgpack.UnpackException, RecursionError) as error:  # TypeError: a key that is a list
        raise StateError(f"not msgpack: {error}") from None
    if not isinstance(content, dict) or set(content) != set(SCHEMA):
        raise StateError(f"a map of {', '.join(SCHEMA)} is accepted")
    for name, kind in SCHEMA.items():
        if type(content[name]) is not kind:
            raise StateError(f"{name} is {type(content[name]).__name__}; {kind.__name__} is accepted")
    return Checkpoint(**content)


def _digest(body: bytes, key: bytes | None) -> bytes:
    if key is None:
        return hashlib.sha256(body).digest()
    return hmac.digest(hmac.digest(key, b"magcal checkpoints", "sha256"), body, "sha256")


class StateStore:
    """The checkpoints of one craft in its folder: ``DIRECTORY/CRAFT/NUMBER.state`` and ``NAME.named``.

    Those of a magnetometer beside the craft's own are in a folder of that one's: ``DIRECTORY/CRAFT/SOURCE``.

    Parameters
    ----------
    config: where, and how many.
    craft: the craft's name, or what a magnetometer is called (``config.magnetometers.label``).

    Attributes
    ----------
    writes, written_bytes: of this craft's checkpoints since the folder was new, as far as they are known.

    Raises InputRefusedError where a folder cannot be made, ConfigError where the key is none or others can read it.
    """

    def __init__(self, config: StateConfig, craft: str) -> None:
        self._key = None if config.key is None else read_key(config.key)
        self._floor = None if config.counters is None else Floor(config.counters, craft)
        self.folder = config.directory / craft
        self._keep = config.keep
        self.writes = 0 if self._floor is None else self._floor.number
        self.written_bytes = 0
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            with suppress(_HeldError), self._locked():  # another's half-written file is no leftover
                self._sweep()
        except OSError as error:
            fault = FileFault(str(self.folder), error, "a folder that can be written is accepted")
            raise InputRefusedError([fault]) from None

    @contextmanager
    def held(self) -> Iterator[None]:
        """Within, no other daemon keeps its state in this folder; InputRefusedError where one does already."""
        with ExitStack() as stack:
            try:
                stack.enter_context(self._locked())
            except _HeldError:
                accepted = (
                    "a folder in which no other daemon keeps this craft is accepted; stop that one, or give another"
                )
                raise InputRefusedError([Fault("state.directory", str(self.folder), accepted)]) from None
            except OSError as error:
                accepted = "a folder that can be opened is accepted; each craft takes one open file (ulimit -n)"
                raise InputRefusedError([FileFault(str(self.folder), error, accepted)]) from None
            yield

    @contextmanager
    def _locked(self) -> Iterator[None]:
        opened = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            try:
                fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise _HeldError from None
            except OSError:  # some file systems know no locks
                pass
            yield
        finally:
            os.close(opened)

    def _sweep(self) -> None:
        """Remove what a crash left half written."""
        for left in self.folder.glob(f"*{_UNFINISHED}"):
            _remove(left)

    def numbered(self) -> list[Path]:
        """The checkpoints of the rotation, newest first."""
        return sorted((path for path in self.folder.iterdir() if _NUMBERED.fullmatch(path.name)), reverse=True)

    def named(self) -> list[str]:
        """Names of the named checkpoints."""
        return sorted(path.stem for path in self.folder.glob("*.named") if is_file(path))

    def beside(self) -> list[str]:
        """Sources of the magnetometers that have a folder with checkpoints within this one."""
        folders = (path for path in self.folder.iterdir() if path.is_dir() and not path.is_symlink())
        return sorted(path.name for path in folders if NAME.fullmatch(path.name) and any(path.glob("*.state")))

    def write(self, checkpoint: Checkpoint) -> None:
        """Write the newest of the rotation and remove what is older than the ``keep`` newest; OSError is the disk's."""
        last = self.numbered()
        while last and int(last[0].stem) >= _LARGEST_NUMBER:  # not one of ours
            self.set_aside(last.pop(0).name)
        number = int(last[0].stem) + 1 if last else 1
        self._replace(self.folder / f"{number:010d}.state", checkpoint)
        for old in self.numbered()[self._keep :]:
            _remove(old)
        if self._floor is not None:
            self._floor.written(checkpoint.writes)

    def set_aside(self, name: str) -> None:
        """Take a checkpoint that cannot be used out of the rotation, as ``NUMBER.dropped``: none is counted from it."""
        path = self.folder / name
        with suppress(OSError):
            path.replace(path.with_suffix(".dropped"))

    def write_named(self, name: str, checkpoint: Checkpoint) -> None:
        """Write a checkpoint under a name, in place of an earlier one of that name.

        Raises StateError for a name that is not accepted or one too many; OSError is the disk's.
        """
        path = self._path_of(name)
        if not is_file(path) and len(self.named()) >= _MOST_NAMED:
            raise StateError(
                f"{_MOST_NAMED} named checkpoints are there already: {', '.join(self.named())}; use one of them"
            )
        self._replace(path, checkpoint)

    def read_named(self, name: str) -> Checkpoint:
        """The checkpoint of a name; ``StateError`` where there is none that can be used."""
        path = self._path_of(name)
        if not is_file(path):
            raise StateError(f"no checkpoint {name!r}; there are: {', '.join(self.named()) or 'none'}")
        return self._read(path)

    def newest(self) -> Iterator[tuple[str, Checkpoint | StateError]]:
        """Name and content of each checkpoint of the rotation, newest first, or why it cannot be used."""
        for path in self.numbered():
            try:
                checkpoint = self._read(path)
            except StateError as error:
                yield path.name, error
                continue
            self.writes = max(self.writes, checkpoint.writes)
            self.written_bytes = max(self.written_bytes, checkpoint.written_bytes + path.stat().st_size)
            refusal = "" if self._floor is None else self._floor.refusal(checkpoint.writes)
            yield path.name, StateError(refusal) if refusal else checkpoint

    def _path_of(self, name: str) -> Path:
        if not NAME.fullmatch(name):
            raise StateError(f"name {name!r} is refused; 1 to 32 characters of A-Z a-z 0-9 _ - are accepted")
        return self.folder / f"{name}.named"

    def _read(self, path: Path) -> Checkpoint:
        try:
            with open(path, "rb", opener=opened_itself) as file:
                _refuse_anybodys(os.fstat(file.fileno()))
                raw = file.read(_LARGEST_BYTES + 1)
        except OSError as error:
            raise StateError("a link, not a file" if error.errno == errno.ELOOP else why_not(error)) from None
        if len(raw) > _LARGEST_BYTES:
            raise StateError(f"larger than {_LARGEST_BYTES} bytes")
        return decode(raw, self._key)

    def _replace(self, path: Path, checkpoint: Checkpoint) -> None:
        raw = encode(checkpoint, self._key)
        write_whole(path, raw, mode=0o600, mark=_UNFINISHED)
        self.writes += 1
        self.written_bytes += len(raw)


class _HeldError(Exception):
    """Another daemon holds the folder."""


def _remove(path: Path) -> None:
    """Remove what is in the way, but for a folder, which nobody but people makes."""
    with suppress(IsADirectoryError):
        path.unlink()


def _refuse_anybodys(status: os.stat_result) -> None:
    """``StateError`` for what is no file, such as a pipe, and for a file that everybody could have written."""
    if not stat.S_ISREG(status.st_mode):
        raise StateError("not a file")
    if status.st_mode & stat.S_IWOTH:
        raise StateError(f"everybody can write it (mode {stat.S_IMODE(status.st_mode):04o})")


def utc_s() -> float:
    """This machine's clock [s since 1970]: a label, never used in arithmetic."""
    return time.time()
