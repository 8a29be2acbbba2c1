"""Which record drives a term: those that a recording cannot tell apart, and whether it matters which."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.diagnosis.belief import MOST_NATS, OF_A_RECORD
from magcal_service.diagnosis.explain import CLASS_NATS, Explained
from magcal_service.diagnosis.problem import Fit, disturbances
from magcal_service.diagnosis.rivals import is_recorded
from magcal_service.diagnosis.screen import Candidate
from magcal_service.model import Array
from magcal_service.physics.drivers.readout import lost_by_hold
from magcal_service.physics.scene.scene import Scene

_ALONG: Final = 0.9
"""Correlation from which on two records rise and fall together, so that numbers by the one are those by the other."""


def drivers_of(explained: Explained, index: int) -> tuple[tuple[str, float], ...]:
    """Drivers of a term that this recording cannot tell apart, with their probabilities, most probable first.

    Of each driver of the term's own effect its best form; those within ``CLASS_NATS`` of the best.  Of records, one
    that is held from one readout to the next loses evidence by what it does not show in between, and each by its own
    noise and lag: it may be the cause, and another that goes along with it fits better.
    """
    ranked, lost = explained.drivers[index], _Lost.of(explained.fit, index)
    own, first = max(ranked[0].nats, 0.0), ranked[0].hypothesis

    def short(other: Candidate) -> float:
        """Nats that it lacks; of two records, beyond what either may be short of by itself."""
        if not is_recorded(first) or not is_recorded(other.hypothesis):
            return own - other.nats
        return (own - other.nats - lost.by(other.hypothesis.driver) * own) / (1.0 + OF_A_RECORD * own)

    weights = [math.exp(-float(np.clip(short(one), 0.0, MOST_NATS))) for one in ranked]
    total = sum(weights)
    alike = [(c.hypothesis.driver, w / total) for c, w in zip(ranked, weights, strict=True)]
    likely = [(driver, p) for driver, p in alike if p * total > math.exp(-CLASS_NATS)]
    return tuple(sorted(likely, key=lambda pair: -pair[1]))


def otherwise(explained: Explained, index: int) -> float:
    """Probability that another record drives a term, which does not rise and fall with its own.

    Numbers by that would be others, and hold elsewhere.  Two thermometers side by side may be either.
    """
    term = explained.fit.terms[index]
    scenes = [part.scene for part, _ in explained.fit.problem.acting(term)]
    values = _values(scenes, term.hypothesis.driver)
    if values is None:
        return 0.0
    others = ((p, _values(scenes, d)) for d, p in drivers_of(explained, index) if d != term.hypothesis.driver)
    return sum(p for p, other in others if other is not None and _correlation(values, other) < _ALONG)


def _values(scenes: Sequence[Scene], driver: str) -> Array | None:
    """The record (n,) of one column that is a driver in each of some recordings, one after another, less its mean in
    each; None of another one, or one that some of them lack."""
    kind, _, name = driver.partition(":")
    if kind != "channel" or any(s.channels[name].values.shape[1] != 1 if name in s.channels else True for s in scenes):
        return None
    records = [scene.channels[name].values[:, 0] for scene in scenes]
    return np.concatenate([one - one.mean() for one in records])


def _correlation(one: Array, other: Array) -> float:
    spread = float(np.std(one) * np.std(other))
    return float(np.mean(one * other)) / spread if spread > 0.0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Lost:
    """What records do not show of what flows, in each recording that a term acts in, with its share of the term."""

    each: Sequence[tuple[Scene, float]]

    @classmethod
    def of(cls, fit: Fit, index: int) -> _Lost:
        """A recording's share is that of the squares that the term adds to its vectors, in its noise."""
        acting = fit.problem.acting(fit.terms[index])
        added = [disturbances([term], part.scene) for part, term in acting]
        squares = [
            (float((body**2).sum()) + float((grown**2).sum())) / part.noise_nt**2
            for (part, _), (body, grown) in zip(acting, added, strict=True)
        ]
        whole = max(sum(squares), 1e-300)
        return cls([(part.scene, one / whole) for (part, _), one in zip(acting, squares, strict=True)])

    def by(self, driver: str) -> float:
        """Share of the evidence that a held record loses, over all of them."""
        kind, _, name = driver.partition(":")
        if kind != "channel":
            return 0.0
        return sum(share * lost_by_hold(s, s.channels[name]) for s, share in self.each if name in s.channels)
