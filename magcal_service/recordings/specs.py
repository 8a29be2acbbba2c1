"""What a descriptor says, as frozen records."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from magcal_service.recordings.channels import ChannelSpec
from magcal_service.units import FieldUnit, LengthUnit
from magcal_service.wire.messages import Clock, Frame, Vector

MAX_FIELD_NT = 1e6
"""1 mT: more than this is no magnetometer reading, here and on the wire."""


SESSION_SUFFIX = ".mcap"
"""The service's own recordings."""


class TimeFormat(StrEnum):
    """How a time cell is written."""

    ISO8601 = "iso8601"
    UNIX_S = "unix_s"
    ELAPSED_S = "elapsed_s"


class FieldModel(StrEnum):
    """Field models that can stand in for a recorded reference."""

    IGRF = "igrf"


class PositionFrame(StrEnum):
    """Frames of a position given as three columns."""

    ECI = "eci"
    ECEF = "ecef"


class Axis(StrEnum):
    """Body axes by letter."""

    X = "x"
    Y = "y"
    Z = "z"


@dataclass(frozen=True, slots=True)
class TimeSpec:
    """Column and format of the time; ``start_ns`` is the UTC instant [ns] of elapsed 0, where known."""

    column: str
    format: TimeFormat
    start_ns: int | None = None

    @property
    def clock(self) -> Clock:
        """UTC unless only the elapsed time is known."""
        return Clock.ELAPSED if self.format is TimeFormat.ELAPSED_S and self.start_ns is None else Clock.UTC


@dataclass(frozen=True, slots=True)
class MagnetometerSpec:
    """The measured vector's three columns, their unit, and the noise [nT, 1 sigma per axis] where stated."""

    columns: tuple[str, ...]
    unit: FieldUnit
    noise_nt: float | None = None


@dataclass(frozen=True, slots=True)
class VectorReference:
    """A reference vector per row."""

    columns: tuple[str, ...]
    unit: FieldUnit
    frame: Frame


@dataclass(frozen=True, slots=True)
class MagnitudeReference:
    """A reference magnitude per row."""

    column: str
    unit: FieldUnit


@dataclass(frozen=True, slots=True)
class ModelReference:
    """A field model evaluated at the recorded position and time."""

    model: FieldModel


@dataclass(frozen=True, slots=True)
class ConstantReference:
    """One magnitude [nT] for all rows."""

    magnitude_nt: float


ReferenceSpec = VectorReference | MagnitudeReference | ModelReference | ConstantReference


@dataclass(frozen=True, slots=True)
class GeodeticPosition:
    """Latitude and longitude columns [deg], and the altitude: either one constant [km] or a column with its unit."""

    columns: tuple[str, ...]
    altitude_km: float | None
    altitude_column: str | None
    altitude_unit: LengthUnit


@dataclass(frozen=True, slots=True)
class CartesianPosition:
    """Three columns, their unit and frame."""

    columns: tuple[str, ...]
    unit: LengthUnit
    frame: Frame


PositionSpec = GeodeticPosition | CartesianPosition


@dataclass(frozen=True, slots=True)
class SpinSpec:
    """Unit vector of the spin axis in the body, and the rate [rpm] about +axis where known."""

    axis: Vector
    rate_rpm: float | None

    @property
    def rate_rad_s(self) -> float | None:
        """The rate [rad/s]."""
        return None if self.rate_rpm is None else self.rate_rpm * 2.0 * math.pi / 60.0


@dataclass(frozen=True, slots=True)
class Descriptor:
    """One RECORDING.toml, checked.

    Parameters
    ----------
    path: the descriptor itself.
    samples: the log it describes, found beside the descriptor.
    delimiter: what separates the cells of a row.
    craft: which craft of a recorded session, where the descriptor names it.
    """

    path: Path
    samples: Path
    delimiter: str
    time: TimeSpec
    magnetometer: MagnetometerSpec
    reference: ReferenceSpec
    position: PositionSpec | None
    spin: SpinSpec | None
    channels: tuple[ChannelSpec, ...]
    craft: str | None = None

    @property
    def session(self) -> bool:
        """Whether the log is a recorded session, which brings its own times, units and frames."""
        return self.samples.suffix.lower() == SESSION_SUFFIX
