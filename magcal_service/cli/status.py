"""``magcal status``: ask a running daemon how it is.  Exit codes: 0 healthy, 3 not healthy, 2 not to be reached."""

from __future__ import annotations

import argparse
import itertools
import json
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

from magcal_service.config.magnetometers import MAGNETOMETERS, label_of
from magcal_service.errors import ConfigError, Fault, LinkAddressError, MagcalError

if TYPE_CHECKING:
    from magcal_service.links import Link
    from magcal_service.wire.messages import Status

HEALTHY, NOT_REACHED, NOT_HEALTHY = 0, 2, 3  # done, refused and not trusted, of a daemon

_ASK_AGAIN_S: Final = 1.0  # a command put before the daemon subscribes is lost, so it is repeated until answered
_LOOK_S: Final = 2.0
"""Between two looks at which craft are served at all [s]: nobody waits for one that no daemon there has."""

_OTHERS_S: Final = 1.0
"""Where nobody said which craft there are, those count that are heard so long after the first [s]."""


class NotReachedError(MagcalError):
    """No daemon answered."""

    exit_code = NOT_REACHED


def add_status(parser: argparse.ArgumentParser) -> None:
    """The arguments of ``magcal status``."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--link", metavar="ADDRESS", help="the daemon's link (default: zenoh:tcp/127.0.0.1:7447)")
    where.add_argument("--config", type=Path, metavar="FILE", help="the daemon's configuration: its link and craft")
    parser.add_argument("--craft", action="append", default=[], metavar="NAME", help="ask for this craft; repeatable")
    parser.add_argument("--timeout", type=_seconds, default=15.0, metavar="S", help="longest wait (default: 15 s)")
    parser.add_argument("--json", action="store_true", help="as one JSON object")
    parser.set_defaults(command=_status)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.1 <= value <= 3600.0:
        raise argparse.ArgumentTypeError(f"{text!r} is refused; 0.1 to 3600 s is accepted")
    return value


def _status(options: argparse.Namespace) -> int:
    from magcal_service.links import Role, open_link
    from magcal_service.links.silence import why_silent

    address, crafts = _whom(options)
    with open_link(address, Role.VIEWER, crafts=crafts) as link:
        found = ask(link, crafts, options.timeout)
        missing = sorted(set(crafts) - {status.craft for status in found})
        if not found or missing:
            who = f"craft {', '.join(missing)}" if missing else "any craft"
            raise NotReachedError(f"no status of {who} on {address}: {why_silent(link, missing)}")
    print(as_json(found) if options.json else as_text(found))
    return HEALTHY if all(map(is_healthy, found)) else NOT_HEALTHY


def _whom(options: argparse.Namespace) -> tuple[str, list[str]]:
    """The link's address as a viewer opens it, and the craft asked for (none: all that are heard)."""
    from magcal_service.config.reader import load_config
    from magcal_service.config.settings import DEFAULT_LINK

    if options.config is None:
        return options.link or DEFAULT_LINK, options.craft
    config = load_config(options.config)
    names = [craft.name for craft in config.crafts]
    for name in options.craft:
        if name not in names:
            raise ConfigError([Fault("--craft", name, f"one of {', '.join(names)} is accepted")])
    if not config.link.startswith("zenoh:"):
        raise LinkAddressError(
            f"link {config.link!r} has one other end, which the node is at; give --link with the end of a viewer"
        )
    return viewers_address(config.link), options.craft or names


def viewers_address(link: str) -> str:
    """A daemon's zenoh address without what makes it listen."""
    place, _, options = link.partition("?")
    kept = [one for one in options.split("&") if one and one.partition("=")[0] in ("config",)]
    return f"{place}?{'&'.join(kept)}" if kept else place


def ask(link: Link, crafts: Iterable[str], timeout_s: float) -> list[Status]:
    """The newest status of each craft, and of each of its magnetometers where it has several.

    Asked for by command until they have come or ``timeout_s`` [s] are over.
    """
    from magcal_service.wire.messages import Command, Status

    wanted, found, numbers = set(crafts), dict[tuple[str, str], Status](), itertools.count()
    deadline_s, asked_s, look_s = time.monotonic() + timeout_s, 0.0, time.monotonic() + _LOOK_S
    while time.monotonic() < deadline_s and not (wanted and wanted <= _complete(found)):
        if time.monotonic() - asked_s > _ASK_AGAIN_S:
            asked_s = time.monotonic()
            for craft in wanted - _complete(found):
                number, now_ns = next(numbers), time.time_ns()
                link.send(Command(craft=craft, source="status", sequence=number, time_ns=now_ns, name="status"))
        if wanted and time.monotonic() > look_s:
            served, look_s = link.served(), time.monotonic() + _LOOK_S
            if served and not wanted <= served and wanted & served <= _complete(found):
                break  # daemons are there, and none of them serves the rest
        for message in link.receive(0.1):
            if isinstance(message, Status):
                if not found and not wanted:
                    deadline_s = min(deadline_s, time.monotonic() + _OTHERS_S)
                found[message.craft, message.source] = message
    return list(found.values())


def _complete(found: Mapping[tuple[str, str], Status]) -> set[str]:
    """The craft of which as many statuses have come as they have magnetometers."""
    come, of = Counter[str](), Counter[str]()
    for (craft, _), status in found.items():
        come[craft] += 1
        of[craft] = max(of[craft], status.counters.get(MAGNETOMETERS, 1))
    return {craft for craft in come if come[craft] >= of[craft]}


def is_healthy(status: Status) -> bool:
    """Whether the daemon finds nothing amiss with a craft."""
    return not status.counters.get("troubles", 0)


def as_text(statuses: Iterable[Status]) -> str:
    """A few lines for people."""
    lines = []
    for status in sorted(statuses, key=lambda one: (one.craft, label_of(one))):
        count = status.counters
        lines.append(f"{label_of(status)}: {'healthy' if is_healthy(status) else 'NOT HEALTHY'}: {status.text}")
        half_ms, most_ms = (count.get(f"tick_late_{name}_us", 0) / 1e3 for name in ("p50", "p99"))
        lines.append(
            f"  up {status.uptime_s:.0f} s; {count.get('accepted', 0)} samples, {count.get('ticks', 0)} ticks, "
            f"{half_ms:.1f} ms late at p50, {most_ms:.1f} ms at p99; {count.get('rss_kb', 0) / 1024:.0f} MB, "
            f"{count.get('open_files', 0)} files, {count.get('threads', 0)} threads"
        )
    return "\n".join(lines)


def as_json(statuses: Iterable[Status]) -> str:
    """One object: ``healthy``, and for each craft verdict, text, uptime and counters."""
    each = {
        label_of(status): {
            "healthy": is_healthy(status),
            "verdict": str(status.verdict),
            "text": status.text,
            "uptime_s": status.uptime_s,
            "counters": dict(sorted(status.counters.items())),
        }
        for status in statuses
    }
    return json.dumps({"healthy": all(one["healthy"] for one in each.values()), "craft": each}, indent=1)
