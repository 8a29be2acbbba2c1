"""RECORDING.toml read and checked; every fault of the file is named at once.

The log itself is not opened here.  ``docs/recording-format.md`` explains each key to a newcomer.
"""

from __future__ import annotations

import datetime
import math
from pathlib import Path

from magcal_service.errors import Fault, RecordingError
from magcal_service.recordings.channels import read_channels
from magcal_service.recordings.specs import (
    MAX_FIELD_NT,
    SESSION_SUFFIX,
    Axis,
    CartesianPosition,
    ConstantReference,
    Descriptor,
    FieldModel,
    GeodeticPosition,
    MagnetometerSpec,
    MagnitudeReference,
    ModelReference,
    PositionFrame,
    PositionSpec,
    ReferenceSpec,
    SpinSpec,
    TimeFormat,
    TimeSpec,
    VectorReference,
)
from magcal_service.recordings.timestamps import iso8601_to_ns
from magcal_service.typed_toml import Table, open_toml
from magcal_service.units import FIELD_NT, FieldUnit, LengthUnit
from magcal_service.wire.fields import NAME
from magcal_service.wire.messages import Clock, Frame, Vector

_VERSION = 1
_SUFFIXES = (".csv", ".csv.gz")
_DELIMITERS = (",", ";", "\t")
_REFERENCE_FORMS = ("columns", "magnitude", "model", "constant")


def load_descriptor(path: Path | str) -> Descriptor:
    """Read and check a descriptor; raises ``RecordingError`` with every fault of the file."""
    path = Path(path)
    top = open_toml(path, RecordingError)
    top.integer("version", _VERSION, minimum=_VERSION, maximum=_VERSION)
    if not top.has("version"):
        top.refuse("version", "missing", f"required: version = {_VERSION}")
    samples, delimiter, craft = _samples(top)
    if samples.lower().endswith(SESSION_SUFFIX):
        return _session(top, path, samples, craft)
    time = _time(top)
    magnetometer = _magnetometer(top)
    reference = _reference(top)
    position = _position(top)
    spin = _spin(top)
    channels = read_channels(top)
    _check_model(top, time, reference, position)
    top.finish()
    if top.faults or reference is None:
        raise RecordingError(top.faults)
    return Descriptor(path, path.parent / samples, delimiter, time, magnetometer, reference, position, spin, channels)


def _session(top: Table, path: Path, samples: str, craft: str | None) -> Descriptor:
    """The description of a recorded session: noise and spin, where they are better known than when it was made.

    Times, units and frames stand in the session itself, so its other sections are refused.
    """
    noise_nt = None
    section = top.table("magnetometer")
    if section is not None:
        noise_nt = section.number("noise_nt", minimum=1e-3, maximum=MAX_FIELD_NT)
        section.finish()
    spin = _spin(top)
    for name in ("time", "reference", "position", "channels"):
        if top.has(name):
            top.refuse(name, "given", "a recorded session (.mcap) brings its own; remove the section")
    top.finish()
    if top.faults:
        raise RecordingError(top.faults)
    time, magnetometer = TimeSpec("timestamp", TimeFormat.UNIX_S), MagnetometerSpec((), FieldUnit.NT, noise_nt)
    reference = MagnitudeReference("magnitude_nt", FieldUnit.NT)
    return Descriptor(path, path.parent / samples, ",", time, magnetometer, reference, None, spin, (), craft)


def _section(top: Table, name: str) -> Table:
    """A required section; an empty one in its place, so that its own keys are not reported missing as well."""
    return top.table(name, required=True) or Table({}, top.file, name, [])


def _samples(top: Table) -> tuple[str, str, str | None]:
    section = _section(top, "samples")
    file = section.text("file", accepted="the name of a .csv, .csv.gz or .mcap file")
    if file.lower().endswith(SESSION_SUFFIX):
        craft = section.text("craft", "") if section.has("craft") else None
        if craft is not None and not NAME.fullmatch(craft):
            section.refuse("craft", section.content["craft"], "the name of a craft in the session is accepted")
        section.finish()
        return file, ",", craft
    if file and not file.lower().endswith(_SUFFIXES):
        section.refuse("file", file, "a .csv, .csv.gz or .mcap file is accepted")
    delimiter = section.text("delimiter", ",")
    if delimiter not in _DELIMITERS:
        section.refuse("delimiter", delimiter, r'"," ";" or "\t" is accepted')
    section.finish()
    return file, delimiter, None


def _time(top: Table) -> TimeSpec:
    section = _section(top, "time")
    column = section.text("column", accepted="the name of the time column")
    time_format = section.choice("format", TimeFormat)
    start_ns = _start(section) if section.has("start") else None
    if start_ns is not None and time_format is not TimeFormat.ELAPSED_S:
        section.refuse("start", section.content["start"], 'it goes with format = "elapsed_s" only; remove it')
    section.finish()
    return TimeSpec(column, time_format, start_ns)


def _start(section: Table) -> int | None:
    """``start`` as a string or as TOML's own date-time, which is UTC where it names no zone."""
    value = section.content["start"]
    text = value.isoformat() if isinstance(value, datetime.datetime) else value
    start_ns = iso8601_to_ns(text) if isinstance(text, str) else None
    if start_ns is None:
        section.refuse("start", str(value), 'an ISO 8601 instant such as "2025-06-01T00:00:00Z" is accepted')
    return start_ns


def _magnetometer(top: Table) -> MagnetometerSpec:
    section = _section(top, "magnetometer")
    columns = section.texts("columns", 3, required=True) or ()
    unit = section.choice("unit", FieldUnit)
    noise_nt = section.number("noise_nt", minimum=1e-3, maximum=MAX_FIELD_NT)
    section.finish()
    return MagnetometerSpec(columns, unit, noise_nt)


def _reference(top: Table) -> ReferenceSpec | None:
    section = _section(top, "reference")
    forms = [form for form in _REFERENCE_FORMS if section.has(form)]
    if len(forms) != 1:
        if section.faults is top.faults:  # a missing section has been reported already
            top.refuse("reference", " + ".join(forms) or "none", "exactly one of columns, magnitude, model, constant")
        return None
    spec = _reference_form(section, forms[0])
    section.finish()
    return spec


def _reference_form(section: Table, form: str) -> ReferenceSpec | None:
    if form == "columns":
        columns = section.texts("columns", 3, required=True) or ()
        return VectorReference(columns, section.choice("unit", FieldUnit), section.choice("frame", Frame))
    if form == "magnitude":
        return MagnitudeReference(section.text("magnitude"), section.choice("unit", FieldUnit))
    if form == "model":
        return ModelReference(section.choice("model", FieldModel))
    value = section.number("constant", required=True)
    factor = FIELD_NT[section.choice("unit", FieldUnit)]
    if value is None:
        return None
    if not 0.0 < value * factor <= MAX_FIELD_NT:
        section.refuse("constant", value, "a magnitude above 0 and up to 1 mT is accepted")
    return ConstantReference(value * factor)


def _position(top: Table) -> PositionSpec | None:
    section = top.table("position")
    if section is None:
        return None
    columns = section.texts("columns", required=True)
    spec: PositionSpec | None = None
    if columns is not None and len(columns) == 2:
        spec = _geodetic(section, columns)
    elif columns is not None and len(columns) == 3:
        frame = section.choice("frame", PositionFrame)
        spec = CartesianPosition(columns, section.choice("unit", LengthUnit), Frame(frame.value))
    elif columns is not None:
        section.refuse("columns", list(columns), "two columns (latitude, longitude) or three (x, y, z) are accepted")
    if spec is not None:
        section.finish()
    return spec


def _geodetic(section: Table, columns: tuple[str, ...]) -> GeodeticPosition:
    altitude_km = section.number("altitude_km", minimum=-10.0, maximum=1e5)
    altitude = section.table("altitude")
    if section.has("altitude_km") == section.has("altitude"):
        given = "both" if section.has("altitude") else "neither"
        section.refuse(
            "altitude", given, 'exactly one of altitude_km = 415.0 or altitude = {column = "alt", unit = "km"}'
        )
    if altitude is None:
        return GeodeticPosition(columns, altitude_km, None, LengthUnit.KM)
    spec = GeodeticPosition(columns, None, altitude.text("column"), altitude.choice("unit", LengthUnit))
    altitude.finish()
    return spec


def _spin(top: Table) -> SpinSpec | None:
    section = top.table("spin")
    if section is None:
        return None
    axis = _axis(section)
    rate_rpm = section.number("rate_rpm", minimum=-6000.0, maximum=6000.0)
    section.finish()
    return SpinSpec(axis, rate_rpm)


def _axis(section: Table) -> Vector:
    """A body axis by letter or as a vector, made a unit vector."""
    if isinstance(section.content.get("axis"), list):
        x, y, z = section.numbers("axis", 3) or (0.0, 0.0, 1.0)
        norm = math.sqrt(x * x + y * y + z * z)
        if norm < 1e-6:
            section.refuse("axis", [x, y, z], "a body vector that is not zero is accepted")
            return (0.0, 0.0, 1.0)
        if abs(norm - 1.0) < 1e-12:  # a unit vector stays as it was written, bit for bit
            return (x, y, z)
        return (x / norm, y / norm, z / norm)
    letter = section.choice("axis", Axis)
    return (float(letter is Axis.X), float(letter is Axis.Y), float(letter is Axis.Z))


def _check_model(top: Table, time: TimeSpec, reference: ReferenceSpec | None, position: PositionSpec | None) -> None:
    """A field model needs to know where and when."""
    if not isinstance(reference, ModelReference):
        return
    if position is None and "position" not in top.content:
        top.refuse("position", "missing", 'required with model = "igrf"')
    if time.clock is not Clock.UTC:
        top.faults.append(Fault(f"{top.file}: time.start", "missing", 'required with elapsed_s and model = "igrf"'))
