"""Both ends of a link that is really there: zenoh on this machine, or a serial line over a pair of pseudo-terminals."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import cast

from magcal_service.links import Link, Role, open_link
from magcal_service.links.zenoh import ZenohLink
from sim_sensor.demo.pty_pair import PtyPair
from tests.links.link_messages import free_port, settle


@contextmanager
def ends(kind: str) -> Iterator[tuple[Link, Link]]:
    """The service's end and the node's; what is sent before they have found each other would be dropped."""
    with PtyPair() as line:
        here, there = (f"serial:{path}" for path in line.paths)
        if kind == "zenoh":
            here = there = f"zenoh:tcp/127.0.0.1:{free_port()}"
        with (
            open_link(here, Role.SERVICE, crafts=["pair"]) as link,
            open_link(there, Role.NODE, crafts=["pair"]) as node,
        ):
            if kind == "zenoh":
                assert settle(lambda: all(cast(ZenohLink, end).alive() for end in (link, node)))
            yield link, node
