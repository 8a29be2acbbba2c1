"""Spherical harmonics of the Earth's main field: the coefficients of IGRF-14, and the field they give.

``igrf14.csv`` holds them as IAGA publishes them: degree n, order m (below 0: of sin), one column an epoch, Schmidt
semi-normalised [nT].  Numpy alone, so that a daemon needs nothing else for a field of its own.

Source: IAGA 2024, IGRF-14 (doi:10.5281/zenodo.14012302); recursions: Winch et al. 2005, Geophys. J. Int. 160, 487-504.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cache
from importlib import resources
from typing import Final

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
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


def field(years: tuple[int, ...], basis: Floats, max_degree: int) -> Floats:
    """Field of the coefficients of some epochs.

    Parameters
    ----------
    years: epochs of the table.
    basis: of n places, to ``max_degree`` at least.
    max_degree: terms above this degree are left out, 1 to 13.

    Returns (3, epochs, n) [nT]: radially outwards, south, east.
    """
    known, _, table = coefficients()
    count = max_degree * (max_degree + 2)
    chosen = table[np.ix_(range(count), [known.index(year) for year in years])].T
    return np.stack([chosen @ part[:count] for part in basis])


def basis_at(radius_km: Floats, theta: Floats, phi: Floats, max_degree: int) -> Floats:
    """What one unit of each coefficient up to a degree gives (3, k, n), in the order of the table.

    Parameters
    ----------
    radius_km, theta, phi: geocentric radius, colatitude and longitude (n,) [km], [rad]; no colatitude on the axis.
    """
    if len(theta) > 1:
        return _basis_of_many(radius_km, theta, phi, max_degree)
    # Python's own numbers: a position alone takes a fifth of the time
    found: list[tuple[float, float, float]] = []
    turn = [(math.cos(m * phi[0]), math.sin(m * phi[0])) for m in range(max_degree + 1)]
    _fill(found, RADIUS_KM / float(radius_km[0]), math.cos(theta[0]), math.sin(theta[0]), turn, max_degree)
    return np.array(found).T[:, :, None]


def _basis_of_many(radius_km: Floats, theta: Floats, phi: Floats, max_degree: int) -> Floats:
    """As ``_fill``, all orders of a degree at once."""
    count, ratio, sine = len(theta), RADIUS_KM / radius_km, np.sin(theta)
    orders = np.arange(max_degree + 1)[:, None]
    of_cos, of_sin = np.cos(orders * phi), np.sin(orders * phi)
    found = np.empty((3, max_degree * (max_degree + 2), count))
    power, row = ratio * ratio, 0
    for n, (p, slope) in enumerate(_legendre_of_many(np.cos(theta), sine, max_degree), start=1):
        power = power * ratio
        up, south, east = (n + 1) * power * p, -power * slope, orders[: n + 1] * power * p / sine
        c, s, end = of_cos[: n + 1], of_sin[: n + 1], row + 2 * n + 1
        for axis, (part, with_cos, with_sin) in enumerate([(up, c, s), (south, c, s), (east, s, -c)]):
            np.multiply(part[0], with_cos[0], out=found[axis, row])
            np.multiply(part[1:], with_cos[1:], out=found[axis, row + 1 : end : 2])
            np.multiply(part[1:], with_sin[1:], out=found[axis, row + 2 : end : 2])
        row = end
    return found


def _legendre_of_many(cosine: Floats, sine: Floats, max_degree: int) -> Iterator[tuple[Floats, Floats]]:
    """As ``_legendre``: functions and slopes (n + 1, count) of one degree after the other, from the first."""
    older = older_slope = np.zeros((1, len(cosine)))
    last, last_slope = np.ones((1, len(cosine))), np.zeros((1, len(cosine)))
    for n in range(1, max_degree + 1):
        by, above, before = (np.array(one)[:, None] for one in zip(*(_factors(n, m) for m in range(n)), strict=True))
        p, slope = np.empty((2, n + 1, len(cosine)))
        p[:n] = by * (above * cosine * last - before * older)
        slope[:n] = by * (above * (cosine * last_slope - sine * last) - before * older_slope)
        own = 1.0 if n == 1 else math.sqrt(1.0 - 0.5 / n)
        p[n] = own * sine * last[-1]
        slope[n] = own * (sine * last_slope[-1] + cosine * last[-1])
        yield p, slope
        none = np.zeros((1, len(cosine)))  # a function of an order above its degree
        older, older_slope, last, last_slope = np.vstack([last, none]), np.vstack([last_slope, none]), p, slope


def _fill(
    found: list[tuple[float, float, float]],
    ratio: float,
    cosine: float,
    sine: float,
    turn: Sequence[tuple[float, float]],
    max_degree: int,
) -> None:
    """Append the parts up, south and east of each coefficient's unit, at one position."""
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
    cosine: float, sine: float, max_degree: int
) -> tuple[dict[tuple[int, int], float], dict[tuple[int, int], float]]:
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
