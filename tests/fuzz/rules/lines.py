"""The links that the rules drive a service over: memory, zenoh on 127.0.0.1, a serial line of two pseudo-terminals."""

from __future__ import annotations

import abc
import itertools
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ClassVar, Final, cast

import zenoh

from magcal_service.links import Link, Role, open_link
from magcal_service.links.loop import LoopLink
from magcal_service.links.presence import Presence
from magcal_service.links.zenoh import ZenohLink
from sim_sensor.demo.pty_pair import PtyPair
from tests.links.link_messages import WAIT_S, free_port

_numbers: Final = itertools.count()
_POLL_S: Final = 0.002
"""Between two looks at a link [s]."""


def await_that(true: Callable[[], bool], what: str) -> None:
    """Wait until something is true; AssertionError that says what was waited for."""
    deadline_s = time.monotonic() + WAIT_S
    while not true():
        assert time.monotonic() < deadline_s, what
        time.sleep(_POLL_S)


class Line(abc.ABC):
    """A link with a node's end that stays, and a service's end that comes and goes.

    Parameters
    ----------
    crafts: whom the service serves.
    """

    node: Link
    takes_results: ClassVar[bool] = True
    """Whether results that a node sends arrive at the service, which is to leave them alone."""

    def __init__(self, crafts: Sequence[str]) -> None:
        self.crafts = tuple(crafts)

    @abc.abstractmethod
    def address(self) -> str:
        """The service's."""

    @abc.abstractmethod
    def inject(self, data: bytes) -> None:
        """Let bytes arrive at the service."""

    def open(self) -> Link:
        """The service's end, once both ends hear each other."""
        link = open_link(self.address(), Role.SERVICE, crafts=self.crafts)
        await_that(lambda: self.connected(link), "the ends of a link have not found each other")
        return link

    def connected(self, link: Link) -> bool:
        """Whether what one end sends reaches the other."""
        return True

    def close(self) -> None:
        """Close the node's end."""
        self.node.close()


class LoopLine(Line):
    """Memory."""

    def __init__(self, crafts: Sequence[str]) -> None:
        super().__init__(crafts)
        self._name = f"loop:rules-{next(_numbers)}?queue=100000"
        self.node = open_link(self._name, Role.NODE)

    def address(self) -> str:
        return self._name

    def inject(self, data: bytes) -> None:
        cast(LoopLink, self.node).inject(data)


class SerialLine(Line):
    """Two pseudo-terminals; bytes that are no message end with the end of a frame, so that they spoil none."""

    def __init__(self, crafts: Sequence[str]) -> None:
        super().__init__(crafts)
        self._cable = PtyPair()
        self.node = open_link(f"serial:{self._cable.paths[1]}", Role.NODE)

    def address(self) -> str:
        return f"serial:{self._cable.paths[0]}"

    def inject(self, data: bytes) -> None:
        Path(self._cable.paths[1]).write_bytes(b"\0" + data + b"\0")

    def close(self) -> None:
        super().close()
        self._cable.close()


class ZenohLine(Line):
    """Two sessions on 127.0.0.1, and a third that is no node of ours.

    A result that the node sends comes back to itself, which listens to results, and to no service.
    """

    takes_results = False

    def __init__(self, crafts: Sequence[str]) -> None:
        super().__init__(crafts)
        self._endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.node = open_link(f"zenoh:{self._endpoint}", Role.NODE, crafts=crafts)
        self._stranger: zenoh.Session | None = None

    def address(self) -> str:
        return f"zenoh:{self._endpoint}"

    def connected(self, link: Link) -> bool:
        seen = zip((link, self.node), (Role.NODE, Role.SERVICE), strict=True)
        return all({one.craft for one in _alive(end) if one.role is role} >= set(self.crafts) for end, role in seen)

    def inject(self, data: bytes) -> None:
        if self._stranger is None:
            config = zenoh.Config()
            for key, value in (
                ("mode", '"client"'),
                ("connect/endpoints", f'["{self._endpoint}"]'),
                ("scouting/multicast/enabled", "false"),
            ):
                config.insert_json5(key, value)
            self._stranger = zenoh.open(config)
        self._stranger.put(f"magcal/v1/{self.crafts[0]}/sample/magnetometer/mag0", data)

    def close(self) -> None:
        super().close()
        if self._stranger is not None:
            self._stranger.close()  # type: ignore[no-untyped-call]


def _alive(end: Link) -> frozenset[Presence]:
    return cast(ZenohLink, end).alive()


LINES: Final[dict[str, Callable[[Sequence[str]], Line]]] = {"loop": LoopLine, "zenoh": ZenohLine, "serial": SerialLine}
