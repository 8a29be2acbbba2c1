"""The table of everything that travels: each kind's number, name, record and fields with their limits.

``codec`` walks it in both directions, ``keys`` names zenoh keys from it, and the tests of ``docs/wire.md`` read it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from magcal_service.base.errors import DecodeError
from magcal_service.wire import fields as check
from magcal_service.wire.messages import (
    CalibratedVector,
    Clock,
    Command,
    CommandReply,
    Estimate,
    Frame,
    MagnetometerSample,
    Message,
    PositionSample,
    ReferenceSample,
    Status,
    TelemetrySample,
    Verdict,
)

MAX_SAMPLE_FIELD_NT = 1e6  # 1 mT: sixteen times the strongest field on the ground
MAX_RESULT_FIELD_NT = 1e7  # an estimate still converging may scale an accepted sample beyond 1 mT; it is still sent
MAX_POSITION_KM = 1e6  # beyond the Moon, 4e5 km away: every orbit of the Earth is within
MAX_TELEMETRY = 1e18  # leaves room for nanosecond clocks, none for squares that overflow
MAX_D = 1e3  # an estimate still converging is sent; a sound one has entries below 1
MAX_COVARIANCE = 1e30  # a variance far beyond MAX_RESULT_FIELD_NT squared, whose sums and products stay finite
MAX_COUNTERS = 128  # of a status; sets the largest payload, see codec.MAX_PAYLOAD_BYTES
MAX_ARGUMENTS = 8  # of a command: above what any command takes, and small for a receiver
MAX_VALUES = 16  # of a telemetry sample: as many as the columns of one channel in a descriptor
MAX_REASONS = 16  # of an estimate: the trust monitor sends the first that apply and cuts the rest
FIRST_RESULT = 16  # codes below are samples
FIRST_COMMAND = 32  # codes from here are commands and replies, those between are results


def _plain_map(value: Any) -> Any:
    return dict(value) if isinstance(value, Mapping) else value


@dataclass(frozen=True, slots=True)
class Field:
    """One place of a payload: the record's attribute, its check, and its way to msgpack where that isn't itself."""

    name: str
    check: check.Check
    dump: Callable[[Any], Any] | None = None


def _choice(name: str, members: Any, *allowed: Any, optional: bool = False) -> Field:
    accept = check.choice(members, allowed or None)
    return Field(name, check.optional(accept) if optional else accept, check.code_of(members))


_COMMON = (
    Field("craft", check.name_like()),
    Field("source", check.name_like()),
    Field("sequence", check.integer(*check.UINT32)),
    Field("time_ns", check.integer(*check.INT64)),
    _choice("clock", Clock),
)


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of message.

    Parameters
    ----------
    code: its number in payloads and frame headers; below 16 samples, from 16 results, from 32 commands.
    name: its short name in zenoh keys and encodings.
    record: its class.
    own: the fields after the seven that all kinds share.
    rule: a check across fields; raises ``DecodeError``.
    appended: how many of the last fields came later: an older sender leaves them out, and they are not sent where nil.
    """

    code: int
    name: str
    record: type[Message]
    own: tuple[Field, ...]
    rule: Callable[[Mapping[str, Any]], None] | None = None
    appended: int = 0

    @property
    def fields(self) -> tuple[Field, ...]:
        """All fields from ``craft`` on, in the order of the payload."""
        return _COMMON + self.own


def _vector_or_magnitude(values: Mapping[str, Any]) -> None:
    given = (values["field_nt"] is not None, values["frame"] is not None, values["magnitude_nt"] is not None)
    if given not in ((True, True, False), (False, False, True)):
        raise DecodeError("wrong_shape", "field_nt with frame, or magnitude_nt alone, is accepted; the others are nil")


_PROTECTION = (
    Field("protection_nt", check.optional(check.real(0.0, MAX_RESULT_FIELD_NT))),
    Field("protection_by", check.optional(check.name_like())),
)


def _with_its_hazard(values: Mapping[str, Any]) -> None:
    if (values["protection_nt"] is None) != (values["protection_by"] is None):
        raise DecodeError("wrong_shape", "protection_nt with protection_by, or neither, is accepted")


KINDS = (
    Kind(1, "magnetometer", MagnetometerSample, (Field("field_body_nt", check.vector(MAX_SAMPLE_FIELD_NT)),)),
    Kind(
        2,
        "reference",
        ReferenceSample,
        (
            Field("field_nt", check.optional(check.vector(MAX_SAMPLE_FIELD_NT))),
            _choice("frame", Frame, optional=True),
            Field("magnitude_nt", check.optional(check.real(0.0, MAX_SAMPLE_FIELD_NT))),
        ),
        _vector_or_magnitude,
    ),
    Kind(
        3,
        "position",
        PositionSample,
        (Field("position_km", check.vector(MAX_POSITION_KM)), _choice("frame", Frame, Frame.ECI, Frame.ECEF)),
    ),
    Kind(
        4,
        "telemetry",
        TelemetrySample,
        (
            Field("channel", check.name_like()),
            Field("unit", check.text(32)),
            Field("values", check.array(check.real(-MAX_TELEMETRY, MAX_TELEMETRY), 1, MAX_VALUES)),
        ),
    ),
    Kind(
        16,
        "calibrated",
        CalibratedVector,
        (
            Field("field_body_nt", check.vector(MAX_RESULT_FIELD_NT)),
            Field("covariance_nt2", check.covariance(3, MAX_COVARIANCE)),
            _choice("verdict", Verdict),
            *_PROTECTION,
        ),
        _with_its_hazard,
        appended=len(_PROTECTION),
    ),
    Kind(
        17,
        "estimate",
        Estimate,
        (
            Field("method", check.name_like()),
            Field("tick", check.integer(*check.COUNT)),
            Field("bias_nt", check.vector(MAX_RESULT_FIELD_NT)),
            Field("D", check.array(check.real(-MAX_D, MAX_D), 6, 6)),
            Field("covariance", check.covariance(9, MAX_COVARIANCE)),
            _choice("verdict", Verdict),
            Field("reasons", check.array(check.name_like(), 0, MAX_REASONS)),
            Field("remedy", check.text()),
            Field("residual_rms_nt", check.real(0.0, MAX_RESULT_FIELD_NT)),
            Field("noise_nt", check.real(0.0, MAX_RESULT_FIELD_NT)),
            Field("samples_used", check.integer(*check.COUNT)),
            *_PROTECTION,
        ),
        _with_its_hazard,
        appended=len(_PROTECTION),
    ),
    Kind(
        18,
        "status",
        Status,
        (
            Field("uptime_s", check.real(0.0, 1e12)),
            _choice("verdict", Verdict),
            Field(
                "counters",
                check.mapping(check.name_like(check.COUNTER_NAME), check.integer(*check.COUNT), MAX_COUNTERS),
                _plain_map,
            ),
            Field("text", check.text()),
        ),
    ),
    Kind(
        32,
        "command",
        Command,
        (
            Field("name", check.name_like()),
            Field("arguments", check.mapping(check.name_like(), check.argument, MAX_ARGUMENTS), _plain_map),
        ),
    ),
    Kind(
        33,
        "reply",
        CommandReply,
        (
            Field("name", check.name_like()),
            Field("command_source", check.name_like()),
            Field("command_sequence", check.integer(*check.UINT32)),
            Field("accepted", check.flag),
            Field("text", check.text()),
        ),
    ),
)

KIND_BY_CODE: Mapping[int, Kind] = {kind.code: kind for kind in KINDS}
_KIND_BY_RECORD: Mapping[type, Kind] = {kind.record: kind for kind in KINDS}


def kind_of(message: Message) -> Kind:
    """The table row of a message; ``DecodeError`` (``unknown_kind``) for what is no message of this schema."""
    kind = _KIND_BY_RECORD.get(type(message))
    if kind is None:
        raise DecodeError("unknown_kind", f"{type(message).__name__} is no message; {kind_names()} are accepted")
    return kind


def kind_names() -> str:
    """All kinds as ``code (name)``, for a refusal's text."""
    return ", ".join(f"{kind.code} ({kind.name})" for kind in KINDS)
