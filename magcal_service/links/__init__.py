"""Links: one interface, chosen by one address.

``open_link("zenoh:tcp/127.0.0.1:7447", Role.SERVICE, crafts=["alpha"])``; each link's module is imported only where
its scheme is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from magcal_service.errors import LinkAddressError
from magcal_service.links.address import LinkAddress, parse_address
from magcal_service.links.base import Link, Role
from magcal_service.links.sequence import SourceRecord
from magcal_service.typed_toml import nearest

__all__ = ["SCHEMES", "Link", "LinkAddress", "Role", "SourceRecord", "check_address", "open_link", "parse_address"]


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


SCHEMES: dict[str, Callable[[LinkAddress, Role, Sequence[str]], Link]] = {
    "zenoh": _zenoh,
    "serial": _serial,
    "loop": _loop,
    "recording": _recording,
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
    return _scheme(parsed)(parsed, role, crafts)


def check_address(address: str) -> None:
    """Refuse an address whose scheme or form is unknown, without opening or importing anything."""
    _scheme(parse_address(address))


def _scheme(address: LinkAddress) -> Callable[[LinkAddress, Role, Sequence[str]], Link]:
    if address.scheme not in SCHEMES:
        raise LinkAddressError(f"link address {address.text!r}: unknown scheme; {nearest(address.scheme, SCHEMES)}")
    return SCHEMES[address.scheme]
