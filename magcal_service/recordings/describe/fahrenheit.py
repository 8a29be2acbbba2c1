"""Degrees Fahrenheit that are called degC, or nothing, on a craft so cold that they could be: what shows them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.recordings.describe.columns import Column

FloatArray = npt.NDArray[np.float64]

_PER_DEGC: Final = 1.8  # degF in a degC, by definition
_FREEZING: Final = 32.0  # degF, by definition
_STEPS: Final = (1, 2, 4, 8, 16)  # in a degC: what digital thermometers give
_SHARPEST: Final = 0.1  # of a step: what the digits written may leave open for a step to be seen
_FITS: Final = 0.97  # of the values
_DISTINCT: Final = 8  # values: each fits by chance in one of five, all of them in one log of 400 000
_SWING_DEGC: Final = 1.0  # of the other channel, standard deviation: less is no swing to compare with
_SLOPE: Final = 0.1  # of 1.8: what two places of a craft may differ by and still be one temperature
_FROM_LINE_DEGF: Final = 5.0  # between the two, usually: they are at different places
_LOOSE: Final = 0.3  # of the swing: what may be left beside the line


def steps_of_degf(column: Column) -> str:
    """Why the numbers are a thermometer's steps of degC turned into degF; empty where they need not be."""
    values = np.unique(column.values[np.isfinite(column.values)])
    if len(values) < _DISTINCT:
        return ""
    half = 0.5 * 10.0 ** -max(len(cell.partition(".")[2]) for cell in column.cells)
    for steps in _STEPS:
        open_by = half / _PER_DEGC * steps
        if open_by > _SHARPEST:
            break
        if _on_steps((values - _FREEZING) / _PER_DEGC, steps, open_by) and not _on_steps(values, steps, half * steps):
            return f"its values are steps of 1/{steps} degC turned into degF" if steps > 1 else _WHOLE
    return ""


_WHOLE: Final = "its values are whole degC turned into degF"


def _on_steps(values: FloatArray, steps: int, open_by: float) -> bool:
    off = np.abs(values * steps - np.round(values * steps))
    return float(np.mean(off <= 1.01 * open_by)) >= _FITS  # 1.01: what a float loses


def swings_as_degf(column: Column, others: Iterable[tuple[Column, FloatArray]]) -> str:
    """Why a column is the degF of what another one gives in degC; empty where none does.

    Parameters
    ----------
    others: further temperatures, with their values (n,) in degC.

    Two places of a craft may swing 1.8 times as far as one another, but about a temperature that they share, and not
    about -40 degrees, where both scales meet.
    """
    for other, degc in others:
        good = np.isfinite(column.values) & np.isfinite(degc)
        if good.sum() < _DISTINCT or float(degc[good].std()) < _SWING_DEGC:
            continue
        slope, offset = np.polyfit(degc[good], column.values[good], 1)
        left = column.values[good] - slope * degc[good] - offset
        from_line = float(np.median(np.abs(column.values[good] - _PER_DEGC * degc[good] - _FREEZING)))
        swing = float(column.values[good].std())
        if abs(slope / _PER_DEGC - 1.0) < _SLOPE and from_line < _FROM_LINE_DEGF and float(left.std()) < _LOOSE * swing:
            return f"it is what {other.label} has in degC, in degF"
    return ""
