"""A reader of MCAP files: everything in a file that is sound, what stands behind damage included."""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

from magcal_service.base.errors import ExtraMissingError, Lacking, RecordingError
from magcal_service.base.progress import Work, counted
from magcal_service.recordings.mcap import INDEX_ENTRY_BYTES, MAGIC, MOST_MISSING, RawMessage, Topic
from magcal_service.recordings.mcap_limits import LONGEST_MESSAGE, McapLimits
from magcal_service.recordings.mcap_records import (
    CHUNK_HEAD,
    INDEX_HEAD,
    LARGEST_RECORD,
    SPOILT,
    checked,
    chunk_of,
    strict,
    unpack,
    unpacked_size,
)

try:
    from mcap.data_stream import ReadDataStream
    from mcap.opcode import Opcode
    from mcap.records import Channel, Footer, Header, Metadata, Schema, Statistics
except ImportError as error:
    raise ExtraMissingError("mcap", "record", "a recording in MCAP") from error

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_FOOTER_BYTES: Final = 20  # two places of 8 bytes and a checksum
_CHECKSUM_BYTES: Final = 4  # at the footer's end, not part of what it covers

_UNFINISHED: Final = "it ends early"
_IN_CHUNKS: Final = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)

_MARKS: Final = re.compile(
    rb"(?P<chunk>\x04\0\0\0zstd)|\x0c.{8}.{4}magcal\.|\x02\x14\0{7}|" + re.escape(MAGIC), re.DOTALL
)
"""Where reading may go on: within a chunk's head, at the begin of our metadata, of a footer, of another file."""

_MARK_IN_CHUNK: Final = 37  # bytes of a chunk's record before its mark
_MARK_BYTES: Final = 32  # longer than any mark
_BLOCK_BYTES: Final = 1 << 20  # read at once; choice: a few of the writer's chunks
_SEARCH_AT_LEAST: Final = 1 << 26  # 64 MiB; choice: a second of reading, whatever a small file holds
_SEARCH_TIMES: Final = 4
"""All places tried together may have so many times the file's bytes and ``_SEARCH_AT_LEAST``: each is read whole."""


class _Record(NamedTuple):
    """A sound record: a chunk's content is unpacked; ``end`` is where the next one begins."""

    opcode: int
    content: bytes
    end: int


class _SpoiltError(Exception):
    """What stands at a place is no sound record; ``end`` is where it says it ends, None where that says nothing."""

    def __init__(self, why: str, end: int | None = None, *, chunk: bool = False) -> None:
        super().__init__(why)
        self.end, self.chunk = end, chunk


class McapReader:
    """Reads a file from front to back; behind damage it goes on with the next chunk that is sound.

    Parameters
    ----------
    file: opened for reading, at its beginning.
    name: what faults call it.

    While ``messages`` is read, these fill: ``topics`` by channel number, ``metadata`` in the order of the file,
    ``good_bytes`` (of sound records so far), ``bad_chunks`` and ``bad_records`` (skipped, the rest is read),
    ``damage`` (the first thing that is wrong but for those, empty where nothing is), ``sound`` (one finished file,
    nothing was skipped, nothing follows its end).

    Raises ``RecordingError`` where the file is no MCAP file at all, or unpacks to far more than a recording does;
    nothing else, whatever its bytes.
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
        self._introduced: dict[tuple[int, bytes], bytes] = {}
        self._finished = False  # the last thing read is a file's closing mark
        self._summary: bytes | None = None  # the statistics of a summary that is not known to be sound yet
        self._read = self._indexed = self._stated = 0  # messages: read, and what indices and sound summaries say
        self._all_stated = True
        self._to_search = _SEARCH_AT_LEAST + _SEARCH_TIMES * self.size
        self._limits = McapLimits(name, self.size)
        self._place = 0  # where the record ends that is read

    @property
    def sound(self) -> bool:
        """Whether this is one file, and all of it could be read, to its closing mark."""
        return self._finished and not (self.bad_chunks or self.bad_records or self.damage)

    @property
    def undamaged(self) -> bool:
        """Whether it is sound, or lacks its end and nothing else, as what a killed daemon leaves may."""
        unfinished = self.damage == _UNFINISHED and self.good_bytes == self.size
        return self.sound or (unfinished and not (self.bad_chunks or self.bad_records))

    @property
    def gone(self) -> int:
        """Messages that were in the file and cannot be read, as far as what is sound of it still says so."""
        return min(max(0, max(self._indexed, self._stated) - self._read), MOST_MISSING)

    @property
    def all_gone_known(self) -> bool:
        """Whether ``gone`` is all of them: the summary, which counts every message, is sound."""
        return self._finished and self._all_stated

    def messages(self) -> Iterator[RawMessage]:
        """Every readable message in the order of the file, which is the order in which they were recorded."""
        begins = self._file.read(len(MAGIC))
        if begins != MAGIC:
            accepted = "an MCAP file, as the recorder writes it, is accepted"
            what = "this is not an MCAP file" if begins else "this file is empty"
            raise RecordingError([Lacking(self.name, what, accepted)])
        self.good_bytes = len(MAGIC)
        chunked = (
            False  # then a message outside a chunk, where it has no checksum, is another record with a flipped bit
        )
        for opcode, content in self._top_records():
            chunked |= opcode in (Opcode.CHUNK, Opcode.DATA_END)
            if chunked and opcode == Opcode.MESSAGE:
                self.bad_records += 1
                continue
            for message in self._unpacked(content) if opcode == Opcode.CHUNK else self._taken(opcode, content):
                self._read += 1
                if self._read > self._limits.most_messages:
                    self._limits.refuse_messages()
                yield message

    def _top_records(self) -> Iterator[tuple[int, bytes]]:
        with counted(Work(f"reading {Path(self.name).name}", 1e-6 * self.size, "MB")) as work:
            yield from self._shown_records(work)

    def _shown_records(self, work: Work) -> Iterator[tuple[int, bytes]]:
        at: int | None = len(MAGIC)
        while at is not None and not (self._finished and at == self.size):
            work.done = 1e-6 * at
            if self._at(at, len(MAGIC)) == MAGIC:
                at = self._another_file(at)
                continue
            try:
                record = self._record(at)
            except _SpoiltError as error:
                at = self._behind(at, error)
                continue
            if record.opcode == Opcode.CHUNK:
                self._limits.count_bytes(len(record.content), record.end)
            self.good_bytes += record.end - at
            self._finished = False
            self._place = record.end
            yield record.opcode, record.content
            at = record.end
            if record.opcode == Opcode.FOOTER:
                at = self._ended(at, record.content)

    # What stands at a place

    def _at(self, place: int, count: int) -> bytes:
        self._file.seek(place)
        return self._file.read(count)

    def _record(self, place: int) -> _Record:
        """The record at a place; ``_SpoiltError`` where it is not sound."""
        head = self._at(place, _HEAD.size)
        if len(head) < _HEAD.size:
            raise _SpoiltError(_UNFINISHED)
        opcode, length = _HEAD.unpack(head)
        if opcode == Opcode.CHUNK:
            return self._chunk(place, length)
        self._refuse_length(place, length)
        body, end = self._file.read(length), place + _HEAD.size + length
        try:
            return _Record(opcode, checked(opcode, body), end)
        except SPOILT:
            raise _SpoiltError("a record is spoilt", end) from None

    def _chunk(self, place: int, length: int) -> _Record:
        """The chunk at a place, whose length stands in it twice: the one that goes with its checksum is its length."""
        head = self._at(place + _HEAD.size, CHUNK_HEAD.size)
        own = CHUNK_HEAD.size + CHUNK_HEAD.unpack(head)[-1] if len(head) == CHUNK_HEAD.size else length
        for one in dict.fromkeys((length, own)):
            if one > self._most(place):
                continue
            body = self._at(place + _HEAD.size, one)
            try:
                chunk = chunk_of(body)
                self._limits.count_tried(unpacked_size(chunk), place + _HEAD.size + one)
                records = unpack(chunk)
            except SPOILT:
                continue
            if own != length:
                self._damaged("the length of a chunk is spoilt")
            return _Record(Opcode.CHUNK, records, place + _HEAD.size + one)
        self._refuse_length(place, length)
        raise _SpoiltError("a chunk is spoilt", place + _HEAD.size + length, chunk=True)

    def _refuse_length(self, place: int, length: int) -> None:
        if length > self._most(place):
            raise _SpoiltError("it ends within a record" if length <= LARGEST_RECORD else "a record has no sane length")

    def _most(self, place: int) -> int:
        """The longest that a record at a place can be."""
        return min(self.size - place - _HEAD.size, LARGEST_RECORD)

    def _ended(self, at: int, footer: bytes) -> int:
        """The place behind the closing mark, which is the end of a sound file."""
        whole = self._at(at, len(MAGIC)) == MAGIC
        self._finished = whole
        if not whole:
            self._damaged("its closing mark is missing")
            return at
        self.good_bytes += len(MAGIC)
        sound = self._summary_is_sound(at, footer)
        if not sound:
            self._damaged("its summary is spoilt")
        if sound and self._summary is not None:
            self._stated += Statistics.read(strict(self._summary)).message_count
        else:
            self._all_stated = False
        self._summary = None
        return at + len(MAGIC)

    def _summary_is_sound(self, at: int, footer: bytes) -> bool:
        """Whether the summary that ends at ``at`` has the checksum that its footer says; 0 says none."""
        content = Footer.read(strict(footer))
        if not content.summary_crc:
            return True
        begin = content.summary_start or at - len(footer) - _HEAD.size
        if not len(MAGIC) <= begin <= at or at - begin > LARGEST_RECORD:
            return False
        wanted: int = content.summary_crc
        return zlib.crc32(self._at(begin, at - begin - _CHECKSUM_BYTES)) == wanted

    def _another_file(self, at: int) -> int:
        """Begin with a file that was put behind another's end, which has channels of its own."""
        self._damaged("another file follows its end" if self._finished else "another file begins within it")
        self._all_stated &= self._finished
        self._finished = False
        self.topics, self._schemas, self._introduced = {}, {}, {}
        self.good_bytes += len(MAGIC)
        return at + len(MAGIC)

    # Behind damage

    def _behind(self, at: int, error: _SpoiltError) -> int | None:
        """Where reading goes on behind what is spoilt at a place; None where nothing sound is left."""
        if error.chunk:
            self.bad_chunks += 1
        if self._finished:
            self._damaged(f"{self.size - at} bytes follow its end")
        if error.end is not None and self._sound_at(error.end):
            if not error.chunk:
                self.bad_records += 1
            return error.end
        if not error.chunk:
            self._damaged(str(error))
        self._finished = False
        return self._next_sound(at + 1)

    def _damaged(self, what: str) -> None:
        self.damage = self.damage or what

    def _next_sound(self, begin: int) -> int | None:
        """The first place from ``begin`` on where a chunk, our metadata, a file or its end stand, and are sound."""
        for block in range(begin, self.size, _BLOCK_BYTES):
            content = self._at(block, _BLOCK_BYTES + _MARK_BYTES)
            for mark in _MARKS.finditer(content):
                place = block + mark.start() - (_MARK_IN_CHUNK if mark["chunk"] else 0)
                if place >= begin and self._sound_at(place):
                    return place
                if self._to_search < 0:
                    return None
        return None

    def _sound_at(self, place: int) -> bool:
        """Whether a record is at a place that has more to show than its length, or a file begins there."""
        if self._at(place, len(MAGIC)) == MAGIC:
            return True
        try:
            record = self._record(place)
        except _SpoiltError as error:
            self._to_search -= 0 if error.end is None else error.end - place
            return False
        self._to_search -= record.end - place + len(record.content)
        if record.opcode == Opcode.FOOTER:
            return self._at(record.end, len(MAGIC)) == MAGIC
        return record.opcode in (Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.METADATA, Opcode.DATA_END)

    # What a record says

    def _unpacked(self, records: bytes) -> Iterator[RawMessage]:
        """The messages of a chunk."""
        at, end = 0, len(records)
        while end - at >= _HEAD.size:
            opcode, length = _HEAD.unpack_from(records, at)
            at += _HEAD.size
            if length > end - at:
                break
            if length > LONGEST_MESSAGE or opcode not in _IN_CHUNKS:
                self._limits.count_unused(length, self._place)
                self.bad_records += opcode in _IN_CHUNKS
            else:
                yield from self._taken(opcode, records[at : at + length])
            at += length
        if at != end:
            self.bad_records += 1

    def _taken(self, opcode: int, body: bytes) -> Iterator[RawMessage]:
        """Remember a schema, channel or metadata, count what an index has; give a message."""
        try:
            if opcode == Opcode.MESSAGE:
                number, sequence, log_time_ns, publish_time_ns = _MESSAGE.unpack_from(body)
                yield RawMessage(self.topics[number], sequence, log_time_ns, publish_time_ns, body[_MESSAGE.size :])
            elif opcode == Opcode.MESSAGE_INDEX:
                self._indexed += (len(body) - INDEX_HEAD.size) // INDEX_ENTRY_BYTES
            elif opcode == Opcode.STATISTICS:
                self._summary = body
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                if self._introduced.get((opcode, body[:2])) != body:  # begins with its number; each chunk repeats it
                    self._limits.count_introduced(len(body), self._place)
                    self._remember(opcode, ReadDataStream(io.BytesIO(body)))
                    self._introduced[opcode, body[:2]] = body
            elif opcode in (Opcode.METADATA, Opcode.HEADER):
                self._remember(opcode, ReadDataStream(io.BytesIO(body)))
        except SPOILT:
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
