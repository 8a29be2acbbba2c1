"""``ccsds:udp/HOST:PORT``: the daemon's results as CCSDS space packets, for mission control; nothing comes back.

One packet a datagram.  Options: ``apid`` (of the first kind; the others follow), ``apid_KIND`` (of one kind), ``craft``
(only this one's results), ``vectors`` (``no`` leaves the calibrated vectors out).  ``docs/mission-control.md`` has the
packets.
"""

from __future__ import annotations

import ipaddress
import logging
import math
import re
import socket
import time
from collections import Counter
from collections.abc import Sequence
from typing import Final

from magcal_service.base.errors import LinkError, why_not
from magcal_service.config.address import LinkAddress
from magcal_service.links.base import Link, Role
from magcal_service.links.states import LinkEvent
from magcal_service.wire.fields import NAME
from magcal_service.wire.kinds import KIND_BY_CODE, kind_of
from magcal_service.wire.messages import CalibratedVector, Message
from magcal_service.wire.packets import SENT, pack
from magcal_service.wire.space_packet import MAX_APID, space_packet

FIRST_APID: Final = 256
"""Where the address says nothing: above the numbers that flight software mostly gives its own parts."""

DEFAULT_ADDRESS: Final = "ccsds:udp/127.0.0.1:10015"

REFUSED_S: Final = 30.0
"""How long nobody is taken to listen, or be reached, after the network said so [s]: three statuses."""

_PLACE: Final = re.compile(r"udp/(?:\[(?P<six>[0-9A-Fa-f:.]+)\]|(?P<four>[0-9.]+)):(?P<port>[0-9]{1,5})")
_ACCEPTED: Final = "udp/ADDRESS:PORT such as udp/127.0.0.1:10015 is accepted, with an IP address (IPv6 in brackets)"

_log = logging.getLogger("magcal.links")


def apids_of(address: LinkAddress) -> dict[int, int]:
    """The APID of each kind that an address sends, by the kind's code; ``LinkAddressError`` where two are the same."""
    first = address.integer("apid", FIRST_APID, 0, MAX_APID - len(SENT) + 1)
    apids: dict[int, int] = {}
    for place, code in enumerate(SENT):
        option = f"apid_{KIND_BY_CODE[code].name}"
        apid = address.integer(option, first + place, 0, MAX_APID)
        if apid in apids.values():
            address.refuse(option, apid, "each kind has an APID of its own")
        apids[code] = apid
    return apids


def _place_of(address: LinkAddress) -> tuple[str, int]:
    match = _PLACE.fullmatch(address.rest)
    if match is None:
        address.refuse("the place", address.rest, _ACCEPTED)
    host, port = match["six"] or match["four"], int(match["port"])
    try:
        ipaddress.ip_address(host)
    except ValueError:
        address.refuse("the IP address", host, _ACCEPTED)
    if not 1 <= port <= 65_535:
        address.refuse("the port", port, "1 to 65535 is accepted")
    return host, port


class CcsdsLink(Link):
    """Results of the daemon as space packets, sent and never received.

    ``counters`` has ``sent`` (packets that the network took), ``dropped`` (those that it did not), and ``unheard``
    (times that the other machine said that nobody listens; a packet was lost before each).
    """

    def __init__(self, address: LinkAddress, role: Role, crafts: Sequence[str] = ()) -> None:
        super().__init__(address.text, crafts)
        if role is not Role.SERVICE:
            address.refuse("the link", "ccsds", "it only sends the daemon's results: [output] links names it")
        self._host, self._port = _place_of(address)
        self.apids = apids_of(address)
        self._craft = address.text_of("craft", "", NAME.pattern, "1 to 32 characters of A-Z a-z 0-9 _ -")
        if self._craft and self.crafts and self._craft not in self.crafts:
            address.refuse("craft", self._craft, f"one of {', '.join(sorted(self.crafts))} is accepted")
        self._vectors = address.flag("vectors", True)
        address.finish()
        self.counters["unheard"] = 0
        self._counts: Counter[int] = Counter()
        self._unheard_s = -math.inf  # when the network said last that a packet had not arrived, monotonic [s]
        self._unheard = ""  # and why
        self._socket: socket.socket | None = None
        self._open()

    @property
    def alone(self) -> str:
        """Why mission control hears nothing, as far as the network tells."""
        if self._socket is not None and time.monotonic() - self._unheard_s >= REFUSED_S:
            return ""
        return self._unheard

    def receive(self, timeout_s: float) -> list[Message]:
        """Raise ``LinkError``: nothing ever comes in by this link."""
        raise LinkError(f"link {self.address!r} only sends; take messages from the daemon's main link")

    def _poll(self, wait_s: float) -> list[Message]:
        return self.receive(wait_s)

    def send(self, message: Message) -> None:
        """Send one result as a packet; other messages, and other craft's, are left out in silence."""
        code = kind_of(message).code
        if code not in self.apids or (self._craft and message.craft != self._craft):
            return
        if (isinstance(message, CalibratedVector) and not self._vectors) or self._encoded(message) is None:
            return
        apid = self.apids[code]
        packet = space_packet(apid, self._counts[apid], message.time_ns, pack(message))
        self._counts[apid] += 1  # what is dropped has its number too, so that the gap shows
        self._count("sent" if self._sent(packet) else "dropped")

    def close(self) -> None:
        """Release the socket; may be called twice."""
        self._life.happens(LinkEvent.CLOSE)
        self._release()

    def _open(self) -> None:
        """Take a socket that knows its other end, without which nobody tells that nobody listens."""
        family = socket.AF_INET6 if ":" in self._host else socket.AF_INET
        opened = socket.socket(family, socket.SOCK_DGRAM)
        opened.setblocking(False)
        try:
            opened.connect((self._host, self._port))
        except OSError as error:
            opened.close()
            self._note(f"there is no way to {self._host}:{self._port} ({why_not(error)})")
            if self._life.happens(LinkEvent.FAILED).logged:
                _log.warning("%s: %s; it is tried again with every message", self.address, why_not(error))
            return
        self._socket = opened
        self._life.happens(LinkEvent.OPENED)

    def _sent(self, packet: bytes) -> bool:
        if self._socket is None and not self._life.is_closed:
            self._open()
        if self._socket is None:
            return False
        try:
            try:
                self._socket.send(packet)
            except ConnectionRefusedError:  # told of a packet before; this one has not been sent
                self._count("unheard")
                self._note(f"nobody listens at {self._host}:{self._port}")
                self._socket.send(packet)
        except (BlockingIOError, ConnectionRefusedError):  # this machine's queue is full; nobody listens even now
            return False
        except OSError as error:  # the socket may be bound to an address that this machine no longer has: take another
            self._note(f"there is no way to {self._host}:{self._port} ({why_not(error)})")
            self._release()
            return False
        return True

    def _note(self, why: str) -> None:
        self._unheard_s, self._unheard = time.monotonic(), why

    def _release(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None
