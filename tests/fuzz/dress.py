"""Operations that change what a checksum or a length protects, and put the right one on again."""

from __future__ import annotations

import hashlib
import io
import json
import struct
from random import Random
from typing import Any

import msgpack

from magcal_service.base.errors import MagcalError
from magcal_service.daemon.checkpoints.files import MAGIC
from magcal_service.recordings.mcap import RawMessage
from magcal_service.recordings.mcap_reader import McapReader
from magcal_service.recordings.mcap_writer import McapWriter
from magcal_service.wire.framing import FrameDecoder, ReceivedFrame, pack_frame
from magcal_service.wire.seal import SEALED, seal
from tests.fuzz.mutate import mutate

KEY = b"k" * 32
"""The key of the sealed line that is fuzzed."""

_VALUES: tuple[Any, ...] = (
    None, True, 0, -1, 1, 1 << 31, (1 << 63) - 1, -(1 << 63), 0.0, -0.0, 5e-324, 1e6, 1e308, float("nan"), float("inf"),
    "", "utc", "a/b", "\x1b[2J", "\u202e", "x" * 600, [], [1.0, 2.0, 3.0], [0.0, 0.0, 0.0], [1e6, 0.0, 0.0], {},
    {"a": 1},
)  # fmt: skip


def _changed(rng: Random, value: Any) -> Any:
    """A value of the same structure with one thing in it changed."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        key = rng.choice(list(value))
        if rng.random() < 0.1:
            return {name: entry for name, entry in value.items() if name != key}
        return value | {key: _changed(rng, value[key])}
    if isinstance(value, list) and value and rng.random() < 0.9:
        at = rng.randrange(len(value))
        return [*value[:at], _changed(rng, value[at]), *value[at + 1 :]]
    if isinstance(value, bytes) and rng.random() < 0.9:
        return _changed_array(rng, value)
    if isinstance(value, int | float) and not isinstance(value, bool) and rng.random() < 0.5:
        return value + rng.choice((-1, 1, 1000, 10**9, 6 * 10**10, 10**13)) * rng.choice((1, 1.0))
    return rng.choice(_VALUES)


def _changed_array(rng: Random, data: bytes) -> bytes:
    """The bytes of an array with one number changed, or of another length."""
    at = 8 * rng.randrange(1 + len(data) // 8)
    match rng.randrange(4):
        case 0:
            return data[:at]
        case 1:
            return data + data[:at]
        case _:
            number = rng.choice((0.0, -1.0, 1e-300, 1e300, -1e300, float("nan"), float("inf"), rng.gauss(0.0, 1e5)))
            return (data[:at] + struct.pack("<d", number) + data[at + 8 :])[: len(data)]


def checkpoint(rng: Random, data: bytes) -> bytes:
    """A checkpoint with one value changed, and its checksum right again."""
    body = data[len(MAGIC) + 32 :]
    try:
        content = msgpack.unpackb(body, strict_map_key=False)
        if isinstance(content, dict) and "state" in content and rng.random() < 0.8:
            content["state"] = _changed(rng, content["state"])
        else:
            content = _changed(rng, content)
        body = msgpack.packb(content)
    except (ValueError, TypeError, OverflowError, msgpack.exceptions.UnpackException):
        return data
    return MAGIC + hashlib.sha256(body).digest() + body


def payload(rng: Random, data: bytes) -> bytes:
    """A msgpack payload with one value changed."""
    try:
        values = msgpack.unpackb(data, strict_map_key=False)
        packed: bytes = msgpack.packb(_changed(rng, values))
    except (ValueError, TypeError, OverflowError, msgpack.exceptions.UnpackException):
        return data
    return packed


def frame(rng: Random, data: bytes) -> bytes:
    """A stream of frames with one payload changed, dropped, doubled or moved; checksums are right."""
    frames = [event for event in FrameDecoder().feed(data) if isinstance(event, ReceivedFrame)]
    if not frames:
        return data
    at = rng.randrange(len(frames))
    one = frames[at]
    changed = payload(rng, one.payload) if rng.random() < 0.7 else mutate(rng, [one.payload], ())[:4096]
    match rng.randrange(5):
        case 0:
            frames.insert(rng.randrange(len(frames)), frames.pop(at))
        case 1:
            frames.insert(at, one)
        case 2:
            sealed = seal(KEY, rng.choice((1, 2, 1 << 63)), changed)
            frames[at] = ReceivedFrame((one.kind | SEALED) & 0xFF, one.sequence, sealed)
        case _:
            frames[at] = ReceivedFrame(one.kind, one.sequence, changed)
    return b"".join(pack_frame(each.kind, each.payload, each.sequence) for each in frames)


def json_object(rng: Random, data: bytes) -> bytes:
    """A JSON object with one value changed."""
    try:
        return json.dumps(_changed(rng, json.loads(data))).encode()
    except (ValueError, RecursionError, TypeError):
        return data


def session(rng: Random, data: bytes) -> bytes:
    """A session file with one record changed, dropped, doubled or moved; checksums are right."""
    try:
        reader = McapReader(io.BytesIO(data), "input")
        messages = list(reader.messages())
    except MagcalError:
        return data
    if not messages:
        return data
    at = rng.randrange(len(messages))
    one = messages[at]
    match rng.randrange(6):
        case 0:
            messages.insert(rng.randrange(len(messages)), messages.pop(at))
        case 1:
            messages.insert(at, one)
        case 2:
            messages[at] = one._replace(topic=rng.choice(messages).topic)
        case 3:
            messages[at] = one._replace(data=mutate(rng, [one.data], ()))
        case _:
            messages[at] = one._replace(data=json_object(rng, one.data))
    return _packed(rng, reader, messages)


def _packed(rng: Random, reader: McapReader, messages: list[RawMessage]) -> bytes:
    file = io.BytesIO()
    writer = McapWriter(file, "fuzz")
    for name, content in reader.metadata:
        if rng.random() < 0.2:
            content = {key: mutate(rng, [text.encode()], ()).decode(errors="replace") for key, text in content.items()}
        writer.add_metadata(name, content)
    for number, message in enumerate(messages):
        writer.add(message)
        if number % 16 == 15:
            writer.end_chunk()
    writer.finish()
    return file.getvalue()
