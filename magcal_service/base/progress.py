"""How far a command has come and when it ends: one line of a terminal's stderr, for what takes more than two seconds.

A command opens the line with ``showing``; what takes its time says so with ``counted``, ``each`` or ``steps``, and is
silent where nothing is shown: in a library, in a worker process, in a thread.
"""

from __future__ import annotations

import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Final, Protocol, TextIO, TypeVar

Item = TypeVar("Item")

AFTER_S: Final = 2.0
"""What ends sooner is not worth a line [s]."""

_AGAIN_S: Final = 0.5  # between two lines on a terminal: a choice, so that seconds are seen to pass
_ERASED: Final = "\r\x1b[K"


class Forecast(Protocol):
    """When a work ends whose steps may be passed over, and made again."""

    def begin(self, step: str, now_s: float) -> None:
        """A step begins [s, of a clock that never steps]."""

    def left_s(self, now_s: float) -> float | None:
        """Seconds until the end; None as long as nothing is known."""


@dataclass(slots=True)
class Work:
    """What is being done, and how much of it has been.

    Parameters
    ----------
    what: in words.
    total: how much there is, in ``unit``; 0 where nobody knows.
    done, failed: what has ended; ``failed`` of it with no result.
    kept: of ``done``, what was there before and says nothing about how long the rest will take.
    place: which step it is of how many at most.
    forecast: what says when a work of such steps ends; None where nobody knows.
    """

    what: str
    total: float = 0.0
    unit: str = ""
    done: float = 0.0
    failed: int = 0
    kept: float = 0.0
    place: tuple[int, int] | None = None
    began_s: float = field(default_factory=time.monotonic)
    forecast: Forecast | None = None

    def left_s(self, elapsed_s: float) -> float | None:
        """Seconds until the end, at the pace so far or by a forecast; None as long as nobody knows."""
        if self.forecast is not None:
            return self.forecast.left_s(self.began_s + elapsed_s)
        worked = self.done - self.kept
        return elapsed_s * max(self.total - self.done, 0.0) / worked if worked > 0.0 and self.total else None

    def line(self, elapsed_s: float, now: float) -> str:
        """All of it as a line; ``now`` is the time of day [s since 1970]."""
        parts = [self.what if self.place is None else f"step {self.place[0]} of at most {self.place[1]}"]
        if self.total:
            parts = [f"{self.what}: {self.done:.0f} of {self.total:.0f}{self.unit and ' '}{self.unit} done"]
        if self.failed:
            parts.append(f"{self.failed} failed")
        parts.append(duration(elapsed_s))
        left = self.left_s(elapsed_s)
        if left is not None and self.forecast is not None:
            parts.append(f"about {duration(left)} left")
        elif left is not None:
            parts.append(f"{duration(left)} left, until {time.strftime('%H:%M', time.localtime(now + left))}")
        return ", ".join(parts) + ("" if self.place is None else f": {self.what}")


def duration(seconds: float) -> str:
    """Seconds as people say them."""
    whole = round(seconds)
    if whole < 100:
        return f"{whole} s"
    return f"{whole // 60} min" if whole < 100 * 60 else f"{whole // 3600} h {whole % 3600 // 60} min"


class _Terminal:
    """The line of a terminal: rewritten by a thread of its own while something is done, else empty."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._works: list[Work] = []
        self._lock, self._closed = threading.Lock(), threading.Event()
        self._is_written = False
        self._thread = threading.Thread(target=self._run, name="magcal-progress", daemon=True)
        self._thread.start()

    def begin(self, work: Work) -> None:
        """Show this as well."""
        with self._lock:
            self._works.append(work)

    def end(self, work: Work) -> None:
        """Show this no more; the line is empty where it was the last one, so that results can be printed."""
        with self._lock:
            self._works.remove(work)
            if not self._works and self._is_written:
                self._write("")

    def close(self) -> None:
        """End the thread."""
        self._closed.set()
        self._thread.join()

    def _run(self) -> None:
        pause_s = AFTER_S
        while not self._closed.wait(pause_s):
            pause_s = _AGAIN_S
            with self._lock:
                if self._works:
                    self._write(self._line()[: shutil.get_terminal_size().columns - 1])

    def _line(self) -> str:
        """The outermost work whose end is known, else the newest."""
        work = next((one for one in self._works if one.total), self._works[-1])
        return work.line(time.monotonic() - work.began_s, time.time())

    def _write(self, line: str) -> None:
        self._stream.write(_ERASED + line)
        self._stream.flush()
        self._is_written = bool(line)


_SHOWN: ContextVar[_Terminal | None] = ContextVar("shown", default=None)
_QUIET: ContextVar[bool] = ContextVar("quiet", default=False)


@contextmanager
def showing(quiet: bool = False) -> Iterator[None]:
    """Show how far it is while the block lasts, where stderr is a terminal, unless ``quiet`` or NO_COLOR is set."""
    terminal = None if quiet or not is_wanted() else _Terminal(sys.stderr)
    tokens = _SHOWN.set(terminal), _QUIET.set(quiet)
    try:
        yield
    finally:
        _SHOWN.reset(tokens[0])
        _QUIET.reset(tokens[1])
        if terminal is not None:
            terminal.close()


def is_wanted() -> bool:
    """Whether a line on stderr can be rewritten, and NO_COLOR does not forbid it."""
    return sys.stderr.isatty() and not os.environ.get("NO_COLOR")


def wants_lines() -> bool:
    """Whether hours of work should say in a log how far they are: there is no terminal, and nobody asked for quiet."""
    return _SHOWN.get() is None and not _QUIET.get()


@contextmanager
def counted(work: Work) -> Iterator[Work]:
    """Show a work while the block lasts, which sets its ``done``; results are printed after it."""
    terminal = _SHOWN.get()
    if terminal is None:
        yield work
        return
    terminal.begin(work)
    try:
        yield work
    finally:
        terminal.end(work)


def each(items: Sequence[Item], what: str, unit: str) -> Iterator[Item]:
    """The items in their order, shown as a work of as many."""
    yield from each_of(items, len(items), what, unit)


def each_of(items: Iterable[Item], total: int, what: str, unit: str) -> Iterator[Item]:
    """Items that come one by one, shown as a work of about ``total``."""
    with counted(Work(what, total, unit)) as work:
        for item in items:
            yield item
            work.done += 1


@contextmanager
def steps(names: Sequence[str], forecast: Forecast | None = None) -> Iterator[Callable[[str], None]]:
    """Show a work of these steps, of which some may be passed over and some made again.

    The function that is given says which of them begins; ``forecast`` is told so, and says when the last one ends.
    """
    with counted(Work(names[0], place=(1, len(names)), forecast=forecast)) as work:
        furthest = 0

        def begin(step: str) -> None:
            nonlocal furthest
            number = names.index(step)
            if forecast is not None:
                forecast.begin(step, time.monotonic())
            work.what, work.place = step if number > furthest else f"{step} once more", (number + 1, len(names))
            furthest = max(furthest, number)

        yield begin
