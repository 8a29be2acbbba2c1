"""How much of a recorded session is read at most: a packed one may be thousands of times what its file is."""

from __future__ import annotations

from typing import Final, NoReturn

from magcal_service.base.errors import Fault, RecordingError
from magcal_service.recordings.mcap import INDEX_ENTRY_BYTES

_AT_LEAST: Final = 1 << 24  # 16 MiB
_TIMES: Final = 64
"""All chunks together may have so many times the file's bytes and ``_AT_LEAST``; choice: what the recorder writes has
3 to 8 times, a sensor that is stuck included, since each message has 16 bytes in an index."""

_MOST_UNSTATED: Final = 1 << 16
"""Messages beyond what the indices of a file of its size can state; choice: a dozen chunks that have lost theirs."""


class McapLimits:
    """The most that is taken of one file; each check raises ``RecordingError`` beyond it.

    Parameters
    ----------
    name: what faults call the file.
    size: its bytes.
    """

    def __init__(self, name: str, size: int) -> None:
        self._name, self._size = name, size
        self.most_messages = size // INDEX_ENTRY_BYTES + _MOST_UNSTATED
        self._most_bytes = _AT_LEAST + _TIMES * size
        self._bytes = 0

    def count_bytes(self, count: int) -> None:
        """Count the bytes of one more chunk, unpacked."""
        self._bytes += count
        if self._bytes > self._most_bytes:
            accepted = (
                f"at most {_TIMES} times the file and {_AT_LEAST} bytes more are accepted, "
                "what magcal records has 3 to 8 times"
            )
            self._refuse(f"{self._size} bytes that unpack to more than {self._most_bytes}", accepted)

    def refuse_messages(self) -> NoReturn:
        """Refuse a file that has more than ``most_messages``."""
        accepted = (
            f"one for each {INDEX_ENTRY_BYTES} bytes, which its index takes, and {_MOST_UNSTATED} more are accepted"
        )
        self._refuse(f"more than {self.most_messages} messages in {self._size} bytes", accepted)

    def _refuse(self, value: str, accepted: str) -> NoReturn:
        remedy = "do not trust this file, take a copy from where it was recorded"
        raise RecordingError([Fault(self._name, value, f"{accepted}; {remedy}")])
