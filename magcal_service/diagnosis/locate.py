"""Where a mismatch sits: every family of shapes and every channel, ranked, corrected for the number of trials."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from magcal_service.diagnosis.explain import Search
from magcal_service.diagnosis.leftover import Structure, structures
from magcal_service.diagnosis.lines import body_spectrum, strongest
from magcal_service.diagnosis.problem import Fit
from magcal_service.physics.columns import along_axes, oscillation

_LINES: Final = 4
"""Strongest lines that are listed; choice: the spin, its double, an orbit's side line, and one that is none of them."""


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Something that a mismatch is correlated with.

    Parameters
    ----------
    kind: ``time``, ``frequency``, ``field``, ``phase``, ``light``, ``place`` or ``channel``.
    says: in words.
    share: of the excess over noise, 0 to 1.
    significance: ln of the odds for structure there, less ln of the number of trials [nats].
    at: number that belongs to it, such as a frequency [Hz] or a time [s], or None.
    """

    kind: str
    says: str
    share: float
    significance: float
    at: float | None = None

    def as_json(self) -> dict[str, Any]:
        """For ``diagnosis.json``."""
        return {
            "kind": self.kind,
            "says": self.says,
            "share": round(self.share, 4),
            "significance_nats": round(self.significance, 2),
            "at": self.at,
        }


_KINDS: Final = {
    "line": "frequency",
    "cycle": "frequency",
    "wandering": "frequency",
    "slow": "time",
    "time": "time",
    "transients": "time",
    "course": "time",
    "two": "time",
    "inferred": "light",
    "field": "field",
    "spin": "phase",
    "sunlight": "light",
    "place": "place",
}


def locate(search: Search, fit: Fit, found: Sequence[Structure] | None = None) -> list[Place]:
    """Places of a fit's residual, most significant first; those that may be chance are omitted.

    ``found``: the structures of this residual where they have been computed already.
    """
    floor = 0.3 * search.problem.noise_nt
    found = structures(search, fit, None, floor) if found is None else found
    space = search.workspace(fit)
    excess = max(found[0].squares if found else 0.0, space.squares - space.count * search.problem.noise_nt**2, 1e-9)
    places = [_of_structure(structure, excess) for structure in found]
    places += _change(search, fit, excess)
    places += _frequencies(search, fit, excess)
    looked = math.log(max(len(places), 1))
    kept = [
        Place(p.kind, p.says, p.share, p.significance - looked, p.at) for p in places if p.significance > looked + 5.0
    ]
    return sorted(kept, key=lambda place: -place.significance)


def _of_structure(structure: Structure, excess: float) -> Place:
    name = structure.shape.name
    kind = "channel" if name.startswith("channel") else _KINDS[name.split()[0]]
    return Place(kind, f"{structure.shape.says} ({name})", min(1.0, structure.squares / excess), structure.nats)


def _change(search: Search, fit: Fit, excess: float) -> list[Place]:
    """The instant at which a constant body field would best set in."""
    problem = search.problem
    if problem.is_vector or len(problem.scene) < 100:
        return []
    space = search.workspace(fit)
    sigma = max(math.sqrt(space.squares / space.count), 1e-6)
    rows = search.white(along_axes(np.ones(len(problem.scene))).along(fit.unit))
    firsts = np.unique(np.linspace(0, len(rows) - 1, 130)[1:-1].astype(np.intp))
    gains = space.gated(rows, firsts, sigma)
    best = int(np.argmax([gain.nats for gain in gains]))
    at = float(problem.scene.time_s[firsts[best]])
    share = min(1.0, gains[best].squares / excess)
    return [Place("time", f"a change at {at:.0f} s", share, gains[best].nats - math.log(len(firsts)), at)]


def _frequencies(search: Search, fit: Fit, excess: float) -> list[Place]:
    """The strongest lines, with what they coincide with."""
    problem = search.problem
    if problem.is_vector or len(problem.scene) < 100:
        return []
    scene, space = problem.scene, search.workspace(fit)
    sigma = max(math.sqrt(space.squares / space.count), 1e-6)
    found = []
    spectrum = body_spectrum(scene, space.residual, fit.unit)
    for frequency in strongest(scene, spectrum, _LINES, search.spin_hz, all_lines=True).tolist():
        rows = search.white(oscillation(scene.time_s, frequency).along(fit.unit))
        gain = space.gain(rows, sigma)
        words = f"a line at {frequency:.5g} Hz in the body{_coincidence(frequency, search.spin_hz, scene.period_s)}"
        found.append(
            Place(
                "frequency",
                words,
                min(1.0, gain.squares / excess),
                gain.nats - math.log(max(len(scene), 2)),
                frequency,
            )
        )
    return found


def _coincidence(frequency: float, spin_hz: float | None, period_s: float) -> str:
    """What a line falls together with, as a part of a sentence."""
    if spin_hz is None:
        return ""
    names: dict[str, float] = {
        "the spin": spin_hz,
        "twice the spin": 2.0 * spin_hz,
        "three times the spin": 3.0 * spin_hz,
    }
    rate = 1.0 / period_s
    for name, line in names.items():
        seen = line % rate
        folded = min(seen, rate - seen)
        if abs(frequency - folded) < 1.2e-3:
            alias = "" if line < 0.5 * rate else ", an alias"
            return f", at {name}{alias}"
    return ""
