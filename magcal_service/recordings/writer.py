"""Arrays as a described recording: reading it back gives the same arrays, bit for bit."""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from magcal_service.base.disk import write_whole
from magcal_service.base.errors import Fault, RecordingError
from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.recordings.channels import Axes, ChannelSpec
from magcal_service.recordings.recording import Channel, Position
from magcal_service.recordings.specs import DESCRIPTOR_NAME, MAX_FIELD_NT, SpinSpec
from magcal_service.recordings.timestamps import ns_to_iso8601, ns_to_seconds
from magcal_service.wire.messages import Clock, Frame


def make_channel(name: str, values: npt.ArrayLike, unit: str = "", frame: Axes | None = None) -> Channel:
    """A channel for the writer: values (n,) or (n, k) in ``unit``, one of ``units.CHANNEL_UNITS``."""
    if unit not in CHANNEL_UNITS:
        raise RecordingError([Fault(f"channels.{name}.unit", unit, f"one of {', '.join(CHANNEL_UNITS)}")])
    array = np.asarray(values, dtype=np.float64)
    array = array.reshape(len(array), -1)
    columns = (name,) if array.shape[1] == 1 else tuple(f"{name}_{index}" for index in range(array.shape[1]))
    return Channel(ChannelSpec(name, columns, unit, frame), array)


def write_recording(
    directory: Path | str,
    *,
    time_ns: npt.ArrayLike,
    clock: Clock,
    field_body_nt: npt.ArrayLike,
    reference_nt: npt.ArrayLike,
    frame: Frame | None = None,
    position: Position | None = None,
    channels: Sequence[Channel] = (),
    spin: SpinSpec | None = None,
    noise_nt: float | None = None,
    craft: str | None = None,
    compress: bool = False,
) -> Path:
    """Write ``samples.csv`` (or ``.csv.gz``) and ``RECORDING.toml`` into a folder, which is made where absent.

    Parameters
    ----------
    time_ns: (n,) int64 [ns] on ``clock``.
    field_body_nt: (n, 3) measured vectors [nT], finite and up to 1 mT.
    reference_nt: (n, 3) vectors in ``frame``, or (n,) magnitudes without one [nT]; NaN where a row has none.
    position: where the craft was, (n, 3) [km] in ECI or ECEF.
    channels: telemetry, as ``make_channel`` gives it; NaN where a row has none.
    spin, noise_nt, craft: written to the descriptor.

    Returns the descriptor's path.  The descriptor appears last, each file at once.  Raises RecordingError for what
    the reader would refuse.
    """
    field = np.asarray(field_body_nt, dtype=np.float64)
    reference = np.asarray(reference_nt, dtype=np.float64)
    times = np.asarray(time_ns, dtype=np.int64)
    _check(times, field, reference, frame, position, channels)
    sheet = _Sheet()
    seconds = ns_to_iso8601 if clock is Clock.UTC else ns_to_seconds
    sheet.texts("time", [seconds(int(time)) for time in times])
    sections = [_section("time", column="time", format="iso8601" if clock is Clock.UTC else "elapsed_s")]
    columns = sheet.add(("bx_nt", "by_nt", "bz_nt"), field)
    sections.append(_section("magnetometer", columns=columns, unit="nT", noise_nt=noise_nt))
    if frame is None:
        sections.append(_section("reference", magnitude=sheet.add(("h_nt",), reference)[0], unit="nT"))
    else:
        columns = sheet.add(("hx_nt", "hy_nt", "hz_nt"), reference)
        sections.append(_section("reference", columns=columns, unit="nT", frame=frame.value))
    if position is not None:
        columns = sheet.add(("x_km", "y_km", "z_km"), position.km)
        sections.append(_section("position", columns=columns, unit="km", frame=position.frame.value))
    if spin is not None:
        sections.append(_section("spin", axis=list(spin.axis), rate_rpm=spin.rate_rpm))
    if channels:
        sections.append("[channels]\n" + "".join(_channel(sheet, channel) for channel in channels))
    name = "samples.csv.gz" if compress else "samples.csv"
    content = sheet.text().encode()
    folder = Path(directory)
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / name, gzip.compress(content, mtime=0) if compress else content)
    head = "version = 1\n" + _section("samples", file=name, craft=craft)
    write_whole(folder / DESCRIPTOR_NAME, "".join([head, *sections]).encode())
    return folder / DESCRIPTOR_NAME


def _check(
    times: npt.NDArray[np.int64],
    field: npt.NDArray[np.float64],
    reference: npt.NDArray[np.float64],
    frame: Frame | None,
    position: Position | None,
    channels: Iterable[Channel],
) -> None:
    """Every array has n rows and the right width, and the field is one that the reader takes."""
    n = len(times)
    shapes = [("field_body_nt", field.shape, (n, 3)), ("reference_nt", reference.shape, (n, 3) if frame else (n,))]
    if position is not None:
        shapes.append(("position", position.km.shape, (n, 3)))
    shapes += [(f"channels.{c.spec.name}", c.values.shape, (n, len(c.spec.columns))) for c in channels]
    faults = [Fault(name, shape, f"shape {wanted} is accepted") for name, shape, wanted in shapes if shape != wanted]
    if n == 0:
        faults.append(Fault("time_ns", "empty", "at least one row is needed"))
    if not faults:
        wrong = np.flatnonzero(~(np.linalg.norm(field, axis=1) <= MAX_FIELD_NT))
        if len(wrong):
            accepted = "finite vectors up to 1 mT are accepted; leave such rows out"
            faults.append(Fault(f"field_body_nt[{wrong[0]}]", field[wrong[0]].tolist(), accepted))
    if faults:
        raise RecordingError(faults)


@dataclass(slots=True)
class _Sheet:
    """Columns of text under unique names."""

    columns: dict[str, list[str]] = field(default_factory=dict)

    def texts(self, name: str, cells: list[str]) -> str:
        """Add one column; the name it got is returned."""
        while name in self.columns:
            name += "_"
        self.columns[name] = cells
        return name

    def add(self, names: tuple[str, ...], values: npt.NDArray[np.float64]) -> list[str]:
        """Add the columns of (n, k) values, written so that reading gives the same bits."""
        rows = values.reshape(len(values), -1).T.tolist()
        return [self.texts(name, [repr(cell) for cell in cells]) for name, cells in zip(names, rows, strict=True)]

    def text(self) -> str:
        """The whole CSV file."""
        rows = zip(*self.columns.values(), strict=True)
        return "\n".join([",".join(self.columns), *map(",".join, rows), ""])


def _channel(sheet: _Sheet, channel: Channel) -> str:
    spec = channel.spec
    plain = spec.wire_name
    names = (plain,) if len(spec.columns) == 1 else tuple(f"{plain}_{index}" for index in range(len(spec.columns)))
    keys = {
        "columns": sheet.add(names, channel.values),
        "unit": spec.unit or None,
        "frame": spec.frame,
        "order": spec.order,
        "from": spec.from_axes,
        "to": spec.to_axes,
    }
    inner = ", ".join(f"{key} = {_toml(value)}" for key, value in keys.items() if value is not None)
    return f"{_toml(spec.name)} = {{ {inner} }}\n"


def _section(name: str, **keys: object) -> str:
    """A TOML table; keys that are None are left out."""
    lines = [f"{key} = {_toml(value)}\n" for key, value in keys.items() if value is not None]
    return f"[{name}]\n{''.join(lines)}"


def _toml(value: object) -> str:
    """A string, number or list of them; JSON writes these the way TOML reads them."""
    return json.dumps(value, ensure_ascii=False)
