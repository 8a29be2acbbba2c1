"""The last counter of sealed commands on disk: a few bytes, replaced as a whole, believed only with their checksum."""

from __future__ import annotations

import re
import zlib
from pathlib import Path

from magcal_service.base.disk import opened_at_once, write_whole
from magcal_service.wire.seal import MAX_COUNTER

_CONTENT = re.compile(rb"magcal counter ([0-9]{1,20}) ([0-9a-f]{8})\n")


class CounterFile:
    """A counter that survives restarts and power cuts.

    Parameters
    ----------
    path: the file; its directory has to be there and to be writable.

    ``last`` is the stored value: 0 where there is no file yet, None where the file is there and not to be believed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.last = self.read()

    def keep(self, value: int) -> None:
        """Store a value for good; ``OSError`` where the disk does not take it, and the old value stays."""
        number = b"%d" % value
        write_whole(self.path, b"magcal counter %s %08x\n" % (number, zlib.crc32(number)), mode=0o600, mark=".new")
        self.last = value

    def read(self) -> int | None:
        """The stored value as it is on disk now, as ``last``."""
        try:
            with open(self.path, "rb", opener=opened_at_once) as file:
                match = _CONTENT.fullmatch(file.read(256) or b"")  # a pipe that is empty gives None
        except FileNotFoundError:
            return 0
        except OSError:
            return None
        if match is None or zlib.crc32(match[1]) != int(match[2], 16):
            return None
        value = int(match[1])
        return value if value <= MAX_COUNTER else None
