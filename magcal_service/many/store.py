"""Finished pieces on disk, one file each, whole or not there at all."""

from __future__ import annotations

import hashlib
import zlib
from pathlib import Path
from typing import Final

from magcal_service.base.disk import write_whole
from magcal_service.base.errors import unwritable
from magcal_service.many.pieces import Done
from magcal_service.many.plain import NotKnownError, pack, unpack

FOLDER: Final = "pieces"
"""Of an output folder: where its finished pieces are."""

_DIGEST_BYTES: Final = 32  # of SHA-256
_SUFFIX: Final = ".piece"


class Store:
    """A folder of finished pieces.

    Parameters
    ----------
    folder: made where it is not there.
    reuse: whether what is there already counts; otherwise it is written anew.

    Raises ``InputRefusedError`` where the folder cannot be made.
    """

    def __init__(self, folder: Path, *, reuse: bool) -> None:
        self.folder, self.reuse = folder, reuse
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as exc:
            raise unwritable(folder, exc) from None

    def get(self, key: str) -> Done | None:
        """The result kept under a key; None where there is none, or only one that cannot be read."""
        if not self.reuse:
            return None
        try:
            content = (self.folder / f"{key}{_SUFFIX}").read_bytes()
        except OSError:
            return None
        digest, packed = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
        if hashlib.sha256(packed).digest() != digest:
            return None
        try:
            return Done(unpack(zlib.decompress(packed)))
        except NotKnownError:
            return None

    def put(self, key: str, done: Done) -> None:
        """Keep a result; raises ``InputRefusedError`` where it cannot be written, ``TypeError`` for what is no data."""
        packed = zlib.compress(pack(done.value))
        path = self.folder / f"{key}{_SUFFIX}"
        try:
            write_whole(path, hashlib.sha256(packed).digest() + packed)
        except OSError as exc:
            raise unwritable(path, exc) from None
