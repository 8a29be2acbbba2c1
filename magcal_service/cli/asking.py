"""What the commands that ask a running daemon share: where it is, and an answer to each command that is sent."""

from __future__ import annotations

import argparse
import itertools
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

from magcal_service.base.errors import ConfigError, Fault, LinkAddressError, MagcalError
from magcal_service.cli.common import REFUSED, within

if TYPE_CHECKING:
    from magcal_service.links import Link
    from magcal_service.wire.messages import CommandReply, Message

ASK_AGAIN_S: Final = 1.0
"""A command put before the daemon subscribes is lost, so one that changes nothing is repeated so often [s]."""

LOOK_S: Final = 2.0
"""Between two looks at which craft are served at all [s]: nobody waits for one that no daemon there has."""


_HIGHEST_START: Final = 1 << 31
"""Of a number, half of what a sequence number holds."""

LONGEST_SOURCE: Final = 29
"""Characters of a source's name, with room for what tells two processes of it apart."""


class NotReachedError(MagcalError):
    """No daemon answered."""

    exit_code = REFUSED


def add_where(
    parser: argparse.ArgumentParser, config_help: str = "the daemon's configuration: its link and craft"
) -> None:
    """The arguments that say where the daemon is, and how long to wait for it."""
    add_link(parser, config_help)
    parser.add_argument(
        "--timeout",
        type=within(0.1, 3600.0, "0.1 to 3600 s"),
        default=15.0,
        metavar="S",
        help="longest wait (default: 15 s)",
    )


def add_link(parser: argparse.ArgumentParser, config_help: str) -> None:
    """The arguments that say where the daemon is."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--link", metavar="ADDRESS", help="the daemon's link (default: zenoh:tcp/127.0.0.1:7447)")
    where.add_argument("--config", type=Path, metavar="FILE", help=config_help)


def whom(options: argparse.Namespace, crafts: list[str], field: str) -> tuple[str, list[str]]:
    """The link's address as a viewer opens it, and the craft asked for (none: all that are heard).

    ``crafts`` were named by the argument ``field``.  Raises ``ConfigError`` for a craft that the configuration lacks,
    ``LinkAddressError`` where its link has no end for a viewer.
    """
    from magcal_service.config.reader import load_config
    from magcal_service.config.settings import DEFAULT_LINK

    if options.config is None:
        return options.link or DEFAULT_LINK, crafts
    config = load_config(options.config)
    names = [craft.name for craft in config.crafts]
    for name in crafts:
        if name not in names:
            raise ConfigError([Fault(field, name, f"one of {', '.join(names)} is accepted")])
    if not config.link.startswith("zenoh:"):
        raise LinkAddressError(
            f"link {config.link!r} has one other end, which the node is at; give --link with the end of a viewer"
        )
    return viewers_address(config.link), crafts or names


def viewers_address(link: str) -> str:
    """A daemon's zenoh address without what makes it listen."""
    place, _, options = link.partition("?")
    kept = [one for one in options.split("&") if one and one.partition("=")[0] in ("config",)]
    return f"{place}?{'&'.join(kept)}" if kept else place


_ENDS: Final = itertools.count(os.urandom(1)[0])
"""Ends of this process: no two of the next 256 have the same two digits, and those of two processes seldom."""


class Desk:
    """An end of a link that gives commands, each with a number of its own.

    Parameters
    ----------
    link: open, as a viewer has it.
    source: who gives the commands, as the daemon logs it, with two digits after it.

    ``give`` raises ``ConfigError`` for arguments that no message can hold.
    """

    def __init__(self, link: Link, source: str) -> None:
        self._link, self._names = link, dict[int, str]()
        # Replies are told apart by source and number: another end's must not be taken for this one's.  A later process
        # begins lower, which a daemon takes for a source's restart and not for messages that were lost.
        self._source = f"{source}-{next(_ENDS) % 256:02x}"
        self._numbers = itertools.count(_HIGHEST_START - time.time_ns() // 1_000_000 % _HIGHEST_START)

    def give(self, craft: str, name: str, arguments: Mapping[str, str | int | float | bool] | None = None) -> int:
        """Send a command; its number."""
        from magcal_service.base.errors import DecodeError
        from magcal_service.wire.codec import encode
        from magcal_service.wire.messages import Command

        number, now_ns = next(self._numbers), time.time_ns()
        given = dict(arguments or {})
        command = Command(craft=craft, source=self._source, sequence=number, time_ns=now_ns, name=name, arguments=given)
        try:
            encode(command)
        except DecodeError as error:
            accepted = "numbers that are finite and printable texts that a message can hold are accepted"
            raise ConfigError([Fault(f"{name}: arguments", str(error), accepted)]) from None
        self._names[number] = name
        self._link.send(command)
        return number

    def reach(self, craft: str, timeout_s: float) -> CommandReply | None:
        """The reply to ``status``, asked for until it comes; None after ``timeout_s`` [s], or where others are served.

        It changes nothing at the other end, so it may be asked for more than once.
        """
        numbers, deadline_s = set[int](), time.monotonic() + timeout_s
        asked_s, look_s = -ASK_AGAIN_S, time.monotonic() + LOOK_S
        while time.monotonic() < deadline_s:
            if time.monotonic() - asked_s > ASK_AGAIN_S:
                asked_s = time.monotonic()
                numbers.add(self.give(craft, "status"))
            for message in self._link.receive(0.1):
                if self._answers(message, craft, numbers):
                    return message  # type: ignore[return-value]
            if time.monotonic() > look_s:
                served, look_s = self._link.served(), time.monotonic() + LOOK_S
                if served and craft not in served:
                    return None
        return None

    def answer(self, craft: str, number: int, timeout_s: float) -> CommandReply | None:
        """The reply to the command of this number; None after ``timeout_s`` [s]."""
        deadline_s = time.monotonic() + timeout_s
        while time.monotonic() < deadline_s:
            for message in self._link.receive(0.1):
                if self._answers(message, craft, {number}):
                    return message  # type: ignore[return-value]
        return None

    def _answers(self, message: Message, craft: str, numbers: set[int]) -> bool:
        from magcal_service.wire.messages import CommandReply

        return (
            isinstance(message, CommandReply)
            and message.craft == craft
            and message.command_source == self._source
            and message.command_sequence in numbers
            and message.name == self._names.get(message.command_sequence)
        )
