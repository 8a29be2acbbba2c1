"""Spherical harmonics of the Earth's main field: the coefficients of IGRF-14, and the field they give.

``igrf14.csv`` holds them as IAGA publishes them: degree n, order m (below 0: of sin), one column an epoch, Schmidt
semi-normalised [nT].  Numpy alone, so that a daemon needs nothing else for a field of its own.

Source: IAGA 2024, IGRF-14 (doi:10.5281/zenodo.14012302); recursions: Winch et al. 2005, Geophys. J. Int. 160, 487-504.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from importlib import resources
from typing import Any, Final

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Number = Any
"""A float, or an array of them: the recursions are the same."""

RADIUS_KM: Final = 6371.2
"""Reference radius of the harmonics."""

HIGHEST_DEGREE: Final = 13
"""Of the published coefficients."""


@cache
def coefficients() -> tuple[tuple[int, ...], tuple[tuple[int, int], ...], Floats]:
    """Epochs [years], degree and order of each row, and the coefficients (k, epochs) [nT]."""
    lines = (resources.files("magcal_service.earth") / "igrf14.csv").read_text(encoding="ascii").splitlines()
    years = tuple(int(one) for one in lines[0].split(",")[2:])
    cells = [line.split(",") for line in lines[1:]]
    orders = tuple((int(row[0]), int(row[1])) for row in cells)
    return years, orders, np.array([[float(one) for one in row[2:]] for row in cells])


def field(years: tuple[int, ...], radius_km: Floats, colatitude: Floats, longitude: Floats, max_degree: int) -> Floats:
    """Field of the coefficients of some epochs.

    Parameters
    ----------
    years: epochs of the table.
    radius_km, colatitude, longitude: geocentric (n,) [km], [rad]; no colatitude on the axis.
    max_degree: terms above this degree are left out, 1 to 13.

    Returns (3, epochs, n) [nT]: radially outwards, south, east.
    """
    known, orders, table = coefficients()
    kept = [row for row, (n, _) in enumerate(orders) if n <= max_degree]
    chosen = table[np.ix_(kept, [known.index(year) for year in years])].T
    return np.stack([chosen @ part for part in _basis(radius_km, colatitude, longitude, max_degree)])


def _basis(radius_km: Floats, theta: Floats, phi: Floats, max_degree: int) -> Floats:
    """What one unit of each coefficient gives (3, k, n), in the order of the table."""
    if len(theta) == 1:  # Python's own numbers: a position alone takes a fifth of the time
        found: list[tuple[Number, Number, Number]] = []
        turn = [(math.cos(m * phi[0]), math.sin(m * phi[0])) for m in range(max_degree + 1)]
        _fill(found, RADIUS_KM / float(radius_km[0]), math.cos(theta[0]), math.sin(theta[0]), turn, max_degree)
        return np.array(found).T[:, :, None]
    found = []
    turns = [(np.cos(m * phi), np.sin(m * phi)) for m in range(max_degree + 1)]
    _fill(found, RADIUS_KM / radius_km, np.cos(theta), np.sin(theta), turns, max_degree)
    return np.array([[row[axis] for row in found] for axis in range(3)])


def _fill(
    found: list[tuple[Number, Number, Number]],
    ratio: Number,
    cosine: Number,
    sine: Number,
    turn: Sequence[tuple[Number, Number]],
    max_degree: int,
) -> None:
    """Append the parts up, south and east of each coefficient's unit; all arguments are numbers, or arrays (n,)."""
    p, slope = _legendre(cosine, sine, max_degree)
    power = ratio * ratio
    for n in range(1, max_degree + 1):
        power = power * ratio
        for m in range(n + 1):
            up, south, east = (n + 1) * power * p[n, m], -power * slope[n, m], m * power * p[n, m] / sine
            of_cos, of_sin = turn[m]
            found.append((up * of_cos, south * of_cos, east * of_sin))
            if m:
                found.append((up * of_sin, south * of_sin, -east * of_cos))


def _legendre(
    cosine: Number, sine: Number, max_degree: int
) -> tuple[dict[tuple[int, int], Number], dict[tuple[int, int], Number]]:
    """Schmidt semi-normalised functions of the colatitude and their slopes, by degree and order."""
    zero = 0.0 * cosine
    p, slope = {(0, 0): zero + 1.0}, {(0, 0): zero}
    for n in range(1, max_degree + 1):
        for m in range(n):
            by, above, before = _factors(n, m)
            older, older_slope = p.get((n - 2, m), zero), slope.get((n - 2, m), zero)
            p[n, m] = by * (above * cosine * p[n - 1, m] - before * older)
            slope[n, m] = by * (above * (cosine * slope[n - 1, m] - sine * p[n - 1, m]) - before * older_slope)
        by = 1.0 if n == 1 else math.sqrt(1.0 - 0.5 / n)
        p[n, n] = by * sine * p[n - 1, n - 1]
        slope[n, n] = by * (sine * slope[n - 1, n - 1] + cosine * p[n - 1, n - 1])
    return p, slope


@cache
def _factors(n: int, m: int) -> tuple[float, float, float]:
    """Of the recursion in the degree."""
    return 1.0 / math.sqrt(n * n - m * m), 2.0 * n - 1.0, math.sqrt((n - 1) ** 2 - m**2)
