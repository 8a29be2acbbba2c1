"""Where a message goes on zenoh: its key and its encoding."""

from __future__ import annotations

from magcal_service.wire.kinds import FIRST_COMMAND, FIRST_RESULT, Kind, kind_of
from magcal_service.wire.messages import Message

ROOT = "magcal/v1"
_ENCODING = "application/msgpack;magcal.v1."


def key_of(message: Message) -> str:
    """The key a message is put on: ``magcal/v1/<craft>/sample/<kind>/<source>`` and its like.

    Samples and results have a key for each source; commands and their replies one for each craft.
    """
    kind = kind_of(message)
    base = f"{ROOT}/{message.craft}/{group_of(kind)}"
    return f"{base}/{kind.name}/{message.source}" if kind.code < FIRST_COMMAND else base


def group_of(kind: Kind) -> str:
    """``sample``, ``result``, ``command`` or ``reply``: the part of the key after the craft."""
    if kind.code < FIRST_RESULT:
        return "sample"
    return "result" if kind.code < FIRST_COMMAND else kind.name


def encoding_of(kind: Kind) -> str:
    """The zenoh encoding of a payload, such as ``application/msgpack;magcal.v1.magnetometer``."""
    return _ENCODING + kind.name
