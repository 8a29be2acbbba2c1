"""The oldest checkpoint that is still believed, kept outside their folder: what is signed may yet be played again.

Each checkpoint bears how many were written with it and before.  Once one is on the disk, the number of the one before
it is put into a file elsewhere, and from then on those below are refused.  So a daemon that is killed between the two
has a lower number, never a higher one, and finds the checkpoint; and one that a failing disk has damaged still gives
way to the one before it.  Whoever can write the checkpoints' folder and not this file can bring back at most that one.
"""

from __future__ import annotations

from pathlib import Path

from magcal_service.base.errors import FileFault, InputRefusedError
from magcal_service.links.counter_file import CounterFile


class Floor:
    """The least number that is believed.

    Parameters
    ----------
    folder: where its file is; made where absent.
    label: what the magnetometer is called (``config.magnetometers.label``).

    Raises InputRefusedError where the folder cannot be made.
    """

    def __init__(self, folder: Path, label: str) -> None:
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            fault = FileFault(str(folder), error, "a folder that can be written is accepted")
            raise InputRefusedError([fault]) from None
        self._file = CounterFile(folder / f"{label.replace('/', '.')}.counter")
        self._before = 0  # the newest that was found sound or written

    @property
    def number(self) -> int:
        """The least number that is believed; 0 where there is none yet."""
        return self._file.last or 0

    def refusal(self, number: int) -> str:
        """Why a sound checkpoint of this number is not to be believed; empty where it is."""
        if self._file.last is None:
            return f"{self._file.path} is damaged, so it may be an old one that was played again"
        if number < self._file.last:
            return f"older than the newest: its number is {number}, {self._file.last} or more is accepted"
        self._before = max(self._before, number)
        return ""

    def written(self, number: int) -> None:
        """A checkpoint of this number is on the disk; OSError where the disk does not take the number before it."""
        if self._file.last is None or self._before > self._file.last:
            self._file.keep(self._before)
        self._before = number
