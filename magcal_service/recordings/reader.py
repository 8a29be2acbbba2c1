"""A described log as arrays, in file order, with an account of every row that was not used."""

from __future__ import annotations

from functools import reduce
from pathlib import Path

import numpy as np
import numpy.typing as npt

from magcal_service.errors import Fault, RecordingError
from magcal_service.recordings.channels import ChannelSpec
from magcal_service.recordings.descriptor import load_descriptor
from magcal_service.recordings.recording import Channel, Position, Recording, Reference
from magcal_service.recordings.report import RowCount, RowFault, RowReport
from magcal_service.recordings.specs import (
    MAX_FIELD_NT,
    SESSION_SUFFIX,
    CartesianPosition,
    Descriptor,
    GeodeticPosition,
    MagnitudeReference,
    ModelReference,
    PositionSpec,
    ReferenceSpec,
    TimeFormat,
    TimeSpec,
    VectorReference,
)
from magcal_service.recordings.table import CODE, FAULTS, Codes, FloatArray, IntArray, TextTable, read_table, why
from magcal_service.recordings.timestamps import MAX_TIME_NS, iso8601_to_ns, seconds_to_ns
from magcal_service.typed_toml import nearest
from magcal_service.units import FIELD_NT, LENGTH_KM
from magcal_service.wire.messages import Frame

_MAX_CHANNEL = 1e18  # as on the wire
_RADIUS_KM = (6300.0, 1e6)


def read_recording(path: Path | str, craft: str | None = None, *, prefer: str | None = None) -> Recording:
    """Read a recording by its descriptor, or a recorded session (``.mcap``) without one.

    Parameters
    ----------
    craft: which craft of a session; may be left out where it has one, or where the descriptor names it.
    prefer: which craft of a session where none is named and there are several.

    Raises
    ------
    RecordingError: the descriptor is faulty, a column is missing, no row can be used, or the craft is not certain.
    ExtraMissingError: ``model = "igrf"`` or a session without the package that it needs.
    """
    path = Path(path)
    if path.suffix.lower() == SESSION_SUFFIX:
        return _read_session(path, None, craft, prefer)
    descriptor = load_descriptor(path)
    if descriptor.session:
        return _read_session(descriptor.samples, descriptor, craft or descriptor.craft, prefer)
    if craft is not None:
        accepted = "only a recorded session (.mcap) has craft to choose from; leave it out"
        raise RecordingError([Fault(f"{path}: craft", craft, accepted)])
    return read_described(descriptor)


def _read_session(path: Path, descriptor: Descriptor | None, craft: str | None, prefer: str | None) -> Recording:
    from magcal_service.recordings.session_arrays import session_recording

    recording = session_recording(path, descriptor, craft, prefer)
    _check_usable(recording)
    return recording


def read_described(descriptor: Descriptor) -> Recording:
    """Read the log in rows of a descriptor that has been loaded; raises as ``read_recording``."""
    table = read_table(descriptor.samples, descriptor.delimiter)
    _check_columns(descriptor, table)
    log = _Log(table)
    time_ns = log.times(descriptor.time)
    field_nt = log.field(descriptor)
    log.note_order(time_ns)
    position = log.position(descriptor.position)
    reference = log.reference(descriptor.reference, time_ns, position)
    channels = {spec.name: log.channel(spec) for spec in descriptor.channels}
    recording = Recording(
        name=descriptor.samples.name,
        descriptor=descriptor,
        time_ns=time_ns,
        clock=descriptor.time.clock,
        field_body_nt=field_nt,
        reference=reference,
        position=position,
        channels=channels,
        report=RowReport(table.seen, int(np.count_nonzero(log.kept)), tuple(log.entries)),
    ).select(log.kept)
    _check_usable(recording)
    return recording


def _columns_by_key(descriptor: Descriptor) -> dict[str, tuple[str, ...]]:
    """Every column the descriptor names, by the key that names it."""
    named = {"time.column": (descriptor.time.column,), "magnetometer.columns": descriptor.magnetometer.columns}
    if isinstance(descriptor.reference, VectorReference):
        named["reference.columns"] = descriptor.reference.columns
    if isinstance(descriptor.reference, MagnitudeReference):
        named["reference.magnitude"] = (descriptor.reference.column,)
    if descriptor.position is not None:
        named["position.columns"] = descriptor.position.columns
    if isinstance(descriptor.position, GeodeticPosition) and descriptor.position.altitude is not None:
        named["position.altitude.column"] = (descriptor.position.altitude.column,)
    return named | {f"channels.{spec.name}": spec.columns for spec in descriptor.channels}


def _check_columns(descriptor: Descriptor, table: TextTable) -> None:
    """Every named column stands in the header, once."""
    faults = []
    for key, columns in _columns_by_key(descriptor).items():
        for column in columns:
            times = table.header.count(column)
            if times != 1:
                accepted = f"it stands {times} times in the header" if times else nearest(column, set(table.header))
                problem = f"a column of {descriptor.samples.name} is accepted; {accepted}"
                faults.append(Fault(f"{descriptor.path.name}: {key}", column, problem))
    if faults:
        raise RecordingError(faults)


def _check_usable(recording: Recording) -> None:
    """At least one row has a time, a magnetometer vector and a reference."""
    report, descriptor = recording.report, recording.descriptor
    account = "; ".join(report.lines())
    if report.used == 0:
        accepted = f"at least one row with a time and three magnetometer values is needed ({account})"
        raise RecordingError([Fault(str(descriptor.samples), "no usable row", accepted)])
    if not np.isfinite(recording.reference.magnitude_nt).any():
        accepted = f"at least one row with a reference is needed; check [reference], [position] and [time] ({account})"
        raise RecordingError([Fault(f"{descriptor.path.name}: reference", "no usable value", accepted)])


class _Log:
    """The rows of a table on their way to arrays: which are still kept, and what was counted."""

    def __init__(self, table: TextTable) -> None:
        self._table = table
        self.entries: list[RowCount] = list(table.entries)
        self.kept = np.ones(len(table.rows), dtype=np.bool_)

    def _count(self, part: str, codes: Codes, *, kept: bool) -> None:
        """Count the faults of rows that are still kept; where these rows cannot be used, keep them no longer."""
        codes = np.where(self.kept, codes, 0)
        for code in np.unique(codes[codes > 0]):
            rows = np.flatnonzero(codes == code)
            first_line = int(self._table.lines[rows[0]])
            self.entries.append(RowCount(part, FAULTS[code - 1], len(rows), first_line, kept))
        if not kept:
            self.kept &= codes == 0

    def _vectors(self, columns: tuple[str, ...], factor: float) -> tuple[FloatArray, Codes]:
        """Columns side by side (n, k), NaN in every component of a faulty row, and each row's first fault (n,)."""
        parsed = [self._table.numbers(column) for column in columns]
        codes = reduce(lambda first, other: np.where(first > 0, first, other), [code for _, code in parsed])
        values = np.stack([value for value, _ in parsed], axis=-1) * factor
        values[codes > 0] = np.nan
        return values, codes

    def times(self, spec: TimeSpec) -> IntArray:
        """The time of every row [ns]; rows without one are refused."""
        cells = self._table.column(spec.column)
        parse = iso8601_to_ns if spec.format is TimeFormat.ISO8601 else seconds_to_ns
        start_ns = spec.start_ns or 0
        codes = np.zeros(len(cells), dtype=np.uint8)
        time_ns = np.zeros(len(cells), dtype=np.int64)
        for row, cell in enumerate(cells):
            value = parse(cell)
            if value is None:
                codes[row] = CODE[why(cell)]
            elif abs(value + start_ns) > MAX_TIME_NS:
                codes[row] = CODE[RowFault.ABSURD]
            else:
                time_ns[row] = value + start_ns
        self._count("time", codes, kept=False)
        return time_ns

    def field(self, descriptor: Descriptor) -> FloatArray:
        """The magnetometer vector of every row [nT]; rows without one, or with one beyond 1 mT, are refused."""
        spec = descriptor.magnetometer
        field_nt, codes = self._vectors(spec.columns, FIELD_NT[spec.unit])
        self._count("magnetometer", _or_absurd(codes, _length(field_nt) > MAX_FIELD_NT), kept=False)
        return field_nt

    def note_order(self, time_ns: IntArray) -> None:
        """Count rows whose time was there before, or lies before an earlier row's; the ticks decide about them."""
        rows = np.flatnonzero(self.kept)
        times = time_ns[rows]
        codes = np.zeros(len(time_ns), dtype=np.uint8)
        codes[rows[times < np.maximum.accumulate(times)]] = CODE[RowFault.OUT_OF_ORDER]
        doubled = np.ones(len(rows), dtype=np.bool_)
        doubled[np.unique(times, return_index=True)[1]] = False
        codes[rows[doubled]] = CODE[RowFault.DOUBLED_TIME]
        self._count("time", codes, kept=True)

    def position(self, spec: PositionSpec | None) -> Position | None:
        """Where the craft was at every row."""
        if spec is None:
            return None
        if isinstance(spec, CartesianPosition):
            km, codes = self._vectors(spec.columns, LENGTH_KM[spec.unit])
            frame = spec.frame
        else:
            km, codes = self._geodetic(spec)
            frame = Frame.ECEF
        radius_km = _length(km)
        codes = _or_absurd(codes, (radius_km < _RADIUS_KM[0]) | (radius_km > _RADIUS_KM[1]))
        km[codes > 0] = np.nan
        self._count("position", codes, kept=True)
        return Position(km, frame)

    def _geodetic(self, spec: GeodeticPosition) -> tuple[FloatArray, Codes]:
        from magcal_service.geomagnetic import ecef_from_geodetic

        degrees, codes = self._vectors(spec.columns, 1.0)
        altitude_km = np.full(len(codes), spec.altitude_km or 0.0)
        if spec.altitude is not None:
            altitude, altitude_codes = self._vectors((spec.altitude.column,), LENGTH_KM[spec.altitude.unit])
            altitude_km = altitude[:, 0]
            codes = np.where(codes > 0, codes, altitude_codes)
        latitude, longitude = degrees.T
        codes = _or_absurd(codes, (np.abs(latitude) > 90.0) | (np.abs(longitude) > 360.0))
        return ecef_from_geodetic(latitude, longitude, altitude_km), codes

    def reference(self, spec: ReferenceSpec, time_ns: IntArray, position: Position | None) -> Reference:
        """The reference field of every row."""
        vector_nt: FloatArray | None = None
        frame: Frame | None = None
        if isinstance(spec, VectorReference):
            vector_nt, codes = self._vectors(spec.columns, FIELD_NT[spec.unit])
            frame = spec.frame
        elif isinstance(spec, ModelReference):
            vector_nt, codes = _igrf_eci(time_ns, position, self.kept)
            frame = Frame.ECI
        elif isinstance(spec, MagnitudeReference):
            values, codes = self._vectors((spec.column,), FIELD_NT[spec.unit])
            magnitude_nt = values[:, 0]
        else:
            magnitude_nt = np.full(len(time_ns), spec.magnitude_nt)
            codes = np.zeros(len(time_ns), dtype=np.uint8)
        if vector_nt is not None:
            magnitude_nt = _length(vector_nt)
        codes = _or_absurd(codes, (magnitude_nt <= 0.0) | (magnitude_nt > MAX_FIELD_NT))
        magnitude_nt = np.where(codes > 0, np.nan, magnitude_nt)
        if vector_nt is not None:
            vector_nt[codes > 0] = np.nan
        self._count("reference", codes, kept=True)
        return Reference(magnitude_nt, vector_nt, frame)

    def channel(self, spec: ChannelSpec) -> Channel:
        """One telemetry channel; a faulty cell is NaN and its neighbours stay."""
        parsed = [self._table.numbers(column) for column in spec.columns]
        codes = np.stack([code for _, code in parsed])
        values = np.stack([value for value, _ in parsed], axis=-1)
        absurd: npt.NDArray[np.bool_] = np.abs(values) > _MAX_CHANNEL
        values[absurd] = np.nan
        first = codes[np.argmax(codes > 0, axis=0), np.arange(codes.shape[1])]
        self._count(f"channels.{spec.name}", _or_absurd(first, np.any(absurd, axis=1)), kept=True)
        return Channel(spec, values)


def _length(vectors: FloatArray) -> FloatArray:
    """Lengths (n,) of vectors (n, 3); infinite where a component is too large to be squared."""
    with np.errstate(over="ignore"):
        lengths: FloatArray = np.linalg.norm(vectors, axis=1)
    return lengths


def _or_absurd(codes: Codes, absurd: npt.NDArray[np.bool_]) -> Codes:
    """Good cells become absurd ones where said; comparisons with NaN are False, so faulty cells keep their fault."""
    return np.where((codes == 0) & absurd, np.uint8(CODE[RowFault.ABSURD]), codes)


def _igrf_eci(time_ns: IntArray, position: Position | None, wanted: npt.NDArray[np.bool_]) -> tuple[FloatArray, Codes]:
    """IGRF (n, 3) [nT] in ECI where the position and the date are within the model's domain, and the fault codes."""
    from magcal_service import geomagnetic

    assert position is not None, "the descriptor was refused without a position"
    radius_km = np.linalg.norm(position.km, axis=1)
    codes = np.where(np.isfinite(radius_km), 0, CODE[RowFault.MISSING]).astype(np.uint8)
    years = time_ns.astype("datetime64[ns]").astype("datetime64[Y]").astype(np.int64) + 1970
    first_year, end_year = geomagnetic.IGRF_YEARS
    outside = (years < first_year) | (years >= end_year) | (radius_km > geomagnetic.RADIUS_KM[1])
    codes = _or_absurd(codes, np.asarray(outside))
    rows = np.flatnonzero(wanted & (codes == 0))
    vector_nt = np.full((len(time_ns), 3), np.nan)
    if len(rows):
        model = geomagnetic.igrf_eci_nt if position.frame is Frame.ECI else _igrf_eci_at_ecef
        vector_nt[rows] = model(time_ns[rows], position.km[rows])
    return vector_nt, codes


def _igrf_eci_at_ecef(time_ns: IntArray, position_ecef_km: FloatArray) -> FloatArray:
    from magcal_service import geomagnetic

    return geomagnetic.eci_from_ecef(time_ns, geomagnetic.igrf_ecef_nt(time_ns, position_ecef_km))
