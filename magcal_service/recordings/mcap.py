"""MCAP files: a writer that can end a chunk at any time, and a reader that goes as far as a file is sound.

The format is that of https://mcap.dev/spec, its records are packed by the package ``mcap`` (extra ``record``).  That
package's own writer ends a chunk by size only and gives no way back after a failed write, and its readers end with an
exception of many kinds where a file is cut; hence these two.

Every chunk is written at once and repeats the channels that it uses, so a file that lost its end, or a chunk in its
middle, is readable but for what was lost.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO, Final, NamedTuple

from magcal_service.errors import ExtraMissingError, Fault, RecordingError

try:
    import zstandard
    from mcap.data_stream import ReadDataStream, RecordBuilder
    from mcap.exceptions import McapError
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

MAGIC: Final = b"\x89MCAP0\r\n"
PROFILE: Final = "magcal"

# Names of metadata records: the session's account of itself, a craft's configuration, the state it began with, a hole.
SESSION: Final = "magcal.session"
CRAFT: Final = "magcal.craft"
STATE: Final = "magcal.state"
DROPPED: Final = "magcal.dropped"

MOST_CHANNELS: Final = 65_000
"""A channel's number has 16 bits; a file with this many is full."""

_MOST_IN_CHUNK: Final = 1 << 20
"""A chunk that has this many bytes is ended though its time has not come."""

_LARGEST_RECORD: Final = 1 << 26
"""What a reader takes for a record at most, packed and unpacked: 64 times what the writer makes."""

_SPOILT: Final = (McapError, zstandard.ZstdError, struct.error, ValueError, OverflowError, KeyError)
"""What the package raises for a record that is none."""

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")


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


class McapReader:
    """Reads a file from front to back, as far as it is sound.

    Parameters
    ----------
    file: opened for reading, at its beginning.
    name: what faults call it.

    While ``messages`` is read, these fill: ``topics`` by channel number, ``metadata`` in the order of the file,
    ``good_bytes`` (whole records so far), ``bad_chunks`` and ``bad_records`` (skipped, the rest is read), ``damage``
    (why reading ended early, empty where it did not), ``sound`` (the file is finished and nothing was skipped).

    Raises ``RecordingError`` where the file is no MCAP file at all; nothing else, whatever its bytes.
    """

    def __init__(self, file: BinaryIO, name: str) -> None:
        self._file, self.name = file, name
        self.size = file.seek(0, io.SEEK_END)
        file.seek(0)
        self.topics: dict[int, Topic] = {}
        self.metadata: list[tuple[str, dict[str, str]]] = []
        self.good_bytes = 0
        self.bad_chunks = 0
        self.bad_records = 0
        self.damage = ""
        self.library = ""
        self.profile = ""
        self._schemas: dict[int, Schema] = {}
        self._finished = False

    @property
    def sound(self) -> bool:
        """Whether the whole file could be read, to its closing mark."""
        return self._finished and not (self.bad_chunks or self.bad_records or self.damage)

    def messages(self) -> Iterator[RawMessage]:
        """Every readable message in the order of the file, which is the order in which they were recorded."""
        if self._file.read(len(MAGIC)) != MAGIC:
            accepted = "an MCAP file, as the recorder writes it, is accepted"
            raise RecordingError([Fault(self.name, "not an MCAP file", accepted)])
        self.good_bytes = len(MAGIC)
        for opcode, body in self._top_records():
            if opcode == Opcode.CHUNK:
                yield from self._unpacked(body)
            else:
                yield from self._taken(opcode, body)

    def _top_records(self) -> Iterator[tuple[int, bytes]]:
        while not self._finished:
            head = self._file.read(_HEAD.size)
            if len(head) < _HEAD.size:
                self.damage = "it ends early"
                return
            opcode, length = _HEAD.unpack(head)
            left = self.size - self.good_bytes - _HEAD.size
            if length > min(left, _LARGEST_RECORD):
                self.damage = "it ends within a record" if length <= _LARGEST_RECORD else "a record has no sane length"
                return
            yield opcode, self._file.read(length)
            self.good_bytes += _HEAD.size + length
            if opcode == Opcode.FOOTER:
                self._finished = self._file.read(len(MAGIC)) == MAGIC
                if not self._finished:
                    self.damage = "its closing mark is missing"
                    return
                self.good_bytes += len(MAGIC)

    def _unpacked(self, body: bytes) -> Iterator[RawMessage]:
        """The messages of a chunk; one whose checksum is wrong is skipped as a whole."""
        try:
            records = _unpack(Chunk.read(ReadDataStream(io.BytesIO(body))))
        except _SPOILT:
            self.bad_chunks += 1
            return
        at, end = 0, len(records)
        while end - at >= _HEAD.size:
            opcode, length = _HEAD.unpack_from(records, at)
            at += _HEAD.size
            if length > end - at:
                break
            yield from self._taken(opcode, records[at : at + length])
            at += length
        if at != end:
            self.bad_records += 1

    def _taken(self, opcode: int, body: bytes) -> Iterator[RawMessage]:
        """Remember a schema, channel or metadata; give a message."""
        try:
            if opcode == Opcode.MESSAGE:
                number, sequence, log_time_ns, publish_time_ns = _MESSAGE.unpack_from(body)
                yield RawMessage(self.topics[number], sequence, log_time_ns, publish_time_ns, body[_MESSAGE.size :])
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA, Opcode.HEADER):
                self._remember(opcode, ReadDataStream(io.BytesIO(body)))
        except _SPOILT:
            self.bad_records += 1

    def _remember(self, opcode: int, stream: ReadDataStream) -> None:
        if opcode == Opcode.HEADER:
            header = Header.read(stream)
            self.library, self.profile = header.library, header.profile
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self._schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream)
            schema_name, text = "", b""
            if channel.schema_id in self._schemas:
                schema_name, text = self._schemas[channel.schema_id].name, self._schemas[channel.schema_id].data
            craft, kind = channel.metadata.get("craft", ""), channel.metadata.get("kind", "")
            self.topics[channel.id] = Topic(craft, kind, schema_name, text)
        else:
            metadata = Metadata.read(stream)
            self.metadata.append((metadata.name, metadata.metadata))


def _unpack(chunk: Chunk) -> bytes:
    """A chunk's records; ``ValueError`` where size or checksum is wrong."""
    if chunk.uncompressed_size > _LARGEST_RECORD:
        raise ValueError("larger than any chunk")
    if chunk.compression == "zstd":
        if zstandard.frame_content_size(chunk.data) > chunk.uncompressed_size:
            raise ValueError("unpacks to more than it says")
        unpacked = zstandard.ZstdDecompressor()
        records: bytes = unpacked.decompress(chunk.data, max_output_size=chunk.uncompressed_size)
    elif chunk.compression == "":
        records = chunk.data
    else:
        raise ValueError("an unknown packing")
    if len(records) != chunk.uncompressed_size or chunk.uncompressed_crc not in (0, zlib.crc32(records)):
        raise ValueError("a wrong checksum")
    return records
