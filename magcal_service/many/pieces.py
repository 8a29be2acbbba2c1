"""A piece of work, what becomes of it, and how a worker does it."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from magcal_service.base.errors import Fault, InputRefusedError, MagcalError
from magcal_service.many.identity import code_of, content_of

THREAD_COUNTS: Final = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Of the environment; a worker's linear algebra has one thread: workers fill the cores, and sums keep their order."""

ATTEMPTS: Final = 3
"""How often a piece is begun whose worker dies; choice: one death is an accident, three are the piece's own doing."""


@dataclass(frozen=True, slots=True)
class Piece:
    """One piece of work.

    Parameters
    ----------
    name: what people call it, such as a recording's.
    function, argument: what is to be done.  Argument and result are plain data (``plain.pack``), the function is of
        a module, or a ``partial`` of one, and the result must depend on these, ``inputs`` and the code alone.
    inputs: files that it reads.
    size: how much it counts in the progress.
    """

    name: str
    function: Callable[[Any], Any]
    argument: Any
    inputs: tuple[Path, ...] = ()
    size: int = 1


@dataclass(frozen=True, slots=True)
class Done:
    """A piece that came to its result."""

    value: Any


@dataclass(frozen=True, slots=True)
class Refused:
    """A piece whose input was refused: the text of the ``MagcalError``, and its exit code."""

    text: str
    exit_code: int


@dataclass(frozen=True, slots=True)
class Failed:
    """A piece that came to nothing: its worker died each time, or it met a defect; ``trace`` says where."""

    text: str
    trace: str = ""


Outcome = Done | Refused | Failed


@dataclass(frozen=True, slots=True)
class Task:
    """A piece as a worker gets it: with the code and the contents of files that its result is asked for."""

    function: Callable[[Any], Any]
    argument: Any
    inputs: tuple[tuple[Path, str], ...]
    code: str


_ALONE: Final = threading.Lock()
"""A worker with several threads does one piece at a time: drawing and warnings are a process's, not a thread's."""


def perform(task: Task) -> Outcome:
    """Do the work of one task; whatever it raises is an outcome."""
    with _ALONE:
        try:
            _check_same(task)
            return Done(task.function(task.argument))
        except MagcalError as exc:
            return Refused(str(exc), exc.exit_code)
        except Exception as exc:  # one piece that fails must not cost the others
            return failure(exc)


def failure(exc: Exception) -> Failed:
    """A defect in a line, and its trace."""
    text = "".join(traceback.format_exception_only(exc)).strip()
    return Failed(text, "".join(traceback.format_exception(exc)))


def _check_same(task: Task) -> None:
    """Refuse to answer for another code or other files than those the result will be kept under."""
    if task.code != code_of(task.function):
        accepted = f"install there the code of whoever asks ({task.code[:12]}), with the same numpy and Python"
        raise InputRefusedError([Fault("worker's code", code_of(task.function)[:12], accepted)])
    for path, content in task.inputs:
        if content_of(path) != content:
            accepted = "a worker has to see the file that was there at the start; share the folder, or begin again"
            raise InputRefusedError([Fault(str(path), "another content, or none", accepted)])


def died(code: int | None) -> Failed:
    """The outcome of a piece whose worker died at each attempt; ``code`` is the last one's exit code."""
    how = "" if code is None else f", the last time by signal {-code}" if code < 0 else f", the last time with {code}"
    return Failed(f"its process died {ATTEMPTS} times{how}; was there memory enough?")
