"""A log as arrays: what the reader gives and everything offline works on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

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


if TYPE_CHECKING:
    from magcal_service.recordings.in_memory import DataFrame


@dataclass(frozen=True, slots=True, eq=False, repr=False)
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
    beside: the same of magnetometers beside the craft's own, by source.
    source: whose samples the rows are, of a session; empty where the log does not say.
    others: other sources of samples of the same craft in the log.
    further: their vectors in the same rows (n, 3) [nT], where the log is rows; NaN where a row has none.
    lines: (n,) line of the file of each row, from 1; None where the log has none.
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
    beside: Mapping[str, dict[str, Any]] = field(default_factory=dict)
    source: str = ""
    others: tuple[str, ...] = ()
    further: Mapping[str, FloatArray] = field(default_factory=dict)
    lines: IntArray | None = None

    @property
    def of_craft(self) -> str | None:
        """The name of the craft, where the log or its descriptor says it."""
        return self.craft.name if self.craft is not None else self.descriptor.craft

    @property
    def driving(self) -> dict[str, bool]:
        """The channels by name, each with whether any row has all of its values, so that it can drive anything."""
        return {name: bool(np.isfinite(one.values).all(axis=1).any()) for name, one in self.channels.items()}

    @classmethod
    def from_arrays(
        cls,
        time: npt.ArrayLike,
        B: npt.ArrayLike,
        H: npt.ArrayLike,
        *,
        frame: str = "eci",
        position_ecef_km: npt.ArrayLike | None = None,
        noise_nt: float | None = None,
        range_nt: float | None = None,
        spin_axis: str | tuple[float, float, float] = "z",
        spin_rpm: float | None = None,
        channels: Mapping[str, tuple[npt.ArrayLike, str]] | None = None,
        attitude: npt.ArrayLike | None = None,
        craft: str | None = None,
    ) -> Recording:
        """A recording of arrays, one row per sample.

        Parameters
        ----------
        time: (n,) datetime64 (UTC), or seconds since any instant (then nothing that needs the date is known).
        B: measured vectors (n, 3) [nT], sensor axes; rows that are not finite are refused and counted.
        H: reference [nT]: vectors (n, 3) in ``frame``, magnitudes (n,), or one magnitude for all.
        frame: axes of H, ``"eci"``, ``"ecef"`` or ``"ned"``.
        position_ecef_km: places (n, 3) [km], Earth-fixed axes.
        noise_nt: white noise of the sensor, 1 sigma per axis [nT]; None: estimated.
        range_nt: full scale of each axis [nT]: rows that reach it are left out; None: looked for in the samples.
        spin_axis, spin_rpm: the spin where there is one: body axis, and rate about it [rpm].
        channels: telemetry by name: values (n,) or (n, k), and their unit (``units.CHANNEL_UNITS``).
        attitude: quaternions (n, 4), scalar first, that turn vectors of inertial axes into body axes.
        craft: name of the craft; recordings that are diagnosed together have to be of one.

        Raises RecordingError for shapes, units, axes or times that are not accepted.
        """
        from magcal_service.recordings.in_memory import from_arrays

        return from_arrays(
            time,
            B,
            H,
            frame=frame,
            position_ecef_km=position_ecef_km,
            noise_nt=noise_nt,
            range_nt=range_nt,
            spin_axis=spin_axis,
            spin_rpm=spin_rpm,
            channels=channels,
            attitude=attitude,
            craft=craft,
        )

    @classmethod
    def from_dataframe(cls, frame: DataFrame, tables: Mapping[str, Any]) -> Recording:
        """A recording of a data frame, described as a log is.

        Parameters
        ----------
        frame: columns by name, of pandas, polars, pyarrow, or a mapping; each is taken by ``numpy.asarray``.
        tables: the tables of a RECORDING.toml, of ``[samples]`` no more than ``craft``, such as ``{"time": {"column":
            "t", "format": "unix_s"}, "magnetometer": {"columns": ["x", "y", "z"], "unit": "uT"}, "reference":
            {"constant": 49.0}}``.

        Rows are read, refused and counted as those of a file.  Raises RecordingError as ``read_recording``.
        """
        from magcal_service.recordings.in_memory import from_dataframe

        return from_dataframe(frame, tables)

    def __len__(self) -> int:
        return len(self.time_ns)

    def __repr__(self) -> str:
        known = [name for name, part in (("position", self.position), ("craft", self.craft)) if part is not None]
        channels = f", channels {', '.join(self.channels)}" if self.channels else ""
        return (
            f"Recording {self.name}: {len(self)} samples over {self.duration_s:.0f} s, "
            f"{self.report.refused} rows refused{''.join(f', {name}' for name in known)}{channels}"
        )

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
            further={name: vectors[rows] for name, vectors in self.further.items()},
            stream=None,
            state=None,
            lines=None if self.lines is None else self.lines[rows],
        )

    def sorted_unique(self) -> Recording:
        """For offline use: rows in time order, the first in the file of those with the same time, |H| known."""
        if (np.diff(self.time_ns) > 0).all() and np.isfinite(self.reference.magnitude_nt).all():
            return replace(self, stream=None, state=None)  # so already: nothing is copied
        _, first = np.unique(self.time_ns, return_index=True)
        return self.select(first[np.isfinite(self.reference.magnitude_nt[first])])
