"""``magcal reference``: a node that sends the reference field of a craft that has none."""

from __future__ import annotations

import argparse
import sys
import threading
import time
from pathlib import Path

from magcal_service.cli.common import DONE, NOT_TRUSTED, Parser, end_by_signal, within

_MORE = """
Without --tle it hears the craft's position messages on a zenoh link and sends the field at each.  A daemon can do the
same by itself: [craft.reference] model = "igrf".
"""


def add_reference(parser: Parser) -> None:
    """The arguments of ``magcal reference``."""
    parser.add_argument("--craft", required=True, metavar="NAME", help="whose")
    parser.add_argument("--tle", type=Path, metavar="FILE", help="two-line element sets; read again when it changes")
    parser.add_argument("--link", metavar="ADDRESS", help="the daemon's link (default: zenoh:tcp/127.0.0.1:7447)")
    parser.add_argument(
        "--rate-hz", type=within(0.01, 1e6), default=1.0, metavar="HZ", help="fields a second (default: 1)"
    )
    parser.add_argument(
        "--max-age-days", type=within(0.01, 60.0), default=3.0, metavar="D", help="oldest element set (default: 3)"
    )
    parser.add_argument(
        "--duration-s", type=within(0.01, 1e6), metavar="S", help="end after so long (default: at SIGTERM or Ctrl-C)"
    )
    parser.more = lambda: _MORE
    parser.examples = ("magcal reference --craft demo --tle demo.tle --link zenoh:tcp/127.0.0.1:7447",)
    parser.set_defaults(command=_reference, endless=True)


def _reference(options: argparse.Namespace) -> int:
    from magcal_service.base import log
    from magcal_service.base.errors import ConfigError, Fault
    from magcal_service.cli.asking import viewers_address
    from magcal_service.config.settings import DEFAULT_LINK, default_craft
    from magcal_service.daemon.reference_node import Elements, cost_of, run_along, run_beside
    from magcal_service.links import Role, open_link
    from magcal_service.links.silence import why_silent

    craft = default_craft(options.craft).name
    address = options.link or viewers_address(DEFAULT_LINK)
    elements = None
    if options.tle is not None:
        elements = Elements(options.tle, options.max_age_days)
        elements.refuse_old(time.time_ns())
        print(f"{options.tle}: {cost_of(elements.age_days(time.time_ns()))}", flush=True)
    elif not address.startswith(("zenoh:", "loop:")):
        accepted = "positions of others are heard on zenoh links alone; give --tle, or [craft.reference] in the daemon"
        raise ConfigError([Fault("--link", address, accepted)])
    stop = threading.Event()
    end_by_signal(stop)
    if options.duration_s is not None:
        threading.Timer(options.duration_s, stop.set).start()
    log.to_stderr()
    with open_link(address, Role.NODE, crafts=[craft]) as link:
        if elements is not None:
            sent = run_along(link, craft, elements, options.rate_hz, stop)
        else:
            with open_link(address, Role.VIEWER, crafts=[craft]) as heard:
                sent = run_beside(link, heard, craft, stop)
        served = link.served()
        lonely = why_silent(link, [craft]) if link.alone or (served is not None and craft not in served) else ""
    refused = "".join(f"; {name} {count}" for name, count in sorted(sent.refused.items()))
    print(f"{sent.references} references put on the link{refused}")
    if lonely:
        print(f"nobody heard them: {lonely}", file=sys.stderr)
    return DONE if sent.references and not lonely else NOT_TRUSTED
