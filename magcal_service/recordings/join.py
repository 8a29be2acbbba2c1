"""Rows of further files joined to those of a log by their times."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from magcal_service.base.errors import Fault, RecordingError
from magcal_service.base.typed_toml import nearest
from magcal_service.recordings.join_spec import JoinSpec
from magcal_service.recordings.report import RowCount, RowFault
from magcal_service.recordings.row_arrays import RowArrays
from magcal_service.recordings.row_limits import RowLimits
from magcal_service.recordings.specs import Descriptor
from magcal_service.recordings.table import POINT, IntArray, TextTable, read_table


def join_files(descriptor: Descriptor, table: TextTable) -> TextTable:
    """The log's rows with the columns of every joined file, called ``NAME.COLUMN``.

    Each row takes the newest joined row that is not later and within the tolerance; cells of the others are empty,
    and rows without one are counted.  Raises ``RecordingError`` where a joined file cannot be read.
    """
    if not descriptor.joins:
        return table
    _check_time(descriptor.path.name, "time", table, descriptor.time.named)
    log = RowArrays(table)
    time_ns = log.times(descriptor.time)
    for number, spec in enumerate(descriptor.joins):
        table = _join(descriptor, spec, f"samples.join[{number}]", table, time_ns, log)
    return table


def _join(
    descriptor: Descriptor, spec: JoinSpec, key: str, table: TextTable, time_ns: IntArray, log: RowArrays
) -> TextTable:
    path = descriptor.beside_it(spec.file)
    other = read_table(path, spec.form, RowLimits(descriptor.max_rows))
    time = spec.time or descriptor.time
    _check_time(descriptor.path.name, f"{key}.time", other, time.named)
    rows = RowArrays(other)
    other_ns = rows.times(time)
    taken = _newest(time_ns, other_ns, np.flatnonzero(rows.kept), round(spec.tolerance_s * 1e9))
    joined = dict(table.joined)
    for column in dict.fromkeys(other.header):
        if other.header.count(column) == 1:
            joined[f"{spec.name}.{column}"] = partial(_cells, other, column, taken, table)
    entries = [replace(entry, part=f"{spec.name}.{entry.part}") for entry in rows.entries]
    lonely = np.flatnonzero(log.kept & (taken < 0))
    if len(lonely):
        first = int(table.lines[lonely[0]])
        shows = f"no row of {path.name} within {spec.tolerance_s:g} s before it"
        entries.append(RowCount(spec.name, RowFault.UNMATCHED, len(lonely), first, True, shows=shows))
    header = (*table.header, *(f"{spec.name}.{column}" for column in other.header))
    return replace(table, header=header, joined=joined, entries=(*table.entries, *entries))


def _check_time(file: str, key: str, table: TextTable, columns: tuple[str, ...]) -> None:
    for column in columns:
        if table.header.count(column) != 1:
            accepted = f"a column that stands once in the header is accepted; {nearest(column, set(table.header))}"
            raise RecordingError([Fault(f"{file}: {key}.column", column, accepted)])


def _newest(time_ns: IntArray, other_ns: IntArray, usable: IntArray, tolerance_ns: int) -> IntArray:
    """For each time the number of the newest usable row of the others that is not later; -1 where none is in reach."""
    order = usable[np.argsort(other_ns[usable], kind="stable")]
    at = np.searchsorted(other_ns[order], time_ns, side="right") - 1
    taken = np.where(at >= 0, order[np.maximum(at, 0)], -1) if len(order) else np.full(len(time_ns), -1)
    if len(order):
        taken[time_ns - other_ns[taken] > tolerance_ns] = -1
    return np.asarray(taken, dtype=np.int64)


def _cells(other: TextTable, column: str, taken: IntArray, table: TextTable) -> list[str]:
    """A column of the other file for every row of the log, with numbers as the log writes them."""
    cells = [*other.column(column), ""]
    if other.decimal != table.decimal:
        cells = [cell.translate(POINT) for cell in cells]
    return [cells[at] for at in taken.tolist()]
