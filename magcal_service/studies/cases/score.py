"""A case's answer held against what is true of it, and what is counted of many."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, permutations
from statistics import fmean
from typing import Any, Final

import numpy as np

from magcal_service.studies.cases.ask import NO_ANSWER, UNKNOWN, Named, Said
from magcal_service.studies.cases.truth import Truth

PROBABILITIES: Final = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 0.999, 1.0)
"""Edges of the bins of claimed probabilities; a bin holds its lower edge, the last one 1 as well."""

_Z95: Final = 1.959964
"""Half the width of the middle 95 % of a normal distribution [sigma]."""


@dataclass(frozen=True, slots=True)
class Scored:
    """A case, by simulator and name, with what is true and what was said of it."""

    simulator: str
    case: str
    truth: Truth
    said: Said

    @property
    def _true(self) -> set[str]:
        return {effect.effect for effect in self.truth.effects}

    @property
    def false(self) -> tuple[str, ...]:
        """Names that are not true."""
        return tuple(name for name in self.said.names if name not in self.truth.names)

    @property
    def first(self) -> Named | None:
        """The first name that is not merely true besides."""
        true, entries = self._true, [entry for entry in self.said.named if entry.effect != UNKNOWN]
        return next((entry for entry in entries if entry.effect in true or entry.effect not in self.truth.also), None)

    @property
    def is_right(self) -> bool:
        """Clean: no false name.  Outside: ``unknown``.  Otherwise: a right name first, and all of them if several."""
        if self.said.verdict == UNKNOWN and self.truth.unknown_is_right:
            return True
        if self.said.verdict in NO_ANSWER or (self.said.verdict == UNKNOWN and not self.truth.unknown_is_fair):
            return False
        if self.truth.kind == "clean":
            return not self.false
        return self.first is not None and self.first.effect in self._true and self._true <= set(self.said.names)

    @property
    def is_in_class(self) -> bool:
        """Right, or the effect is in the class of the first name; of several, each in the class of another name."""
        if self.is_right or not self._true or self.said.verdict != "named" or self.first is None:
            return self.is_right
        if self.truth.kind == "effect":
            return not self._true.isdisjoint(self.first.members)
        classes = [set(entry.members) for entry in self.said.named]
        chosen = permutations(classes, len(self._true))
        each = (all(effect in one for effect, one in zip(self._true, some, strict=True)) for some in chosen)
        return self.truth.kind == "several" and any(each)

    def distances(self) -> dict[str, list[float]]:
        """|value - truth| / sigma of each component of parameters that both give, by effect and parameter."""
        found: dict[str, list[float]] = {}
        for effect in self.truth.effects:
            entry = next((one for one in self.said.named if one.effect == effect.effect), None)
            for name, expected in {} if entry is None else effect.parameters.items():
                z = _distance(entry.parameters.get(name), expected) if entry is not None else []
                if z:
                    found[f"{effect.effect}.{name}"] = z
        return found


def _distance(given: Mapping[str, Any] | None, expected: Any) -> list[float]:
    if given is None:
        return []
    value = np.array(given["value"], dtype=np.float64)
    sigma, truth = np.array(given["sigma"], dtype=np.float64), np.array(expected, dtype=np.float64)
    if value.shape != truth.shape or sigma.shape != truth.shape or not np.all(sigma > 0.0):
        return []
    return [float(z) for z in np.ravel(np.abs(value - truth) / sigma)]


@dataclass(frozen=True, slots=True)
class Bin:
    """Names whose claimed probability is from ``low`` on and below ``high``: how many, how many of them true.

    ``mean`` is the mean of what they claim; None where there are none.
    """

    low: float
    high: float
    names: int
    true: int
    mean: float | None

    @property
    def share(self) -> float | None:
        """The share that is true."""
        return share(self.true, self.names)

    @property
    def interval(self) -> tuple[float, float] | None:
        """Where the share lies with 95 %."""
        return wilson(self.true, self.names)


def reliability(scored: Sequence[Scored]) -> list[Bin]:
    """Every name in the bin of the probability that it claims; ``unknown`` claims nothing."""
    claims = claims_of(scored)
    bins = []
    for low, high in pairwise(PROBABILITIES):
        inside = [(p, true) for p, true in claims if low <= p < high or (high == PROBABILITIES[-1] and p >= high)]
        mean = fmean(p for p, _ in inside) if inside else None
        bins.append(Bin(low, high, len(inside), sum(true for _, true in inside), mean))
    return bins


def claims_of(scored: Sequence[Scored]) -> list[tuple[float, bool]]:
    """The probability that each name claims, and whether it is true."""
    return [
        (entry.probability, entry.effect in one.truth.names)
        for one in scored
        for entry in one.said.named
        if entry.effect != UNKNOWN
    ]


def wilson(count: int, of: int) -> tuple[float, float] | None:
    """The 95 % interval of a share by Wilson's score (1927), which holds the share itself; None of nothing."""
    if of == 0:
        return None
    p, z2 = count / of, _Z95**2
    middle = (p + z2 / (2.0 * of)) / (1.0 + z2 / of)
    half = _Z95 / (1.0 + z2 / of) * math.sqrt(p * (1.0 - p) / of + z2 / (4.0 * of**2))
    return min(p, max(0.0, middle - half)), max(p, min(1.0, middle + half))  # at 0 and 1 rounding leaves the share out


def share(count: int, of: int) -> float | None:
    """``count / of``; None of nothing."""
    return count / of if of else None


def all_distances(scored: Sequence[Scored]) -> dict[str, list[float]]:
    """Distances of every case in sigmas: ``all`` first, then by effect and parameter."""
    groups: dict[str, list[float]] = {"all": []}
    for one in scored:
        for name, z in one.distances().items():
            groups["all"] += z
            groups.setdefault(name, []).extend(z)
    return {"all": groups.pop("all"), **dict(sorted(groups.items()))}
