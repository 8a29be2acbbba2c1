"""Who may read the keys and write the state: checked before anything is opened.

Each check raises ``ConfigError`` with one line: file, mode, what is accepted.
"""

from __future__ import annotations

import binascii
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from magcal_service.base.disk import opened_at_once
from magcal_service.base.errors import ConfigError, Fault, FileFault

__all__ = [
    "MIN_KEY_BYTES",
    "check_input",
    "check_secret",
    "check_state_directory",
    "check_unaltered",
    "check_way",
    "read_key",
]

MIN_KEY_BYTES: Final = 16  # 128 bits: fewer can be searched
MAX_KEY_BYTES: Final = 64  # a longer one is hashed by HMAC to 32 bytes anyway

_MOST_LINKS: Final = 40  # on the way to a file, as in the kernel

_OTHERS: Final = stat.S_IRWXO
_GROUP: Final = stat.S_IRWXG
_MAKE_KEY: Final = "make one with: (umask 077; openssl rand -hex 32 >FILE)"


def check_secret(path: Path) -> None:
    """Refuse a private key, a password file or the like that others than its owner can read.

    Its group may read it where that is root's: systemd hands credentials over with an access list, which shows as such.
    """
    _refuse_open_secret(path, _status(path))


def check_unaltered(path: Path) -> None:
    """Refuse a configuration that everybody could rewrite: it lists the nodes that may connect."""
    mode = _status(path).st_mode
    if mode & stat.S_IWOTH:
        raise _fault(path, mode, "a file that not everybody can write is accepted; mend it with: chmod o-w FILE")


def check_input(path: Path) -> None:
    """Refuse a file that the daemon acts on where everybody could rewrite it or put another in its place."""
    check_way(path)
    if not stat.S_ISREG(_status(path).st_mode):
        raise ConfigError([Fault(str(path), "not a file", "a file is accepted")])
    check_unaltered(path)


def check_way(path: Path) -> None:
    """Refuse a path on which anybody could put another folder, link or file in place of one that is there.

    That is so in a folder above it, or above a link on the way, that everybody can write.  Where that one is sticky,
    as ``/tmp``, what the daemon's user or root owns in it is safe.  What is not there yet ends the way.
    """
    for place in _way(path.absolute()):
        mode, owner = _status(place.parent).st_mode, place.lstat().st_uid
        if not mode & stat.S_IWOTH:
            continue
        if not mode & stat.S_ISVTX:
            accepted = f"above {path}, a folder that not everybody can write is accepted; mend it with: chmod o-w FILE"
            raise _fault(place.parent, mode, accepted)
        if owner not in (0, os.geteuid()):
            accepted = (
                f"on the way to {path}, in a folder that everybody can write, one of the daemon's user is accepted"
            )
            raise ConfigError([Fault(str(place), f"owner {owner}", accepted)])


def _way(path: Path) -> Iterator[Path]:
    """Each folder, link and file on the way from the root to a path, links followed, as far as they are there.

    What is above each of them is a folder itself, no link.
    """
    at, left, links = Path("/"), list(reversed(path.parts[1:])), 0
    while left:
        name = left.pop()
        if name == "..":
            at = at.parent
            continue
        one = at / name
        try:
            mode = one.lstat().st_mode
        except FileNotFoundError:
            return
        except OSError as error:
            raise _unreadable(one, error) from None
        yield one
        if not stat.S_ISLNK(mode):
            at = one
            continue
        links += 1
        if links > _MOST_LINKS:
            raise ConfigError([Fault(str(path), "links in a circle", "a readable file is required")])
        target = one.readlink()
        at = Path("/") if target.is_absolute() else at
        left += reversed(target.parts[1:] if target.is_absolute() else target.parts)


def check_state_directory(path: Path) -> None:
    """Refuse a directory for state that everybody could write: what is restored from it has to be the daemon's own."""
    status = _status(path)
    if not stat.S_ISDIR(status.st_mode):
        raise ConfigError([Fault(str(path), "not a directory", "a directory is accepted")])
    if status.st_mode & stat.S_IWOTH:
        raise _fault(path, status.st_mode, "a directory that not everybody can write is accepted; chmod 0700 is best")


def read_key(path: Path) -> bytes:
    """The key in a file that nobody else can read: ``MIN_KEY_BYTES`` to ``MAX_KEY_BYTES`` bytes in hexadecimal."""
    try:
        with open(path, "rb", opener=opened_at_once) as file:
            _refuse_open_secret(path, os.fstat(file.fileno()))
            text = file.read(4 * MAX_KEY_BYTES)
    except OSError as error:
        raise _unreadable(path, error) from None
    try:
        key = binascii.unhexlify(text.strip())
    except ValueError:
        raise ConfigError([Fault(str(path), "no hexadecimal text", f"a key is hexadecimal; {_MAKE_KEY}")]) from None
    if not MIN_KEY_BYTES <= len(key) <= MAX_KEY_BYTES:
        accepted = f"{MIN_KEY_BYTES} to {MAX_KEY_BYTES} bytes are accepted; {_MAKE_KEY}"
        raise ConfigError([Fault(str(path), f"a key of {len(key)} bytes", accepted)])
    return key


def _refuse_open_secret(path: Path, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise ConfigError([Fault(str(path), "not a file", "a file with the secret in it is accepted")])
    shared = _OTHERS if status.st_gid == 0 else _OTHERS | _GROUP
    if status.st_mode & shared:
        raise _fault(path, status.st_mode, "a secret that its owner alone can read is accepted; chmod 0600 FILE")


def _status(path: Path) -> os.stat_result:
    try:
        return path.stat()
    except OSError as error:
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: OSError) -> ConfigError:
    return ConfigError([FileFault(str(path), error, "a readable file is required")])


def _fault(path: Path, mode: int, accepted: str) -> ConfigError:
    return ConfigError([Fault(str(path), f"mode {stat.S_IMODE(mode):04o}", accepted.replace("FILE", str(path)))])
