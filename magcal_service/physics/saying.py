"""Parameters in sentences: a number with its 1 sigma in the unit that the field uses, its sign as a verb, and where.

A sentence of an effect has fields such as ``{per_k.falls}`` or ``{per_k.size}``: the name of a parameter and a property
of ``Said``.  Of several numbers, the largest of those that stand out of their sigma is said, and ``place`` says which
it is.
"""

from __future__ import annotations

import string
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.model import Array

AXES: Final = ("axis x", "axis y", "axis z")
"""What the numbers of a parameter are along, unless it says otherwise."""

_NATURAL: Final = {
    "1/K": (100.0, "%/K"),
    "1/s": (360000.0, "%/h"),
    "1/s2": (3600.0**2 * 100.0, "%/h2"),
    "nT/s": (3600.0, "nT/h"),
    "nT/s2": (3600.0**2, "nT/h2"),
    "1/nT2": (50_000.0**2 * 100.0, "% at 50 uT"),
    "1e-6": (1.0, "ppm"),
    "a": (1.0, "years"),
    "1": (1.0, ""),
}
"""Factor and unit in which a quantity is said; others are said in their own unit."""

_STANDS_OUT: Final = 3.0
"""Of its own sigma, what a number has to be to speak for the others."""

_SMALL_PERCENT: Final = 0.01
"""Percentages below are said in millionths."""


@dataclass(frozen=True, slots=True, eq=False)
class Said:
    """A parameter, as a sentence may have it.

    Parameters
    ----------
    value, sigma: of one shape; sigma NaN where none is claimed.
    unit: of both.
    labels: names along each dimension; those that are missing are axes, or numbers.
    bounds: what it was searched between; None where nothing bounds it.
    """

    value: Array
    sigma: Array
    unit: str
    labels: tuple[tuple[str, ...], ...] = ()
    bounds: tuple[float, float] | None = None

    def __str__(self) -> str:
        """All numbers, without sigma."""
        text = ", ".join(
            digits(float(v), float(s)) for v, s in zip(np.ravel(self.value), np.ravel(self.sigma), strict=True)
        )
        return text if self.value.ndim == 0 else f"({text})"

    @property
    def signed(self) -> str:
        """The largest number with its sign, 1 sigma and unit: ``"-12.4 ± 0.3 nT"``; ``"at most 0.5 s"`` where the
        search ended at the least of it."""
        if self.bounds is not None and self.value.ndim == 0 and 0.0 < float(self.value) <= self.bounds[0]:
            factor, unit = _natural(self.unit, float(self.value))
            return f"at most {float(self.value) * factor:.2g} {unit}".rstrip()
        at = self._largest
        return _measured(float(self.value[at]), float(self.sigma[at]), *_natural(self.unit, float(self.value[at])))

    @property
    def size(self) -> str:
        """The same without the sign."""
        return self.signed.removeprefix("-")

    def __format__(self, either: str) -> str:
        """The size and the first of two words, the second where it is negative: ``"52.5 ± 2.6 km behind"`` by
        ``"ahead|behind"``; all numbers where there are none."""
        if not either:
            return str(self)
        positive, negative = either.split("|")
        return f"{self.size} {negative if float(self.value[self._largest]) < 0.0 else positive}"

    @property
    def each(self) -> str:
        """All numbers of a list and the unit: ``"1204.5, 3410.5 and 5002.5 s"``."""
        factor, unit = _natural(self.unit, 1.0)
        pairs = zip(np.ravel(self.value).tolist(), np.ravel(self.sigma).tolist(), strict=True)
        *most, last = (digits(v * factor, s * factor) for v, s in pairs)
        return f"{' and '.join(filter(None, (', '.join(most), last)))} {unit}".rstrip()

    @property
    def placed(self) -> str:
        """All numbers of a list with their signs, each with its name: ``"+37000 nT on x and -37000 nT on z"``."""
        factor, unit = _natural(self.unit, 1.0)
        names = labels_of(self.value.shape, self.labels)[0]
        pairs = zip(self.value.tolist(), self.sigma.tolist(), names, strict=True)
        *most, last = (
            f"{'+' if v >= 0.0 else ''}{digits(v * factor, s * factor)} {unit} on {name}" for v, s, name in pairs
        )
        return " and ".join(filter(None, (", ".join(most), last)))

    @property
    def percent(self) -> str:
        """A share as a percentage, without the sign."""
        at = self._largest
        value, sigma = abs(float(self.value[at])), float(self.sigma[at])
        return _measured(value, sigma, 100.0, "%") if sigma > 0.0 else f"{100.0 * value:.3g} %"

    @property
    def falls(self) -> str:
        """``falls`` where the largest number is positive: D is what takes a gain off again."""
        return "falls" if float(self.value[self._largest]) > 0.0 else "rises"

    @property
    def place(self) -> str:
        """Which number it is: ``"axis z"``, ``"panel +x, axis y"``."""
        names = labels_of(self.value.shape, self.labels)
        return ", ".join(names[dim][index] for dim, index in enumerate(self._largest))

    @property
    def _largest(self) -> tuple[int, ...]:
        """Of the numbers that are three of their own sigma, if any are: what may be nothing is not said for all."""
        size = np.abs(self.value)
        sure = size >= _STANDS_OUT * self.sigma
        chosen = np.where(sure, size, -1.0) if np.any(sure) else size
        return tuple(int(i) for i in np.unravel_index(int(np.argmax(chosen)), self.value.shape))


def labels_of(shape: tuple[int, ...], given: tuple[tuple[str, ...], ...] = ()) -> tuple[tuple[str, ...], ...]:
    """Names along each dimension: as given where they fit, else axes of three, else numbers."""
    if tuple(map(len, given)) == shape:
        return given
    return tuple(AXES if size == len(AXES) else tuple(str(i + 1) for i in range(size)) for size in shape)


def _natural(unit: str, value: float) -> tuple[float, str]:
    factor, name = _NATURAL.get(unit, (1.0, unit))
    if name.startswith("%/") and 0.0 < abs(value) * factor < _SMALL_PERCENT:
        return 1e4 * factor, name.replace("%", "ppm")
    return factor, name


def _measured(value: float, sigma: float, factor: float, unit: str) -> str:
    return f"{measured(value * factor, sigma * factor)} {unit}".rstrip()


def measured(value: float, sigma: float) -> str:
    """A number with its 1 sigma: ``"12.4 ± 0.3"``; without one where none is claimed."""
    words = digits(value, sigma)
    return f"{words} ± {_as(words, sigma)}" if np.isfinite(sigma) and sigma > 0.0 else words


def _as(words: str, sigma: float) -> str:
    """Sigma with as many places as the number that it belongs to."""
    if "e" in words:
        return f"{sigma:.1e}"
    return f"{sigma:.{len(words.partition('.')[2])}f}"


def digits(number: float, sigma: float) -> str:
    """A number with as many digits as its sigma supports."""
    if not np.isfinite(sigma) or sigma <= 0.0:
        return f"{number:.5g}"
    places = int(np.clip(1 - np.floor(np.log10(sigma)), 0, 12))
    if max(abs(number), sigma) < 1e-3 or places > 6:
        significant = int(np.clip(np.floor(np.log10(max(abs(number), sigma) / sigma)) + 2, 2, 8))
        return f"{number:.{significant - 1}e}"
    return f"{number:.{places}f}"


def filled(texts: Sequence[str], said: Mapping[str, Said], words: Mapping[str, str]) -> str:
    """The first of some texts whose fields are all there, parameters or words, with them; empty where there is none."""
    for text in texts:
        fields = [field.partition(".")[0] for _, field, _, _ in string.Formatter().parse(text) if field]
        if all(field in words or field in said for field in fields):
            return text.format(**words, **said)
    return ""
