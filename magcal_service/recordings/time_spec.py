"""``[time]`` of a descriptor: a column of times in one of several forms, or rows that come evenly."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from magcal_service.recordings.timestamps import iso8601_to_ns
from magcal_service.typed_toml.keys import number, special
from magcal_service.typed_toml.record import Reading
from magcal_service.wire.messages import Clock


class TimeFormat(StrEnum):
    """How a time cell is written."""

    ISO8601 = "iso8601"
    UNIX_S = "unix_s"
    UNIX_MS = "unix_ms"
    UNIX_US = "unix_us"
    UNIX_NS = "unix_ns"
    ELAPSED_S = "elapsed_s"
    ELAPSED_MS = "elapsed_ms"
    ELAPSED_US = "elapsed_us"
    ELAPSED_NS = "elapsed_ns"

    @property
    def kind(self) -> str:
        """``iso8601``, ``unix`` or ``elapsed``."""
        return self.value.split("_")[0]

    @property
    def decimals(self) -> int:
        """Decimal places from the cell's unit down to nanoseconds."""
        return _DECIMALS[self.value.rpartition("_")[2]]


_DECIMALS: Final = {"s": 9, "ms": 6, "us": 3, "ns": 0, "iso8601": 9}


def _by_rate(reading: Reading) -> bool:
    return reading.table.has("rate_hz")


def _column(reading: Reading, name: str) -> str:
    """Required, but where rows come evenly."""
    if not _by_rate(reading):
        return reading.table.text(name, accepted="the name of the time column")
    if reading.table.has(name):
        reading.table.refuse(name, reading.table.content[name], "it goes without rate_hz only; remove one of the two")
    return ""


def _format(reading: Reading, name: str) -> TimeFormat:
    if not _by_rate(reading):
        return reading.table.choice(name, TimeFormat)
    if reading.table.has(name):
        reading.table.refuse(name, reading.table.content[name], "it goes without rate_hz only; remove one of the two")
    return TimeFormat.ELAPSED_S


def _start(reading: Reading, name: str) -> int | None:
    """A string or TOML's own date-time, which is UTC where it names no zone."""
    if not reading.table.has(name):
        return None
    value = reading.table.content[name]
    written = value.isoformat() if isinstance(value, datetime.datetime) else value
    start_ns = iso8601_to_ns(written) if isinstance(written, str) else None
    if start_ns is None:
        accepted = 'an ISO 8601 instant such as "2025-06-01T00:00:00Z" is accepted'
        reading.table.refuse(name, str(value), accepted)
    return start_ns


def _check_start(reading: Reading, name: str, start_ns: int | None) -> None:
    if start_ns is not None and reading.values["format"].kind != "elapsed":
        accepted = 'it goes with format = "elapsed_s" (ms, us, ns) or rate_hz only; remove it'
        reading.table.refuse(name, reading.table.content[name], accepted)


@dataclass(frozen=True, slots=True)
class TimeSpec:
    """Column and format of the time, or the rate at which rows come.

    Parameters
    ----------
    column: its name; empty where rows come evenly.
    start_ns: UTC instant [ns] of elapsed 0 (of the first row, where rows come evenly), where known.
    rate_hz: rows a second where they come evenly and no time was logged.
    """

    column: str = special(_column)
    format: TimeFormat = special(_format)
    start_ns: int | None = special(_start, None, name="start", check=_check_start)
    rate_hz: float | None = number(None, 1e-4, 1e5, unit="Hz")

    @property
    def clock(self) -> Clock:
        """UTC unless only the elapsed time is known."""
        return Clock.ELAPSED if self.format.kind == "elapsed" and self.start_ns is None else Clock.UTC
