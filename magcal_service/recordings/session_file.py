"""One file of a session being written: messages as MCAP, whole up to the last flush whatever happens.

The recorder opens one after the other (``recorder``); their folder is ``session_files``.
"""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import BinaryIO, Final

from magcal_service.config.settings import CraftConfig
from magcal_service.config.text import craft_as_toml
from magcal_service.recordings.json_form import schema_name, schema_of, to_json
from magcal_service.recordings.mcap import CRAFT, DROPPED, SESSION, STATE, RawMessage, Topic
from magcal_service.recordings.mcap_writer import McapWriter
from magcal_service.recordings.session_files import LIBRARY
from magcal_service.wire.kinds import KIND_BY_CODE, kind_of
from magcal_service.wire.messages import Clock, Message

_LARGEST_TIME: Final = (1 << 63) - 1  # [ns] of the wire (INT64); a negative time cannot stand in MCAP either


@cache
def _topic(craft: str, code: int) -> Topic:
    kind = KIND_BY_CODE[code]
    return Topic(craft, kind.name, schema_name(kind), json.dumps(schema_of(kind)).encode())


class SessionFile:
    """One file of a session being written; every method passes ``OSError`` on.

    Parameters
    ----------
    path, file: the file, new and open.
    about: the session's metadata.
    crafts: whose configurations are written before the first message of each.
    states: of craft that did not begin from nothing, as text by source of the magnetometer (empty: the craft's own);
        taken out of it with the first message of each.
    """

    def __init__(
        self,
        path: Path,
        file: BinaryIO,
        about: dict[str, str],
        crafts: dict[str, CraftConfig],
        states: dict[str, dict[str, str]] | None = None,
    ) -> None:
        self.path, self._file = path, file
        self._crafts, self._states = dict(crafts), {} if states is None else states
        self._last_ns = 0
        self.taken = 0
        self._saved = 0
        self.opened_s = time.monotonic()
        self._writer = McapWriter(file, LIBRARY)
        self._writer.add_metadata(SESSION, about)

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._writer.good_bytes

    @property
    def full(self) -> bool:
        """Whether the format takes no more channels."""
        return self._writer.full

    def add(self, now_ns: int, message: Message) -> None:
        """Append one message, recorded at the wall clock ``now_ns`` [ns].

        Raises ``DecodeError`` where JSON cannot hold it.  ``log_time`` never goes back within a file, so order by time
        is order of recording whatever the clock does.
        """
        data = to_json(message)
        self.taken += 1
        craft = self._crafts.pop(message.craft, None)
        if craft is not None:
            self._writer.add_metadata(CRAFT, {"name": craft.name, "configuration": craft_as_toml(craft)})
        for source, state in self._states.pop(message.craft, {}).items():
            whose = {"craft": message.craft, **({"source": source} if source else {})}
            self._writer.add_metadata(STATE, {**whose, "state": state})
        self._last_ns = max(self._last_ns, now_ns)
        published = message.clock is Clock.UTC and 0 <= message.time_ns <= _LARGEST_TIME
        publish_ns = message.time_ns if published else self._last_ns
        topic = _topic(message.craft, kind_of(message).code)
        self._writer.add(RawMessage(topic, message.sequence, self._last_ns, publish_ns, data))

    def note_dropped(self, count: int) -> None:
        """Mark a hole: ``count`` messages are missing between those added before and the next one."""
        self._writer.add_metadata(DROPPED, {"messages": str(count)})

    def flush(self) -> int:
        """Write the open chunk to the disk, so that it survives a crash; how many more messages do so now."""
        if self.taken > self._saved:
            self._writer.end_chunk()
            os.fdatasync(self._file.fileno())
        return self._newly_saved()

    def close(self) -> int:
        """Finish the file: it is sound and can be searched; the count is that of ``flush``."""
        self._writer.finish()
        os.fdatasync(self._file.fileno())
        self._file.close()
        return self._newly_saved()

    def _newly_saved(self) -> int:
        before, self._saved = self._saved, self._writer.messages
        return self._saved - before

    def abandon(self) -> tuple[int, int]:
        """Close after a failed write, with what is whole; how many messages were kept since the last flush and lost."""
        kept, lost = self._newly_saved(), self.taken - self._writer.messages
        self._writer.discard()
        with suppress(OSError):
            self._file.truncate(self._writer.good_bytes)
            self._file.seek(self._writer.good_bytes)
            self._writer.finish()
        with suppress(OSError):
            self._file.truncate(self._writer.good_bytes)
        with suppress(OSError):
            self._file.close()
        return kept, lost
