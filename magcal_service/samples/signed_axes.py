"""The 48 ways in which axes can be swapped and flipped: signed permutations, and how each is said."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import permutations, product
from typing import Final

import numpy as np

from magcal_service.model import Array

_NAMES: Final = "xyz"


def _matrices() -> Array:
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[np.arange(3), order] = signs
            found.append(matrix)
    return np.array(found)


SIGNED_AXES: Final = _matrices()
"""Each P (48, 3, 3): where the sensor should read B, it reads P B; the first is the identity."""

PROPER: Final = np.linalg.det(SIGNED_AXES)
"""Determinant of each (48,): 1 for a turn, -1 where the sense of turning changes."""

SAME: Final = 0
"""Number of the identity."""


def product_of(first: int, then: int) -> int:
    """Number of the change that ``then`` makes after ``first``."""
    matrix = SIGNED_AXES[then] @ SIGNED_AXES[first]
    return int(np.argmin(np.abs(SIGNED_AXES - matrix).sum(axis=(1, 2))))


def described(number: int) -> str:
    """A change in words: ``x and y were swapped``, ``z was flipped``, ``x reads -y, y reads z, z reads x``."""
    matrix = SIGNED_AXES[number]
    order, signs = np.abs(matrix).argmax(axis=1).tolist(), matrix.sum(axis=1).tolist()
    flipped = [_NAMES[axis] for axis in range(3) if signs[axis] < 0.0]
    moved = [axis for axis in range(3) if order[axis] != axis]
    if not moved:
        verb = "was" if len(flipped) == 1 else "were"
        return f"{' and '.join(flipped)} {verb} flipped" if len(flipped) < 3 else "all three axes were flipped"
    if len(moved) == 2 and not flipped:
        return f"{_NAMES[moved[0]]} and {_NAMES[moved[1]]} were swapped"
    reads = (f"{_NAMES[axis]} reads {'-' if signs[axis] < 0.0 else ''}{_NAMES[order[axis]]}" for axis in range(3))
    return ", ".join(reads)


def any_of(numbers: Iterable[int]) -> str:
    """Up to three changes in words; where there are more, that it is not known which."""
    names = [described(number) for number in numbers]
    return " or ".join(names) if len(names) <= 3 else "some axes were swapped or flipped"
