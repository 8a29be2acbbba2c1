"""How far many pieces have come, on stderr: a bar on a terminal with rich, else a line every half minute."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

_LINE_EVERY_S: Final = 30.0
"""Between two lines where there is no bar [s]; choice: a log of an hour stays below 120 lines."""


@dataclass(slots=True)
class Count:
    """What has ended so far, in the pieces' own sizes.

    Parameters
    ----------
    what, total: what is done, and how much of it there is.
    done, failed: what has ended; ``failed`` with no result.
    kept: of ``done``, what was there before and says nothing about how long the rest will take.
    """

    what: str
    total: int
    done: int = 0
    failed: int = 0
    kept: int = 0

    def left_s(self, elapsed_s: float) -> float | None:
        """Seconds until the end, at the pace so far; None before anything has ended."""
        worked = self.done - self.kept
        return elapsed_s * (self.total - self.done) / worked if worked > 0 else None

    def line(self, elapsed_s: float, now: float) -> str:
        """All of it as a line; ``now`` is the time of day [s since 1970]."""
        parts = [f"{self.what}: {self.done} of {self.total} done", f"{self.failed} failed", duration(elapsed_s)]
        left = self.left_s(elapsed_s)
        if left is not None:
            parts.append(f"{duration(left)} left, until {time.strftime('%H:%M', time.localtime(now + left))}")
        return ", ".join(parts)


def duration(seconds: float) -> str:
    """Seconds as people say them."""
    whole = round(seconds)
    if whole < 100:
        return f"{whole} s"
    return f"{whole // 60} min" if whole < 100 * 60 else f"{whole // 3600} h {whole % 3600 // 60} min"


Show = Callable[[], None]
"""To be called when the count has changed."""


@contextmanager
def shown(count: Count) -> Iterator[Show]:
    """Show a count while the block lasts."""
    if sys.stderr.isatty():
        try:
            import rich.progress  # noqa: F401
        except ImportError:
            pass
        else:
            with _bar(count) as show:
                yield show
            return
    yield _Lines(count)


@contextmanager
def _bar(count: Count) -> Iterator[Show]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TextColumn("{task.fields[end]}"), console=Console(stderr=True), transient=True) as display:
        task = display.add_task(count.what, total=count.total, end="")
        began = time.monotonic()

        def show() -> None:
            left = count.left_s(time.monotonic() - began)
            end = f"{count.failed} failed" if count.failed else ""
            end += f" {duration(left)} left" if left is not None else ""
            display.update(task, completed=count.done, end=end)

        yield show


class _Lines:
    """A line every half minute; what ends sooner is not worth one."""

    def __init__(self, count: Count) -> None:
        self.count = count
        self._began_s = time.monotonic()
        self._next_s = self._began_s + _LINE_EVERY_S

    def __call__(self) -> None:
        now_s = time.monotonic()
        if now_s >= self._next_s:
            self._next_s = now_s + _LINE_EVERY_S
            print(self.count.line(now_s - self._began_s, time.time()), file=sys.stderr, flush=True)
