"""Calibrated vectors as a file: CSV, Parquet, or MCAP as the daemon records them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from magcal_service.base.disk import beside
from magcal_service.base.errors import Fault, InputRefusedError, unwritable
from magcal_service.base.progress import each
from magcal_service.base.version import __version__
from magcal_service.recordings.table_file import write_table
from magcal_service.recordings.timestamps import ns_to_iso8601, ns_to_seconds
from magcal_service.wire.messages import SCHEMA_VERSION, CalibratedVector, Clock

SUFFIXES: Final = (".csv", ".parquet", ".mcap")

_COVARIANCE: Final = ("xx", "xy", "xz", "yy", "yz", "zz")

COLUMNS: Final = (
    "time",
    *(f"w{axis}_nt" for axis in "xyz"),
    *(f"cov_{pair}_nt2" for pair in _COVARIANCE),
    "verdict",
    "protection_nt",
    "protection_by",
    "time_ns",
)
"""``time`` is ISO 8601 in UTC, or seconds where the recording counts from its own start."""


def refuse_suffix(out: Path) -> None:
    """Raise ``InputRefusedError`` for a name whose end is none of ``SUFFIXES``."""
    if out.suffix.lower() not in SUFFIXES:
        raise InputRefusedError([Fault("--out", str(out), f"a name ending in {', '.join(SUFFIXES)} is accepted")])


def write_vectors(out: Path, vectors: Sequence[CalibratedVector], about: dict[str, str]) -> None:
    """Write vectors; the file appears when it is whole.

    Parameters
    ----------
    out: by the end of its name the format, one of ``SUFFIXES``.
    vectors: in the order of their rows.
    about: what they are made of, for the metadata of MCAP.

    Raises ``InputRefusedError`` where the file cannot be written, ``ExtraMissingError`` for Parquet and
    MCAP without their packages.
    """
    refuse_suffix(out)
    if out.suffix.lower() != ".mcap":
        write_table(out, _columns(vectors))
        return
    from magcal_service.recordings.session_file import SessionFile  # of the extra `record`

    try:
        with beside(out) as part, part.open("wb") as file:
            header = {"session": about["recording"], "magcal": __version__, "wire_schema": str(SCHEMA_VERSION)}
            session = SessionFile(part, file, {**header, **about}, {})
            for vector in each(vectors, "writing", "rows"):
                session.add(max(0, vector.time_ns), vector)
            session.close()
    except OSError as error:
        raise unwritable(out, error) from None


def _columns(vectors: Sequence[CalibratedVector]) -> dict[str, list[Any]]:
    cells = [
        (
            (ns_to_iso8601 if one.clock is Clock.UTC else ns_to_seconds)(one.time_ns),
            *one.field_body_nt,
            *one.covariance_nt2,
            str(one.verdict),
            one.protection_nt,
            one.protection_by,
            one.time_ns,
        )
        for one in each(vectors, "writing", "rows")
    ]
    columns = [list(column) for column in zip(*cells, strict=True)] or [[] for _ in COLUMNS]
    return dict(zip(COLUMNS, columns, strict=True))
