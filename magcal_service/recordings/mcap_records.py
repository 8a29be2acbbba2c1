"""Records of an MCAP file as bytes: which are sound, and what they hold."""

from __future__ import annotations

import io
import struct
import zlib
from typing import Any, Final

from magcal_service.base.errors import ExtraMissingError
from magcal_service.recordings.mcap import INDEX_ENTRY_BYTES

try:
    import zstandard
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import EndOfFile, McapError
    from mcap.opcode import Opcode
    from mcap.records import Channel, Chunk, Footer, Header, Metadata, Schema, Statistics
except ImportError as error:
    raise ExtraMissingError("mcap", "record", "a recording in MCAP") from error

LARGEST_RECORD: Final = 1 << 26
"""What a reader takes for a record at most, packed and unpacked: 64 times what the writer makes."""

SPOILT: Final = (McapError, zstandard.ZstdError, struct.error, ValueError, OverflowError, KeyError)
"""What the package raises for a record that is none."""

CHUNK_HEAD = struct.Struct("<QQQII4sQ")
"""A chunk of the writer up to its packed records: times, size, checksum, kind of packing, their length."""

_ZSTD: Final = b"zstd"
INDEX_HEAD = struct.Struct("<HI")


def strict(body: bytes) -> _StrictStream:
    """A stream over records that raises ``EndOfFile`` where one is shorter than it says."""
    return _StrictStream(io.BytesIO(body))


class _StrictStream(ReadDataStream):
    """Raises ``EndOfFile`` where a record is shorter than it says, which the package's own lets pass."""

    def read(self, length: int) -> bytes:
        """So many bytes."""
        data: bytes = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


_FILLED: Final = {
    Opcode.HEADER: Header,
    Opcode.FOOTER: Footer,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.STATISTICS: Statistics,
}
"""Records that have to fill the length that they say: a damaged length shows."""

_OTHERS: Final = frozenset(Opcode) - _FILLED.keys() - {Opcode.CHUNK, Opcode.MESSAGE_INDEX}


def checked(opcode: int, body: bytes) -> bytes:
    """The bytes of a record that is no chunk; raises one of ``SPOILT`` where the format shows that they are spoilt."""
    if opcode == Opcode.MESSAGE_INDEX:
        length = INDEX_HEAD.unpack_from(body)[1]
        if length != len(body) - INDEX_HEAD.size or length % INDEX_ENTRY_BYTES:
            raise ValueError("an index of another length")
    elif opcode in _FILLED:
        _filling(_FILLED[Opcode(opcode)], body)
    elif opcode not in _OTHERS:
        raise ValueError("a kind of record that there is not")
    return body


def _filling(kind: Any, body: bytes) -> Any:
    """A record of a class of the package; ``ValueError`` where it is shorter than its bytes."""
    stream = strict(body)
    record = kind.read(stream)
    if stream.count != len(body):
        raise ValueError("longer than what it holds")
    return record


def chunk_of(body: bytes) -> Chunk:
    """A chunk, whose packed records are all that follows its head, whatever length it says for them."""
    if len(body) < CHUNK_HEAD.size or CHUNK_HEAD.unpack_from(body)[-3:-1] != (len(_ZSTD), _ZSTD):
        chunk: Chunk = _filling(Chunk, body)
        return chunk
    first_ns, last_ns, size, checksum, *_ = CHUNK_HEAD.unpack_from(body)
    return Chunk(_ZSTD.decode(), body[CHUNK_HEAD.size :], last_ns, first_ns, checksum, size)


def unpacked_size(chunk: Chunk) -> int:
    """How many bytes ``unpack`` would make of a chunk at most; 0 where it would not begin."""
    size: int = chunk.uncompressed_size
    if chunk.compression != "zstd" or size > LARGEST_RECORD:
        return 0
    stated: int = zstandard.frame_content_size(chunk.data)
    return size if stated < 0 else stated if stated <= size else 0


def unpack(chunk: Chunk) -> bytes:
    """A chunk's records; ``ValueError`` where size or checksum is wrong."""
    if chunk.uncompressed_size > LARGEST_RECORD:
        raise ValueError("larger than any chunk")
    if chunk.compression == "zstd":
        if zstandard.frame_content_size(chunk.data) > chunk.uncompressed_size:
            raise ValueError("unpacks to more than it says")
        unpacked = zstandard.ZstdDecompressor()
        records: bytes = unpacked.decompress(
            chunk.data, max_output_size=chunk.uncompressed_size, allow_extra_data=False
        )
    elif chunk.compression == "":
        records = chunk.data
    else:
        raise ValueError("an unknown packing")
    if len(records) != chunk.uncompressed_size or chunk.uncompressed_crc not in (0, zlib.crc32(records)):
        raise ValueError("a wrong checksum")
    return records
