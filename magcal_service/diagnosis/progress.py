"""How far a diagnosis has come, on stderr: a turning wheel where rich is installed and somebody looks, else lines."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress() -> Iterator[Callable[[str], None]]:
    """What to tell each step to while the block lasts."""
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
