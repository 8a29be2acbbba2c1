"""Account of the rows of a log: every fault counted by kind, with the first line it was seen on."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum

from magcal_service.base.errors import printable

_SHOWN = 40
"""Characters of a cell that are shown."""


def shown(text: str) -> str:
    """A cell in quotes: escaped where a terminal might obey it, and cut where it is long."""
    escaped = printable(text)
    return f"'{escaped}'" if len(escaped) <= _SHOWN else f"'{escaped[:_SHOWN]}'..."


class RowFault(StrEnum):
    """Kinds of fault in a row, a cell or its time."""

    BLANK_LINE = "blank_line"
    SHORT_ROW = "short_row"
    LONG_ROW = "long_row"
    MISSING = "missing"
    NOT_A_NUMBER = "not_a_number"
    INFINITE = "infinite"
    UNPARSABLE = "unparsable"
    ABSURD = "absurd"
    OUT_OF_ORDER = "out_of_order"
    DOUBLED_TIME = "doubled_time"
    TRUNCATED_FILE = "truncated_file"
    OTHER_FORM = "other_form"
    UNKNOWN_UNIT = "unknown_unit"
    NOT_RECORDED = "not_recorded"
    UNMATCHED = "unmatched"
    OLD_ELEMENTS = "old_elements"


@dataclass(frozen=True, slots=True)
class RowCount:
    """One kind of fault in one part of the rows.

    Parameters
    ----------
    part: ``row``, ``time``, ``magnetometer``, ``reference``, ``position`` or ``channels.<name>``; of a session also
        ``recorder``, ``file`` or ``record (<reason>)``.
    fault: the kind.
    count: rows that have it.
    first_line: line of the file, or number of the record in a session, from 1, that has it first.
    kept: whether the row is used all the same (without the faulty part).
    place: what ``first_line`` counts.
    shows: what stands there in place of what was expected, in words; empty where the kind says it all.
    """

    part: str
    fault: RowFault
    count: int
    first_line: int
    kept: bool
    place: str = "line"
    shows: str = ""

    def __str__(self) -> str:
        fate = self._kept_as if self.kept else "refused"
        shows = f" ({self.shows})" if self.shows else ""
        return f"{self.part}: {self.fault.value} x {self.count}, first on {self.place} {self.first_line}{shows}, {fate}"

    @property
    def _kept_as(self) -> str:
        """How a row is read that has the fault."""
        if self.part in ("reference", "position"):
            return f"read without that {self.part}"
        return "read without that value" if self.part.startswith("channels.") else "read all the same"


@dataclass(frozen=True, slots=True)
class RowReport:
    """The account of one log: ``rows`` seen, ``used`` of them (read; later steps leave more out), and every fault.

    ``remarks`` are sentences on what the rows were read with, where that is not in the log alone.
    """

    rows: int
    used: int
    entries: tuple[RowCount, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def refused(self) -> int:
        """Rows that are not used at all."""
        return self.rows - self.used

    @property
    def counts(self) -> Counter[str]:
        """Total of each kind of fault over all parts, kept or refused."""
        total: Counter[str] = Counter()
        for entry in self.entries:
            total[entry.fault.value] += entry.count
        return total

    def count(self, part: str, fault: RowFault) -> int:
        """Rows with this fault in this part."""
        return sum(entry.count for entry in self.entries if entry.part == part and entry.fault is fault)

    def lines(self) -> list[str]:
        """The account in words, one line per kind."""
        return [f"{self.rows} rows, {self.used} read, {self.refused} refused", *map(str, self.entries), *self.remarks]
