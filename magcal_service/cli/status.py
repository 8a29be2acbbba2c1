"""``magcal status``: ask a running daemon how it is.  Exit codes: 0 healthy, 3 not healthy, 2 not to be reached."""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Final

from magcal_service.cli.asking import ASK_AGAIN_S, LOOK_S, Desk, NotReachedError, add_where, whom
from magcal_service.cli.common import Parser
from magcal_service.config.magnetometers import MAGNETOMETERS, label_of

if TYPE_CHECKING:
    from magcal_service.links import Link
    from magcal_service.wire.messages import Status

HEALTHY, NOT_HEALTHY = 0, 3  # done and not trusted, of a daemon

_OTHERS_S: Final = 1.0
"""Where nobody said which craft there are, those count that are heard so long after the first [s]."""


def add_status(parser: Parser) -> None:
    """The arguments of ``magcal status``."""
    add_where(parser)
    parser.add_argument("--craft", action="append", default=[], metavar="NAME", help="ask for this craft; repeatable")
    parser.add_argument("--json", action="store_true", help="as one JSON object")
    parser.examples = ("magcal status --config deploy/config/zenoh-peer.toml",)
    parser.set_defaults(command=_status)


def _status(options: argparse.Namespace) -> int:
    from magcal_service.links import Role, open_link
    from magcal_service.links.silence import why_silent

    address, crafts = whom(options, options.craft, "--craft")
    with open_link(address, Role.VIEWER, crafts=crafts) as link:
        found = ask(link, crafts, options.timeout)
        missing = sorted(set(crafts) - {status.craft for status in found})
        if not found or missing:
            who = f"craft {', '.join(missing)}" if missing else "any craft"
            raise NotReachedError(f"no status of {who} on {address}: {why_silent(link, missing)}")
    print(as_json(found) if options.json else as_text(found))
    return HEALTHY if all(map(is_healthy, found)) else NOT_HEALTHY


def ask(link: Link, crafts: Iterable[str], timeout_s: float) -> list[Status]:
    """The newest status of each craft, and of each of its magnetometers where it has several.

    Asked for by command until they have come or ``timeout_s`` [s] are over.
    """
    from magcal_service.wire.messages import Status

    wanted, found, desk = set(crafts), dict[tuple[str, str], Status](), Desk(link, "status")
    deadline_s, asked_s, look_s = time.monotonic() + timeout_s, 0.0, time.monotonic() + LOOK_S
    while time.monotonic() < deadline_s and not (wanted and wanted <= _complete(found)):
        if time.monotonic() - asked_s > ASK_AGAIN_S:
            asked_s = time.monotonic()
            for craft in wanted - _complete(found):
                desk.give(craft, "status")
        if wanted and time.monotonic() > look_s:
            served, look_s = link.served(), time.monotonic() + LOOK_S
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
