"""What a descriptor says, as frozen records that declare how they stand in its TOML."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Final

from magcal_service.base.typed_toml.keys import choice, number, section, sections, special, text, texts
from magcal_service.base.typed_toml.record import Reading, read_part, read_record
from magcal_service.config.rules import RANGE_NT, RESERVED_SOURCE
from magcal_service.recordings.accepted import read_accepted
from magcal_service.recordings.channels import ChannelSpec, read_channels
from magcal_service.recordings.defects import Code
from magcal_service.recordings.join_spec import JoinSpec
from magcal_service.recordings.position_spec import (
    CartesianPosition,
    ElementsPosition,
    GeodeticPosition,
    PositionSpec,
    read_position,
)
from magcal_service.recordings.reference_spec import (
    MAX_FIELD_NT,
    ConstantReference,
    FieldModel,
    MagnitudeReference,
    ModelReference,
    ReferenceSpec,
    VectorReference,
    read_reference,
)
from magcal_service.recordings.row_form import PLAIN_ROWS, RowForm
from magcal_service.recordings.row_limits import DEFAULT_MAX_ROWS, HIGHEST_MAX_ROWS
from magcal_service.recordings.scaled import FieldCells
from magcal_service.recordings.time_spec import TimeFormat, TimeSpec
from magcal_service.wire.fields import NAME
from magcal_service.wire.messages import Vector

__all__ = [
    "MAX_FIELD_NT",
    "SESSION_SUFFIX",
    "CartesianPosition",
    "ConstantReference",
    "Descriptor",
    "ElementsPosition",
    "FieldModel",
    "GeodeticPosition",
    "JoinSpec",
    "MagnetometerSpec",
    "MagnitudeReference",
    "ModelReference",
    "PositionSpec",
    "ReferenceSpec",
    "RowForm",
    "SamplesSpec",
    "SpinSpec",
    "TimeFormat",
    "TimeSpec",
    "VectorReference",
]

NOISE_NT: Final = (1e-3, MAX_FIELD_NT)
"""What a sensor's noise may be stated as, 1 sigma per axis, from and to [nT]."""

SESSION_SUFFIX = ".mcap"
"""The service's own recordings."""

DESCRIPTOR_NAME: Final = "RECORDING.toml"
"""Name of a descriptor that this project writes; any other name is read as well."""

LOG_SUFFIXES: Final = (".csv", ".csv.gz")
RAW_SUFFIXES: Final = (".txt", ".tsv", ".dat", ".log", ".asc", ".gz")
"""What else raw logs are called; any other name is read as well."""

_NO_LOGS: Final = (".toml", ".parquet", ".xlsx", ".xls", ".ods", ".zip", ".bz2", ".xz", ".zst", ".7z", ".tar", ".pdf")
"""Files that surely are no text in rows."""


class Axis(StrEnum):
    """Body axes by letter."""

    X = "x"
    Y = "y"
    Z = "z"


def _check_file(reading: Reading, name: str, file: str) -> None:
    if file.lower().endswith(_NO_LOGS):
        reading.table.refuse(
            name, file, "a log in rows (.csv, .txt and the like, or packed as .gz) or a .mcap file is accepted"
        )


def _is_session(reading: Reading) -> bool:
    file: str = reading.values["file"]
    return file.lower().endswith(SESSION_SUFFIX)


def _row_form(reading: Reading, _: str) -> RowForm:
    """How the rows are laid out; a session has none."""
    return PLAIN_ROWS if _is_session(reading) else read_part(reading.table, RowForm)


def _joins(reading: Reading, name: str) -> tuple[JoinSpec, ...]:
    """Files that go with the rows; a session has none."""
    if _is_session(reading):
        return ()
    joins = tuple(read_record(one, JoinSpec) for one in reading.table.tables(name))
    names = [one.name for one in joins]
    if len(set(names)) != len(names):
        reading.table.refuse(name, names, "a name of its own for each joined file is accepted")
    return joins


def _craft(reading: Reading, name: str) -> str | None:
    """Which craft of a session, or whose rows these are."""
    table = reading.table
    if not table.has(name):
        return None
    craft = table.text(name, "")
    if not NAME.fullmatch(craft):
        table.refuse(name, table.content[name], "the name of a craft, 1 to 32 of A-Z a-z 0-9 _ -, is accepted")
    return craft


def _max_rows(reading: Reading, name: str) -> int:
    """How many rows, or messages of a session, are read at most."""
    return reading.table.integer(name, DEFAULT_MAX_ROWS, minimum=1, maximum=HIGHEST_MAX_ROWS)


@dataclass(frozen=True, slots=True)
class SamplesSpec:
    """The log's name beside the descriptor; form, most and craft of its rows, and what is joined to them."""

    file: str = text(accepted="the name of a log in rows, or of a .mcap file", check=_check_file)
    form: RowForm = special(_row_form, PLAIN_ROWS)
    craft: str | None = special(_craft, None)
    max_rows: int = special(_max_rows, DEFAULT_MAX_ROWS)
    joins: tuple[JoinSpec, ...] = special(_joins, (), name="join")


def _source(reading: Reading, name: str) -> str:
    """What the samples' source is called; empty where nothing is said."""
    table = reading.table
    if not table.has(name):
        return ""
    source = table.text(name, "")
    if not NAME.fullmatch(source) or source == RESERVED_SOURCE:
        accepted = f'1 to 32 of A-Z a-z 0-9 _ -, other than "{RESERVED_SOURCE}", are accepted'
        table.refuse(name, table.content[name], accepted)
    return source


@dataclass(frozen=True, slots=True)
class MagnetometerSpec(FieldCells):
    """The measured vector's three columns and their unit; where stated the noise [nT, 1 sigma per axis], the source and
    the full scale of each axis [nT]."""

    columns: tuple[str, ...] = texts(3)
    noise_nt: float | None = number(None, *NOISE_NT, unit="nT")
    source: str = special(_source, "")
    range_nt: float | None = number(None, *RANGE_NT, unit="nT")


_SHORTEST_AXIS = 1e-6
"""A body vector shorter than this is zero or a mistake: its direction is rounding."""

_UNIT_LENGTH = 1e-12
"""A vector this close to length 1 stays as it was written, bit for bit; some thousand roundings of a double."""


def _axis(reading: Reading, name: str) -> Vector:
    """A body axis by letter or as a vector, made a unit vector."""
    table = reading.table
    if isinstance(table.content.get(name), list):
        x, y, z = table.numbers(name, 3) or (0.0, 0.0, 1.0)
        norm = math.sqrt(x * x + y * y + z * z)
        if norm < _SHORTEST_AXIS:
            table.refuse(name, [x, y, z], "a body vector that is not zero is accepted")
            return (0.0, 0.0, 1.0)
        if abs(norm - 1.0) < _UNIT_LENGTH:
            return (x, y, z)
        return (x / norm, y / norm, z / norm)
    letter = table.choice(name, Axis)
    return (float(letter is Axis.X), float(letter is Axis.Y), float(letter is Axis.Z))


@dataclass(frozen=True, slots=True)
class SpinSpec:
    """Unit vector of the spin axis in the body, and the rate [rpm] about +axis where known."""

    axis: Vector = special(_axis)
    rate_rpm: float | None = number(None, -6000.0, 6000.0, unit="rpm", file_only=True)

    @property
    def rate_rad_s(self) -> float | None:
        """The rate [rad/s]."""
        return None if self.rate_rpm is None else self.rate_rpm * 2.0 * math.pi / 60.0


class PlatformKind(StrEnum):
    """Where a recording was made: what can disturb it there."""

    ORBIT = "orbit"
    GROUND = "ground"
    AIR = "air"
    BENCH = "bench"


@dataclass(frozen=True, slots=True)
class PlatformSpec:
    """Where the recording was made, where the descriptor says so."""

    kind: PlatformKind = choice(PlatformKind)


@dataclass(frozen=True, slots=True)
class Descriptor:
    """One RECORDING.toml, checked.

    Parameters
    ----------
    path: the descriptor itself.
    samples: the log it describes, found beside the descriptor.
    beside: further magnetometers of the same craft in the same rows.
    form: how rows stand in the log.
    joins: further files, whose rows are joined to the log's by time.
    max_rows: how many rows are read at most.
    craft: whose rows these are, or which craft of a recorded session, where the descriptor names it.
    accepted: likely defects that whoever wrote the descriptor has looked at and found to be none.
    """

    path: Path
    samples: Path
    time: TimeSpec = section(TimeSpec)
    magnetometer: MagnetometerSpec = section(MagnetometerSpec)
    reference: ReferenceSpec = special(read_reference)
    position: PositionSpec | None = special(read_position)
    spin: SpinSpec | None = section(SpinSpec, None, file_only=True)
    channels: tuple[ChannelSpec, ...] = special(read_channels)
    craft: str | None = None
    platform: PlatformSpec | None = section(PlatformSpec, None)
    accepted: tuple[Code, ...] = special(read_accepted, (), name="inspect")
    beside: tuple[MagnetometerSpec, ...] = sections(MagnetometerSpec)
    max_rows: int = DEFAULT_MAX_ROWS
    form: RowForm = PLAIN_ROWS
    joins: tuple[JoinSpec, ...] = ()

    @property
    def sources(self) -> tuple[str, ...]:
        """Sources of all magnetometers, where they are called anything."""
        return tuple(one.source for one in (self.magnetometer, *self.beside) if one.source)

    def of_source(self, source: str) -> Descriptor:
        """The same log with another of its magnetometers in front; a spin is told in the first one's axes."""
        chosen = next(one for one in (self.magnetometer, *self.beside) if one.source == source)
        if chosen is self.magnetometer:
            return self
        others = (self.magnetometer, *(one for one in self.beside if one is not chosen))
        return replace(self, magnetometer=chosen, beside=others, spin=None)

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that a recording comes from."""
        beside = [join.file for join in self.joins]
        if isinstance(self.position, ElementsPosition):
            beside.append(self.position.file)
        return self.path, self.samples, *map(self.beside_it, beside)

    def beside_it(self, file: str) -> Path:
        """Where a file lies that the descriptor names."""
        return self.path.parent / file

    @property
    def session(self) -> bool:
        """Whether the log is a recorded session, which brings its own times, units and frames."""
        return self.samples.suffix.lower() == SESSION_SUFFIX
