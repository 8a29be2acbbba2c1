"""The state that a craft began a session with, as text for a recording and back."""

from __future__ import annotations

import base64
import zlib
from typing import Any, Final

import msgpack

_LARGEST_BYTES: Final = 1 << 23
"""8 MiB: no craft's state comes near it: 0.4 MB with 4096 samples collected towards a start, 1 MB with physics."""


def state_as_text(state: dict[str, Any]) -> str:
    """Plain data as ``Pipeline.export_state`` gives them, packed."""
    return base64.b64encode(zlib.compress(msgpack.packb(state))).decode("ascii")


def state_from_text(text: str) -> dict[str, Any] | None:
    """The plain data of such a text, still to be checked by ``Pipeline.restore_state``; None where it is none."""
    unpacker = zlib.decompressobj()
    try:
        packed = unpacker.decompress(base64.b64decode(text, validate=True), _LARGEST_BYTES)
        state = msgpack.unpackb(packed, strict_map_key=False)
    except (ValueError, TypeError, zlib.error, msgpack.UnpackException, RecursionError):  # TypeError: a list as a key
        return None
    return state if isinstance(state, dict) else None
