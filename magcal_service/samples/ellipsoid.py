"""The nine errors as an ellipsoid, by linear least squares: what an inspection has before any estimator has run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.residuals import MEDIAN_TO_SIGMA

_MOST_FITTED: Final = 200_000
"""Rows at once; choice: 16 MB of columns, and ten numbers are as sure by these as by ten times as many."""

SPIKE: Final = 6.0
"""Robust sigmas beyond which a row takes no part in the fits after the first; choice: noise does once in 10^9."""

_FITS: Final = 3  # choice: the first finds the spikes, the second is free of them, the third agrees


@dataclass(frozen=True, slots=True, eq=False)
class Ellipsoid:
    """|B_cal|^2 as a quadric of B, in units of ``scale_nt``.

    Parameters
    ----------
    solution: (10,) of x^2, y^2, z^2, xy, xz, yz, x, y, z and 1.
    scale_nt: unit of length [nT].
    sigma_nt: spread of the residual over the rows that it was fitted to, by its median [nT].
    """

    solution: Array
    scale_nt: float
    sigma_nt: float = 0.0

    def residual(self, field_nt: Array, magnitude_nt: Array) -> Array:
        """|B_cal| - |H| (n,) [nT], to first order, of B (n, 3) and |H| (n,) [nT]."""
        blocks = range(0, len(field_nt), _MOST_FITTED)
        parts = [_quadric(field_nt[at : at + _MOST_FITTED] / self.scale_nt) @ self.solution for at in blocks]
        magnitude = magnitude_nt / self.scale_nt
        return np.asarray((np.concatenate(parts) - magnitude**2) / (2.0 * magnitude) * self.scale_nt)

    def gradient(self, field_nt: Array, magnitude_nt: Array) -> Array:
        """(n, 3) derivative of the residual by B [-]."""
        xx, yy, zz, xy, xz, yz, x, y, z, _ = self.solution
        turned = (field_nt / self.scale_nt) @ np.array([[2 * xx, xy, xz], [xy, 2 * yy, yz], [xz, yz, 2 * zz]])
        return np.asarray((turned + np.array([x, y, z])) / (2.0 * magnitude_nt / self.scale_nt)[:, None])


def fitted(field_nt: Array, magnitude_nt: Array, rows: NDArray[np.bool_] | slice = slice(None)) -> Ellipsoid:
    """The ellipsoid that fits best to some rows of B (n, 3) and |H| (n,) [nT], without the spikes among them."""
    field_nt, magnitude_nt = field_nt[rows], magnitude_nt[rows]
    stride = -(-len(field_nt) // _MOST_FITTED)
    field_nt, magnitude_nt = field_nt[::stride], magnitude_nt[::stride]
    scale = float(np.mean(magnitude_nt))
    columns, squares = _quadric(field_nt / scale), (magnitude_nt / scale) ** 2
    kept = np.ones(len(squares), dtype=bool)
    for _ in range(_FITS):
        found = Ellipsoid(np.linalg.lstsq(columns[kept], squares[kept], rcond=None)[0], scale)
        off = np.abs((columns @ found.solution - squares) / (2.0 * np.sqrt(squares)) * scale)
        sigma = MEDIAN_TO_SIGMA * float(np.median(off))
        if np.array_equal(kept, kept := off <= SPIKE * sigma):
            break
    return Ellipsoid(found.solution, scale, sigma)


def _quadric(field: Array) -> Array:
    """(n, 10) what an ellipsoid is linear in, of vectors (n, 3)."""
    x, y, z = field.T
    return np.stack([x * x, y * y, z * z, x * y, x * z, y * z, x, y, z, np.ones(len(x))], axis=1)
