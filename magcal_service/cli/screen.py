"""A terminal that shows pictures and hears keys, and is left as it was found."""

from __future__ import annotations

import os
import select
import shutil
import signal
import sys
import termios
import tty
from collections.abc import Iterable
from contextlib import suppress
from types import FrameType, TracebackType
from typing import Any, Final, Self

from magcal_service.views.text import ASCII_BARS, BARS

_ENTER: Final = "\x1b[?1049h\x1b[?25l"  # the other screen, no cursor
_LEAVE: Final = "\x1b[?25h\x1b[?1049l"
_HOME: Final = "\x1b[H"
_END_OF_LINE: Final = "\x1b[K"  # erases from the cursor
_BELOW: Final = "\x1b[J"
_ENDING: Final = (signal.SIGTERM, signal.SIGHUP)


def is_terminal() -> bool:
    """Whether there is a terminal that takes pictures: both ways, and not a dumb one."""
    return sys.stdin.isatty() and sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"


def has_colour() -> bool:
    """Whether colours are wanted: on a terminal, without ``NO_COLOR`` (https://no-color.org)."""
    return is_terminal() and not os.environ.get("NO_COLOR")


def marks() -> str:
    """What traces are drawn with: blocks where the output's encoding has them."""
    try:
        BARS.encode(sys.stdout.encoding or "ascii")
    except (LookupError, UnicodeEncodeError):
        return ASCII_BARS
    return BARS


class Screen:
    """The terminal while pictures are shown; a context.

    Attributes
    ----------
    is_ended: the process was asked to end.
    colour: whether colours are wanted.
    """

    def __init__(self) -> None:
        self.is_ended = False
        self.colour = has_colour()
        self._stdin = sys.stdin.fileno()
        self._shown: list[str] = []
        self._size = (0, 0)

    def __enter__(self) -> Self:
        self._mode: list[Any] = termios.tcgetattr(self._stdin)
        self._handlers = {one: signal.signal(one, self._end) for one in _ENDING}
        tty.setcbreak(self._stdin)
        self._write(_ENTER)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        with suppress(termios.error):  # of a terminal that is gone there is nothing to restore
            termios.tcsetattr(self._stdin, termios.TCSADRAIN, self._mode)
        for one, handler in self._handlers.items():
            signal.signal(one, handler)
        self._write(_LEAVE)

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
        columns, rows = shutil.get_terminal_size()
        return columns, rows

    def draw(self, lines: Iterable[str]) -> None:
        """Show these lines from the top; lines that have not changed are not sent again."""
        new = list(lines)
        if self._size != self.size:
            self._size, self._shown = self.size, []
        out = "" if self._shown else _HOME + _BELOW
        for number, line in enumerate(new):
            if number >= len(self._shown) or self._shown[number] != line:
                out += f"\x1b[{number + 1};1H{line}{_END_OF_LINE}"
        if len(new) < len(self._shown):
            out += f"\x1b[{len(new) + 1};1H{_BELOW}"
        self._shown = new
        if out:
            self._write(out)

    def keys(self, wait_s: float = 0.0) -> str:
        """What was typed since the last look; waits at most so long [s] for the first key.

        An input that is closed, and a terminal that is gone, are ``q``.
        """
        pressed = ""
        while select.select([self._stdin], [], [], 0.0 if pressed else wait_s)[0]:
            try:
                typed = os.read(self._stdin, 64)
            except OSError:
                typed = b""
            pressed += typed.decode("ascii", "ignore") or ("" if typed else "q")
            if not typed:
                break
        return pressed

    def _end(self, number: int, frame: FrameType | None) -> None:
        self.is_ended = True

    def _write(self, text: str) -> None:
        try:
            sys.stdout.write(text)
            sys.stdout.flush()
        except OSError:
            self.is_ended = True  # the terminal is gone
            with open(os.devnull, "wb") as nowhere:  # where what is still to be flushed at the end goes
                os.dup2(nowhere.fileno(), sys.stdout.fileno())
