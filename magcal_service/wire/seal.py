"""Sealed commands for a line without TLS: a counter and an HMAC around the payload, checked without input or output.

A sealed frame has ``SEALED`` added to the kind in its header, and carries ``counter payload tag``: the counter u64
little-endian, the tag the first 16 bytes of HMAC-SHA256 over a label, the counter and the payload.  A receiver with the
key takes each command only with a counter above all it has taken before, so what was recorded cannot be played again.
``docs/wire.md`` has the bytes.
"""

from __future__ import annotations

import hmac
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from magcal_service.base.errors import DecodeError, why_not

SEALED: Final = 0x40
"""Added to the kind in a frame's header where the payload is sealed."""

SEAL_REFUSALS: Final = ("no_key", "unsealed", "bad_seal", "replayed", "not_kept")
"""Why a command is refused by its seal, in the order of the checks; counted as ``refused.<reason>`` and answered."""

TAG_BYTES: Final = 16  # 128 of the 256 bits of HMAC-SHA256: half, the least that RFC 2104 recommends
MAX_COUNTER: Final = (1 << 64) - 1  # the counter is a u64 on the line

LABEL: Final = b"magcal sealed command 1\0"
_COUNTER: Final = struct.Struct("<Q")
_US_PER_S: Final = 1e6  # microseconds in a second


@dataclass(frozen=True, slots=True)
class Sealed:
    """The content of a sealed frame; nothing is proved yet."""

    counter: int
    payload: bytes
    tag: bytes


def seal(key: bytes, counter: int, payload: bytes) -> bytes:
    """What a sealed frame carries for a payload; ``counter`` from 1 to 2^64-1."""
    counted = _COUNTER.pack(counter)
    return counted + payload + _tag(key, counted, payload)


def split(content: bytes) -> Sealed:
    """The parts of what a sealed frame carries; ``DecodeError`` (``bad_seal``) where it is too short."""
    if len(content) < _COUNTER.size + TAG_BYTES:
        raise DecodeError("bad_seal", f"{len(content)} bytes; at least {_COUNTER.size + TAG_BYTES} are accepted")
    (counter,) = _COUNTER.unpack_from(content)
    return Sealed(counter, content[_COUNTER.size : -TAG_BYTES], content[-TAG_BYTES:])


def _tag(key: bytes, counted: bytes, payload: bytes) -> bytes:
    return hmac.digest(key, LABEL + counted + payload, "sha256")[:TAG_BYTES]


class SealGate:
    """Lets sealed commands in, each counter once.

    Parameters
    ----------
    key: the secret that both ends share.
    last: the highest counter let in so far; None where it is not known, and nothing can be let in.
    keep: stores a counter for good before its command is let in; ``OSError`` where it cannot.
    """

    def __init__(self, key: bytes, last: int | None, keep: Callable[[int], None]) -> None:
        self._key, self._last, self._keep = key, last, keep

    def admit(self, sealed: Sealed | None) -> None:
        """Let a command in, sealed or (None) not; ``DecodeError`` with one of ``SEAL_REFUSALS`` where it stays out."""
        if sealed is None:
            raise DecodeError("unsealed", "this line takes sealed commands only; seal it with the line's key")
        if not hmac.compare_digest(sealed.tag, _tag(self._key, _COUNTER.pack(sealed.counter), sealed.payload)):
            raise DecodeError("bad_seal", "the tag does not fit; seal it with the line's key")
        if self._last is None:
            raise DecodeError("not_kept", "the last counter is not known here; mend the counter's file")
        if sealed.counter <= self._last:
            behind_s = (self._last - sealed.counter) / _US_PER_S
            raise DecodeError(
                "replayed",
                f"counter {sealed.counter} was used; above {self._last} is accepted; a clock that the counter follows, "
                f"as of magcal send, is {behind_s:.6g} s behind: set it, or wait",
            )
        try:
            self._keep(sealed.counter)
        except OSError as error:
            raise DecodeError("not_kept", f"the counter cannot be stored ({why_not(error)})") from None
        self._last = sealed.counter
