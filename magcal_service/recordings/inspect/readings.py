"""Readings that are none: zeros, values that stand for a failure, readings that a recorder repeats."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.recordings.inspect.finding import NO_ROWS, Code, Seen, Spoils, rows_text, rows_that, verb_of
from magcal_service.recordings.inspect.log import Log
from magcal_service.recordings.report import RowFault
from magcal_service.recordings.table import FloatArray

_NINES: Final = (999.0, 9999.0, 99999.0, 999999.0, 999.9, 9999.9, 99999.9, 999.99, 9999.99, 99999.99)
"""What programs and archives write for no value, by the width of the column."""

_WORDS: Final = tuple(float(2**bits - one) for bits in (15, 16, 23, 31) for one in (0, 1))
_KNOWN: Final = np.array([*_NINES, *_WORDS, 4096.0])
"""Magnitudes that drivers and archives write for "no value"; 4096 is a common magnetometer's overflow."""

_FEWEST_ALIKE: Final = 3
"""Repeats of an extreme value from which it stands for a failure; choice: two alike are met by chance."""

_ROUNDS: Final = 4
"""Kinds of sentinel that are looked for one after the other: two ends, and some known values."""

_NO_VALUE: Final = (RowFault.NOT_A_NUMBER, RowFault.INFINITE, RowFault.ABSURD, RowFault.UNPARSABLE)

_FEWEST_HELD: Final = 10
"""Repeats from which readings are held; choice: fewer are some odd rows, and change no result."""

_OFTENER_HELD: Final = 5.0
"""Times oftener than chance lets three axes of this resolution repeat their values together."""


def zero_rows(log: Log) -> Iterator[Seen]:
    """All three components are exactly 0."""
    at = np.flatnonzero(~log.field_nt.any(axis=1))
    if len(at):
        says = f"{rows_that(len(at), 'read', len(log))} (0, 0, 0): a failed read of the sensor"
        remedy = "they are left out; nothing has to be written, but look after the sensor's bus"
        yield Seen(Code.ZERO_ROWS, True, log.rows[at], says, remedy, Spoils.ROW)


def sentinels(log: Log) -> Iterator[Seen]:
    """One extreme value comes again and again, far from all others, or a value known to stand for a failure does."""
    yield from _unreadable(log)
    values = log.field_as_written
    left = np.ones(len(log), dtype=np.bool_)
    for _ in range(_ROUNDS):
        found = _sentinel(values, left)
        if found is None:
            return
        value, at = found
        left &= ~at
        unit = log.recording.descriptor.magnetometer.unit
        count = int(np.count_nonzero(at))
        says = f"{rows_that(count, 'hold', len(log))} {value:g} {unit}, far from every other value: it means no reading"
        remedy = "they are left out; write nothing, or an empty cell where the recorder writes this value"
        yield Seen(Code.SENTINEL, True, log.rows[at], says, remedy, Spoils.ROW)


def _unreadable(log: Log) -> Iterator[Seen]:
    """What the reader refused already, as no number or beyond what a magnetometer reads."""
    for entry in log.recording.report.entries:
        if entry.part == "magnetometer" and entry.fault in _NO_VALUE:
            what = "a field beyond 1 mT" if entry.fault is RowFault.ABSURD else f"no number ({entry.fault})"
            says = f"{rows_text(entry.count)}, the first on {entry.place} {entry.first_line}, "
            says += f"{verb_of(entry.count, 'hold')} {what}"
            remedy = "they are refused; if most are, check magnetometer.columns and magnetometer.unit"
            yield Seen(Code.SENTINEL, True, NO_ROWS, says, remedy, refused=entry)


def _sentinel(values: FloatArray, left: NDArray[np.bool_]) -> tuple[float, NDArray[np.bool_]] | None:
    """The value and a flag (m,) of the rows that hold it, of those ``left``."""
    same = left & np.all(values == values[:, :1], axis=1) & np.isin(np.abs(values[:, 0]), _KNOWN)
    if same.any():
        value = float(values[same][0, 0])
        return value, same & (values[:, 0] == value)
    if np.count_nonzero(left) < 2 * _FEWEST_ALIKE:
        return None
    for axis in range(3):
        column = values[:, axis]
        levels, counts = np.unique(column[left], return_counts=True)
        for value in _candidates(levels, counts):
            at = left & (column == value)
            if _jumps(column, left, at):
                return value, at
    return None


def _candidates(levels: FloatArray, counts: NDArray[np.intp]) -> Iterator[float]:
    """Repeated values at an end of the range with a wide gap before the next, and repeated known ones."""
    if len(levels) < _FEWEST_ALIKE:
        return
    for end, next_one, other in ((0, 1, -1), (-1, -2, 0)):
        rest = abs(float(levels[other] - levels[next_one]))
        if counts[end] >= _FEWEST_ALIKE and abs(float(levels[end] - levels[next_one])) > max(0.5 * rest, 1e-9):
            yield float(levels[end])
    for index in np.flatnonzero((counts >= _FEWEST_ALIKE) & np.isin(np.abs(levels), _KNOWN)):
        yield float(levels[index])


def _jumps(column: FloatArray, left: NDArray[np.bool_], at: NDArray[np.bool_]) -> bool:
    """Whether the value is reached by a jump, out of its neighbours' way, wherever it comes."""
    kept = np.flatnonzero(left)
    flags, steps = at[kept], np.abs(np.diff(column[kept]))
    into = flags[1:] != flags[:-1]
    inside = ~flags[1:] & ~flags[:-1]
    if not into.any() or not inside.any():
        return False
    usual = float(np.quantile(steps[inside], 0.9))
    return bool(np.quantile(steps[into], 0.1) > 3.0 * usual)


def held_readings(log: Log) -> Iterator[Seen]:
    """Each reading is repeated until the sensor has a new one: rows that are no new information.

    Repeats by chance are told from that by what follows: after a held reading all three axes move on together by more
    than their resolution, while a craft that stands still moves on by one step of one axis.
    """
    if len(log) < 2 * _FEWEST_HELD:
        return
    values = log.field_as_written
    steps = np.abs(np.diff(values, axis=0))
    repeated = ~steps.any(axis=1) & (np.diff(log.time_ns) != 0)
    moves = np.flatnonzero(steps.any(axis=1))
    repeats = np.flatnonzero(repeated)
    if len(repeats) < _FEWEST_HELD or not len(moves):
        return
    following = steps[moves[np.minimum(np.searchsorted(moves, repeats), len(moves) - 1)]]
    held = int(np.count_nonzero(np.all(following >= 1.9 * log.resolution, axis=1)))
    chance = np.prod((np.count_nonzero(steps[moves] == 0.0, axis=0) + 1.0) / (len(moves) + 1.0))
    if held < max(_FEWEST_HELD, 0.5 * len(repeats), _OFTENER_HELD * float(chance) * len(log)):
        return
    each = len(log) / (len(log) - len(repeats))
    says = (
        f"{rows_that(len(repeats), 'repeat', len(log))} the reading before them to the last digit: "
        f"the sensor renews it every {each:.1f} rows, every {each * log.step_s:.3g} s"
    )
    remedy = "the first of each reading is used and the repeats are left out; nothing has to be written"
    yield Seen(Code.HELD_READINGS, True, log.rows[repeats + 1], says, remedy, Spoils.ROW)
