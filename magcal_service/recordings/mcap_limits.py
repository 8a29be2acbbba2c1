"""How much of a recorded session is read at most: a packed one may be thousands of times what its file is."""

from __future__ import annotations

from typing import Final, NoReturn

from magcal_service.base.errors import Fault, RecordingError
from magcal_service.recordings.mcap import INDEX_ENTRY_BYTES

_AT_LEAST: Final = 1 << 24  # 16 MiB
_TIMES: Final = 64
"""All chunks together may have so many times the file's bytes and ``_AT_LEAST``; choice: what the recorder writes has
3 to 8 times, a sensor that is stuck included, since each message has 16 bytes in an index; nothing but the longest
statuses, from one second to the next all alike, has 30."""

_UNUSED_TIMES: Final = 4
"""The same of what is no message, schema or channel; choice: what the recorder writes has none."""

_TRIED_TIMES: Final = 4
"""Chunks unpacked to find out whether they are sound, in the same measure; each is tried three times at most."""

_MOST_INTRODUCED: Final = 1 << 16
"""Schemas and channels that differ from the one of their number before; the writer ends a file with 65 000."""

LONGEST_MESSAGE: Final = 1 << 16
"""Bytes of one record in a chunk; choice: five times the longest payload of the wire, which JSON makes longer."""

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
        self._bytes = self._tried = self._unused = self._introduced = 0

    def count_bytes(self, count: int, end: int) -> None:
        """Count the bytes of one more chunk up to ``end``, unpacked; what stands behind does not excuse it."""
        self._bytes += count
        most = _AT_LEAST + _TIMES * end
        if self._bytes > most:
            accepted = (
                f"at most {_TIMES} times the file and {_AT_LEAST} bytes more are accepted, "
                "what magcal records has 3 to 8 times"
            )
            self._refuse(f"{end} of {self._size} bytes that unpack to more than {most}", accepted)

    def count_tried(self, count: int, end: int) -> None:
        """Count the bytes that a chunk would unpack to, before it is known to be sound."""
        self._tried += count
        most = _TRIED_TIMES * (_AT_LEAST + _TIMES * end)
        if self._tried > most:
            accepted = f"at most {most} bytes are unpacked in search of what is sound in it"
            self._refuse(f"{self._size} bytes with spoilt chunks that unpack to more than {most}", accepted)

    def count_introduced(self, count: int, end: int) -> None:
        """Count a schema or channel that is new or says something new."""
        self._introduced += 1
        if self._introduced > _MOST_INTRODUCED:
            accepted = f"at most {_MOST_INTRODUCED} are accepted"
            self._refuse(f"more than {_MOST_INTRODUCED} channels and schemas in {self._size} bytes", accepted)
        self.count_unused(count, end)

    def count_unused(self, count: int, end: int) -> None:
        """Count bytes of a chunk up to ``end`` that are no message."""
        self._unused += count
        most = _AT_LEAST + _UNUSED_TIMES * end
        if self._unused > most:
            accepted = (
                f"at most {_UNUSED_TIMES} times the file and {_AT_LEAST} bytes of what is no message are accepted"
            )
            self._refuse(f"{end} of {self._size} bytes that unpack to more than {most} of padding", accepted)

    def refuse_messages(self) -> NoReturn:
        """Refuse a file that has more than ``most_messages``."""
        accepted = (
            f"one for each {INDEX_ENTRY_BYTES} bytes, which its index takes, and {_MOST_UNSTATED} more are accepted"
        )
        self._refuse(f"more than {self.most_messages} messages in {self._size} bytes", accepted)

    def _refuse(self, value: str, accepted: str) -> NoReturn:
        remedy = "do not trust this file, take a copy from where it was recorded"
        raise RecordingError([Fault(self._name, value, f"{accepted}; {remedy}")])
