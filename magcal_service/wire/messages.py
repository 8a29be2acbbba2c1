"""Typed records that travel between a craft's sensors, the daemon and its listeners.

Every record carries the craft, the source within the craft, the source's own sequence number and the source time.
Units are in the names.  Records are immutable; vectors are tuples of Python floats, so a record compares and hashes
by value and survives msgpack without loss.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

SCHEMA_VERSION = 1  # first value of every payload; docs/wire.md says when it changes

# Why a payload is refused; every link counts ``refused.<reason>``.  ``docs/wire.md`` says what each means.
REFUSALS = (
    "too_large",
    "not_msgpack",
    "too_long",
    "too_deep",
    "wrong_shape",
    "unknown_version",
    "unknown_kind",
    "wrong_type",
    "not_finite",
    "out_of_range",
    "bad_name",
    "bad_text",
    "unknown_choice",
)

Vector = tuple[float, float, float]


class Clock(StrEnum):
    """What ``time_ns`` counts from: the UTC epoch 1970-01-01 (leap seconds ignored), or the source's own start."""

    UTC = "utc"
    ELAPSED = "elapsed"


class Frame(StrEnum):
    """Axes a vector is given in: inertial (true equator of date), Earth-fixed, or local north-east-down."""

    ECI = "eci"
    ECEF = "ecef"
    NED = "ned"


class Verdict(StrEnum):
    """How far an estimate can be trusted."""

    NOT_STARTED = "not_started"
    CONVERGING = "converging"
    TRUSTED = "trusted"
    DOUBTFUL = "doubtful"


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """What every message carries.

    Parameters
    ----------
    craft: name of the craft, 1-32 characters of ``A-Z a-z 0-9 _ -``.
    source: name of the sensor or process within the craft, same alphabet.
    sequence: counts the messages of one kind from one source, modulo 2**32.
    time_ns: source time [ns] on ``clock``.
    """

    craft: str
    source: str
    sequence: int
    time_ns: int
    clock: Clock = Clock.UTC


@dataclass(frozen=True, slots=True, kw_only=True)
class MagnetometerSample(Message):
    """A measured vector B in the sensor's own axes [nT], equation (1)."""

    field_body_nt: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceSample(Message):
    """The reference field H: a vector with its frame, or a magnitude alone [nT]; exactly one of the two."""

    field_nt: Vector | None = None
    frame: Frame | None = None
    magnitude_nt: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionSample(Message):
    """Position of the craft [km], in ECI or ECEF."""

    position_km: Vector
    frame: Frame


@dataclass(frozen=True, slots=True, kw_only=True)
class TelemetrySample(Message):
    """One telemetry channel: 1 to 16 values with their unit (``degC``, ``A``, ``A m2``, ``rad/s``, ...)."""

    channel: str
    unit: str
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibratedVector(Message):
    """The answer to one accepted magnetometer sample; ``sequence`` and ``time_ns`` are those of that sample.

    ``covariance_nt2`` is the upper triangle xx, xy, xz, yy, yz, zz [nT^2] of sensor noise and estimate together;
    ``protection_nt`` and ``protection_by`` are as in ``Estimate``.
    """

    field_body_nt: Vector
    covariance_nt2: tuple[float, float, float, float, float, float]
    verdict: Verdict
    protection_nt: float | None = None
    protection_by: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate(Message):
    """The nine errors after a tick.

    Parameters
    ----------
    method: estimator that made it, such as ``"ukf"``.
    tick: ticks used so far.
    bias_nt: b [nT].
    D: D11, D22, D33, D12, D13, D23 [-].
    covariance: upper triangle, row by row, of the 9x9 covariance in the order (bias_nt, D): 45 values.
    verdict, reasons, remedy: trust, the reasons' codes (``trust.Reason``), and what to do about them.
    residual_rms_nt: running rms of |(I+D)B - b| - |H| [nT].
    noise_nt: sensor noise that the filter assumes, 1 sigma per axis [nT].
    samples_used: magnetometer samples that entered the estimate so far.
    protection_nt: how far a calibrated vector may be off by a hazard that would not have been seen yet [nT], None while
        unknown (docs/integrity.md).
    protection_by: the hazard that sets it (``trust.hazards``), None while unknown.
    """

    method: str
    tick: int
    bias_nt: Vector
    D: tuple[float, float, float, float, float, float]
    covariance: tuple[float, ...]
    verdict: Verdict
    reasons: tuple[str, ...] = ()
    remedy: str = ""
    residual_rms_nt: float = 0.0
    noise_nt: float = 0.0
    samples_used: int = 0
    protection_nt: float | None = None
    protection_by: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Status(Message):
    """Health of the daemon for one craft: verdict and counters by kind (at most 128)."""

    uptime_s: float
    verdict: Verdict
    counters: Mapping[str, int] = field(default_factory=dict)
    text: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Command(Message):
    """A request to the daemon, such as ``status``, ``freeze``, ``resume``, ``reset``; up to 8 arguments."""

    name: str
    arguments: Mapping[str, str | int | float | bool] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandReply(Message):
    """The answer to one command, named by the command's source and sequence."""

    name: str
    command_source: str
    command_sequence: int
    accepted: bool
    text: str = ""
