"""Rows of text to arrays in file order: time, field, position, reference, channels; every fault is counted."""

from __future__ import annotations

from functools import reduce
from pathlib import Path

import numpy as np
import numpy.typing as npt

from magcal_service.base.progress import each
from magcal_service.base.units import ANGLE_DEG
from magcal_service.recordings.channels import ChannelSpec
from magcal_service.recordings.recording import Channel, Position, Reference
from magcal_service.recordings.report import RowCount, RowFault, shown
from magcal_service.recordings.specs import (
    MAX_FIELD_NT,
    CartesianPosition,
    Descriptor,
    ElementsPosition,
    GeodeticPosition,
    MagnetometerSpec,
    MagnitudeReference,
    ModelReference,
    ReferenceSpec,
    TimeSpec,
    VectorReference,
)
from magcal_service.recordings.table import (
    CODE,
    FAULTS,
    POINT,
    Codes,
    FloatArray,
    IntArray,
    TextTable,
    parse_numbers,
    why,
)
from magcal_service.recordings.time_cells import time_parser
from magcal_service.recordings.timestamps import MAX_TIME_NS
from magcal_service.wire.messages import Frame

_MAX_CHANNEL = 1e18  # as on the wire
_RADIUS_KM = (6300.0, 1e6)
"""Of a position: from below the Earth's polar radius of 6357 km to beyond the Moon; metres given as km fall outside."""

_DAY_NS = 86_400 * 10**9  # nanoseconds in a day
_SHOWN_FAULTS = (RowFault.UNPARSABLE, RowFault.INFINITE, RowFault.ABSURD)
"""Faults whose first cell is shown; the others say it all."""


class RowArrays:
    """Makes arrays of a table's rows; knows which rows are still kept, and what was counted.

    Parameters
    ----------
    table: the log's rows as text.
    """

    def __init__(self, table: TextTable) -> None:
        self._table = table
        self.entries: list[RowCount] = list(table.entries)
        self.remarks: list[str] = []
        self.kept = np.ones(len(table.lines), dtype=np.bool_)

    def _count(
        self, part: str, codes: Codes, columns: tuple[str, ...] = (), *, kept: bool, expects: str = "a number"
    ) -> None:
        """Count the faults of rows that are still kept; where these rows cannot be used, keep them no longer.

        ``columns`` hold the part, in cells that should be as ``expects`` says.
        """
        codes = np.where(self.kept, codes, 0)
        for code in np.unique(codes[codes > 0]):
            rows = np.flatnonzero(codes == code)
            first_line = int(self._table.lines[rows[0]])
            shows = self._shows(FAULTS[code - 1], int(rows[0]), columns, expects)
            self.entries.append(RowCount(part, FAULTS[code - 1], len(rows), first_line, kept, shows=shows))
        if not kept:
            self.kept &= codes == 0

    def _shows(self, fault: RowFault, row: int, columns: tuple[str, ...], expects: str) -> str:
        """What stands in the cells of a row that has a fault, where that helps to mend it."""
        if fault not in _SHOWN_FAULTS:
            return ""
        cells = {column: self._table.column(column)[row] for column in columns}
        if fault is RowFault.ABSURD:
            return " ".join(shown(cell.strip()) for cell in cells.values())
        if expects != "a number":
            return f"{shown(' '.join(cell.strip() for cell in cells.values()))} where {expects} is expected"
        for column, cell in cells.items():
            if parse_numbers([self._table.plain(cell)])[1][0] == CODE[fault]:
                comma = " with a decimal comma" if self._table.decimal == "," else ""
                hint = '; decimal = "," under [samples] reads it' if self._is_with_comma(cell) else ""
                return f"{shown(cell.strip())} in {column} where {expects}{comma} is expected{hint}"
        return ""

    def _is_with_comma(self, cell: str) -> bool:
        """Whether a cell would be a number with the other decimal sign."""
        return self._table.decimal == "." and not parse_numbers([cell.translate(POINT)])[1][0]

    def _vectors(self, columns: tuple[str, ...], factor: float) -> tuple[FloatArray, Codes]:
        """Columns side by side (n, k), NaN in every component of a faulty row, and each row's first fault (n,)."""
        parsed = [self._table.numbers(column) for column in columns]
        codes = reduce(lambda first, other: np.where(first > 0, first, other), [code for _, code in parsed])
        values = np.stack([value for value, _ in parsed], axis=-1) * factor
        values[codes > 0] = np.nan
        return values, codes

    def times(self, spec: TimeSpec) -> IntArray:
        """The time of every row [ns]; rows without one are refused."""
        if spec.rate_hz is not None:
            return self._even_times(spec.start_ns or 0, spec.rate_hz)
        cells = self._cells(spec.named)
        parse = time_parser(spec, self._table.decimal)
        start_ns = spec.start_ns or 0
        codes = np.zeros(len(cells), dtype=np.uint8)
        time_ns = np.zeros(len(cells), dtype=np.int64)
        for row, cell in enumerate(each(cells, "reading times", "rows")):
            value = parse(cell)
            if value is None:
                codes[row] = CODE[why(cell)]
            elif abs(value + start_ns) > MAX_TIME_NS:
                codes[row] = CODE[RowFault.ABSURD]
            else:
                time_ns[row] = value + start_ns
        self._count("time", codes, spec.named, kept=False, expects=spec.expects)
        return time_ns

    def _cells(self, columns: tuple[str, ...]) -> list[str]:
        """The cells of a column; of several, with a blank between."""
        if len(columns) == 1:
            return self._table.column(columns[0])
        parts = zip(*(self._table.column(column) for column in columns), strict=True)
        return [" ".join(cell.strip() for cell in row) for row in parts]

    def _even_times(self, start_ns: int, rate_hz: float) -> IntArray:
        """One row after the other, those that were refused for their cells counted too."""
        since_first = self._table.rows_before() / rate_hz
        return start_ns + np.rint(since_first * 1e9).astype(np.int64)

    def field(self, descriptor: Descriptor) -> FloatArray:
        """The magnetometer vector of every row [nT]; rows without one, or with one beyond 1 mT, are refused."""
        spec = descriptor.magnetometer
        field_nt, codes = self._vectors(spec.columns, spec.unit_nt)
        self._count("magnetometer", _or_absurd(codes, _length(field_nt) > MAX_FIELD_NT), spec.columns, kept=False)
        return field_nt

    def further(self, spec: MagnetometerSpec) -> FloatArray:
        """The vector of a further magnetometer (n, 3) [nT], NaN in rows that have none or one beyond 1 mT."""
        field_nt, codes = self._vectors(spec.columns, spec.unit_nt)
        codes = _or_absurd(codes, _length(field_nt) > MAX_FIELD_NT)
        self._count(spec.source, codes, spec.columns, kept=True)
        field_nt[codes > 0] = np.nan
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

    def position(self, descriptor: Descriptor, time_ns: IntArray) -> Position | None:
        """Where the craft was at every row."""
        spec = descriptor.position
        if spec is None:
            return None
        if isinstance(spec, ElementsPosition):
            km, codes = self._by_elements(spec, descriptor.beside_it(spec.file), time_ns)
            frame = Frame.ECI
        elif isinstance(spec, CartesianPosition):
            km, codes = self._vectors(spec.columns, spec.unit_km)
            frame = spec.frame
        else:
            km, codes = self._geodetic(spec)
            frame = Frame.ECEF
        radius_km = _length(km)
        codes = _or_absurd(codes, (radius_km < _RADIUS_KM[0]) | (radius_km > _RADIUS_KM[1]))
        km[codes > 0] = np.nan
        self._count("position", codes, spec.columns, kept=True)
        return Position(km, frame)

    def _by_elements(self, spec: ElementsPosition, path: Path, time_ns: IntArray) -> tuple[FloatArray, Codes]:
        from magcal_service.earth.orbit_elements import read_element_sets

        sets = read_element_sets(path)
        ages_days = sets.ages_ns(time_ns) / _DAY_NS
        codes = np.where(ages_days > spec.max_age_days, CODE[RowFault.OLD_ELEMENTS], 0).astype(np.uint8)
        rows = np.flatnonzero(self.kept & (codes == 0))
        km = np.full((len(time_ns), 3), np.nan)
        km[rows] = sets.positions_km(time_ns[rows])
        codes[rows[np.isnan(km[rows, 0])]] = CODE[RowFault.ABSURD]
        if len(rows):
            ages = ages_days[rows]
            text = f"position: by {len(sets.satellites)} element sets, {np.median(ages):.2g} days from their epoch in"
            self.remarks.append(f"{text} the middle, {ages.max():.2g} at most")
        return km, codes

    def _geodetic(self, spec: GeodeticPosition) -> tuple[FloatArray, Codes]:
        from magcal_service.earth.geomagnetic import ecef_from_geocentric, ecef_from_geodetic

        degrees, codes = self._vectors(spec.columns, ANGLE_DEG[spec.unit])
        height_km = np.full(len(codes), spec.altitude_km or 0.0)
        if spec.height is not None:
            height, altitude_codes = self._vectors((spec.height.column,), spec.height.unit_km)
            height_km = height[:, 0]
            codes = np.where(codes > 0, codes, altitude_codes)
        latitude, longitude = degrees.T
        codes = _or_absurd(codes, (np.abs(latitude) > 90.0) | (np.abs(longitude) > 360.0))
        to_ecef = ecef_from_geodetic if spec.radius is None else ecef_from_geocentric
        return to_ecef(latitude, longitude, height_km), codes

    def reference(self, spec: ReferenceSpec, time_ns: IntArray, position: Position | None) -> Reference:
        """The reference field of every row."""
        vector_nt: FloatArray | None = None
        frame: Frame | None = None
        if isinstance(spec, VectorReference):
            vector_nt, codes = self._vectors(spec.columns, spec.unit_nt)
            frame = spec.frame
        elif isinstance(spec, ModelReference):
            vector_nt, codes = _igrf_eci(time_ns, position, self.kept)
            frame = Frame.ECI
        elif isinstance(spec, MagnitudeReference):
            values, codes = self._vectors((spec.column,), spec.unit_nt)
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
        self._count("reference", codes, columns_of_reference(spec), kept=True)
        return Reference(magnitude_nt, vector_nt, frame)

    def channel(self, spec: ChannelSpec) -> Channel:
        """One telemetry channel; a faulty cell is NaN and its neighbours stay."""
        parsed = [self._table.numbers(column) for column in spec.columns]
        codes = np.stack([code for _, code in parsed])
        values = np.stack([value for value, _ in parsed], axis=-1) * spec.factor
        absurd: npt.NDArray[np.bool_] = np.abs(values) > _MAX_CHANNEL
        values[absurd] = np.nan
        first = codes[np.argmax(codes > 0, axis=0), np.arange(codes.shape[1])]
        codes_of_rows = _or_absurd(first, np.any(absurd, axis=1))
        self._count(f"channels.{spec.name}", codes_of_rows, spec.columns, kept=True)
        return Channel(spec, values)


def columns_of_reference(spec: ReferenceSpec) -> tuple[str, ...]:
    """Columns that hold the reference; none where it is a model or a constant."""
    if isinstance(spec, VectorReference):
        return spec.columns
    return (spec.column,) if isinstance(spec, MagnitudeReference) else ()


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
    from magcal_service.earth import geomagnetic

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
    from magcal_service.earth import geomagnetic

    return geomagnetic.eci_from_ecef(time_ns, geomagnetic.igrf_ecef_nt(time_ns, position_ecef_km))
