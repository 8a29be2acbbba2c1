"""Recordings from what a notebook holds: arrays, or a data frame described as a log is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt

from magcal_service.base.errors import Fault, RecordingError
from magcal_service.base.typed_toml import Table, nearest
from magcal_service.base.units import CHANNEL_UNITS, FieldUnit
from magcal_service.config.rules import RANGE_NT
from magcal_service.recordings.channels import Axes, ChannelSpec, QuaternionOrder
from magcal_service.recordings.descriptor import SAMPLES_IN_MEMORY, descriptor_of
from magcal_service.recordings.reader import read_rows
from magcal_service.recordings.recording import Channel, Position, Recording, Reference
from magcal_service.recordings.report import RowReport
from magcal_service.recordings.specs import (
    ConstantReference,
    Descriptor,
    MagnetometerSpec,
    SpinSpec,
    TimeFormat,
    TimeSpec,
)
from magcal_service.recordings.table import FloatArray, IntArray, TextTable
from magcal_service.wire.fields import NAME
from magcal_service.wire.messages import Frame, Vector

ARRAYS: Final = "arrays"
"""What a recording made of arrays calls itself where another names its file."""

_AXES: Final[dict[str, Vector]] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


class DataFrame(Protocol):
    """What pandas, polars and pyarrow have in common: named columns that numpy can take."""

    def __getitem__(self, name: str, /) -> Any:
        """The column of a name, convertible by ``numpy.asarray``."""


_SAMPLES = ("craft", "max_rows")
"""Keys of ``[samples]`` that mean something where there is no file."""


def from_arrays(
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
    """A recording of arrays, one row per sample; the parameters are those of ``Recording.from_arrays``."""
    if craft is not None and not NAME.fullmatch(craft):
        raise RecordingError([Fault("craft", craft, "a name of 1 to 32 of A-Z a-z 0-9 _ - is accepted")])
    low, high = RANGE_NT
    if range_nt is not None and not low <= range_nt <= high:
        raise RecordingError([Fault("range_nt", range_nt, f"{low:g} to {high:g} nT is accepted")])
    time_ns, utc = _times(time)
    count = len(time_ns)
    field = _columns("B", B, count, 3)
    reference = _reference(H, count, frame)
    spin = None if spin_rpm is None else SpinSpec(_axis(spin_axis), float(spin_rpm))
    parts = dict(_channel(name, *given, count) for name, given in (channels or {}).items())
    if attitude is not None:
        parts["attitude"] = _attitude(attitude, count)
    kept = np.asarray(np.isfinite(field).all(axis=1))
    if not (kept & np.isfinite(reference.magnitude_nt)).any():
        accepted = "at least one row with three finite components of B and a finite H is needed"
        raise RecordingError([Fault("usable rows", 0, accepted)])
    descriptor = Descriptor(
        path=Path(ARRAYS),
        samples=Path(ARRAYS),
        time=TimeSpec("time", TimeFormat.UNIX_S if utc else TimeFormat.ELAPSED_S, None),
        magnetometer=MagnetometerSpec((), noise_nt, range_nt=range_nt, unit=FieldUnit.NT),
        reference=ConstantReference(float(np.nanmean(reference.magnitude_nt))),
        position=None,
        spin=spin,
        channels=tuple(channel.spec for channel in parts.values()),
        craft=craft,
    )
    recording = Recording(
        name=ARRAYS,
        descriptor=descriptor,
        time_ns=time_ns,
        clock=descriptor.time.clock,
        field_body_nt=field,
        reference=reference,
        position=_position(position_ecef_km, count),
        channels=parts,
        report=RowReport(count, int(np.count_nonzero(kept))),
    )
    return recording.select(kept)


def from_dataframe(frame: DataFrame, tables: Mapping[str, Any]) -> Recording:
    """A recording of a data frame; the parameters are those of ``Recording.from_dataframe``."""
    unknown = [key for key in tables.get("samples", {}) if key not in _SAMPLES]
    if unknown:
        accepted = f"rows in memory have no layout of a file; {nearest(unknown[0], _SAMPLES)}"
        raise RecordingError([Fault("tables: samples", unknown[0], accepted)])
    content = {"version": 1, **tables, "samples": {**tables.get("samples", {}), "file": SAMPLES_IN_MEMORY}}
    descriptor = descriptor_of(Table(content, "tables", "", []), Path("tables"))
    header = tuple(_names(frame))
    cells = [_texts(frame[name]) for name in header]
    count = len(cells[0]) if cells else 0
    return read_rows(descriptor, TextTable(header, cells, np.arange(1, count + 1), count, ()))


def _names(frame: DataFrame) -> Iterable[str]:
    names = getattr(frame, "column_names", None)  # pyarrow
    if names is None:
        names = getattr(frame, "columns", None)  # pandas and polars
    if names is None and isinstance(frame, Mapping):
        names = frame.keys()
    if names is None:
        accepted = "a data frame of pandas, polars or pyarrow, or a mapping of names to columns, is accepted"
        raise RecordingError([Fault("frame", type(frame).__name__, accepted)])
    return [str(name) for name in names]


def _texts(column: Any) -> list[str]:
    """Cells as a log would hold them; missing ones are empty, times are ISO 8601 in UTC."""
    values = np.asarray(column)
    if values.dtype.kind == "M":
        return ["" if np.isnat(value) else f"{value}Z" for value in values.astype("datetime64[ns]")]
    return ["" if _is_missing(value) else str(value) for value in values.tolist()]


def _is_missing(value: object) -> bool:
    return value is None or (isinstance(value, float) and np.isnan(value))


def _times(time: npt.ArrayLike) -> tuple[IntArray, bool]:
    """Nanoseconds (n,), and whether they are UTC."""
    values = np.asarray(time)
    if values.ndim != 1 or values.dtype.kind not in "Mfiu" or not len(values):
        accepted = "an array (n,) of datetime64 (UTC), or of seconds since any instant, is accepted"
        raise RecordingError([Fault("time", f"{values.dtype} of shape {values.shape}", accepted)])
    if values.dtype.kind == "M":
        if np.isnat(values).any():
            accepted = "a time for every row is accepted; leave out the rows that have none"
            raise RecordingError([Fault("time", "NaT", accepted)])
        return values.astype("datetime64[ns]").astype(np.int64), True
    seconds = values.astype(np.float64)
    if not np.isfinite(seconds).all() or np.abs(seconds).max() > 9e9:
        accepted = "finite seconds of at most 9e9 are accepted; give UTC as datetime64"
        raise RecordingError([Fault("time", float(seconds[np.argmax(~np.isfinite(seconds))]), accepted)])
    return np.round(seconds * 1e9).astype(np.int64), False


def _numbers(name: str, values: npt.ArrayLike) -> FloatArray:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise RecordingError([Fault(name, type(values).__name__, "numbers are accepted")]) from None


def _columns(name: str, values: npt.ArrayLike, count: int, width: int) -> FloatArray:
    array = _numbers(name, values)
    if array.shape != (count, width):
        accepted = f"({count}, {width}) is accepted: a row for each time"
        raise RecordingError([Fault(f"shape of {name}", array.shape, accepted)])
    return array


def _reference(H: npt.ArrayLike, count: int, frame: str) -> Reference:
    if frame not in {each.value for each in Frame}:
        raise RecordingError([Fault("frame", frame, nearest(frame, [each.value for each in Frame]))])
    array = _numbers("H", H)
    if array.ndim == 0:
        array = np.full(count, float(array))
    if array.shape == (count,):
        return Reference(array)
    vectors = _columns("H", array, count, 3)
    return Reference(np.linalg.norm(vectors, axis=1), vectors, Frame(frame))


def _position(values: npt.ArrayLike | None, count: int) -> Position | None:
    return None if values is None else Position(_columns("position_ecef_km", values, count, 3), Frame.ECEF)


def _axis(axis: str | tuple[float, float, float]) -> Vector:
    if isinstance(axis, str):
        if axis not in _AXES:
            raise RecordingError([Fault("spin_axis", axis, '"x" "y" "z" or a body vector is accepted')])
        return _AXES[axis]
    vector = np.asarray(axis, dtype=np.float64)
    length = float(np.linalg.norm(vector)) if vector.shape == (3,) else 0.0
    if not length > 0.0:
        raise RecordingError([Fault("spin_axis", axis, '"x" "y" "z" or a body vector is accepted')])
    x, y, z = (vector / length).tolist()
    return x, y, z


def _channel(name: str, values: npt.ArrayLike, unit: str, count: int) -> tuple[str, Channel]:
    if unit not in CHANNEL_UNITS:
        raise RecordingError([Fault(f"unit of channel {name}", unit, nearest(unit, CHANNEL_UNITS))])
    array = _numbers(f"channel {name}", values)
    array = array[:, None] if array.ndim == 1 else array
    array = _columns(f"channel {name}", array, count, array.shape[1] if array.ndim == 2 else 1)
    return name, Channel(ChannelSpec(name, tuple(f"{name}{i}" for i in range(array.shape[1])), unit), array)


def _attitude(values: npt.ArrayLike, count: int) -> Channel:
    columns = ("q0", "q1", "q2", "q3")
    spec = ChannelSpec("attitude", columns, "", None, QuaternionOrder.WXYZ, Axes.ECI, Axes.BODY)
    return Channel(spec, _columns("attitude", values, count, 4))
