"""Readings at the end of a sensor's or a number's range, axes that stand still, and a recorder that begins badly."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.recordings.inspect.finding import Code, Seen, Spoils, rows_text, rows_that
from magcal_service.recordings.inspect.log import Log, runs
from magcal_service.recordings.table import FloatArray
from magcal_service.residuals import MEDIAN_TO_SIGMA
from magcal_service.samples.ellipsoid import fitted
from magcal_service.samples.stops import Stop, stops

_AXES: Final = "xyz"
_WORD: Final = 65_536.0
"""Values of 16 bits."""

_SHORTEST_STUCK: Final = 60  # rows; as the daemon's watch over axes has it
_OFTEN_STILL: Final = 0.2
"""Share of all other steps in which an axis does not move, from which on it may stay for long where the sensor turns
about it: of steps of 520 nT in 60 nT of noise 43 % are none, and a table that turned about z was a stuck axis."""

_OTHERS_MOVE: Final = 30.0
"""Times its own usual step that an axis would have moved, going by the others."""

_BEYOND: Final = 1.1
"""Times a stated range that readings may go to; choice: a factor for each axis, set by the factory, is within that."""

_FEWEST_BEYOND: Final = 8  # readings; choice: fewer at a stop may differ by noise behind it
_OWN_VALUE: Final = 0.5  # of them, that have a value of their own; choice

_LONGEST_START: Final = 30  # rows; choice: half a minute at 1 Hz, settling and not physics
_SHARE_OF_START: Final = 0.02  # choice: of the log; longer is no start
_OUT: Final = 30.0
"""Robust sigmas that every row of a bad start lies off, and hardly a row after it."""


def wrapped(log: Log) -> Iterator[Seen]:
    """A component jumps by all 65536 values of 16 bits and back: the number was too small for the field."""
    values = log.field_as_written
    for axis in range(3):
        column = values[:, axis]
        for unit in {1.0, float(log.resolution[axis])}:
            at = _wrapped(column, _WORD * unit) if unit > 0.0 else None
            if at is None:
                continue
            says = (
                f"{_AXES[axis]} jumps by {_WORD * unit:g} {log.recording.descriptor.magnetometer.unit} and back: "
                f"{rows_that(len(at), 'have', len(log))} wrapped round 16 bits"
            )
            remedy = "they are left out; log the sensor's values in a wider number"
            yield Seen(Code.WRAPPED, True, log.rows[at], says, remedy, Spoils.ROW)
            break


def _wrapped(column: FloatArray, width: float) -> NDArray[np.intp] | None:
    """Rows on the smaller side of jumps by ``width``; None where the jumps are no wraps."""
    if not 0.8 * width < np.ptp(column) <= width or np.abs(column).max() > 0.5 * width:
        return None
    steps = np.diff(column)
    turns = np.where(np.abs(steps) > 0.5 * width, -np.sign(steps), 0.0)
    if np.count_nonzero(turns) < 2:
        return None
    turn = np.concatenate([[0.0], np.cumsum(turns)])
    smooth = np.abs(np.diff(column + width * turn))
    levels, counts = np.unique(turn, return_counts=True)
    if smooth.max() > 0.3 * width or len(levels) > 3:
        return None
    return np.flatnonzero(turn != levels[np.argmax(counts)])


def saturated(log: Log) -> Iterator[Seen]:
    """An axis stops at the end of its range: the rows at the stop, and those that noise has kept from it."""
    range_nt = log.recording.descriptor.magnetometer.range_nt
    found = stops(log.field_nt, log.magnitude_nt, range_nt)
    stated = [one for one in found if abs(one.at_nt) == range_nt]
    exceeded = next((one for one in stated if _goes_on(log, one)), None)
    if exceeded is not None:
        says = f"{_at(log, exceeded, 'reach')}, the end of the range that the descriptor states"
        says += f", and they go on beyond it, up to {exceeded.side * float(_outwards(log, exceeded).max()):g} nT"
        yield Seen(Code.SATURATED, False, log.rows[exceeded.rows], says, "check magnetometer.range_nt [nT]")
    for stop in found:
        if stop not in stated:
            yield _left_out(log, stop, f"{_at(log, stop, 'stop at')}: the end of the range")
        elif exceeded is None:
            yield _left_out(log, stop, f"{_at(log, stop, 'reach')}: the end of the range that the descriptor states")


def _goes_on(log: Log, stop: Stop) -> bool:
    """Whether readings go on beyond a stated end: most of them far, or most of them to a value of their own, where a
    sensor that stops gives one."""
    outwards = _outwards(log, stop)
    if float(np.median(outwards)) > _BEYOND * abs(stop.at_nt):
        return True
    return len(outwards) >= _FEWEST_BEYOND and len(np.unique(outwards)) > _OWN_VALUE * len(outwards)


def _outwards(log: Log, stop: Stop) -> FloatArray:
    """Readings at a stop, positive outwards [nT]."""
    return np.asarray(stop.side * log.field_nt[stop.rows, stop.axis])


def _left_out(log: Log, stop: Stop, says: str) -> Seen:
    near = int(np.count_nonzero(stop.near))
    says += f"; {near} more would be at it or within its noise" if near else ""
    remedy = "they are left out; choose a wider range of the sensor"
    return Seen(Code.SATURATED, True, log.rows[stop.spoiled], says, remedy, Spoils.SAMPLES)


def _at(log: Log, stop: Stop, verb: str) -> str:
    at = int(np.count_nonzero(stop.rows))
    return f"{rows_that(at, verb, len(log))} {stop.at_nt:g} nT on {_AXES[stop.axis]}"


def stuck_axis(log: Log) -> Iterator[Seen]:
    """One axis repeats its value while the others move as they do when it moves too."""
    steps = np.abs(np.diff(log.field_as_written, axis=0))
    usual = np.array([np.median(column[column > 0.0]) if column.any() else 0.0 for column in steps.T])
    for axis in range(3):
        still = steps[:, axis] == 0.0
        first, end = runs(still)
        long = end - first >= _SHORTEST_STUCK
        if not long.any() or len(log) < 2 * _SHORTEST_STUCK:
            continue
        at = [np.arange(a, b + 1) for a, b in zip(first[long], end[long], strict=True) if _others_move(log, axis, a, b)]
        if not at:
            continue
        rows = np.concatenate(at)
        whole = len(rows) == len(log)  # dead from the beginning, or coarse and along the axis of a spin
        elsewhere = still[~np.isin(np.arange(len(still)), rows)]
        is_coarse = usual[axis] <= 1.1 * log.resolution[axis] or elsewhere.sum() > _OFTEN_STILL * len(elsewhere)
        if is_coarse and not whole:
            continue
        value = log.field_nt[rows[0], axis]
        says = f"{_AXES[axis]} repeats one value over {rows_text(len(rows))} of {len(log)} while the others move"
        says += f", the first time {value:g} nT" if len(at) > 1 else f", {value:g} nT"
        remedy = "they cannot be used; power-cycle the sensor, and check magnetometer.columns"
        if whole:
            remedy = "the axis is dead, or coarse and along the axis of a spin: check sensor and magnetometer.columns"
        yield Seen(Code.STUCK_AXIS, not whole, log.rows[rows], says, remedy, Spoils.SAMPLES)


def _others_move(log: Log, axis: int, first: int, end: int) -> bool:
    """Whether another axis moves over the stretch by a good part of the whole field, far more than its resolution."""
    others = np.delete(log.field_as_written[first : end + 1], axis, axis=1)
    resolution = np.delete(log.resolution, axis)
    length = float(np.median(np.linalg.norm(log.field_as_written, axis=1)))
    moved = np.ptp(others, axis=0)
    return bool(np.any((moved > 0.3 * length) & (moved > _OTHERS_MOVE * resolution)))


def start_transient(log: Log) -> Iterator[Seen]:
    """The first rows lie far off what all others agree on: a sensor that had not settled, a filter that filled."""
    known = np.flatnonzero(np.isfinite(log.magnitude_nt))
    if len(known) < 200 or known[0] != 0:
        return
    field, magnitude = log.field_nt[known], log.magnitude_nt[known]
    begin = min(_LONGEST_START, len(field) // 4)  # the first rows take no part in the fit
    off = np.abs(fitted(field, magnitude, slice(begin, None)).residual(field, magnitude))
    sigma = MEDIAN_TO_SIGMA * float(np.median(off))
    most = min(_LONGEST_START, int(_SHARE_OF_START * len(known)))
    count = int(np.argmin(np.append(off[: most + 1] > _OUT * sigma, False)))
    if not 1 <= count <= most or np.count_nonzero(off[count:] > _OUT * sigma) > 0.001 * len(known):
        return
    worst = float(off[:count].max())
    says = f"the first {rows_that(count, 'lie')} up to {worst:.0f} nT off what the rest agree on to {sigma:.0f} nT"
    remedy = "they are left out; begin the log when the sensor has settled"
    yield Seen(Code.START_TRANSIENT, True, log.rows[known[:count]], says, remedy, Spoils.ROW)
