"""Field against reference: a scale between units, a reference that is held, columns that were shifted."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from magcal_service.recordings.inspect.finding import Code, Seen, Spoils, rows_text, rows_that
from magcal_service.recordings.inspect.log import Log
from magcal_service.recordings.specs import ConstantReference
from magcal_service.recordings.table import FloatArray

_TOO_LARGE: Final = 3.0  # the scatter of B about its mean is at most |H| (1 + D); a coil that sweeps gives 2.5
_TOO_SMALL: Final = 0.25  # |B| stays below that only if the bias cancels the field all the time
_EARTH_NT: Final = (15_000.0, 70_000.0)
"""The Earth's field from the ground to 1000 km."""

_FEWEST: Final = 50  # rows: fewer are refused anyway
_HELD: Final = 0.3  # of the rows: a receiver that misses a few values now and then is no holder
_STEPS: Final = 3.0
"""Times as far as from row to row elsewhere, that readings move where the reference jumps, from which on the field does
so too, as in a coil that is driven in steps; those of a craft that turns move there as anywhere."""

_STEADY: Final = 0.002  # of |H|: a reference that hardly changes may well repeat


def field_scale(log: Log) -> Iterator[Seen]:
    """The measured field varies by several times the reference, or is a small part of it: a unit was mistaken."""
    known = np.isfinite(log.magnitude_nt)
    if np.count_nonzero(known) < _FEWEST:
        return
    field, magnitude = log.field_nt[known], log.magnitude_nt[known]
    reference = float(np.sqrt(np.mean(magnitude**2)))
    spread = float(np.sqrt(np.mean(np.sum((field - field.mean(axis=0)) ** 2, axis=1))))
    largest = float(np.quantile(np.linalg.norm(field, axis=1), 0.99))
    if spread > _TOO_LARGE * reference:
        ratio, what = spread / reference, f"varies by {spread:.0f} nT"
    elif largest < _TOO_SMALL * reference:
        ratio, what = largest / reference, f"is at most {largest:.0f} nT"
    else:
        return
    power = 10.0 ** np.round(np.log10(ratio))
    wrong = "reference" if not _EARTH_NT[0] <= reference <= _EARTH_NT[1] else "magnetometer"
    says = f"the measured field {what}, the reference is {reference:.0f} nT: about {power:g} times"
    remedy = (
        f"check [{wrong}] unit (1 uT = 10 mG = 1000 nT): it is now "
        f"{getattr(getattr(log.recording.descriptor, wrong), 'unit', 'that of the model')}"
    )
    yield Seen(Code.FIELD_SCALE, False, log.rows, says, remedy)


def reference_repeats(log: Log) -> Iterator[Seen]:
    """The reference is held over several rows and then jumps by far more than its last digit."""
    spec = log.recording.descriptor.reference
    known = np.flatnonzero(np.isfinite(log.magnitude_nt))
    if isinstance(spec, ConstantReference) or len(known) < _FEWEST:
        return
    values = log.magnitude_nt[known]
    if np.ptp(values) < _STEADY * float(np.mean(values)):
        return
    steps = np.abs(np.diff(values))
    moving = steps[steps > 0.0]
    repeats = np.flatnonzero((steps == 0.0) & (np.diff(log.time_ns[known]) != 0))
    if len(repeats) < _HELD * len(known) or len(moving) < 3:
        return
    moved = np.linalg.norm(np.diff(log.field_nt[known], axis=0), axis=1)
    if float(np.median(moved[steps > 0.0])) > _STEPS * float(np.median(moved[repeats])):
        return
    levels = np.diff(np.unique(np.round(values, 6)))
    if float(np.median(moving)) < 3.0 * float(np.quantile(levels, 0.1)) or _is_rounded(moving):
        return
    each = len(known) / (len(known) - len(repeats))
    says = (
        f"{rows_that(len(repeats), 'repeat', len(log))} the reference before them: it is renewed every {each:.1f} "
        f"rows and jumps by {float(np.median(moving)):.3g} nT then"
    )
    remedy = "only renewed values are used, and interpolated between; log the reference, or its place, at every row"
    yield Seen(Code.REFERENCE_REPEATS, True, log.rows[known[repeats + 1]], says, remedy, Spoils.REFERENCE)


def _is_rounded(moving: FloatArray) -> bool:
    """Whether most steps are one and the same: the last digit of a rounded reference."""
    least = float(moving.min())
    return bool(np.median(moving) < 1.5 * least)


def shifted_columns(log: Log) -> Iterator[Seen]:
    """A column of the magnetometer is a clock, a counter, or the reference itself."""
    names = log.recording.descriptor.magnetometer.columns
    if len(log) < _FEWEST:
        return
    field, magnitude = log.field_nt, log.magnitude_nt
    for axis in range(3):
        column = field[:, axis]
        name = names[axis] if names else "xyz"[axis]
        other = _what_else(column, magnitude)
        if other:
            says = f"column {name} of the magnetometer {other} in {rows_text(len(log))}"
            remedy = "check magnetometer.columns against the log: the header may be shifted against its data"
            yield Seen(Code.SHIFTED_COLUMNS, False, log.rows, says, remedy)
            return


def _what_else(column: FloatArray, magnitude: FloatArray) -> str:
    steps = np.diff(column)
    if np.all(steps > 0.0) and np.ptp(steps) < 0.5 * float(np.median(steps)):
        return f"rises evenly, by {float(np.median(steps)):.3g} nT a row, as a clock or a counter does"
    known = np.isfinite(magnitude)
    if np.count_nonzero(known) < _FEWEST or np.ptp(magnitude[known]) < 0.02 * float(np.mean(magnitude[known])):
        return ""
    away = np.abs(column[known] - magnitude[known])
    return (
        "is the reference's magnitude to 2 %"
        if float(np.quantile(away, 0.95)) < 0.02 * float(np.mean(magnitude[known]))
        else ""
    )
