"""MCAP files: what ``mcap_writer``, which can end a chunk at any time, and ``mcap_reader`` have in common.

The format is that of https://mcap.dev/spec, its records are packed by the package ``mcap`` (extra ``record``).  That
package's own writer ends a chunk by size only and gives no way back after a failed write, and its readers end with an
exception of many kinds where a file is cut; hence these two.

Every chunk is written at once and repeats the channels that it uses, so a file that lost its end, or a chunk in its
middle, is readable but for what was lost.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

MAGIC: Final = b"\x89MCAP0\r\n"
PROFILE: Final = "magcal"

# Names of metadata records: the session's account of itself, a craft's configuration, the state it began with, a hole.
SESSION: Final = "magcal.session"
CRAFT: Final = "magcal.craft"
STATE: Final = "magcal.state"
DROPPED: Final = "magcal.dropped"

INDEX_ENTRY_BYTES: Final = 16
"""Of each message in the index behind its chunk: two numbers of 8 bytes, time and place."""

MOST_MISSING: Final = 10**12
"""Messages that a file may say are missing, whatever a damaged or hostile one says: more than any has had."""

_MOST_DIGITS: Final = 18  # of a hole's count


class Topic(NamedTuple):
    """What a channel carries: one kind of message of one craft, with the JSON schema of its messages."""

    craft: str
    kind: str
    schema_name: str
    schema: bytes

    @property
    def name(self) -> str:
        """The channel's topic, such as ``/magcal/demo/magnetometer``."""
        return f"/magcal/{self.craft}/{self.kind}"


class RawMessage(NamedTuple):
    """One recorded message as it stands in the file; times are UTC [ns]."""

    topic: Topic
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    data: bytes


def dropped_messages(content: Mapping[str, str]) -> int:
    """How many messages a ``DROPPED`` record says are missing; 0 where it says no number."""
    digits = content.get("messages", "")
    return int(digits[:_MOST_DIGITS]) if digits.isdecimal() else 0
