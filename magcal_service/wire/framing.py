"""A byte stream to frames and back, without any input or output: bytes in, events out.

On the line a frame is ``00 COBS(header payload crc) 00``.  The header is, little-endian, version u8, kind u8, frame
sequence u16, payload length u16; the CRC-32 (of zlib, Ethernet) covers header and payload and is little-endian too.
A big-endian CRC-16 in its place accepts wrong frames when a bit of a delimiter flips.  See ``docs/wire.md``.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from cobs import cobs

from magcal_service.base.errors import DecodeError
from magcal_service.wire.codec import MAX_PAYLOAD_BYTES, decode, encode
from magcal_service.wire.kinds import kind_of
from magcal_service.wire.messages import Command, Message
from magcal_service.wire.seal import SEALED, Sealed, SealGate, split

FRAME_VERSION = 1  # of header and checksum; docs/wire.md says when it changes

# Why a frame is refused, in the order of the checks; counted as ``refused.<reason>`` beside ``messages.REFUSALS``.
FRAME_REFUSALS = ("oversize", "bad_cobs", "bad_crc", "unknown_frame_version", "bad_length", "wrong_kind")

_HEADER = struct.Struct("<BBHH")
_CRC = struct.Struct("<I")
_DELIMITER = b"\0"
_PLAIN_BYTES = _HEADER.size + MAX_PAYLOAD_BYTES + _CRC.size
MAX_ENCODED_BYTES = _PLAIN_BYTES + -(-_PLAIN_BYTES // 254)  # COBS adds one byte for each 254 begun

MAX_GAP = 1024
"""A jump of the frame sequence beyond this counts as a restarted sender, not as that many lost frames."""


@dataclass(frozen=True, slots=True)
class ReceivedFrame:
    """A whole frame whose checksum is right: the kind its header names, its sequence, its payload."""

    kind: int
    sequence: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class FrameRefusal:
    """Bytes between two delimiters that are no frame; ``reason`` is one of ``FRAME_REFUSALS``."""

    reason: str
    detail: str


def pack_frame(kind: int, payload: bytes, sequence: int) -> bytes:
    """One frame with both delimiters.

    Parameters
    ----------
    kind: code of the payload's kind, 0 to 255.
    payload: at most ``MAX_PAYLOAD_BYTES``; ``ValueError`` beyond.
    sequence: number of the frame on this line; taken modulo 2**16.
    """
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise ValueError(f"a payload of {len(payload)} bytes; up to {MAX_PAYLOAD_BYTES} are accepted")
    body = _HEADER.pack(FRAME_VERSION, kind, sequence & 0xFFFF, len(payload)) + payload
    encoded: bytes = cobs.encode(body + _CRC.pack(zlib.crc32(body)))
    return _DELIMITER + encoded + _DELIMITER


def unpack_frame(encoded: bytes) -> ReceivedFrame | FrameRefusal:
    """What stands between two delimiters, without them."""
    try:
        body: bytes = cobs.decode(encoded)
    except cobs.DecodeError as error:
        return FrameRefusal("bad_cobs", str(error))
    if len(body) < _HEADER.size + _CRC.size:
        return FrameRefusal("bad_length", f"{len(body)} bytes; at least {_HEADER.size + _CRC.size} are accepted")
    content = body[: -_CRC.size]
    if zlib.crc32(content) != _CRC.unpack_from(body, len(content))[0]:
        return FrameRefusal("bad_crc", f"the checksum of {len(content)} bytes is wrong")
    version, kind, sequence, length = _HEADER.unpack_from(content)
    if version != FRAME_VERSION:
        return FrameRefusal("unknown_frame_version", f"version {version}; {FRAME_VERSION} is accepted")
    payload = content[_HEADER.size :]
    if len(payload) != length:
        return FrameRefusal("bad_length", f"{len(payload)} bytes of payload; the header says {length}")
    return ReceivedFrame(kind, sequence, payload)


class FrameEncoder:
    """Numbers and packs the frames of one line.

    Parameters
    ----------
    seal: what a sealed frame carries for a command's payload; commands go as they are where None.
    """

    def __init__(self, seal: Callable[[bytes], bytes] | None = None) -> None:
        self._sequence = 0
        self._seal = seal

    def encode(self, message: Message) -> bytes:
        """The next frame, ready to be written; ``DecodeError`` where the message itself is refused (no number used)."""
        payload, kind = encode(message), kind_of(message).code
        if self._seal is not None and isinstance(message, Command):
            payload, kind = self._seal(payload), kind | SEALED
        frame = pack_frame(kind, payload, self._sequence)
        self._sequence = (self._sequence + 1) & 0xFFFF
        return frame


class FrameDecoder:
    """Bytes in, frames and refusals out, for any split of the bytes.

    Holds at most ``MAX_ENCODED_BYTES``; after an overlong run it waits for the next delimiter.  Empty runs between
    delimiters are idle line and count as nothing.

    Parameters
    ----------
    counters: where to count ``frames``, ``frames_lost`` (gaps of the frame sequence up to ``MAX_GAP``),
        ``frame_restarts`` (jumps beyond it) and ``refused.<reason>``; its own where not given.
    """

    def __init__(self, counters: Counter[str] | None = None) -> None:
        self.counters: Counter[str] = Counter() if counters is None else counters
        self._run = bytearray()
        self._overlong = False
        self._expected: int | None = None

    def feed(self, data: bytes) -> list[ReceivedFrame | FrameRefusal]:
        """Everything that ``data`` completes, in the order of the line."""
        events: list[ReceivedFrame | FrameRefusal] = []
        *ended, rest = bytes(data).split(_DELIMITER)
        for piece in ended:
            self._extend(piece, events)
            if self._run:
                events.append(unpack_frame(bytes(self._run)))
            self._run.clear()
            self._overlong = False
        self._extend(rest, events)
        for event in events:
            self._count(event)
        return events

    def _extend(self, piece: bytes, events: list[ReceivedFrame | FrameRefusal]) -> None:
        if self._overlong:
            return
        self._run += piece
        if len(self._run) > MAX_ENCODED_BYTES:
            self._run.clear()
            self._overlong = True
            events.append(FrameRefusal("oversize", f"more than {MAX_ENCODED_BYTES} bytes without a delimiter"))

    def _count(self, event: ReceivedFrame | FrameRefusal) -> None:
        if isinstance(event, FrameRefusal):
            self.counters[f"refused.{event.reason}"] += 1
            return
        self.counters["frames"] += 1
        gap = 0 if self._expected is None else (event.sequence - self._expected) & 0xFFFF
        self._expected = (event.sequence + 1) & 0xFFFF
        if gap > MAX_GAP:
            self.counters["frame_restarts"] += 1
        elif gap:
            self.counters["frames_lost"] += gap


class StreamDecoder:
    """Bytes in, messages out; never raises for what arrives, ``counters`` says what was refused.

    Parameters
    ----------
    counters: where to count what ``FrameDecoder`` counts and ``refused.<reason>`` of the payloads.
    gate: what commands have to pass; where None, sealed ones are refused and the others taken.
    refused: called with each command that does not pass, and why.
    """

    def __init__(
        self,
        counters: Counter[str] | None = None,
        gate: SealGate | None = None,
        refused: Callable[[Command, DecodeError], None] | None = None,
    ) -> None:
        self.counters: Counter[str] = Counter() if counters is None else counters
        self._frames = FrameDecoder(self.counters)
        self._gate, self._refused = gate, refused

    def feed(self, data: bytes) -> list[Message]:
        """The messages that ``data`` completes, in the order of the line."""
        messages: list[Message] = []
        for event in self._frames.feed(data):
            if isinstance(event, ReceivedFrame):
                self._take(event, messages)
        return messages

    def _take(self, frame: ReceivedFrame, messages: list[Message]) -> None:
        try:
            sealed = split(frame.payload) if frame.kind & SEALED else None
            message = decode(frame.payload if sealed is None else sealed.payload)
            expected = kind_of(message).code
            if frame.kind != (expected if sealed is None else expected | SEALED):
                raise DecodeError("wrong_kind", f"the header says {frame.kind}, the payload {expected}")
            if isinstance(message, Command):
                self._admit(message, sealed)
            elif sealed is not None:
                raise DecodeError("wrong_kind", "only commands are sealed")
        except DecodeError as error:
            self.counters[f"refused.{error.reason}"] += 1
            return
        messages.append(message)

    def _admit(self, command: Command, sealed: Sealed | None) -> None:
        try:
            if self._gate is not None:
                self._gate.admit(sealed)
            elif sealed is not None:
                raise DecodeError("no_key", "this end has no key to check the seal with; send it unsealed")
        except DecodeError as error:
            if self._refused is not None:
                self._refused(command, error)
            raise
