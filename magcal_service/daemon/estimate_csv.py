"""Estimates as CSV rows, the same from a live run and from a replay."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import numpy as np

from magcal_service.errors import Fault, InputRefusedError, unwritable
from magcal_service.model import STATE_NAMES, STATE_SIZE
from magcal_service.wire.messages import Estimate

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
)


def _cut_torn_row(path: Path) -> None:
    with path.open("r+b") as file:
        begin = max(0, file.seek(0, os.SEEK_END) - _LONGEST_ROW)
        file.seek(begin)
        file.truncate(begin + file.read().rfind(b"\n") + 1)


class EstimateCsv:
    """Writes one row per ``Estimate``; numbers in full precision, so equal files mean equal runs.

    Parameters
    ----------
    path: the file.
    append: continue after the rows that a file already holds, as a restarted daemon does; a last row that a crash
        cut short is removed.

    Every method raises ``InputRefusedError`` where the file cannot be written.
    """

    def __init__(self, path: Path, *, append: bool = False) -> None:
        self.path = path
        if "\0" in str(path):
            raise InputRefusedError([Fault("output file", str(path), "give a file that can be written")])
        with self._refusing():
            if append and path.is_file():
                _cut_torn_row(path)
            self._file = path.open("a" if append else "w", newline="", encoding="utf-8")
        self._writer = csv.writer(self._file, lineterminator="\n")
        if not self._file.tell():
            self._write(COLUMNS)

    @contextmanager
    def _refusing(self) -> Iterator[None]:
        try:
            yield
        except OSError as exc:
            raise unwritable(self.path, exc) from None

    def _write(self, row: Iterable[object]) -> None:
        with self._refusing():
            self._writer.writerow(row)

    def add(self, estimate: Estimate) -> None:
        """Write one row."""
        sigma = [estimate.covariance[index] ** 0.5 for index in _VARIANCES]
        self._write(
            (
                estimate.craft,
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
            )
        )

    def flush(self) -> None:
        """Hand what was written to the operating system."""
        with self._refusing():
            self._file.flush()

    def close(self) -> None:
        """Flush and close the file; may be called twice."""
        with self._refusing():
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()
