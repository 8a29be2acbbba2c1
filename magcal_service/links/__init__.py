"""Links: one interface, chosen by one address.

``open_link("zenoh:tcp/127.0.0.1:7447", Role.SERVICE, crafts=["alpha"])``; each link's module is imported only where
its scheme is asked for.  Imports recordings, config, wire and base.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from magcal_service.config.address import LinkAddress, parse_address
from magcal_service.links.base import Link, Role
from magcal_service.links.sequence import SourceRecord

__all__ = ["LINKS", "Link", "LinkAddress", "Role", "SourceRecord", "open_link", "parse_address"]


def _zenoh(address: LinkAddress, role: Role, crafts: Sequence[str]) -> Link:
    from magcal_service.links.zenoh import ZenohLink

    return ZenohLink(address, role, crafts)


def _serial(address: LinkAddress, role: Role, crafts: Sequence[str]) -> Link:
    from magcal_service.links.serial import SerialLink

    return SerialLink(address, role, crafts)


def _loop(address: LinkAddress, role: Role, crafts: Sequence[str]) -> Link:
    from magcal_service.links.loop import LoopLink

    return LoopLink(address, role, crafts)


def _recording(address: LinkAddress, role: Role, crafts: Sequence[str]) -> Link:
    from magcal_service.links.recording import RecordingLink

    return RecordingLink(address, crafts)


def _ccsds(address: LinkAddress, role: Role, crafts: Sequence[str]) -> Link:
    from magcal_service.links.ccsds import CcsdsLink

    return CcsdsLink(address, role, crafts)


LINKS: dict[str, Callable[[LinkAddress, Role, Sequence[str]], Link]] = {
    "zenoh": _zenoh,
    "serial": _serial,
    "loop": _loop,
    "recording": _recording,
    "ccsds": _ccsds,
}


def open_link(address: str, role: Role, *, crafts: Sequence[str] = ()) -> Link:
    """Open the link of an address.

    Parameters
    ----------
    address: ``scheme:rest?option=value&...``; schemes and options are in ``docs/links.md``.
    role: which end this is.
    crafts: names of the craft whose messages are wanted; all where empty.

    Raises
    ------
    LinkAddressError: the address or one of its options is refused.
    LinkError: the link can never open as asked, such as a port that is taken.  A peer or device that is not there
        yet is no error: the link connects when it comes.
    ConfigError: a file with a key or a password in it can be read by others.
    """
    parsed = parse_address(address)
    return LINKS[parsed.scheme](parsed, role, crafts)
