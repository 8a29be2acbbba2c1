"""Standard output that may go away: a reader that has seen enough, such as ``head``, a full disk, or none at all."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO, cast

from magcal_service.base.errors import unwritable


class _Output:
    """A stream that loses what can no longer be written; what is lost is no reason to leave work undone.

    Parameters
    ----------
    stream: where it goes.
    endless: whether the command ends only when somebody ends it: then the reader's leaving does.
    """

    def __init__(self, stream: TextIO, *, endless: bool) -> None:
        self.failure: OSError | None = None
        self._stream, self._endless = stream, endless

    def write(self, text: str) -> int:
        """As of a text stream; all of the text is taken."""
        try:
            self._stream.write(text)
        except OSError as error:
            self._lose(error)
        return len(text)

    def flush(self) -> None:
        """As of a text stream."""
        try:
            self._stream.flush()
        except OSError as error:
            self._lose(error)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _lose(self, error: OSError) -> None:
        with contextlib.suppress(OSError), open(os.devnull, "wb") as nowhere:  # where what is still held goes
            os.dup2(nowhere.fileno(), self._stream.fileno())
        if not isinstance(error, BrokenPipeError):
            self.failure = self.failure or error
        if self._endless:
            raise error


@contextmanager
def standard_output(*, endless: bool) -> Iterator[None]:
    """Within, what is printed may be lost, and everything else is done.

    Raises InputRefusedError at the end where it could not be written, but for a reader that has left.  A command that
    is ``endless`` meets both while it prints, as OSError, and may catch it; BrokenPipeError passes through.
    """
    before = sys.stdout
    with contextlib.ExitStack() as stack:
        stream = before or stack.enter_context(open(os.devnull, "w", encoding="utf-8"))  # closed by whoever started it
        output = _Output(stream, endless=endless)
        sys.stdout = cast(TextIO, output)
        try:
            yield
            sys.stdout.flush()
        except OSError as error:
            if error is not output.failure:
                raise
        else:
            if endless:  # it has met the failure itself
                return
        finally:
            sys.stdout = before
    if output.failure is not None:
        raise unwritable(Path("standard output"), output.failure)
