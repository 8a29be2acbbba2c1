"""RECORDING.toml read and checked; every fault of the file is named at once.

The log itself is not opened here.  ``docs/recording-format.md`` explains each key to a newcomer.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from magcal_service.base.errors import MISSING, Fault, Lacking, RecordingError
from magcal_service.base.typed_toml import Table, TomlKind, open_toml, refuse_another
from magcal_service.base.typed_toml.record import read_record
from magcal_service.base.units import FieldUnit
from magcal_service.recordings.specs import (
    SESSION_SUFFIX,
    Descriptor,
    ElementsPosition,
    MagnetometerSpec,
    MagnitudeReference,
    ModelReference,
    SamplesSpec,
    TimeFormat,
    TimeSpec,
    VectorReference,
)
from magcal_service.wire.messages import Clock

_VERSION = 1
"""Of the format: another one may give known keys another meaning, so it is refused."""

_SESSION_BRINGS = ("time", "reference", "position", "channels", "beside")
"""Sections that a recorded session makes superfluous."""

_NAMES_COLUMNS: Final = ("column", "columns", "magnitude")
"""Keys that name columns, in every section."""

SAMPLES_IN_MEMORY: Final = "rows.csv"
"""Stands for the file of samples where there is none: rows that a program holds."""


def load_descriptor(path: Path | str) -> Descriptor:
    """Read and check a descriptor; raises ``RecordingError`` with every fault of the file."""
    path = Path(path)
    top = open_toml(path, RecordingError)
    refuse_another(top, TomlKind.RECORDING, RecordingError)
    return descriptor_of(top, path)


def descriptor_of(top: Table, path: Path) -> Descriptor:
    """The descriptor of a table that stands, or would stand, in the file ``path``; raises ``RecordingError``."""
    top.integer("version", _VERSION, minimum=_VERSION, maximum=_VERSION)
    if not top.has("version"):
        top.lack("version", f"required: version = {_VERSION}")
    _list_magnetometers(top)
    section = top.table("samples", required=True) or Table({}, top.file, "samples", [])
    samples = read_record(section, SamplesSpec)
    given: dict[str, Any] = {
        "path": path,
        "samples": path.parent / samples.file,
        "form": samples.form,
        "joins": samples.joins,
        "craft": samples.craft,
        "max_rows": samples.max_rows,
    }
    if samples.file.lower().endswith(SESSION_SUFFIX):
        given |= _of_session(top)
    _name_by_number(top, samples)
    descriptor = read_record(top, Descriptor, given)
    _check_model(top, descriptor)
    _check_columns(top, descriptor)
    _check_elements(top, descriptor)
    _check_joins(top, descriptor)
    if top.faults:
        raise RecordingError(top.faults)
    return descriptor


def _list_magnetometers(top: Table) -> None:
    """``[[magnetometer]]`` as the first of them and those ``beside`` it."""
    if top.has("beside"):
        top.refuse("beside", "given", "each magnetometer is a table [[magnetometer]] with its source")
    listed = top.content.get("magnetometer")
    if isinstance(listed, list) and listed and all(isinstance(one, dict) for one in listed):
        top.content = {**top.content, "magnetometer": listed[0], "beside": listed[1:]}


def _name_by_number(top: Table, samples: SamplesSpec) -> None:
    """Columns of a log without a header go by number, which is their name from here on."""
    if not samples.form.header:
        sections = ("time", "magnetometer", "beside", "reference", "position", "channels")
        numbered = {name: _numbers_as_names(top.content[name]) for name in sections if name in top.content}
        top.content = {**top.content, **numbered}


def _numbers_as_names(value: Any) -> Any:
    """A section of the descriptor with whole numbers, where columns are named, as text."""
    if isinstance(value, list):
        return [_numbers_as_names(one) for one in value]
    if not isinstance(value, dict):
        return value
    return {key: _as_name(one) if key in _NAMES_COLUMNS else _numbers_as_names(one) for key, one in value.items()}


def _as_name(value: Any) -> Any:
    if isinstance(value, dict):
        return _numbers_as_names(value)
    if isinstance(value, list):
        return [_as_name(one) for one in value]
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


def _of_session(top: Table) -> dict[str, Any]:
    """What a recorded session brings itself; its descriptor may state noise and spin where they are known better."""
    for name in _SESSION_BRINGS:
        if top.has(name):
            top.refuse(name, "given", "a recorded session (.mcap) brings its own; remove the section")
    section = top.table("magnetometer") or Table({}, top.file, "magnetometer", [])
    return {
        "time": TimeSpec("timestamp", TimeFormat.UNIX_S),
        "magnetometer": read_record(section, MagnetometerSpec, {"columns": (), "unit": FieldUnit.NT, "factor": 1.0}),
        "reference": MagnitudeReference("magnitude_nt", unit=FieldUnit.NT),
        "position": None,
        "channels": (),
        "beside": (),
    }


def _check_columns(top: Table, descriptor: Descriptor) -> None:
    """No axis is there twice, and a sensor is not its own reference: a fit of that is perfect and means nothing."""
    measured: list[str] = []
    for number, one in enumerate((descriptor.magnetometer, *descriptor.beside)):
        key = f"magnetometer[{number}]" if descriptor.beside else "magnetometer"
        if len(set(one.columns)) != len(one.columns) or set(one.columns) & set(measured):
            accepted = "three different columns are accepted, the sensor's x, y and z, and none of another sensor's"
            top.faults.append(Fault(f"{top.file}: {key}.columns", list(one.columns), accepted))
        measured += one.columns
    if descriptor.beside and len(set(descriptor.sources)) != 1 + len(descriptor.beside):
        accepted = "each of several magnetometers needs a source of its own"
        top.faults.append(Fault(f"{top.file}: magnetometer.source", list(descriptor.sources), accepted))
    reference = descriptor.reference
    if isinstance(reference, VectorReference):
        own = sorted(set(reference.columns) & set(measured))
        if own or len(set(reference.columns)) != len(reference.columns):
            accepted = "three different columns are accepted, and none of the magnetometer's own"
            top.faults.append(Fault(f"{top.file}: reference.columns", list(reference.columns), accepted))
    elif isinstance(reference, MagnitudeReference) and reference.column in measured:
        accepted = "a column of the reference's magnitude is accepted, and none of the magnetometer's own"
        top.faults.append(Fault(f"{top.file}: reference.magnitude", reference.column, accepted))


def _check_model(top: Table, descriptor: Descriptor) -> None:
    """A field model needs to know where and when."""
    if not isinstance(descriptor.reference, ModelReference):
        return
    if descriptor.position is None and "position" not in top.content:
        how = 'columns = ["lat", "lon"] with altitude_km, or three with unit and frame, or tle = "FILE" of element sets'
        top.lack("position", f'required with model = "igrf": {how}')
    if descriptor.time.clock is not Clock.UTC:
        top.faults.append(Lacking(f"{top.file}: time.start", MISSING, 'required with elapsed_s and model = "igrf"'))


def _check_elements(top: Table, descriptor: Descriptor) -> None:
    """Elements say where the craft was at a date."""
    if isinstance(descriptor.position, ElementsPosition) and descriptor.time.clock is not Clock.UTC:
        top.faults.append(Lacking(f"{top.file}: time.start", MISSING, "required with elapsed_s and position.tle"))


def _check_joins(top: Table, descriptor: Descriptor) -> None:
    """Rows can be joined by their times where these are of one clock."""
    for number, join in enumerate(descriptor.joins):
        if join.time is not None and join.time.clock is not descriptor.time.clock:
            accepted = (
                f"times as of the log, {descriptor.time.clock.value}, are accepted; start makes elapsed times UTC"
            )
            top.faults.append(Fault(f"{top.file}: samples.join[{number}].time", join.time.clock.value, accepted))
        if join.time is None and not descriptor.time.named:
            accepted = "required where the log's own rows come by rate_hz"
            top.faults.append(Lacking(f"{top.file}: samples.join[{number}].time", MISSING, accepted))
