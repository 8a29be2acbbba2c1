"""How far a study has come, on stderr: a bar where rich is installed on a terminal, else a line every half minute."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

Advance = Callable[[int], None]
"""To be called with the number of runs that have just ended."""

_LINE_EVERY_S: Final = 30.0
"""Between two lines where there is no bar [s]; choice: a log of an hour stays below 120 lines."""


@contextmanager
def progress(what: str, total: int) -> Iterator[Advance]:
    """Show the progress of ``total`` runs while the block lasts."""
    if sys.stderr.isatty():
        try:
            import rich.progress  # noqa: F401
        except ImportError:
            pass
        else:
            with _bar(what, total) as advance:
                yield advance
            return
    yield _Lines(what, total)


@contextmanager
def _bar(what: str, total: int) -> Iterator[Advance]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as display:
        task = display.add_task(what, total=total)
        yield lambda count: display.advance(task, count)


class _Lines:
    """A line every half minute.

    Parameters
    ----------
    what, total: what is counted, and how many there will be.
    """

    def __init__(self, what: str, total: int) -> None:
        self.what, self.total = what, total
        self._done = 0
        self._next_s = time.monotonic() + _LINE_EVERY_S

    def __call__(self, count: int) -> None:
        self._done += count
        if time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + _LINE_EVERY_S
            print(f"{self.what}: {self._done} of {self.total} runs", file=sys.stderr, flush=True)
