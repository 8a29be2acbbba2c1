"""Estimates as CSV rows, the same from a live run and from a replay."""

from __future__ import annotations

import fcntl
import logging
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import numpy as np

from magcal_service.base.disk import opened_at_once
from magcal_service.base.errors import Fault, InputRefusedError, unwritable
from magcal_service.config.magnetometers import label_of
from magcal_service.model import STATE_NAMES, STATE_SIZE
from magcal_service.wire.messages import Estimate

_log = logging.getLogger("magcal")

_VARIANCES: Final = np.flatnonzero(np.equal(*np.triu_indices(STATE_SIZE))).tolist()

_LONGEST_ROW: Final = 65_536  # bytes, far more than any row

COLUMNS: Final = (
    "craft",
    "time_ns",
    "tick",
    *STATE_NAMES,
    *(f"sigma_{name}" for name in STATE_NAMES),
    "verdict",
    "reasons",
    "residual_rms_nt",
    "noise_nt",
    "samples_used",
    "protection_nt",
    "protection_by",
)


_HEADER: Final = ",".join(COLUMNS).encode() + b"\n"


def _cut_torn_row(path: Path) -> None:
    """Cut off a last row that a crash cut short, of a file of ours; InputRefusedError for what is none."""
    with path.open("r+b") as file:
        head = file.read(len(_HEADER))
        if head != _HEADER[: len(head)]:
            accepted = "a file of estimates with the same columns is continued; move this one away, or give another"
            raise InputRefusedError(
                [Fault(str(path), head.partition(b"\n")[0].decode(errors="replace")[:40], accepted)]
            )
        begin = max(0, file.seek(0, os.SEEK_END) - _LONGEST_ROW)
        file.seek(begin)
        file.truncate(begin + file.read().rfind(b"\n") + 1)


class EstimateCsv:
    """Writes one row per ``Estimate``; numbers in full precision, so equal files mean equal runs.

    Parameters
    ----------
    path: the file.
    append: continue after the rows that a file already holds, as a restarted daemon does; a last row that a crash
        cut short is removed.  No other process continues the same file, and one that is renamed, deleted or emptied
        meanwhile is begun anew at the next ``flush``.  A pipe that is not read as fast is an error then, no wait.

    Every method raises ``InputRefusedError`` where the file cannot be written, holds something else, or is written by
    another process.
    """

    def __init__(self, path: Path, *, append: bool = False) -> None:
        self.path = path
        if "\0" in str(path):
            raise InputRefusedError([Fault("output file", str(path), "give a file that can be written")])
        self.append = append
        self._open()

    def open_again(self) -> None:
        """Go on at the end of the file after an error; only where it is continued."""
        self._open()

    def _open(self) -> None:
        with self._refusing():
            mode, opener = ("a", opened_at_once) if self.append else ("w", None)
            self._file = open(  # noqa: SIM115 -- closed by ``close``
                self.path, mode, newline="", encoding="utf-8", opener=opener
            )
            try:
                if self.append:
                    self._lock()
                    if self.path.is_file():
                        _cut_torn_row(self.path)
            except BaseException:
                self._file.close()
                raise
            self._size = os.fstat(self._file.fileno()).st_size
        if not self._size:
            self._write(COLUMNS)

    def _lock(self) -> None:
        """Hold the file for as long as it is open."""
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            accepted = "a file that no other daemon writes is accepted; stop that one, or give another"
            raise InputRefusedError([Fault(str(self.path), "written by another process", accepted)]) from None
        except OSError:  # some file systems, and devices, know no locks
            return

    def _follow(self) -> None:
        """Begin anew where the path leads to another file by now or to none, or the file was made shorter."""
        held = os.fstat(self._file.fileno())
        if not (self.append and stat.S_ISREG(held.st_mode)):
            return
        try:
            there = self.path.stat()
        except FileNotFoundError:
            there = None
        if there is not None and os.path.samestat(held, there) and held.st_size >= self._size:
            self._size = held.st_size
            return
        what = (
            "is gone" if there is None else "was made shorter" if os.path.samestat(held, there) else "is another file"
        )
        _log.warning("%s %s: rows go on at its end", self.path, what)
        self._file.close()
        self._open()
        self._file.flush()

    @contextmanager
    def _refusing(self) -> Iterator[None]:
        try:
            yield
        except OSError as exc:
            raise unwritable(self.path, exc) from None

    def _write(self, row: Iterable[object]) -> None:
        """Write a row; nothing in it is quoted: its numbers, names and codes hold neither comma nor quote."""
        try:
            self._file.write(",".join(["" if value is None else str(value) for value in row]) + "\n")
        except OSError as exc:
            raise unwritable(self.path, exc) from None

    def add(self, estimate: Estimate) -> None:
        """Write one row."""
        sigma = [estimate.covariance[index] ** 0.5 for index in _VARIANCES]
        self._write(
            (
                label_of(estimate),
                estimate.time_ns,
                estimate.tick,
                *estimate.bias_nt,
                *estimate.D,
                *sigma,
                estimate.verdict,
                " ".join(estimate.reasons),
                estimate.residual_rms_nt,
                estimate.noise_nt,
                estimate.samples_used,
                estimate.protection_nt,
                estimate.protection_by,
            )
        )

    def flush(self) -> None:
        """Hand what was written to the operating system, and go on in a new file where this one was taken away."""
        with self._refusing():
            self._file.flush()
            self._follow()

    def close(self) -> None:
        """Flush and close the file; may be called twice."""
        with self._refusing():
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()
