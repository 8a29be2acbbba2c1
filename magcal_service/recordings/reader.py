"""A described log, or a recorded session, as a ``Recording``; what makes it unusable is refused."""

from __future__ import annotations

import re
from pathlib import Path
from shlex import quote
from typing import Final

import numpy as np

from magcal_service.base.errors import Fault, FileFault, Lacking, RecordingError
from magcal_service.base.progress import Work, counted
from magcal_service.base.typed_toml import nearest
from magcal_service.recordings.descriptor import load_descriptor
from magcal_service.recordings.join import join_files
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.report import RowFault, RowReport
from magcal_service.recordings.row_arrays import RowArrays, columns_of_reference
from magcal_service.recordings.row_limits import RowLimits
from magcal_service.recordings.specs import (
    DESCRIPTOR_NAME,
    LOG_SUFFIXES,
    RAW_SUFFIXES,
    SESSION_SUFFIX,
    Descriptor,
    GeodeticPosition,
    MagnitudeReference,
    TimeSpec,
)
from magcal_service.recordings.table import TextTable, read_table
from magcal_service.recordings.unit_words import unit_of

_HEAD_BYTES: Final = 1 << 16  # far more than stands above the first section of a descriptor
_OF_A_DESCRIPTOR: Final = re.compile(rb"^\s*(version\s*=|\[samples\])", re.MULTILINE)


def read_recording(
    path: Path | str, craft: str | None = None, *, prefer: str | None = None, source: str | None = None
) -> Recording:
    """Read a recording by its descriptor, or a recorded session (``.mcap``) without one.

    Parameters
    ----------
    craft: which craft of a session; may be left out where it has one, or where the descriptor names it; of rows, none
        but the one that their descriptor names.
    prefer: which craft of a session where none is named and there are several.
    source: which of the craft's magnetometers; its own where not given.

    Raises
    ------
    RecordingError: the descriptor is faulty, a column is missing, no row can be used, or the craft is not certain.
    ExtraMissingError: ``model = "igrf"`` or a session without the package that it needs.
    """
    path = Path(path)
    if path.suffix.lower() == SESSION_SUFFIX:
        with counted(Work(f"reading {path.name}")):
            return _read_session(path, None, craft, prefer, source)
    _refuse_undescribed(path)
    descriptor = load_descriptor(path)
    source = source or descriptor.magnetometer.source or None
    if descriptor.session:
        with counted(Work(f"reading {descriptor.samples.name}")):
            return _read_session(descriptor.samples, descriptor, craft or descriptor.craft, prefer, source)
    if craft is not None and craft != descriptor.craft:
        accepted = "only a recorded session (.mcap) has craft to choose from; leave it out"
        if descriptor.craft is not None:
            accepted = f"samples.craft says {descriptor.craft!r}; leave it out, or give that name"
        raise RecordingError([Fault(f"{path}: craft", craft, accepted)])
    if source is not None and source not in descriptor.sources:
        accepted = f"{nearest(source, descriptor.sources)}" if descriptor.sources else "the log has one; leave it out"
        raise RecordingError([Fault(f"{path}: source", source, accepted)])
    with counted(Work(f"reading {path.name}")):
        return read_described(descriptor if source is None else descriptor.of_source(source))


def is_session(path: Path) -> bool:
    """Whether a recording is a session, which may hold several craft; raises as ``read_recording`` for a descriptor."""
    if path.suffix.lower() == SESSION_SUFFIX:
        return True
    _refuse_undescribed(path)
    return load_descriptor(path).session


def _refuse_undescribed(path: Path) -> None:
    """Refuse a log, or a folder, that is given in place of the descriptor of a log."""
    if path.is_dir():
        accepted = "a described log is accepted; give the file that describes it"
        if (path / DESCRIPTOR_NAME).is_file():
            accepted += f": {path / DESCRIPTOR_NAME}"
        raise RecordingError([FileFault.of_folder(str(path), accepted)])
    if path.name.lower().endswith((*LOG_SUFFIXES, *RAW_SUFFIXES)) or _is_rows(path):
        accepted = (
            f"a log is read by its descriptor; magcal describe {quote(str(path))} --out "
            f"{quote(str(path.parent / DESCRIPTOR_NAME))} makes one "
            "(docs/describe.md), and give that"
        )
        raise RecordingError([Fault(str(path), "a log without its descriptor", accepted)])


def _is_rows(path: Path) -> bool:
    """Whether a file of another name than a descriptor's begins as a log does: with no line of a descriptor."""
    if path.suffix.lower() == ".toml":
        return False
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError:
        return False  # said where it is opened
    return bool(head.strip()) and not _OF_A_DESCRIPTOR.search(head)


def _read_session(
    path: Path, descriptor: Descriptor | None, craft: str | None, prefer: str | None, source: str | None
) -> Recording:
    from magcal_service.recordings.session_arrays import session_recording

    recording = session_recording(path, descriptor, craft, prefer, source)
    _check_usable(recording)
    return recording


def read_described(descriptor: Descriptor) -> Recording:
    """Read the log in rows of a descriptor that has been loaded; raises as ``read_recording``."""
    table = read_table(descriptor.samples, descriptor.form, RowLimits(descriptor.max_rows))
    return read_rows(descriptor, join_files(descriptor, table))


def read_rows(descriptor: Descriptor, table: TextTable) -> Recording:
    """The recording of rows that have been split into cells; raises as ``read_recording``."""
    _check_columns(descriptor, table)
    log = RowArrays(table)
    time_ns = log.times(descriptor.time)
    field_nt = log.field(descriptor)
    further = {spec.source: log.further(spec) for spec in descriptor.beside}
    log.note_order(time_ns)
    position = log.position(descriptor, time_ns)
    reference = log.reference(descriptor.reference, time_ns, position)
    channels = {spec.name: log.channel(spec) for spec in descriptor.channels}
    remarks = (*_of_units(descriptor, table), *log.remarks)
    recording = Recording(
        name=descriptor.samples.name,
        descriptor=descriptor,
        time_ns=time_ns,
        clock=descriptor.time.clock,
        field_body_nt=field_nt,
        reference=reference,
        position=position,
        channels=channels,
        source=descriptor.magnetometer.source,
        others=tuple(further),
        further=further,
        report=RowReport(table.seen, int(np.count_nonzero(log.kept)), tuple(log.entries), remarks),
        lines=table.lines,
    ).select(log.kept)
    _check_usable(recording)
    return recording


def _of_units(descriptor: Descriptor, table: TextTable) -> list[str]:
    """That a line of units stands below the header, and where it contradicts the descriptor."""
    if not table.units:
        return []
    said = dict(zip(table.header, map(unit_of, table.units), strict=True))
    named = [(spec.columns, str(spec.unit)) for spec in (descriptor.magnetometer, *descriptor.beside)]
    named += [(spec.columns, spec.unit) for spec in descriptor.channels]
    other = {
        column: f"{said[column]} of {column!r}, which the descriptor takes in {unit}"
        for columns, unit in named
        for column in columns
        if unit and said.get(column) and said[column] != unit
    }
    differs = f"; it says {', '.join(other.values())}" if other else ""
    return [f"a line of units stands below the header and is no row{differs}"]


def _columns_by_key(descriptor: Descriptor) -> dict[str, tuple[str, ...]]:
    """Every column the descriptor names, by the key that names it."""
    time = descriptor.time
    named: dict[str, tuple[str, ...]] = {"time.columns" if time.columns else "time.column": time.named}
    named["magnetometer.columns"] = descriptor.magnetometer.columns
    named |= {f"magnetometer.columns of {one.source}": one.columns for one in descriptor.beside}
    key = "reference.magnitude" if isinstance(descriptor.reference, MagnitudeReference) else "reference.columns"
    named[key] = columns_of_reference(descriptor.reference)
    if descriptor.position is not None:
        named["position.columns"] = descriptor.position.columns
    if isinstance(descriptor.position, GeodeticPosition) and (height := descriptor.position.height) is not None:
        key = "altitude" if descriptor.position.radius is None else "radius"
        named[f"position.{key}.column"] = (height.column,)
    return named | {f"channels.{spec.name}": spec.columns for spec in descriptor.channels}


def _check_columns(descriptor: Descriptor, table: TextTable) -> None:
    """Every named column stands in the header, once."""
    faults = []
    for key, columns in _columns_by_key(descriptor).items():
        for column in columns:
            times = table.header.count(column)
            if times != 1:
                accepted = f"it stands {times} times in the header" if times else nearest(column, set(table.header))
                if not times and column.isdecimal() and descriptor.form.header:
                    accepted += "; header = false under [samples] counts columns from 1"
                if not times and len(table.header) == 1:
                    accepted += "; the header is one cell: check delimiter under [samples], and quotes about whole rows"
                problem = f"a column of {descriptor.samples.name} is accepted; {accepted}"
                faults.append(Fault(f"{descriptor.path.name}: {key}", column, problem))
    if faults and descriptor.form.header and not any(map(_has_letters, table.header)):
        found = f"the first line of {descriptor.samples.name} holds numbers and no names"
        accepted = "header = false under [samples] is accepted, with columns by their number from 1"
        raise RecordingError([Lacking(f"{descriptor.path.name}: samples", found, accepted)])
    if faults:
        raise RecordingError(faults)


def _has_letters(cell: str) -> bool:
    """Whether a cell of a header is a name: it has a letter and is no number such as ``1e5`` or ``nan``."""
    try:
        float(cell)
    except ValueError:
        return any(map(str.isalpha, cell))
    return False


def _check_usable(recording: Recording) -> None:
    """At least one row has a time, a magnetometer vector and a reference."""
    report, descriptor = recording.report, recording.descriptor
    account = "; ".join([*report.lines(), *_guesses(recording)])
    if report.used == 0:
        accepted = f"at least one row with a time and three magnetometer values is needed ({account})"
        raise RecordingError([Fault(str(descriptor.samples), "no usable row", accepted)])
    if not np.isfinite(recording.reference.magnitude_nt).any():
        accepted = f"at least one row with a reference is needed; check [reference], [position] and [time] ({account})"
        raise RecordingError([Fault(f"{descriptor.path.name}: reference", "no usable value", accepted)])


def _guesses(recording: Recording) -> list[str]:
    """What may be meant where most values of a part are beyond anything that it can be: mostly another unit."""
    guesses = {
        "time": _guess_of_time(recording.descriptor.time),
        "magnetometer": "is the field in another unit? check magnetometer.unit, and that its columns hold the field",
        "position": "is the place in another unit? km and m are accepted",
        "reference": "is its unit, place or year mistaken? check [reference], [position] and [time]",
    }
    absurd = {e.part: e.count for e in recording.report.entries if e.fault is RowFault.ABSURD}
    return [guess for part, guess in guesses.items() if 2 * absurd.get(part, 0) > recording.report.rows]


def _guess_of_time(spec: TimeSpec) -> str:
    kind = spec.format.kind
    if kind in {"unix", "elapsed"}:
        return f'are the times in ms, us or ns? then write format = "{kind}_ms", "{kind}_us" or "{kind}_ns"'
    if kind == "gps":
        return (
            "are the weeks counted in ten bits (0 to 1023)? then write gps_rollovers = 2 (weeks from 2019-04-07 to "
            '2038-11-20) or 1 (from 1999-08-22); is the time of week in ms? then write format = "gps_week_ms"'
        )
    return "check the format of the times"
