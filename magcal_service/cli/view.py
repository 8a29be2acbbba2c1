"""``magcal view``: a live page in the browser, of a running daemon or of a recording."""

from __future__ import annotations

import argparse
import re
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Final

from magcal_service.base.errors import ConfigError, Fault
from magcal_service.cli.asking import add_link, whom
from magcal_service.cli.common import DONE, REPLAY_SPEED, SOURCE_HELP, Parser, port_number
from magcal_service.cli.craft_choice import CONFIG_HELP, craft_from

if TYPE_CHECKING:
    from magcal_service.views.sources import ReplaySource, Source

_PORT: Final = 8047  # choice: free of what is usual
_ORIGIN: Final = re.compile(r"https?://[A-Za-z0-9.-]+(:[0-9]{1,5})?")


def add_view(parser: Parser) -> None:
    """The arguments of ``magcal view``."""
    parser.add_argument(
        "recording", nargs="?", type=Path, metavar="RECORDING.toml|FILE.mcap", help="show this one; none: a live daemon"
    )
    add_link(parser, f"the daemon's configuration: its link and craft; of a recording the {CONFIG_HELP}")
    parser.add_argument(
        "--craft",
        action="append",
        default=[],
        metavar="NAME",
        help="only this craft, of a daemon or a session; repeatable",
    )
    parser.add_argument("--source", metavar="NAME", help=f"of a recording: {SOURCE_HELP}")
    parser.add_argument(
        "--speed",
        type=REPLAY_SPEED,
        default=0.0,
        help="of a recording, times real time; 0 (default) as fast as it goes",
    )
    parser.add_argument(
        "--port", type=port_number, default=_PORT, help=f"on 127.0.0.1 (default: {_PORT}); 0 for one that is free"
    )
    parser.add_argument(
        "--allow-commands", action="store_true", help="let the page freeze, resume and reset; else it only reads"
    )
    parser.add_argument(
        "--openmct",
        type=Path,
        metavar="FOLDER",
        help="serve the Open MCT in this folder too, under /openmct/; reads only",
    )
    parser.add_argument(
        "--allow-origin",
        action="append",
        default=[],
        metavar="ORIGIN",
        type=_origin,
        help="let pages of this web origin read the telemetry, such as http://127.0.0.1:8080; repeatable",
    )
    parser.examples = (
        "magcal view output/paper/RECORDING.toml",
        "magcal view --link zenoh:tcp/127.0.0.1:7447",
    )
    parser.set_defaults(command=_view, endless=True)


def _origin(text: str) -> str:
    if not _ORIGIN.fullmatch(text):
        raise argparse.ArgumentTypeError(f"{text!r} is refused; SCHEME://HOST or SCHEME://HOST:PORT is accepted")
    return text


def _check_openmct(options: argparse.Namespace) -> None:
    """Refuse a folder without Open MCT, and commands beside it, which its page could give as this one's."""
    if options.openmct is None:
        return
    for needed in ("index.html", "node_modules/openmct/dist/openmct.js"):
        if not (options.openmct / needed).is_file():
            accepted = f"a folder with {needed} is accepted; deploy/openmct/README.md says how it gets there"
            raise ConfigError([Fault("--openmct", str(options.openmct), accepted)])
    if options.allow_commands:
        accepted = "reads only; give commands by a second `magcal view`, or by `magcal send`"
        raise ConfigError([Fault("--allow-commands", "with --openmct", accepted)])


def _view(options: argparse.Namespace) -> int:
    import magcal_service.views.server  # noqa: F401 - a missing extra is told before anything is opened

    _check_openmct(options)
    if options.recording is None:
        return _view_live(options)
    refused = {"--link": options.link, "--allow-commands": options.allow_commands or None}
    faults = [
        Fault(name, value, "a live daemon takes it, a recording does not") for name, value in refused.items() if value
    ]
    if faults:
        raise ConfigError(faults)
    return _served(replayed(options), options)


def _view_live(options: argparse.Namespace) -> int:
    from magcal_service.links import Role, open_link
    from magcal_service.views.sources import LiveSource

    if options.source is not None:
        raise ConfigError(
            [Fault("--source", options.source, "a recording takes it; the page offers all of a daemon's")]
        )
    address, crafts = whom(options, options.craft, "--craft")
    with open_link(address, Role.VIEWER, crafts=crafts) as link:
        return _served(LiveSource(link), options)


def replayed(options: argparse.Namespace) -> ReplaySource:
    """The recording that the arguments name, ready to be replayed; raises what reading it raises."""
    from magcal_service.offline.replay import craft_of
    from magcal_service.recordings.inspect.inspection import inspect
    from magcal_service.recordings.reader import is_session, read_recording
    from magcal_service.recordings.usable import refuse_hopeless
    from magcal_service.views.sources import Flight, ReplaySource

    def flight(name: str | None) -> Flight:
        configured, to_read = craft_from(options.recording, options.config, name, "a view")
        inspection = inspect(read_recording(options.recording, to_read, source=options.source))
        refuse_hopeless(inspection.usable, inspection.lines())
        return Flight(inspection, configured or craft_of(inspection.to_replay))

    names = list(dict.fromkeys(options.craft)) or [None]
    if len(names) > 1 and not is_session(options.recording):
        raise ConfigError([Fault("--craft", " ".join(names), "one craft of rows, or several of a session")])
    return ReplaySource(str(options.recording), [flight(name) for name in names], options.speed)


def _served(source: Source, options: argparse.Namespace) -> int:
    import asyncio

    from magcal_service.views.server import Offer, serve

    offer = Offer(options.allow_commands, options.openmct, tuple(options.allow_origin))

    async def until_stopped() -> None:
        stopped = asyncio.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, stopped.set)
        await serve(source, options.port, offer, _print_address, stopped)

    asyncio.run(until_stopped())
    return DONE


def _print_address(url: str) -> None:
    print(f"{url} (Ctrl-C ends it)", flush=True)
