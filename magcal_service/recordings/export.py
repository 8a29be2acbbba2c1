"""A session as a table for other programs: CSV with every digit, or Parquet with typed columns."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from magcal_service.base.errors import Fault, FileFault, InputRefusedError, RecordingError
from magcal_service.base.typed_toml import nearest
from magcal_service.recordings.mcap_reader import McapReader
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.session import decoded
from magcal_service.recordings.session_arrays import session_recording
from magcal_service.recordings.table_file import Columns, write_table
from magcal_service.wire.kinds import KINDS
from magcal_service.wire.messages import Message

SAMPLES: Final = "samples"
KIND_NAMES: Final = tuple(kind.name for kind in KINDS)
SUFFIXES: Final = (".csv", ".parquet")

_MOST_CELLS: Final = 1 << 25
"""Of one table, empty ones included: as many as of a log in rows, 60 bytes of memory each at most."""

_CELLS = {kind.record: tuple(field.name for field in kind.fields) for kind in KINDS}


def export(path: Path, out: Path, kind: str = SAMPLES, craft: str | None = None, source: str | None = None) -> int:
    """Write one table of a session; returns its rows.

    Parameters
    ----------
    out: ``.csv`` or ``.parquet``; appears at once when it is whole.
    kind: ``samples`` (one row a magnetometer sample, with reference, position and telemetry brought to its time), or
        a kind of message (one row each, as recorded).
    craft: whose; of a kind of message all craft where not given.
    source: of which magnetometer the samples are, its own where not given; of a kind of message, which source's.

    Raises ``RecordingError`` for the session, ``InputRefusedError`` for the rest, ``ExtraMissingError`` where Parquet
    is asked for without pyarrow.
    """
    if out.suffix.lower() not in SUFFIXES:
        raise InputRefusedError([Fault("--out", str(out), "a name ending in .csv or .parquet is accepted")])
    if kind == SAMPLES:
        columns = _sample_columns(session_recording(path, craft=craft, source=source))
    elif kind in KIND_NAMES:
        columns = _message_columns(path, kind, craft, source)
    else:
        raise InputRefusedError([Fault("--kind", kind, nearest(kind, (SAMPLES, *KIND_NAMES)))])
    write_table(out, columns)
    return len(next(iter(columns.values()), []))


def _sample_columns(recording: Recording) -> Columns:
    """The rows of a recording; NaN, in CSV an empty cell, where one has no value."""
    columns: Columns = {"time_ns": recording.time_ns.tolist(), "clock": [recording.clock.value] * len(recording)}
    columns |= _vector("field_body_nt", recording.field_body_nt.T.tolist())
    if recording.reference.vector_nt is not None and recording.reference.frame is not None:
        columns |= _vector(f"reference_{recording.reference.frame.value}_nt", recording.reference.vector_nt.T.tolist())
    columns["reference_magnitude_nt"] = recording.reference.magnitude_nt.tolist()
    if recording.position is not None:
        columns |= _vector(f"position_{recording.position.frame.value}_km", recording.position.km.T.tolist())
    for name, channel in recording.channels.items():
        label = f"channel_{name} [{channel.spec.unit}]" if channel.spec.unit else f"channel_{name}"
        columns |= _vector(label, channel.values.T.tolist())
    return columns


def _vector(name: str, parts: list[list[float]]) -> Columns:
    return {name if len(parts) == 1 else f"{name}.{index}": part for index, part in enumerate(parts)}


def _message_columns(path: Path, kind: str, craft: str | None, source: str | None) -> Columns:
    columns: Columns = {}
    rows, names = 0, set[str]()
    refused: dict[str, Counter[str]] = {}
    try:
        with path.open("rb") as file:
            for name, message in decoded(McapReader(file, str(path)), refused, frozenset({kind})):
                names.add(name)
                if craft not in (None, name) or source not in (None, message.source):
                    continue
                for key, cell in _cells(message):
                    column = columns.setdefault(key, [])
                    column += [None] * (rows - len(column))
                    column.append(cell)
                rows += 1
                _check_cells(path, len(columns), rows)
    except OSError as error:
        raise RecordingError([FileFault(str(path), error, "give a readable recording")]) from None
    if craft is not None and craft not in names:
        raise RecordingError([Fault(f"{path}: craft", craft, nearest(craft, names))])
    for column in columns.values():
        column += [None] * (rows - len(column))
    return columns


def _check_cells(path: Path, columns: int, rows: int) -> None:
    """Refuse a table that would take too much memory."""
    if columns * rows > _MOST_CELLS:
        accepted = f"at most {_MOST_CELLS} cells are accepted; take one --craft or --source, or record with a smaller "
        raise RecordingError([Fault(str(path), f"{rows} rows of {columns} columns", f"{accepted}file_mb")])


def _cells(message: Message) -> Iterator[tuple[str, Any]]:
    """Column and cell of every field; an array's elements and a map's entries have a column each, reasons one."""
    for name in _CELLS[type(message)]:
        value = getattr(message, name)
        if isinstance(value, Mapping):
            yield from ((f"{name}.{key}", entry) for key, entry in value.items())
        elif isinstance(value, tuple) and name == "reasons":
            yield name, " ".join(value)
        elif isinstance(value, tuple):
            yield from ((f"{name}.{index}", entry) for index, entry in enumerate(value))
        else:
            yield name, value
