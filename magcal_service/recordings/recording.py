"""A log as arrays: what the reader gives and everything offline works on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from magcal_service.config.settings import CraftConfig
from magcal_service.recordings.channels import ChannelSpec
from magcal_service.recordings.report import RowReport
from magcal_service.recordings.specs import Descriptor
from magcal_service.recordings.table import FloatArray, IntArray
from magcal_service.wire.messages import Clock, Frame, Message


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """The reference field of every row; NaN where a row has none.

    Parameters
    ----------
    magnitude_nt: (n,) |H| [nT].
    vector_nt: (n, 3) H [nT] in ``frame``, or None where only the magnitude is known.
    """

    magnitude_nt: FloatArray
    vector_nt: FloatArray | None = None
    frame: Frame | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Position:
    """Where the craft was: (n, 3) [km] in ``frame`` (ECI or ECEF); NaN where a row has none."""

    km: FloatArray
    frame: Frame


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """One telemetry channel: what it is, and its values (n, k) in its own unit, NaN where a cell has none."""

    spec: ChannelSpec
    values: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A log as arrays: the rows with a usable time and magnetometer vector, in file order.

    Parameters
    ----------
    name: file name of the log.
    descriptor: what the log is.
    time_ns: (n,) int64, source time [ns] on ``clock``; neither sorted nor unique if the log is not.
    field_body_nt: (n, 3) measured vector B [nT] in the sensor's own axes.
    reference, position, channels: what else each row holds; ``channels`` by name.
    report: the account of the rows.
    craft: the configuration a session was recorded under; None where the log does not say.
    stream: what a session's service received, in order; None where the log is rows and no session.
    state: what a session's service began with, for ``Pipeline.restore_state``; None where that was nothing.
    """

    name: str
    descriptor: Descriptor
    time_ns: IntArray
    clock: Clock
    field_body_nt: FloatArray
    reference: Reference
    position: Position | None
    channels: dict[str, Channel]
    report: RowReport
    craft: CraftConfig | None = None
    stream: tuple[Message, ...] | None = None
    state: dict[str, Any] | None = None

    def __len__(self) -> int:
        return len(self.time_ns)

    @property
    def duration_s(self) -> float:
        """From the earliest to the latest sample [s]."""
        return (int(self.time_ns.max()) - int(self.time_ns.min())) / 1e9

    def select(self, rows: npt.NDArray[np.bool_] | IntArray) -> Recording:
        """The same recording with these rows only (a mask or indices), no session's stream any more.

        The report stays that of the whole log.
        """
        reference, position = self.reference, self.position
        vector_nt = None if reference.vector_nt is None else reference.vector_nt[rows]
        return replace(
            self,
            time_ns=self.time_ns[rows],
            field_body_nt=self.field_body_nt[rows],
            reference=Reference(reference.magnitude_nt[rows], vector_nt, reference.frame),
            position=None if position is None else Position(position.km[rows], position.frame),
            channels={name: Channel(c.spec, c.values[rows]) for name, c in self.channels.items()},
            stream=None,
            state=None,
        )

    def sorted_unique(self) -> Recording:
        """For offline use: rows in time order, the first in the file of those with the same time, |H| known."""
        _, first = np.unique(self.time_ns, return_index=True)
        return self.select(first[np.isfinite(self.reference.magnitude_nt[first])])
