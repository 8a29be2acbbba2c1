"""One craft's work, contained: what it raises begins that craft anew, and no other craft notices.

Nothing is known to raise: the rules of ``tests/fuzz`` look for it.  This is for what they have not found.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from magcal_service.daemon.pipeline import Pipeline
from magcal_service.wire.messages import Message

log = logging.getLogger("magcal")

_LONGEST: Final = 160
"""Characters of an error that are told; the log has all of it."""


def told(error: Exception) -> str:
    """An error in one printable line."""
    line = " ".join(f"{type(error).__name__}: {error}".split())
    return "".join(one for one in line if one.isprintable())[:_LONGEST]


@contextmanager
def contained(pipeline: Pipeline, doing: str, message: Message | None = None) -> Iterator[None]:
    """Within, whatever is raised is logged, with its traceback where it is new, and the craft begins anew.

    Parameters
    ----------
    pipeline: the craft whose work it is.
    doing: what is done, for people.
    message: what is worked on: it is left out from then on.
    """
    try:
        yield
    except Exception as error:  # whatever it is, it is this craft's alone
        cause = f"{told(error)}, while {doing}"
        log.error("%s: failed: %s; it begins anew", pipeline.config.name, cause, exc_info=cause != pipeline.failure)
        pipeline.begin_anew(cause, message)
