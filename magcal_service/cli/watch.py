"""``magcal watch``: a daemon, or a recording that goes through one, on a terminal of 80 by 24 and more."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from magcal_service.base.errors import ConfigError, Fault
from magcal_service.cli.asking import NotReachedError, add_where, whom
from magcal_service.cli.common import DONE, NOT_TRUSTED, REPLAY_SPEED, SOURCE_HELP, Parser
from magcal_service.cli.craft_choice import CONFIG_HELP
from magcal_service.cli.view import replayed

if TYPE_CHECKING:
    from magcal_service.cli.screen import Screen
    from magcal_service.views.picture import Frame
    from magcal_service.views.result import ResultView
    from magcal_service.views.sources import Source
    from magcal_service.views.state import Magnetometer

SPEED: Final = 60.0
"""Times real time at which a recording is shown where nobody says."""

_DRAW_S: Final = 0.2  # between two pictures
_OTHERS_S: Final = 1.0  # as long after one is known whole, others may appear
_FIRST_ASK_S: Final = 2.0  # what a daemon has told lately comes by itself before that, over zenoh
_ASK_S: Final = 10.0  # a status is asked for so often while none has come
_WHY_S: Final = 3.0  # how often it is asked why nothing comes: that may take a second itself
_KEYS: Final = "q quit"
_MORE_KEYS: Final = "q quit   n next magnetometer   p previous one"
_MORE: Final = """
keys: q quit, n next magnetometer, p previous one.  Where there is no terminal, --once is meant.
exit codes: 0; with --once 3 where a verdict is not trusted; 2 refused, or --once and nothing heard within --timeout.
"""


def add_watch(parser: Parser) -> None:
    """The arguments of ``magcal watch``."""
    parser.add_argument(
        "recording",
        nargs="?",
        type=Path,
        metavar="RECORDING.toml|FILE.mcap",
        help="show this one; none: a running daemon",
    )
    add_where(parser, f"the daemon's configuration: its link and craft; of a recording the {CONFIG_HELP}")
    only = "this craft alone, of a daemon or a session; repeatable"
    parser.add_argument("--craft", action="append", default=[], metavar="NAME", help=only)
    parser.add_argument("--source", metavar="NAME", help=f"of a recording: {SOURCE_HELP}")
    faster = f"of a recording: times real time (default: {SPEED:g}, with --once 0); 0 as fast as it goes"
    parser.add_argument("--speed", type=REPLAY_SPEED, metavar="X", help=faster)
    once = "print one picture: when estimate and status have come, or at the end of the recording"
    parser.add_argument("--once", action="store_true", help=once)
    parser.more = lambda: _MORE
    parser.examples = (
        "magcal watch --link zenoh:tcp/127.0.0.1:7447",
        "magcal watch flight.toml --speed 600",
        "magcal watch --config magcal.toml --once",
    )
    parser.set_defaults(command=_watch, endless=True)


class Watch:
    """Somebody who looks at a source.

    Parameters
    ----------
    source: reads already.
    why_silent: what keeps results away, in words, where the daemon has told its status or not; may take a second.
    crafts: whose results are wanted; of all that are heard where empty.
    served: craft that a daemon serves there, heard or not; may take a second.

    ``ask_s`` is when statuses that have not come are asked for next, on the monotonic clock [s].
    """

    def __init__(
        self,
        source: Source,
        why_silent: Callable[[bool], str] = lambda heard: "",
        crafts: tuple[str, ...] = (),
        served: Callable[[], Iterable[str]] = tuple,
    ) -> None:
        self._source, self.why_silent, self._crafts, self._served = source, why_silent, crafts, served
        self._silence = ""
        self.ask_s, self._why_s = time.monotonic() + _FIRST_ASK_S, time.monotonic() + _WHY_S

    @property
    def is_recorded(self) -> bool:
        """Whether it is a recording, which comes to an end."""
        return self._source.origin.kind == "recording"

    @property
    def has_ended(self) -> bool:
        """Whether all of a recording was played."""
        return self._source.origin.has_ended

    def magnetometers(self) -> list[Magnetometer]:
        """All that were heard; statuses that have not come are asked for now and then."""
        with self._source.lock:
            found = self._source.views.magnetometers()
        now_s = time.monotonic()
        if now_s > self.ask_s and not self.is_recorded:
            self.ask_s = now_s + _ASK_S
            told = {one.craft.name for one in found if one.result.status is not None}
            wanted = self._crafts or (() if found else self._served())
            for craft in {*wanted, *(one.craft.name for one in found)} - told:
                self._source.give(craft, "status")
        if any(not one.craft.pulse.is_stale(now_s) for one in found):
            self._silence = ""
        elif now_s > self._why_s:
            self._silence = self.why_silent(any(one.result.status is not None for one in found))
            self._why_s = time.monotonic() + _WHY_S
        return found

    def frame(self, number: int = 1, of: int = 1, keys: str = "", listened_s: float | None = None) -> Frame:
        """What is around the picture of a magnetometer; ``listened_s`` [s] as in ``Frame``."""
        from magcal_service.views.picture import Frame

        origin = self._source.origin
        silence = self._silence or (origin.note if origin.kind == "recording" else "")
        place = number, max(of, 1)
        now_s, recorded = time.monotonic(), self.is_recorded
        return Frame(origin.address, now_s, silence, place, recorded, origin.has_ended, keys, listened_s)

    def picture(self, one: Magnetometer | None, frame: Frame, size: tuple[int, int], colour: bool) -> list[str]:
        """The lines of a screen."""
        from magcal_service.cli.screen import marks
        from magcal_service.views.picture import picture
        from magcal_service.views.text import painted

        with self._source.lock:
            lines = picture(one, frame, *size, marks())
        return [painted(line, colour) for line in lines]


def _watch(options: argparse.Namespace) -> int:
    from magcal_service.cli.screen import Screen, is_terminal

    once = options.once or not is_terminal()
    if options.speed is None and options.recording is not None:
        options.speed = 0.0 if once else SPEED
    with _opened(options) as watch:
        if once:
            return _once(watch, options.timeout)
        with Screen() as screen, suppress(KeyboardInterrupt):
            _shown(watch, screen)
    return DONE


@contextmanager
def _opened(options: argparse.Namespace) -> Iterator[Watch]:
    if options.recording is None:
        with _live(options) as watch:
            yield watch
        return
    if options.link is not None:
        raise ConfigError([Fault("--link", options.link, "a recording or a link is accepted; leave one out")])
    with _reading(replayed(options)) as source:
        yield Watch(source)


@contextmanager
def _live(options: argparse.Namespace) -> Iterator[Watch]:
    from magcal_service.links import Role, open_link
    from magcal_service.links.silence import why_silent
    from magcal_service.views.sources import LiveSource

    for name in ("speed", "source"):
        value = getattr(options, name)
        if value is not None:
            raise ConfigError([Fault(f"--{name}", value, "it goes with a recording; name one or leave it out")])
    address, crafts = whom(options, options.craft, "--craft")
    with open_link(address, Role.VIEWER, crafts=crafts) as link, _reading(LiveSource(link)) as source:
        yield Watch(
            source, lambda heard: why_silent(link, crafts, heard=heard), tuple(crafts), lambda: link.served() or ()
        )


@contextmanager
def _reading(source: Source) -> Iterator[Source]:
    source.start()
    try:
        yield source
    finally:
        source.stop()


def _shown(watch: Watch, screen: Screen) -> None:
    """Show pictures until somebody has seen enough."""
    place = 0
    while not screen.is_ended:
        found = watch.magnetometers()
        place %= max(len(found), 1)
        frame = watch.frame(place + 1, len(found), _KEYS if len(found) < 2 else _MORE_KEYS)
        screen.draw(watch.picture(found[place] if found else None, frame, screen.size, screen.colour))
        keys = screen.keys(_DRAW_S).lower()
        if "q" in keys:
            return
        place += keys.count("n") + keys.count("\t") - keys.count("p")


def _once(watch: Watch, timeout_s: float) -> int:
    """Print a picture of each magnetometer; 3 where one of them is not trusted."""
    from magcal_service.views.picture import HEIGHT, WIDTH
    from magcal_service.wire.messages import Verdict

    began_s = time.monotonic()
    found = _gathered(watch, timeout_s)
    listened_s = None if watch.is_recorded else time.monotonic() - began_s
    if not found:
        where = watch.frame().where
        raise NotReachedError(
            f"no result on {where}: {watch.why_silent(False) or watch.frame().silence or 'it has none'}"
        )
    for number, one in enumerate(found, 1):
        frame = watch.frame(number, len(found), listened_s=listened_s)
        print("\n".join(line.rstrip() for line in watch.picture(one, frame, (WIDTH, HEIGHT), colour=False)))
    return DONE if all(one.result.verdict is Verdict.TRUSTED for one in found) else NOT_TRUSTED


def _gathered(watch: Watch, timeout_s: float) -> list[Magnetometer]:
    """All of a recording; of a daemon when each has a status and what it counts, or after ``timeout_s`` [s]."""
    deadline_s, known = time.monotonic() + timeout_s, False
    while not watch.has_ended and (watch.is_recorded or time.monotonic() < deadline_s):
        time.sleep(_DRAW_S)
        results = [one.result for one in watch.magnetometers()]
        if not known and results and all(map(_is_whole, results)):
            known, deadline_s = True, min(deadline_s, time.monotonic() + _OTHERS_S)
    return watch.magnetometers()


def _is_whole(result: ResultView) -> bool:
    """Whether a status has come, and an estimate unless the status says that there is none yet."""
    status = result.status
    return status is not None and (result.estimate is not None or not status.counters.get("ticks"))
