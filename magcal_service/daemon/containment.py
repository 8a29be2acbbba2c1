"""One craft's work, contained: what it raises begins that craft anew, and no other craft notices.

Nothing is known to raise: the rules of ``tests/fuzz`` look for it.  This is for what they have not found.
"""

from __future__ import annotations

import logging
from types import TracebackType
from typing import Final

from magcal_service.daemon.pipeline import Pipeline
from magcal_service.wire.messages import Message

log = logging.getLogger("magcal")

_LONGEST: Final = 160
"""Characters of an error that are published; the log has all of it."""


def in_a_line(error: Exception) -> str:
    """An error in one printable line."""
    line = " ".join(f"{type(error).__name__}: {error}".split())
    return "".join(one for one in line if one.isprintable())[:_LONGEST]


class contained:  # noqa: N801  a context manager that is called, as those of contextlib are
    """Within, whatever is raised is logged, with its traceback the first time, and the craft begins anew.

    A kind of error while the same is done is logged the first time, the 10th, the 100th and so on, with its count.

    Parameters
    ----------
    pipeline: the craft whose work it is.
    doing: what is done, for people.
    message: what is worked on: it is left out from then on.

    A class, for a generator costs thrice as much, twice for every message.
    """

    __slots__ = ("_doing", "_message", "_pipeline")

    def __init__(self, pipeline: Pipeline, doing: str, message: Message | None = None) -> None:
        self._pipeline, self._doing, self._message = pipeline, doing, message

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> bool:
        if error is None or not isinstance(error, Exception):
            return False
        self._begin_anew(error)  # whatever it is, it is this craft's alone
        return True

    def _begin_anew(self, error: Exception) -> None:
        pipeline = self._pipeline
        cause = f"{in_a_line(error)}, while {self._doing}"
        kind = f"{type(error).__name__}, while {self._doing}"
        pipeline.failures[kind] += 1
        times = pipeline.failures[kind]
        if times == 1:
            log.error(
                "%s: failed: %s; it begins anew, without its estimate", pipeline.config.name, cause, exc_info=error
            )
        elif set(str(times)[1:]) == {"0"} and str(times)[0] == "1":
            log.error(
                "%s: failed: %s, for the %dth time; it begins anew, without its estimate",
                pipeline.config.name,
                cause,
                times,
            )
        pipeline.begin_anew(cause, self._message)
