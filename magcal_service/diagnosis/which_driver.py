"""Which record drives a term: those that a recording cannot tell apart, and whether it matters which."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from magcal_service.diagnosis.belief import MOST_NATS, OF_A_RECORD
from magcal_service.diagnosis.explain import CLASS_NATS, Explained
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
    ranked, scene = explained.drivers[index], explained.fit.problem.scene
    own, first = max(ranked[0].nats, 0.0), ranked[0].hypothesis

    def short(other: Candidate) -> float:
        """Nats that it lacks; of two records, beyond what either may be short of by itself."""
        if not is_recorded(first) or not is_recorded(other.hypothesis):
            return own - other.nats
        return (own - other.nats - _lost(scene, other.hypothesis.driver) * own) / (1.0 + OF_A_RECORD * own)

    weights = [math.exp(-float(np.clip(short(one), 0.0, MOST_NATS))) for one in ranked]
    total = sum(weights)
    alike = [(c.hypothesis.driver, w / total) for c, w in zip(ranked, weights, strict=True)]
    likely = [(driver, p) for driver, p in alike if p * total > math.exp(-CLASS_NATS)]
    return tuple(sorted(likely, key=lambda pair: -pair[1]))


def otherwise(explained: Explained, index: int) -> float:
    """Probability that another record drives a term, which does not rise and fall with its own.

    Numbers by that would be others, and hold elsewhere.  Two thermometers side by side may be either.
    """
    mine = explained.fit.terms[index].hypothesis.driver
    scene = explained.fit.problem.scene
    values = _values(scene, mine)
    if values is None:
        return 0.0
    others = ((p, _values(scene, driver)) for driver, p in drivers_of(explained, index) if driver != mine)
    return sum(p for p, other in others if other is not None and _correlation(values, other) < _ALONG)


def _values(scene: Scene, driver: str) -> Array | None:
    """The record (n,) of one column that is a driver; None of another one."""
    kind, _, name = driver.partition(":")
    if kind != "channel" or name not in scene.channels or scene.channels[name].values.shape[1] != 1:
        return None
    found: Array = scene.channels[name].values[:, 0]
    return found


def _correlation(one: Array, other: Array) -> float:
    spread = float(np.std(one) * np.std(other))
    return float(np.mean((one - one.mean()) * (other - other.mean()))) / spread if spread > 0.0 else 0.0


def _lost(scene: Scene, driver: str) -> float:
    kind, _, name = driver.partition(":")
    return lost_by_hold(scene, scene.channels[name]) if kind == "channel" and name in scene.channels else 0.0
