"""What is in a session file: time span, counts by craft and kind, provenance, and whether it is sound."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

from magcal_service.base.errors import FileFault, RecordingError
from magcal_service.recordings.mcap import DROPPED, SESSION, dropped_messages
from magcal_service.recordings.mcap_reader import McapReader
from magcal_service.recordings.timestamps import ns_to_iso8601


@dataclass(slots=True)
class KindInfo:
    """One kind of message of one craft.

    Parameters
    ----------
    schema: name of its JSON schema.
    count: records.
    first_ns, last_ns: ``publish_time`` of the first and the last record [ns]: source time where that is UTC.
    """

    craft: str
    kind: str
    schema: str
    count: int
    first_ns: int
    last_ns: int


@dataclass(slots=True)
class SessionInfo:
    """The account of one file.

    Parameters
    ----------
    size_bytes, good_bytes: length of the file, and of what can be read.
    sound: whether it is finished and all of it can be read.
    damage: why not, empty where it is.
    bad_chunks, bad_records: what had to be skipped.
    gone: messages that were in the file and cannot be read, as far as it still says so.
    dropped: messages that the recorder had to leave out, or that were gone when a file was recovered.
    library: what wrote it.
    about: the session's own account: identity, part, versions, digest of the configuration.
    first_ns, last_ns: wall clock [ns] at the first and the last record.
    kinds: counts by craft and kind, in order of appearance.
    """

    file: str
    size_bytes: int
    good_bytes: int = 0
    sound: bool = False
    damage: str = ""
    bad_chunks: int = 0
    bad_records: int = 0
    gone: int = 0
    dropped: int = 0
    library: str = ""
    about: dict[str, str] = field(default_factory=dict)
    first_ns: int = 0
    last_ns: int = 0
    kinds: list[KindInfo] = field(default_factory=list)

    def as_json(self) -> str:
        """The account as one JSON object."""
        return json.dumps(asdict(self), indent=2) + "\n"

    def lines(self) -> list[str]:
        """The account in words."""
        state = "sound" if self.sound else f"NOT SOUND: {self.damage or 'some of it is spoilt'}"
        lines = [f"{self.file}: {self.size_bytes} bytes, {state}"]
        if not self.sound:
            skipped = f"{self.bad_chunks} chunks and {self.bad_records} records skipped, {self.gone} messages gone"
            lines.append(
                f"readable: {self.good_bytes} bytes; {skipped}; magcal record recover makes a sound file of it"
            )
        lines.append(", ".join([f"written by {self.library}", *(f"{key} {text}" for key, text in self.about.items())]))
        count = sum(kind.count for kind in self.kinds)
        if count:
            span = f"{ns_to_iso8601(self.first_ns)} to {ns_to_iso8601(self.last_ns)}"
            lines.append(f"{count} records, {span}, {(self.last_ns - self.first_ns) / 1e9:.1f} s")
        else:
            lines.append("no records")
        if self.dropped:
            lines.append(f"{self.dropped} messages are missing: the recorder could not take them, or they were spoilt")
        for one in self.kinds:
            span = f"{ns_to_iso8601(one.first_ns)} to {ns_to_iso8601(one.last_ns)}"
            lines.append(f"  {one.craft:<16} {one.kind:<14} {one.count:>9}  {one.schema:<26} {span}")
        return lines


def session_info(path: Path) -> SessionInfo:
    """Read a whole file and count; raises ``RecordingError`` where it cannot be read or is no MCAP file."""
    try:
        with path.open("rb") as file:
            return _info(McapReader(file, str(path)))
    except OSError as error:
        raise RecordingError([FileFault(str(path), error, "give a readable recording")]) from None


def _info(reader: McapReader) -> SessionInfo:
    info = SessionInfo(reader.name, reader.size)
    kinds: dict[tuple[str, str], KindInfo] = {}
    for raw in reader.messages():
        key = (raw.topic.craft, raw.topic.kind)
        one = kinds.get(key)
        if one is None:
            one = kinds[key] = KindInfo(*key, raw.topic.schema_name, 0, raw.publish_time_ns, 0)
            info.first_ns = info.first_ns or raw.log_time_ns
        one.count += 1
        one.last_ns = raw.publish_time_ns
        info.last_ns = raw.log_time_ns
    info.kinds = list(kinds.values())
    info.good_bytes, info.sound, info.damage = reader.good_bytes, reader.sound, reader.damage
    info.bad_chunks, info.bad_records, info.library = reader.bad_chunks, reader.bad_records, reader.library
    info.gone = reader.gone
    for name, content in reader.metadata:
        if name == SESSION:
            info.about |= content
        elif name == DROPPED:
            info.dropped += dropped_messages(content)
    return info
