"""What became of the rows of a log: how many, which step left how many out and why, and how many are used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

WHY: Final[Mapping[str, str]] = {
    "unreadable": "that cannot be read",
    "defect": "with a certain defect",
    "same_time": "of the same time as an earlier one",
    "no_reference": "without a reference",
    "thinned": "thinned out evenly",
    "spikes": "that are single spikes",
    "edges": "within an edge of a recorded command",
    "weak_field": "in a field of less than ten times the noise",
    "spoiled": "stuck, saturated or within their noise of the stop",
    "in_pulses": "within pulses that nobody recorded, as named",
}
"""Reasons for which a row is left out, in the order of the steps, as what follows a count of rows."""


@dataclass(frozen=True, slots=True)
class Account:
    """The rows of a log.

    Parameters
    ----------
    rows: of the log.
    left_out: rows by the reason for which they are not used, those of ``WHY``; every row once.
    """

    rows: int
    left_out: Mapping[str, int]

    @property
    def used(self) -> int:
        """Rows that are left."""
        return self.rows - sum(self.left_out.values())

    def less(self, left_out: Mapping[str, int]) -> Account:
        """The account after a further step."""
        return Account(self.rows, {**self.left_out, **left_out})

    def to_dict(self) -> dict[str, Any]:
        """``rows``, ``used`` and ``left_out``, for a JSON."""
        return {"rows": self.rows, "used": self.used, "left_out": dict(self.left_out)}

    @property
    def why(self) -> str:
        """What is left out and why, in words; empty where that is nothing."""
        return ", ".join(f"{count} {WHY[why]}" for why, count in self.left_out.items() if count)

    def __str__(self) -> str:
        return f"{self.used} of {self.rows} rows used" + (f"; left out: {self.why}" if self.why else "")
