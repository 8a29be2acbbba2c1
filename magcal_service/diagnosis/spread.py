"""How far fitted numbers may be off, from the columns and the residual of their fit."""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.model import Array

_ROUNDING: Final = 1e-14  # of the largest eigenvalue of scaled products: below it they are rounding


def scaled_inverse(products: Array, tie: Array) -> Array:
    """(p, p) inverse of the products of scaled columns (p, p) with their priors' weights (p,); what nothing tells is as
    wide as its prior, not known exactly."""
    values, vectors = np.linalg.eigh(products + np.diag(tie))
    return np.asarray((vectors / np.maximum(values, _ROUNDING * values[-1])) @ vectors.T)


def robust_covariance(inverse: Array, columns: Array, residual: Array, sigma2: float) -> Array:
    """(p, p) covariance of numbers, in units of their scaled columns, robust to a coloured residual.

    Block sums of the score stand for its variance (Liang & Zeger 1986); never smaller than for white noise.

    Parameters
    ----------
    inverse: (p, p) of ``scaled_inverse``.
    columns, residual: (m, p), scaled, and (m,), both white.
    sigma2: variance of the white noise [nT^2].
    """
    white = sigma2 * inverse
    score = columns * residual[:, None]
    count = max(30, len(score) // 400)
    sums = np.add.reduceat(score, np.arange(0, len(score), max(1, len(score) // count)))
    robust = inverse @ (sums.T @ sums) @ inverse
    grow = np.sqrt(np.maximum(np.diagonal(robust) / np.maximum(np.diagonal(white), 1e-300), 1.0))
    grow = np.where(grow > 1.5, grow, 1.0)  # block sums themselves scatter by 1 / sqrt(2 blocks)
    return np.asarray(white * np.outer(grow, grow))
