"""A link's address and its files, checked without opening the link."""

from __future__ import annotations

from collections.abc import Sequence

from magcal_service.config.address import parse_address
from magcal_service.links import Role, open_link


def check_link(address: str, crafts: Sequence[str]) -> int:
    """Check a daemon's link; returns the history that it asks of its nodes [samples].

    Parameters
    ----------
    address: as of ``open_link``.
    crafts: names of the craft that are served.

    Raises as ``open_link`` for what is refused.  No zenoh session and no serial device is opened; the other links
    reach nobody by being opened, so they are.
    """
    parsed = parse_address(address)
    if parsed.scheme == "zenoh":
        from magcal_service.links.zenoh_settings import ZenohSettings

        settings = ZenohSettings.read(parsed, Role.SERVICE)
        settings.check_files(settings.session_config(parsed))
        return settings.history
    if parsed.scheme == "serial":
        from magcal_service.links.line_seal import check_seal
        from magcal_service.links.serial import SerialSettings

        line = SerialSettings.read(parsed)
        if line.key is not None:
            check_seal(line.key, line.counter)
        return 0
    with open_link(address, Role.SERVICE, crafts=crafts) as link:
        return link.history
