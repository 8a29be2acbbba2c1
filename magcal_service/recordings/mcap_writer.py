"""A writer of MCAP files that can end a chunk at any time, and go back after a failed write."""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO, Final, NamedTuple

from magcal_service.base.errors import ExtraMissingError
from magcal_service.recordings.mcap import MAGIC, PROFILE, RawMessage, Topic

try:
    import zstandard
    from mcap.data_stream import RecordBuilder
    from mcap.opcode import Opcode
    from mcap.records import (
        Channel,
        Chunk,
        ChunkIndex,
        DataEnd,
        Footer,
        Header,
        MessageIndex,
        Metadata,
        MetadataIndex,
        Schema,
        Statistics,
        SummaryOffset,
    )
except ImportError as error:
    raise ExtraMissingError("mcap", "record", "a recording in MCAP") from error

if TYPE_CHECKING:
    from mcap.records import McapRecord

MOST_CHANNELS: Final = 65_000
"""A channel's number has 16 bits; a file with this many is full."""

_MOST_IN_CHUNK: Final = 1 << 20
"""A chunk that has this many bytes is ended though its time has not come."""

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")


@dataclass(slots=True)
class _Open:
    """The chunk that is being filled."""

    records: bytearray = field(default_factory=bytearray)
    index: dict[int, list[tuple[int, int]]] = field(default_factory=lambda: defaultdict(list))


class McapWriter:
    """Writes one file; what is not ended with ``end_chunk`` is still in memory.

    Parameters
    ----------
    file: a file without a buffer of its own, at its beginning.
    library: name and version of the program that writes.

    ``OSError`` of the file is passed on.  ``good_bytes`` is then the length of what is whole: cut the file there and
    call ``finish`` for a sound file without the chunk that failed.
    """

    def __init__(self, file: BinaryIO, library: str) -> None:
        self._file = file
        self._zstd = zstandard.ZstdCompressor()
        self.good_bytes = 0
        self.messages = 0
        self._open = _Open()
        self._channels: dict[Topic, Channel] = {}
        self._schemas: dict[tuple[str, bytes], Schema] = {}
        self._in_file: set[int] = set()  # schemas that a chunk of this file holds
        self._chunks = bytearray()  # their index records, packed: a day of chunks is a tenth of what objects would be
        self._chunk_count = 0
        self._span: tuple[int, int] | None = None  # first and last log time
        self._metadata: list[MetadataIndex] = []
        self._counts: dict[int, int] = defaultdict(int)
        builder = RecordBuilder()
        builder.write(MAGIC)
        Header(PROFILE, library).write(builder)
        self._write(builder)

    @property
    def full(self) -> bool:
        """Whether another channel might not find a number."""
        return len(self._channels) >= MOST_CHANNELS

    def channel(self, topic: Topic) -> int:
        """The number of a topic's channel, which is made where there is none yet."""
        channel = self._channels.get(topic)
        if channel is None:
            key = (topic.schema_name, topic.schema)
            schema = self._schemas.get(key)
            if schema is None:
                schema = Schema(len(self._schemas) + 1, topic.schema, "jsonschema", topic.schema_name)
                self._schemas[key] = schema
            metadata = {"craft": topic.craft, "kind": topic.kind}
            channel = Channel(len(self._channels) + 1, topic.name, "json", metadata, schema.id)
            self._channels[topic] = channel
        return channel.id

    def add_metadata(self, name: str, content: dict[str, str]) -> None:
        """Write a metadata record, after the chunk that is being filled."""
        self.end_chunk()
        builder = RecordBuilder()
        Metadata(name, content).write(builder)
        self._metadata.append(MetadataIndex(self.good_bytes, builder.count, name))
        self._write(builder)

    def add(self, message: RawMessage) -> None:
        """Put a message into the open chunk; ends the chunk where it is large enough."""
        number = self.channel(message.topic)
        records = self._open.records
        if number not in self._open.index:
            self._introduce(self._channels[message.topic])
        self._open.index[number].append((message.log_time_ns, len(records)))
        records += _HEAD.pack(Opcode.MESSAGE, _MESSAGE.size + len(message.data))
        records += _MESSAGE.pack(number, message.sequence, message.log_time_ns, message.publish_time_ns)
        records += message.data
        if len(records) >= _MOST_IN_CHUNK:
            self.end_chunk()

    def _introduce(self, channel: Channel) -> None:
        """Channels stand in every chunk that uses them; a schema, larger, in the first."""
        builder = RecordBuilder()
        if channel.schema_id not in self._in_file:
            next(schema for schema in self._schemas.values() if schema.id == channel.schema_id).write(builder)
            self._in_file.add(channel.schema_id)
        channel.write(builder)
        self._open.records += builder.end()

    def end_chunk(self) -> None:
        """Write what was added since the last call as one chunk with its index."""
        records, index = bytes(self._open.records), self._open.index
        if not index:
            return
        self._open = _Open()
        times = [log_time_ns for entries in index.values() for log_time_ns, _ in entries]
        packed = self._zstd.compress(records)
        builder = RecordBuilder()
        Chunk("zstd", packed, max(times), min(times), zlib.crc32(records), len(records)).write(builder)
        length = builder.count
        offsets = {}
        for number, entries in index.items():
            offsets[number] = self.good_bytes + builder.count
            MessageIndex(number, entries).write(builder)
        entry = ChunkIndex(
            chunk_length=length,
            chunk_start_offset=self.good_bytes,
            compression="zstd",
            compressed_size=len(packed),
            message_end_time=max(times),
            message_index_length=builder.count - length,
            message_index_offsets=offsets,
            message_start_time=min(times),
            uncompressed_size=len(records),
        )
        self._write(builder)
        entry.write(builder)
        self._chunks += builder.end()
        self._chunk_count += 1
        first, last = self._span or (min(times), max(times))
        self._span = min(first, min(times)), max(last, max(times))
        for number, entries in index.items():
            self._counts[number] += len(entries)
        self.messages += len(times)

    def discard(self) -> None:
        """Forget the open chunk, because the file takes no more."""
        self._open = _Open()

    def finish(self) -> None:
        """End the last chunk and write the summary that lets a reader seek; the file stays open."""
        self.end_chunk()
        builder = RecordBuilder()
        DataEnd(0).write(builder)
        start = self.good_bytes + builder.count
        summary = self._summary(start)
        offset_start = start + summary.offset_at
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
        builder.write(summary.data)
        Footer(start, offset_start, zlib.crc32(footer, zlib.crc32(summary.data))).write(builder)
        builder.write(MAGIC)
        self._write(builder)

    def _summary(self, start: int) -> _Summary:
        builder = RecordBuilder()
        groups: tuple[tuple[Opcode, list[McapRecord]], ...] = (
            (Opcode.SCHEMA, list(self._schemas.values())),
            (Opcode.CHANNEL, list(self._channels.values())),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.METADATA_INDEX, list(self._metadata)),
        )
        offsets = []
        for opcode, records in groups:
            at = builder.count
            for record in records:
                record.write(builder)
            if records:
                offsets.append(SummaryOffset(opcode, start + at, builder.count - at))
        if self._chunks:
            offsets.append(SummaryOffset(Opcode.CHUNK_INDEX, start + builder.count, len(self._chunks)))
            builder.write(self._chunks)
        offset_at = builder.count
        for offset in offsets:
            offset.write(builder)
        return _Summary(builder.end(), offset_at)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=self._chunk_count,
            message_count=self.messages,
            metadata_count=len(self._metadata),
            message_start_time=(self._span or (0, 0))[0],
            message_end_time=(self._span or (0, 0))[1],
            schema_count=len(self._schemas),
        )

    def _write(self, builder: RecordBuilder) -> None:
        """All of it or ``OSError``: a file that is nearly full takes a part first."""
        data = memoryview(builder.end())
        written = 0
        while written < len(data):
            written += self._file.write(data[written:])
        self.good_bytes += written


class _Summary(NamedTuple):
    data: bytes
    offset_at: int
