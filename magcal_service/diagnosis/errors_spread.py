"""How far the nine errors may be off: by their fit, and by what a recording's reference is off by besides.

A craft that looks down, or at the Sun, has one axis to the north all the time: what the field model leaves out there
acts as that axis' gain, so the residual does not show it, and no length of recording averages it out.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.diagnosis.problem import Fit, Problem
from magcal_service.model import STATE_SIZE, Array

_WHOLE: Final = slice(None)
_FIRST: Final = slice(0, STATE_SIZE)


def errors_covariance(fit: Fit, part: Problem | None = None, rows: slice = _WHOLE, own: slice = _FIRST) -> Array:
    """(9, 9) covariance of nine errors.

    Parameters
    ----------
    fit: of one recording, or of several.
    part, rows, own: of several, one's problem, its rows of the residual, and where its errors are among the unknowns.
    """
    found = np.array(fit.covariance[own, own])
    error = (fit.problem if part is None else part).field_error
    beside = None if error is None else error.beside_noise
    if error is None or beside is None:
        return found
    scale = fit.normal_equations[0]
    weighed = fit.problem.white(fit.white_columns)[rows] / scale
    moved = fit.scaled_inverse[own] @ error.lines.gathered(weighed).T / scale[own, None]
    return np.asarray(found + moved @ beside @ moved.T)


def errors_sigma(fit: Fit) -> Array:
    """(9,) 1 sigma of the nine errors of one recording, in the order of ``STATE_NAMES``."""
    return np.asarray(np.sqrt(np.maximum(np.diagonal(errors_covariance(fit)), 0.0)))
