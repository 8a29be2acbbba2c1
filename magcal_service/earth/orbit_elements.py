"""Two-line element sets of a craft, and where they say it was, by SGP4.

Positions are in TEME (true equator, mean equinox of date), which is the ECI of ``geomagnetic``.  Needs the extra
``sim`` (sgp4).  Source: Hoots and Roehrich 1980, Spacetrack Report 3; Vallado, Crawford, Hujsak, Kelso 2006, AIAA
2006-6753.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from magcal_service.base.errors import ExtraMissingError, Fault, FileFault, RecordingError

Floats = npt.NDArray[np.float64]
Times = npt.NDArray[np.int64]

LINE: Final = 69
"""Characters of an element line, the last of them its checksum (NORAD two-line element set format)."""

_NUMBER: Final = slice(2, 7)  # columns 3-7: the craft's catalogue number
_DAY_NS: Final = 86_400 * 10**9  # nanoseconds in a day
_UNIX_JD: Final = 2440587.5  # Julian date of 1970-01-01T00:00Z
_MOST_BYTES: Final = 1 << 26  # 64 MiB: element sets of one craft, some a day, for a thousand years
_SHOWN: Final = 80  # characters of a line in a fault


def checksum(line: str) -> str:
    """Checksum of an element line: the sum of its first 68 digits, a minus counting 1, modulo 10."""
    return str(sum(int(c) if c.isdigit() else c == "-" for c in line[: LINE - 1]) % 10)


def is_element_line(line: str, number: int) -> bool:
    """Whether a line is line ``number``, 1 or 2, of an element set, checksum right."""
    return line.startswith(f"{number} ") and len(line) == LINE and line.isascii() and checksum(line) == line[-1]


def satellite(line1: str, line2: str) -> Any:
    """An element set for SGP4 (``sgp4.api.Satrec``); raises ``ExtraMissingError`` without sgp4."""
    try:
        from sgp4.api import Satrec
    except ImportError:
        raise ExtraMissingError("sgp4", "sim", "an orbit from element sets") from None
    return Satrec.twoline2rv(line1, line2)


def propagate(satellite: Any, times_utc_ns: Times) -> tuple[npt.NDArray[np.int64], Floats, Floats]:
    """Error codes of SGP4 (n,), 0 where there is none, positions [km] and velocities [km/s] (n, 3), TEME."""
    days, rest_ns = np.divmod(np.asarray(times_utc_ns, dtype=np.int64), _DAY_NS)
    codes, position, velocity = satellite.sgp4_array(days + _UNIX_JD, rest_ns / _DAY_NS)
    return np.asarray(codes, dtype=np.int64), np.asarray(position), np.asarray(velocity)


@dataclass(frozen=True, slots=True)
class ElementSets:
    """All sets of a file: one craft's, by their epoch.

    Parameters
    ----------
    satellites: as SGP4 takes them, one for each epoch.
    epochs_ns: (k,) UTC [ns], rising.
    """

    satellites: tuple[Any, ...]
    epochs_ns: Times

    @property
    def number(self) -> int:
        """Catalogue number of the craft."""
        return int(self.satellites[0].satnum)

    def ages_ns(self, times_utc_ns: Times) -> Times:
        """How far each time (n,) is from the epoch of the nearest set [ns], before or after."""
        return np.asarray(np.abs(times_utc_ns - self.epochs_ns[self._nearest(times_utc_ns)]), dtype=np.int64)

    def positions_km(self, times_utc_ns: Times) -> Floats:
        """Where the craft was (n, 3) [km], TEME, by the set nearest to each time; NaN where SGP4 reports an error."""
        nearest = self._nearest(times_utc_ns)
        found = np.full((len(times_utc_ns), 3), np.nan)
        for number in np.unique(nearest):
            rows = np.flatnonzero(nearest == number)
            codes, position, _ = propagate(self.satellites[number], times_utc_ns[rows])
            position[codes != 0] = np.nan
            found[rows] = position
        return found

    def _nearest(self, times_utc_ns: Times) -> npt.NDArray[np.intp]:
        """The set whose epoch is nearest to each time; of two equally near, the earlier."""
        after = np.searchsorted(self.epochs_ns, times_utc_ns)
        before = np.maximum(after - 1, 0)
        after = np.minimum(after, len(self.epochs_ns) - 1)
        nearer = np.abs(self.epochs_ns[after] - times_utc_ns) < np.abs(times_utc_ns - self.epochs_ns[before])
        return np.where(nearer, after, before)


def read_element_sets(path: Path) -> ElementSets:
    """The element sets of a file, with or without a line of the craft's name above each.

    Raises
    ------
    RecordingError: the file cannot be read, holds no sets, a broken line, or sets of several craft.
    ExtraMissingError: sgp4 is not installed.
    """
    try:
        with path.open("rb") as file:
            text = file.read(_MOST_BYTES).decode("ascii", errors="replace")
    except OSError as exc:
        accepted = "a readable file of two-line element sets is accepted"
        raise RecordingError([FileFault(str(path), exc, accepted)]) from None
    pairs = list(_pairs(path, [line.rstrip() for line in text.splitlines()]))
    if not pairs:
        accepted = (
            "lines of 69 characters that begin '1 ' and '2 ' are accepted, as Space-Track and CelesTrak give them"
        )
        raise RecordingError([Fault(str(path), "no element set", accepted)])
    craft = sorted({line[_NUMBER].strip() for line, _ in pairs})
    if len(craft) > 1:
        accepted = f"the sets of one craft are accepted; here are those of {', '.join(craft[:5])}: keep one"
        raise RecordingError([Fault(str(path), f"{len(craft)} craft", accepted)])
    of_epoch = {_epoch_ns(one): one for one in (satellite(*pair) for pair in pairs)}
    epochs = sorted(of_epoch)
    return ElementSets(tuple(of_epoch[epoch] for epoch in epochs), np.array(epochs, dtype=np.int64))


def _pairs(path: Path, lines: list[str]) -> Iterable[tuple[str, str]]:
    """First and second line of each set; lines that are neither are the craft's name."""
    for number, line in enumerate(lines):
        if line.startswith("2 ") and len(line) == LINE and not (number and lines[number - 1].startswith("1 ")):
            accepted = "a second line comes after the first of its set"
            raise RecordingError([Fault(f"{path}: line {number + 1}", line[:_SHOWN], accepted)])
        if not line.startswith("1 ") or (len(line) != LINE and not _next(lines, number).startswith("2 ")):
            continue
        second = _next(lines, number)
        for at, one, which in ((number, line, 1), (number + 1, second, 2)):
            if not is_element_line(one, which):
                accepted = f"an element line of {LINE} characters that begins '{which} ', checksum right, is accepted"
                raise RecordingError([Fault(f"{path}: line {at + 1}", one[:_SHOWN], accepted)])
        if line[_NUMBER] != second[_NUMBER]:
            accepted = f"the second line of craft {line[_NUMBER].strip()} is accepted"
            raise RecordingError([Fault(f"{path}: line {number + 2}", second[:_SHOWN], accepted)])
        yield line, second


def _next(lines: list[str], number: int) -> str:
    return lines[number + 1] if number + 1 < len(lines) else ""


def _epoch_ns(one: Any) -> int:
    """Epoch of a set, UTC [ns]."""
    whole = round((one.jdsatepoch - _UNIX_JD) * 86_400) * 10**9
    return int(whole + round(one.jdsatepochF * _DAY_NS))
