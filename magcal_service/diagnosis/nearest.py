"""The effect of the catalogue that would explain most of what is left, and what speaks against it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

from magcal_service.diagnosis.belief import are_rather_unlisted, with_left
from magcal_service.diagnosis.diagnose import Diagnosis
from magcal_service.diagnosis.leftover import significant, structures
from magcal_service.diagnosis.nameless import BY_SHAPE, NEEDED_SHARES, spoken_against
from magcal_service.diagnosis.plausible import all_within_physics
from magcal_service.diagnosis.problem import Term
from magcal_service.diagnosis.rest import Rest
from magcal_service.diagnosis.screen import ACCEPTED_NATS, Candidate
from magcal_service.diagnosis.searching import FLOOR
from magcal_service.diagnosis.solution import solve

_BESIDE: Final = "it did not hold beside what else was tried"
"""Where nothing speaks against it by itself."""


@dataclass(frozen=True, slots=True)
class Nearest:
    """An effect that would explain most of what is left.

    Parameters
    ----------
    effect: its name.
    share: of what is left, what it would explain, 0 to 1.
    against: what speaks against it, as a clause.
    """

    effect: str
    share: float
    against: str

    @classmethod
    def of(cls, diagnosis: Diagnosis) -> Nearest | None:
        """Of a diagnosis that leaves something without a name; None where no effect comes near."""
        fit, search = diagnosis.fit, diagnosis.search
        present = {term.hypothesis.effect for term in fit.terms}
        ranked = search.screen(search.workspace(fit), fit, max(fit.white_rms_nt, 1e-3), sorted(present))
        if not ranked or ranked[0].nats < ACCEPTED_NATS:
            return None
        best: Candidate = ranked[0]
        share = min(1.0, best.gain.squares / max(diagnosis.left[0].squares, 1e-9))
        return cls(best.hypothesis.effect, share, _against(diagnosis, best, share))

    def __str__(self) -> str:
        return f"Nearest is {self.effect}: it would take {100.0 * self.share:.0f} % of it, but {self.against}."

    def to_dict(self) -> dict[str, Any]:
        """For ``diagnosis.json``."""
        return {"effect": self.effect, "explains": round(self.share, 4), "against": self.against}


def _against(diagnosis: Diagnosis, best: Candidate, share: float) -> str:
    """What speaks against a candidate: the first of what every name has to pass, in the order of the search."""
    fit, prepared = diagnosis.fit, diagnosis.prepared
    search = replace(diagnosis.search, close=set(diagnosis.search.close))
    trial = solve(search.problem, fit.x, (*fit.terms, Term(best.hypothesis, best.theta, best.gain.amplitudes)))
    if not all_within_physics(trial):
        return "it would be larger than its physics allows"
    if not search.agrees(fit, trial):
        return "held-out blocks gain too little by it"
    if share < NEEDED_SHARES[0]:
        return BY_SHAPE
    floor_nt = FLOOR * prepared.problem.noise_nt
    explained = search.compared(search.refreshed(trial), floor_nt)
    if len(explained.fit.terms) < len(trial.terms):
        return "what it gains does not stand out of the scatter over blocks"
    phase = None if prepared.spin is None else prepared.spin.phase_rad
    against = spoken_against(search, prepared.baseline, explained, phase, floor_nt)
    if against:
        return against
    left = structures(search, explained.fit, phase, floor_nt)[0]
    rest = None if len(diagnosis.whitening) else Rest.of(prepared.baseline, explained.fit)
    held = with_left(explained, left.squares if significant(left) else 0.0, rest, floor_nt)
    return "what it leaves makes a cause in no catalogue likelier" if are_rather_unlisted(held) else _BESIDE
