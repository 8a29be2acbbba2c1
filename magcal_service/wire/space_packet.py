"""CCSDS space packets (133.0-B-2) with the time of their data as secondary header (CUC, 301.0-B-4)."""

from __future__ import annotations

import struct
from typing import Final

MAX_APID: Final = 2046
"""2047 are idle packets."""

SEQUENCE_COUNTS: Final = 1 << 14
"""A packet's number has 14 bits and wraps to 0."""

MAX_UDP_BYTES: Final = 65_507
"""Payload of an IPv4 datagram: 65535 less the headers of IP (20) and UDP (8)."""

P_FIELD: Final = 0x2F
"""Of the time: unsegmented, epoch of our own (1970-01-01T00:00:00Z), four octets of seconds, three of fraction."""

_SECONDARY_HEADER: Final = 1 << 11  # of the first 16 bits: a secondary header follows; version 0, telemetry
_UNSEGMENTED: Final = 3 << 14  # of the second 16 bits
_NS_PER_S: Final = 1_000_000_000  # nanoseconds in a second
_FRACTIONS: Final = 1 << 24  # of a second: 60 ns
_LAST_S: Final = (1 << 32) - 1  # that four octets hold: in 2106


def cuc(time_ns: int) -> bytes:
    """The eight octets of a time [ns] since 1970, leap seconds ignored, rounded down to 60 ns.

    What lies before 1970 is 0, and what lies after 2106 the last moment that can be written; the user data has the time
    itself.
    """
    seconds, rest = divmod(time_ns, _NS_PER_S)
    fraction = rest * _FRACTIONS // _NS_PER_S
    if seconds < 0:
        seconds, fraction = 0, 0
    elif seconds > _LAST_S:
        seconds, fraction = _LAST_S, _FRACTIONS - 1
    return struct.pack(">BII", P_FIELD, seconds, fraction << 8)[:8]


def space_packet(apid: int, count: int, time_ns: int, data: bytes) -> bytes:
    """One packet of telemetry.

    Parameters
    ----------
    apid: 0 to ``MAX_APID``.
    count: of the packets of this APID before; its lowest 14 bits are written.
    time_ns: of the data, on its own clock [ns].
    data: the user data, at least one octet.
    """
    field = cuc(time_ns) + data
    return struct.pack(">HHH", _SECONDARY_HEADER | apid, _UNSEGMENTED | count % SEQUENCE_COUNTS, len(field) - 1) + field
