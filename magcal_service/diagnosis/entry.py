"""One effect as it is reported: in which words, how sure, with which numbers, and where."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from magcal_service.diagnosis.separation import Separation
from magcal_service.model import Array
from magcal_service.physics.interface import UNLISTED, Value, Values
from magcal_service.physics.saying import labels_of

_LEAST_PROBABILITY: Final = 1e-4
"""Probability below which a rival is not listed, but for the best: what has less changes no decision."""

_MOST_RIVALS: Final = 4
"""Rivals listed for an effect; choice: beyond the class itself they are for orientation."""


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """One effect as it is reported.

    Parameters
    ----------
    effect, says, driver, variant: what, in a sentence, by what, in which form.
    probability: of this effect against its rivals; of what has no name, that something is there.
    rivals: (effect, probability), most probable first.
    members: names that this recording cannot tell apart, the effect's own included.
    separated_by: the observation that would tell them apart, or what would confirm the effect.
    parameters: with sigma and unit.
    where: the contract's place: time_s, axis, frequency_hz, share_of_mismatch.
    nats: evidence over its absence.
    constants: what belongs to the form.
    seen_in_blocks: blocks of the recording that gain by it, of those that should; empty for what is no field.
    measure: what would tell its class apart, the best first.
    drivers: (driver, probability) of the channels that drive it as well as this recording can tell, most probable
        first; empty for what has no driver.
    unlisted: what is no effect and does as well, in words: a recorded channel's signal, a slow change;
        empty where nothing does.
    as_well: of ``members``, those that act exactly so: the field alone never tells them apart.
    extent: how much of what it has a part in, in words.
    record_next: what to record otherwise of its driver, as a request; empty where nothing.
    why_first: why it stands although a rival of its class is likelier; empty where none is.
    """

    effect: str
    says: str
    driver: str
    variant: str
    probability: float
    rivals: tuple[tuple[str, float], ...]
    members: tuple[str, ...]
    separated_by: str
    parameters: Values
    where: Mapping[str, Any]
    nats: float
    constants: Mapping[str, float]
    seen_in_blocks: tuple[int, ...] = ()
    measure: tuple[Separation, ...] = ()
    drivers: tuple[tuple[str, float], ...] = ()
    unlisted: str = ""
    as_well: tuple[str, ...] = ()
    extent: str = ""
    why_first: str = ""
    record_next: str = ""

    def as_json(self) -> dict[str, Any]:
        """The contract's object."""
        return {
            "effect": self.effect,
            "says": self.says,
            "probability": round(self.probability, 6),
            "rivals": [{"effect": name, "probability": round(p, 6)} for name, p in self.rivals],
            "class": list(self.members),
            "as_well": list(self.as_well),
            "why_first": self.why_first,
            "separated_by": self.separated_by,
            "record_next": self.record_next,
            "driver": self.driver,
            "drivers": [{"driver": name, "probability": round(p, 6)} for name, p in self.drivers],
            "unlisted": self.unlisted,
            "variant": self.variant,
            "parameters": {name: _parameter(value) for name, value in self.parameters.items()},
            "where": dict(self.where),
            "evidence_nats": round(self.nats, 2),
            "seen_in_blocks": list(self.seen_in_blocks),
            "measure": [
                {"do": one.do, "against": one.against, "nats": round(one.nats, 1), "sigma": round(one.sigma, 1)}
                for one in self.measure
            ],
        }


def _parameter(value: Value) -> dict[str, Any]:
    """A parameter as JSON."""
    return {
        "value": plain(value.value),
        "sigma": plain(value.sigma),
        "unit": value.unit,
        "labels": [list(names) for names in labels_of(value.value.shape, value.labels)],
        "range": None if value.bounds is None else list(value.bounds),
    }


def listed_rivals(rivals: Sequence[tuple[str, float]], members: Sequence[str]) -> tuple[tuple[str, float], ...]:
    """Of rivals by their probabilities, most probable first, those that are said: the class, the likeliest of the
    others, and the nearest in the catalogue, however unlikely that is."""
    nearest = next((name for name, _ in rivals if name != UNLISTED), "")
    likely = [name for name, p in rivals if p >= _LEAST_PROBABILITY or name == nearest]
    return tuple(pair for pair in rivals if pair[0] in {*likely[:_MOST_RIVALS], *members})


def plain(values: Array) -> Any:
    """Numbers as JSON takes them; NaN as null."""
    if values.ndim == 0:
        return float(values) if math.isfinite(float(values)) else None
    return [plain(np.asarray(part)) for part in values]
