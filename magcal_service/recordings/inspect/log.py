"""The rows of a recording that are still sound, as the checks look at them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from magcal_service.recordings.inspect.finding import Rows
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.specs import ModelReference
from magcal_service.recordings.table import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Log:
    """Some rows of a recording, in file order.

    Parameters
    ----------
    recording: the whole.
    rows: (m,) numbers of its rows that nothing certain was found on so far.
    """

    recording: Recording
    rows: Rows

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def time_ns(self) -> IntArray:
        """(m,) times [ns]."""
        return self.recording.time_ns[self.rows]

    @cached_property
    def time_s(self) -> FloatArray:
        """(m,) times since the first of the rows [s]."""
        return (self.time_ns - self.time_ns[0]) * 1e-9 if len(self) else np.zeros(0)

    @cached_property
    def field_nt(self) -> FloatArray:
        """(m, 3) measured vectors [nT]."""
        return self.recording.field_body_nt[self.rows]

    @cached_property
    def field_as_written(self) -> FloatArray:
        """(m, 3) measured vectors in the unit of the file, free of the rounding of the conversion."""
        return np.asarray(np.round(self.field_nt / self.recording.descriptor.magnetometer.unit_nt, 9))

    @cached_property
    def magnitude_nt(self) -> FloatArray:
        """(m,) |H| [nT], NaN where a row has none."""
        return self.recording.reference.magnitude_nt[self.rows]

    @cached_property
    def place_km(self) -> FloatArray | None:
        """(m, 3) places [km] in the recording's own frame, NaN where a row has none."""
        position = self.recording.position
        return None if position is None else position.km[self.rows]

    @property
    def is_modelled(self) -> bool:
        """Whether the reference comes from the place."""
        return isinstance(self.recording.descriptor.reference, ModelReference)

    @cached_property
    def step_s(self) -> float:
        """Median of the steps between times that differ [s]; 0 where there are none."""
        steps = np.diff(np.unique(self.time_ns))
        return float(np.median(steps)) * 1e-9 if len(steps) else 0.0

    @cached_property
    def resolution(self) -> FloatArray:
        """(3,) steps of the sensor's axes in the unit of the file: the usual least difference between two values."""
        return np.array([_least_step(values) for values in self.field_as_written.T])


def _least_step(values: FloatArray) -> float:
    steps = np.diff(np.unique(values))
    return float(np.quantile(steps, 0.1)) if len(steps) else 0.0


def runs(flag: NDArray[np.bool_]) -> tuple[Rows, Rows]:
    """First and last-plus-one row of every stretch of a flag (m,), each (k,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flag, [False]]).astype(np.int8)))
    return edges[::2], edges[1::2]
