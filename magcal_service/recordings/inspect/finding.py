"""A defect of a recording: what it is, which rows have it, what shows it, and what to write."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magcal_service.recordings.defects import Code
from magcal_service.recordings.report import RowCount

__all__ = ["NO_ROWS", "Code", "Finding", "Rows", "Seen", "Spoils", "rows_text", "rows_that", "verb_of"]

Rows = NDArray[np.intp]
"""Numbers of rows of a recording, rising."""


class Spoils(StrEnum):
    """What of its rows a certain defect takes away."""

    ROW = "row"
    SAMPLES = "samples"  # the row too, but a diagnosis names the cause itself
    PLACE = "place"
    REFERENCE = "reference"
    NOTHING = "nothing"


@dataclass(frozen=True, slots=True)
class Finding:
    """One defect as it is reported.

    Parameters
    ----------
    code: the kind.
    certain: whether its rows can be nothing else; what is only likely is asked about and never acted on.
    rows: how many rows have it.
    first: line of the log (number of the row from 1, where there are no lines) that has it first.
    says: one sentence with the numbers that show it.
    remedy: one sentence: what to write in the descriptor, or what to do.
    """

    code: Code
    certain: bool
    rows: int
    first: int
    says: str
    remedy: str

    def to_dict(self) -> dict[str, Any]:
        """The contract's object."""
        return {
            "code": str(self.code),
            "rows": self.rows,
            "first": self.first,
            "certain": self.certain,
            "says": self.says,
            "remedy": self.remedy,
        }

    def __str__(self) -> str:
        kind = "certain" if self.certain else "likely"
        return f"{self.code} ({kind}, first at line {self.first}): {self.says}; {self.remedy}"


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What a check saw.

    Parameters
    ----------
    code, certain, says, remedy: as in ``Finding``.
    rows: numbers of the recording's rows that have it.
    spoils: what of these rows is left out, where it is certain.
    refused: the count of rows that the reader refused already; then ``rows`` are none.
    """

    code: Code
    certain: bool
    rows: Rows
    says: str
    remedy: str
    spoils: Spoils = Spoils.NOTHING
    refused: RowCount | None = None


NO_ROWS: Rows = np.zeros(0, dtype=np.intp)


def rows_text(count: int) -> str:
    """``1 row`` or ``12 rows``."""
    return f"{count} row" if count == 1 else f"{count} rows"


_OF_ONE = {"have": "has", "reach": "reaches", "stop at": "stops at"}
"""What a verb is of one row, where that is not the verb with an s."""


def verb_of(count: int, verb: str) -> str:
    """A verb in the plural as so many rows have it: ``lies`` of one, ``lie`` of 12."""
    return _OF_ONE.get(verb, f"{verb}s") if count == 1 else verb


def rows_that(count: int, verb: str, of: int | None = None) -> str:
    """``1 row of 20 has``, ``12 rows of 20 have``; without ``of`` the rows alone."""
    rows = rows_text(count) if of is None else f"{rows_text(count)} of {of}"
    return f"{rows} {verb_of(count, verb)}"
