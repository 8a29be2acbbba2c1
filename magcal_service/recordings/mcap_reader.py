"""A reader of MCAP files that goes as far as a file is sound, and never further."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from typing import BinaryIO, Final

from magcal_service.errors import ExtraMissingError, Fault, RecordingError
from magcal_service.recordings.mcap import MAGIC, RawMessage, Topic

try:
    import zstandard
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import McapError
    from mcap.opcode import Opcode
    from mcap.records import (
        Channel,
        Chunk,
        Header,
        Metadata,
        Schema,
    )
except ImportError as error:
    raise ExtraMissingError("mcap", "record", "a recording in MCAP") from error

_LARGEST_RECORD: Final = 1 << 26
"""What a reader takes for a record at most, packed and unpacked: 64 times what the writer makes."""

_SPOILT: Final = (McapError, zstandard.ZstdError, struct.error, ValueError, OverflowError, KeyError)
"""What the package raises for a record that is none."""

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")


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
