"""A session's messages as the arrays of a recording.

One row a magnetometer sample.  A reference, position or channel has its own rate and is brought to the rows' times:
taken as it is where the times agree, else interpolated linearly between the two samples around, where these are at
most ``WIDEST_PERIODS`` of their median period (and never less than the ticks' ``reference_max_gap_s``) apart.  Values
without a unit, counts and magnetic moments are held instead: states and commands, not quantities between which a
straight line means something.  Error of the interpolation: ``reference_track`` has it for the field.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeVar

import numpy as np

from magcal_service.base.errors import Fault, RecordingError
from magcal_service.base.typed_toml import nearest
from magcal_service.base.units import CHANNEL_UNITS, FieldUnit, LengthUnit
from magcal_service.config.magnetometers import of_source
from magcal_service.config.settings import CraftConfig, SpinConfig, TickConfig
from magcal_service.recordings.channels import ChannelSpec
from magcal_service.recordings.recording import Channel, Position, Recording, Reference
from magcal_service.recordings.report import RowCount, RowFault, RowReport
from magcal_service.recordings.row_limits import RowLimits
from magcal_service.recordings.session import Session, read_session
from magcal_service.recordings.specs import (
    CartesianPosition,
    Descriptor,
    MagnetometerSpec,
    MagnitudeReference,
    ReferenceSpec,
    SpinSpec,
    TimeFormat,
    TimeSpec,
    VectorReference,
)
from magcal_service.recordings.table import FloatArray, IntArray
from magcal_service.wire.messages import (
    Clock,
    Frame,
    MagnetometerSample,
    Message,
    PositionSample,
    ReferenceSample,
    TelemetrySample,
)

WIDEST_PERIODS: Final = 2.5  # bridges one missing sample, with room for jitter, and never two
_STATED: Final = ("noise_nt", "range_nt")  # of a sensor, by the same names in a descriptor and a configuration
_HELD: Final = frozenset({"dimensionless", "counts", "magnetic moment"})

M = TypeVar("M", bound=Message)


@dataclass(frozen=True, slots=True)
class _Series:
    """Samples of one source: times (n,) [ns], rising, and values (n, k)."""

    times_ns: IntArray
    values: FloatArray

    @classmethod
    def of(cls, samples: Sequence[Message], values: Sequence[Sequence[float]]) -> _Series:
        """The first of those with the same time counts, as on the line."""
        times_ns, first = np.unique(np.array([one.time_ns for one in samples], dtype=np.int64), return_index=True)
        return cls(times_ns, np.array(values, dtype=np.float64).reshape(len(samples), -1)[first])

    def at(self, rows_ns: IntArray, gap_s: float, *, held: bool = False) -> FloatArray:
        """Values (m, k) at times (m,) [ns], NaN where there are none close enough."""
        known = self.times_ns
        before = np.maximum(np.searchsorted(known, rows_ns, side="right") - 1, 0)
        after = np.where(known[before] == rows_ns, before, np.minimum(before + 1, len(known) - 1))
        span_s = (known[after] - known[before]) * 1e-9
        period_s = float(np.median(np.diff(known))) * 1e-9 if len(known) > 1 else 0.0
        passed_s = (rows_ns - known[before]) * 1e-9
        share = np.where(span_s > 0.0, passed_s / np.where(span_s > 0.0, span_s, 1.0), 0.0)
        values = self.values[before] + (0.0 if held else share[:, None] * (self.values[after] - self.values[before]))
        far = (passed_s if held else span_s) > max(gap_s, WIDEST_PERIODS * period_s)
        outside = (rows_ns < known[0]) | ((rows_ns > known[-1]) & ~np.bool_(held))
        values[far | outside] = np.nan
        return values


class _Rows:
    """Keeps the account while messages become arrays."""

    def __init__(self) -> None:
        self.entries: list[RowCount] = []

    def note(self, part: str, fault: RowFault, numbers: Sequence[int], *, kept: bool) -> None:
        """Count a fault; ``numbers`` count that kind of record from 1."""
        if len(numbers):
            self.entries.append(RowCount(part, fault, len(numbers), int(numbers[0]), kept, "record"))

    def alike(self, part: str, samples: Sequence[M], forms: Sequence[Hashable], *, kept: bool) -> list[M]:
        """The samples of the form that most have; the others are counted."""
        if not samples:
            return []
        ((form, _),) = Counter(forms).most_common(1)
        self.note(part, RowFault.OTHER_FORM, [n for n, one in enumerate(forms, 1) if one != form], kept=kept)
        return [sample for sample, one in zip(samples, forms, strict=True) if one == form]


def session_recording(
    path: Path,
    descriptor: Descriptor | None = None,
    craft: str | None = None,
    prefer: str | None = None,
    source: str | None = None,
) -> Recording:
    """Read one craft of a session file.

    Parameters
    ----------
    descriptor: of a file that names the session; its noise and spin go before those recorded.
    craft, prefer: as ``read_session`` takes them.
    source: which magnetometer's samples the rows are; the craft's own where not given.

    Raises ``RecordingError`` as ``read_session``, and where there is no magnetometer sample.
    """
    limits = RowLimits() if descriptor is None else RowLimits(descriptor.max_rows)
    session = read_session(path, craft, prefer, limits)
    measured = [message for message in session.messages if isinstance(message, MagnetometerSample)]
    if not measured:
        raise RecordingError([Fault(str(path), "no magnetometer samples", "a recording with some is accepted")])
    chosen, further = _chosen(path, session, list(dict.fromkeys(one.source for one in measured)), source)
    samples = [one for one in measured if one.source == chosen]
    rows = _Rows()
    rows.note("recorder", RowFault.NOT_RECORDED, range(1, session.dropped + 1), kept=False)
    for reason, count in session.refused.items():
        rows.note(f"record ({reason})", RowFault.UNPARSABLE, range(1, count + 1), kept=False)
    if session.damage:
        rows.note("file", RowFault.TRUNCATED_FILE, [len(session.messages) + 1], kept=False)
    used = rows.alike("magnetometer", samples, [sample.clock for sample in samples], kept=False)
    clock, time_ns = used[0].clock, np.array([sample.time_ns for sample in used], dtype=np.int64)
    _note_order(rows, time_ns)
    gap_s = (session.configuration.ticks if session.configuration else TickConfig()).reference_max_gap_s
    _check_channels(path, session.messages, len(time_ns), limits)
    others = _Others([message for message in session.messages if message.clock is clock], time_ns, gap_s, rows)
    reference, position, channels = others.reference(), others.position(), others.channels()
    return Recording(
        name=path.name,
        descriptor=_descriptor(path, _settings(session, chosen), descriptor, clock, reference, position, channels),
        time_ns=time_ns,
        clock=clock,
        field_body_nt=np.array([sample.field_body_nt for sample in used], dtype=np.float64),
        reference=reference,
        position=position,
        channels={channel.spec.name: channel for channel in channels},
        report=RowReport(len(samples), len(used), tuple(rows.entries)),
        craft=_configuration(session, descriptor),
        stream=session.messages,
        state=session.state,
        beside=session.beside,
        source=chosen,
        others=further,
    )


def _check_channels(path: Path, messages: Sequence[Message], rows: int, limits: RowLimits) -> None:
    """Refuse more channels, each of which has a value for every row, than rows of a log may have cells."""
    widths = {one.channel: len(one.values) for one in messages if isinstance(one, TelemetrySample)}
    limits.check_cells(path, sum(widths.values()), rows)


def _chosen(path: Path, session: Session, heard: Sequence[str], source: str | None) -> tuple[str, tuple[str, ...]]:
    """The magnetometer whose samples the rows are, and the others; as the service did, where none is named."""
    if source is not None and source not in heard:
        raise RecordingError([Fault(f"{path}: source", source, nearest(source, heard))])
    if source is None:
        craft, state = session.configuration, session.state or {}
        own = craft.magnetometers[0].source if craft is not None and craft.magnetometers else state.get("heard")
        source = own if isinstance(own, str) and own in heard else heard[0]
    return source, tuple(one for one in heard if one != source)


def _note_order(rows: _Rows, time_ns: IntArray) -> None:
    """The ticks decide about these, as they did when the session was live."""
    late = np.flatnonzero(time_ns < np.maximum.accumulate(time_ns))
    rows.note("time", RowFault.OUT_OF_ORDER, (late + 1).tolist(), kept=True)
    doubled = np.ones(len(time_ns), dtype=np.bool_)
    doubled[np.unique(time_ns, return_index=True)[1]] = False
    rows.note("time", RowFault.DOUBLED_TIME, (np.flatnonzero(doubled) + 1).tolist(), kept=True)


class _Others:
    """What is brought to the times of the magnetometer's rows."""

    def __init__(self, messages: Sequence[Message], rows_ns: IntArray, gap_s: float, rows: _Rows) -> None:
        self._messages, self._rows_ns, self._gap_s, self._rows = messages, rows_ns, gap_s, rows

    def reference(self) -> Reference:
        """The field of each row; magnitudes of vectors in axes that turn are interpolated as such."""
        found = [message for message in self._messages if isinstance(message, ReferenceSample)]
        found = self._rows.alike("reference", found, [sample.frame for sample in found], kept=False)
        if not found:
            return Reference(np.full(len(self._rows_ns), np.nan))
        vectors = [sample.field_nt for sample in found if sample.field_nt is not None]
        if not vectors:
            magnitudes = [(sample.magnitude_nt or 0.0,) for sample in found]
            return Reference(_positive(_Series.of(found, magnitudes).at(self._rows_ns, self._gap_s)[:, 0]))
        frame = found[0].frame
        vector_nt = _Series.of(found, vectors).at(self._rows_ns, self._gap_s)
        lengths = np.linalg.norm(np.array(vectors), axis=1)[:, None]
        turning = _Series.of(found, lengths.tolist()).at(self._rows_ns, self._gap_s)[:, 0]
        magnitude_nt = _positive(np.linalg.norm(vector_nt, axis=1) if frame is Frame.ECI else turning)
        vector_nt[np.isnan(magnitude_nt)] = np.nan
        return Reference(magnitude_nt, vector_nt, frame)

    def position(self) -> Position | None:
        """Where the craft was at each row."""
        found = [message for message in self._messages if isinstance(message, PositionSample)]
        found = self._rows.alike("position", found, [sample.frame for sample in found], kept=False)
        if not found:
            return None
        series = _Series.of(found, [sample.position_km for sample in found])
        return Position(series.at(self._rows_ns, self._gap_s), found[0].frame)

    def channels(self) -> list[Channel]:
        """Telemetry by name, in order of appearance."""
        by_name: dict[str, list[TelemetrySample]] = defaultdict(list)
        for message in self._messages:
            if isinstance(message, TelemetrySample):
                by_name[message.channel].append(message)
        return [self._channel(name, samples) for name, samples in by_name.items()]

    def _channel(self, name: str, samples: list[TelemetrySample]) -> Channel:
        part = f"channels.{name}"
        samples = self._rows.alike(part, samples, [(one.unit, len(one.values)) for one in samples], kept=False)
        unit, width = samples[0].unit, len(samples[0].values)
        if unit not in CHANNEL_UNITS:
            self._rows.note(part, RowFault.UNKNOWN_UNIT, range(1, len(samples) + 1), kept=True)
            unit = ""
        columns = (name,) if width == 1 else tuple(f"{name}[{index}]" for index in range(width))
        held = CHANNEL_UNITS[unit].quantity in _HELD
        values = _Series.of(samples, [one.values for one in samples]).at(self._rows_ns, self._gap_s, held=held)
        return Channel(ChannelSpec(name, columns, unit), values)


def _positive(magnitude_nt: FloatArray) -> FloatArray:
    return np.where(magnitude_nt > 0.0, magnitude_nt, np.nan)


def _settings(session: Session, source: str) -> CraftConfig | None:
    """The recorded configuration of one magnetometer; None where the file does not say."""
    craft = session.configuration
    return None if craft is None else of_source(craft, source)


def _configuration(session: Session, descriptor: Descriptor | None) -> CraftConfig | None:
    """The recorded configuration; a descriptor's noise, range and spin are the newer word."""
    craft = session.configuration
    if craft is None or descriptor is None:
        return craft
    stated = {name: getattr(descriptor.magnetometer, name) for name in _STATED}
    newer = {name: value for name, value in stated.items() if value is not None}
    craft = replace(craft, sensor=replace(craft.sensor, **newer))
    spin = descriptor.spin
    if spin is not None and spin.rate_rpm:
        craft = replace(craft, spin=replace(craft.spin or SpinConfig(), axis=spin.axis, rate_rpm=spin.rate_rpm))
    return craft


def _descriptor(
    path: Path,
    craft: CraftConfig | None,
    given: Descriptor | None,
    clock: Clock,
    reference: Reference,
    position: Position | None,
    channels: Sequence[Channel],
) -> Descriptor:
    """The session described as any log is."""
    words = [*([given.magnetometer] if given is not None else []), *([craft.sensor] if craft is not None else [])]
    noise_nt, range_nt = (_first(getattr(word, name) for word in words) for name in _STATED)
    spin = given.spin if given is not None else None
    if spin is None and craft is not None and craft.spin is not None:
        spin = SpinSpec(craft.spin.axis, craft.spin.rate_rpm)
    spec: ReferenceSpec = MagnitudeReference("magnitude_nt", unit=FieldUnit.NT)
    if reference.frame is not None:
        spec = VectorReference(_columns("field_nt"), reference.frame, unit=FieldUnit.NT)
    return Descriptor(
        path=path if given is None else given.path,
        samples=path,
        time=TimeSpec("timestamp", TimeFormat.UNIX_S if clock is Clock.UTC else TimeFormat.ELAPSED_S),
        magnetometer=MagnetometerSpec(_columns("field_body_nt"), noise_nt, range_nt=range_nt, unit=FieldUnit.NT),
        reference=spec,
        position=None
        if position is None
        else CartesianPosition(_columns("position_km"), position.frame, unit=LengthUnit.KM),
        spin=spin,
        channels=tuple(channel.spec for channel in channels),
    )


def _first(values: Iterable[float | None]) -> float | None:
    """The first of some values that is stated."""
    return next((value for value in values if value is not None), None)


def _columns(name: str) -> tuple[str, str, str]:
    return (f"{name}[0]", f"{name}[1]", f"{name}[2]")
