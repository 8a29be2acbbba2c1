"""How far fitted numbers may be off, and the nine errors by what a recording's reference is off by besides.

A craft that looks down, or at the Sun, has one axis to the north all the time: what the field model leaves out there
acts as that axis' gain, so the residual does not show it, and no length of recording averages it out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from magcal_service.model import STATE_SIZE, Array

if TYPE_CHECKING:
    from magcal_service.diagnosis.problem import Fit, Problem

_ROUNDING: Final = 1e-14  # of the largest eigenvalue of scaled products: below it they are rounding
_WHOLE: Final = slice(None)
_FIRST: Final = slice(0, STATE_SIZE)


def scaled_inverse(fit: Fit) -> Array:
    """(p, p) inverse of a fit's scaled products; what nothing tells is as wide as its prior, not known exactly."""
    scale, products, _ = fit.normal_equations
    values, vectors = np.linalg.eigh(products + np.diag(_sigma2(fit) * fit.tie / scale**2))
    return np.asarray((vectors / np.maximum(values, _ROUNDING * values[-1])) @ vectors.T)


def robust_covariance(fit: Fit) -> Array:
    """(p, p) covariance of a fit's numbers, robust to a coloured residual.

    Block sums of the score stand for its variance (Liang & Zeger 1986); never smaller than for white noise.
    """
    scale, inverse = fit.normal_equations[0], fit.scaled_inverse
    white = _sigma2(fit) * inverse
    score = fit.white_columns / scale * fit.white_residual[:, None]
    count = max(30, len(score) // 400)
    sums = np.add.reduceat(score, np.arange(0, len(score), max(1, len(score) // count)))
    robust = inverse @ (sums.T @ sums) @ inverse
    grow = np.sqrt(np.maximum(np.diagonal(robust) / np.maximum(np.diagonal(white), 1e-300), 1.0))
    grow = np.where(grow > 1.5, grow, 1.0)  # block sums themselves scatter by 1 / sqrt(2 blocks)
    return np.asarray(white * np.outer(grow, grow) / np.outer(scale, scale))


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


def _sigma2(fit: Fit) -> float:
    return max(fit.white_rms_nt**2, 1e-12)
