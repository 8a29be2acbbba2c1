"""``magcal xtce``: what a ``ccsds:`` link sends, as XTCE for mission control."""

from __future__ import annotations

import argparse
from pathlib import Path

from magcal_service.cli.common import DONE, Parser, refuse_unwritable, write_text


def add_xtce(parser: Parser) -> None:
    """The arguments of ``magcal xtce``."""
    link = "as in [output] links, for its APIDs (default: ccsds:udp/127.0.0.1:10015)"
    parser.add_argument("--link", metavar="ADDRESS", help=link)
    parser.add_argument("--out", type=Path, metavar="FILE", help="write it here (default: standard output)")
    parser.examples = ("magcal xtce --out magcal.xtce",)
    parser.set_defaults(command=_xtce)


def _xtce(options: argparse.Namespace) -> int:
    from magcal_service.base.errors import LinkAddressError
    from magcal_service.links import Role, open_link
    from magcal_service.links.ccsds import DEFAULT_ADDRESS, CcsdsLink
    from magcal_service.wire.xtce import xtce

    refuse_unwritable(options.out)
    address = options.link or DEFAULT_ADDRESS
    if not address.startswith("ccsds:"):
        raise LinkAddressError(f"link address {address!r}: XTCE describes space packets; a ccsds: address is accepted")
    with open_link(address, Role.SERVICE) as link:
        assert isinstance(link, CcsdsLink)
        text = xtce(link.apids)
    write_text(options.out, text)
    return DONE
