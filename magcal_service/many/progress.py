"""How far many pieces have come: the line of a terminal, else a line every half minute for whoever reads the log."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from magcal_service.base.progress import Work, counted, wants_lines

_LINE_EVERY_S: Final = 30.0
"""Between two lines where there is no terminal [s]; choice: a log of an hour stays below 120 lines."""

Show = Callable[[], None]
"""To be called when the work has gone on."""


@contextmanager
def shown(work: Work) -> Iterator[Show]:
    """Show a work while the block lasts."""
    with counted(work):
        yield _Lines(work) if wants_lines() else lambda: None


class _Lines:
    """A line every half minute; what ends sooner is not worth one."""

    def __init__(self, work: Work) -> None:
        self.work = work
        self._began_s = time.monotonic()
        self._next_s = self._began_s + _LINE_EVERY_S

    def __call__(self) -> None:
        now_s = time.monotonic()
        if now_s >= self._next_s:
            self._next_s = now_s + _LINE_EVERY_S
            print(self.work.line(now_s - self._began_s, time.time()), file=sys.stderr, flush=True)
