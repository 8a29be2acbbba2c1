"""Columns of equal length as a file: CSV with every digit, or Parquet with typed columns."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

from magcal_service.base.disk import beside
from magcal_service.base.errors import ExtraMissingError, unwritable

Columns = dict[str, list[Any]]


def write_table(out: Path, columns: Columns) -> None:
    """Write columns of equal length as ``.csv`` or ``.parquet``, by the name's end; the file appears when it is whole.

    Raises ``InputRefusedError`` where it cannot be written, ``ExtraMissingError`` for Parquet without pyarrow.
    """
    write = _write_csv if out.suffix.lower() == ".csv" else _write_parquet
    try:
        with beside(out) as part:
            write(part, columns)
    except OSError as error:
        raise unwritable(out, error) from None


def _write_csv(path: Path, columns: Columns) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(
            [["" if cell != cell else cell for cell in row] for row in zip(*columns.values(), strict=True)]
        )


def _write_parquet(path: Path, columns: Columns) -> None:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise ExtraMissingError("pyarrow", "export", "Parquet") from error
    try:
        table = pyarrow.table({name: pyarrow.array(cells) for name, cells in columns.items()})
    except pyarrow.ArrowInvalid:  # arguments of commands may be text in one row and a number in the next
        table = pyarrow.table({name: [None if c is None else str(c) for c in cells] for name, cells in columns.items()})
    parquet.write_table(table, path)
