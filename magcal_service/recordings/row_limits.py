"""How much of a log in rows is read at most: a packed one may be a thousand times what its file is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from magcal_service.base.errors import Fault, RecordingError

DEFAULT_MAX_ROWS: Final = 2_000_000
"""Choice: five hours at 100 Hz, two days at 10 Hz; a row of seven columns takes about 0.25 kB of memory."""

HIGHEST_MAX_ROWS: Final = 1_000_000_000  # choice: more than any memory here holds

_BYTES_PER_ROW: Final = 128  # choice: ten numbers of twelve characters
_CELLS_PER_ROW: Final = 16  # a cell takes 60 bytes of memory, however short it is
_LEAST_BYTES: Final = 1 << 20  # of a log of few rows, long as they may be
_LEAST_CELLS: Final = 1 << 16  # the same in cells
_LINE: Final = 1 << 20  # 1 MiB; choice: sixty thousand columns


@dataclass(frozen=True, slots=True)
class RowLimits:
    """The most that is taken of one log; each check raises ``RecordingError`` beyond it.

    Parameters
    ----------
    max_rows: lines below the header; bytes, unpacked, and cells go with it.
    """

    max_rows: int = DEFAULT_MAX_ROWS

    def check_rows(self, path: Path, rows: int) -> None:
        """Refuse a log by its rows so far."""
        if rows > self.max_rows:
            self._refuse(path, f"more than {self.max_rows} rows", f"at most {self.max_rows} rows are accepted")

    def check_messages(self, name: str, messages: int) -> None:
        """Refuse a recorded session by its messages so far, each of which takes as much memory as a row."""
        if messages > self.max_rows:
            accepted = f"at most {self.max_rows} are held in memory; record with a smaller file_mb, or give a "
            accepted += "RECORDING.toml with a higher max_rows under [samples] where there is memory (0.8 kB each)"
            raise RecordingError([Fault(name, f"more than {self.max_rows} messages that came in", accepted)])

    def check_bytes(self, path: Path, size: int) -> None:
        """Refuse a log by its bytes so far, unpacked."""
        most = max(self.max_rows * _BYTES_PER_ROW, _LEAST_BYTES)
        if size > most:
            accepted = f"at most {most} bytes are accepted with {self.max_rows} rows"
            self._refuse(path, f"more than {most} bytes unpacked", accepted)

    def check_line(self, path: Path, length: int) -> None:
        """Refuse a log by the length of one line."""
        if length > _LINE:
            accepted = f"lines of at most {_LINE} bytes are accepted; check that it is a log in rows"
            raise RecordingError([Fault(str(path), "a line that is too long", accepted)])

    def check_cells(self, path: Path, columns: int, rows: int) -> None:
        """Refuse a log whose rows, all as wide as its header, have too many cells."""
        most = max(self.max_rows * _CELLS_PER_ROW, _LEAST_CELLS)
        if columns * rows > most:
            accepted = f"at most {most} cells are accepted with {self.max_rows} rows"
            self._refuse(path, f"{rows} rows of {columns} columns", accepted)

    def _refuse(self, path: Path, value: str, accepted: str) -> None:
        remedy = "split the log, or set max_rows under [samples] higher where there is memory for it (0.25 kB a row)"
        raise RecordingError([Fault(str(path), value, f"{accepted}; {remedy}")])
