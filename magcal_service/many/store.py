"""Finished pieces on disk, one file each, whole or not there at all."""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import zlib
from pathlib import Path
from typing import Final

from magcal_service.errors import Fault, InputRefusedError, unwritable
from magcal_service.many.pieces import Done

FOLDER: Final = "pieces"
"""Of an output folder: where its finished pieces are."""

_DIGEST_BYTES: Final = 32
_SUFFIX: Final = ".piece"


class Store:
    """A folder of finished pieces.

    Parameters
    ----------
    folder: made where it is not there.
    reuse: whether what is there already counts; otherwise it is written anew.

    Raises ``InputRefusedError`` where the folder cannot be written, or is another user's: reading can run code.
    """

    def __init__(self, folder: Path, *, reuse: bool) -> None:
        self.folder, self.reuse = folder, reuse
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            owner = folder.stat().st_uid
        except OSError as exc:
            raise unwritable(folder, exc) from None
        if owner != os.getuid():
            accepted = "a folder of your own is accepted: what is kept there is run as it is read"
            raise InputRefusedError([Fault(str(folder), f"owned by user {owner}", accepted)])

    def get(self, key: str) -> Done | None:
        """The result kept under a key; None where there is none, or only a damaged one."""
        if not self.reuse:
            return None
        try:
            content = (self.folder / f"{key}{_SUFFIX}").read_bytes()
        except OSError:
            return None
        digest, packed = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
        if hashlib.sha256(packed).digest() != digest:
            return None
        return Done(pickle.loads(zlib.decompress(packed)))

    def put(self, key: str, done: Done) -> None:
        """Keep a result; raises ``InputRefusedError`` where it cannot be written."""
        packed = zlib.compress(pickle.dumps(done.value, protocol=pickle.HIGHEST_PROTOCOL))
        path = self.folder / f"{key}{_SUFFIX}"
        partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
        try:
            with partial.open("wb") as file:
                file.write(hashlib.sha256(packed).digest() + packed)
                file.flush()
                os.fsync(file.fileno())
            os.replace(partial, path)
            _sync(self.folder)
        except OSError as exc:
            with contextlib.suppress(OSError):
                partial.unlink(missing_ok=True)
            raise unwritable(path, exc) from None


def _sync(folder: Path) -> None:
    """Have the renaming on the disk, too."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
