"""The newest samples of a spin estimator, for its batch fits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from magcal_service.base.snapshot import SnapshotError, Stateful, plain, restored
from magcal_service.estimators.steady_spin.fit import Samples
from magcal_service.model import Array

CAPACITY: Final = 16384
"""Samples kept, 0.9 MB: three orbits at 1 Hz, half an orbit at 6 Hz."""


class SampleBuffer(Stateful):
    """The newest samples; when it is full, the oldest quarter goes.

    What is saved are the rows that are filled, by methods of this class: the rest of the table is room.
    """

    worked_out = ("_rows", "count")

    def __init__(self) -> None:
        self._rows = np.empty((256, 7))
        self.count = 0

    def export_state(self) -> dict[str, Any]:
        """The samples; what lies behind them in memory is no state."""
        return {"rows": plain(self._rows[: self.count])}

    def restore_state(self, saved: object, where: str = "state", given: Mapping[Any, Any] | None = None) -> None:
        """Take over exported samples into an empty buffer."""
        rows = restored(saved.get("rows") if isinstance(saved, dict) else None, Array, where)
        if rows.ndim != 2 or rows.shape[1] != 7 or len(rows) > 2 * CAPACITY:
            raise SnapshotError(f"{where} has the shape {rows.shape}; rows of 7 are accepted")
        self._rows, self.count = np.empty((256, 7)), 0
        self.add(rows[:, 0], rows[:, 1:4], rows[:, 4:7])

    @property
    def full(self) -> bool:
        """Whether the next samples would cost the oldest."""
        return self.count >= CAPACITY

    def add(self, times_s: Array, field_nt: Array, reference_eci_nt: Array) -> None:
        """Take samples: times (n,) [s], B (n, 3) and H (n, 3) [nT]."""
        new = np.column_stack([times_s, field_nt, reference_eci_nt])
        if self.full:
            self._rows[: self.count * 3 // 4] = self._rows[self.count - self.count * 3 // 4 : self.count]
            self.count = self.count * 3 // 4
        while self.count + len(new) > len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        self._rows[self.count : self.count + len(new)] = new
        self.count += len(new)

    def samples(self) -> Samples:
        """All of them, with times before the newest."""
        rows = self._rows[: self.count]
        return Samples(rows[:, 0] - rows[-1, 0], rows[:, 1:4], rows[:, 4:7])
