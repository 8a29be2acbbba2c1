"""How far a diagnosis has come, on stderr: a spinner where rich is installed on a terminal, else lines."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress() -> Iterator[Callable[[str], None]]:
    """A function to report each step to while the block lasts."""
    if sys.stderr.isatty():
        try:
            from rich.console import Console
            from rich.markup import escape
        except ImportError:
            pass
        else:
            with Console(stderr=True).status("reading ...") as status:
                yield lambda step: status.update(f"{escape(step)} ...")
            return
    yield lambda step: print(f"{step} ...", file=sys.stderr, flush=True)
