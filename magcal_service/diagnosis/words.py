"""A diagnosis in plain words, the same in the terminal and in the report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

from magcal_service.diagnosis.diagnose import Diagnosis, Verdict
from magcal_service.diagnosis.result import Entry

_NATS_PER_DECADE: Final = math.log(10.0)
_MOST_DECADES: Final = 12
"""Odds are not stated beyond 10^12: no model of the noise holds so far out."""

_MOST_LISTED: Final = 3
"""Names in one sentence; choice: more are a list, and it is elsewhere."""

REASONS: Final[Mapping[str, str]] = {
    "recording_doubtful": "what was found on the recording itself has to be answered before any physics is named",
    "collapsed": "the nine errors ended at values that no sensor has",
    "poor_coverage": "the field did not point in enough directions to fix the nine errors; record over more attitudes",
    "unexplained_structure": "a mismatch is left that nothing in the catalogue explains",
    "not_converged": "the fit did not arrive at a solution; its numbers are where it stopped",
    "name_uncertain": "another name does nearly as well; what would tell them apart stands beside it",
    "rough_residual": "what changes from one sample to the next is larger than any sensor's noise; state noise_nt",
    "gain_in_scatter": "what the effects gain on held-out blocks does not stand out of its scatter",
    "not_enough_data": "too few samples for held-out blocks; record longer",
}
"""What each reason against trusting a result means."""


def reason_in_words(reason: str) -> str:
    """A reason as a clause; one that is new here by its own name."""
    return REASONS.get(reason, reason.replace("_", " "))


def odds(nats: float) -> str:
    """Evidence [nats] as odds: ``"odds of 160 000 to 1"``, from 10^12 on ``"odds beyond 10^12 to 1"``."""
    decades = nats / _NATS_PER_DECADE
    if decades >= _MOST_DECADES:
        return f"odds beyond 10^{_MOST_DECADES} to 1"
    if decades >= 6.0:
        return f"odds of about 10^{decades:.0f} to 1"
    value = math.exp(max(nats, 0.0))
    digits = max(0, int(math.log10(value)) - 1)
    return f"odds of {round(value, -digits):,.0f} to 1".replace(",", " ")


def strength(nats: float) -> str:
    """Significance [nats] in a word."""
    if nats > _MOST_DECADES * _NATS_PER_DECADE:
        return "beyond doubt"
    if nats > 12.0:
        return "very strong"
    return "clear" if nats > 7.0 else "weak"


def percent(share: float) -> str:
    """A share from 0 to 1 as a percentage that never rounds to a certainty."""
    if 0.0 < share < 0.001:
        return "< 0.1 %"
    if 0.999 < share < 1.0:
        return "> 99.9 %"
    return f"{100.0 * share:.3g} %"


def chance(probability: float) -> str:
    """A probability as a percentage that is never a certainty."""
    return percent(min(probability, 0.99999))


def titles(diagnosis: Diagnosis) -> dict[str, str]:
    """What each effect of the catalogue is, by name."""
    return {effect.name: effect.title for effect in diagnosis.effects}


def verdict_sentence(diagnosis: Diagnosis, found: Sequence[Entry], held_out: Mapping[str, float]) -> str:
    """The verdict in one plain sentence."""
    known = titles(diagnosis)
    listed = _listed(list(dict.fromkeys(known[entry.effect] for entry in found if entry.effect != "unknown")))
    if diagnosis.verdict is Verdict.NONE:
        floor = diagnosis.prepared.problem.noise_nt
        error = diagnosis.prepared.problem.field_error
        model = "" if error is None else f", and {error.rms_nt:.1f} nT that the field model may err by"
        return (
            f"Simulation and recording agree to the noise: {held_out['with_effects']:.1f} nT are left on data that "
            f"took no part in the fit, over a noise of {floor:.1f} nT{model}."
        )
    if diagnosis.verdict is Verdict.UNKNOWN:
        if diagnosis.inspection.open:
            return (
                "Recording and reference disagree, but the recording itself is in doubt: no physics is named from it."
            )
        besides = f" besides {listed}" if listed else ""
        return (
            f"Something without a name makes {percent(diagnosis.unexplained)} of the mismatch{besides}: no effect of "
            "the catalogue explains it, but where it sits is known."
        )
    if not diagnosis.fit.terms:
        return f"The recording shows what the simulation leaves out: {listed}."
    explained = percent(1.0 - diagnosis.unexplained)
    return f"The simulation leaves out {listed}: {explained} of the mismatch is explained."


def _listed(parts: Sequence[str]) -> str:
    """``a, b and c``; of more than three the first two and how many more."""
    if len(parts) > _MOST_LISTED:
        parts = [*parts[: _MOST_LISTED - 1], f"{len(parts) - _MOST_LISTED + 1} more"]
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}" if parts else ""


def driver_in_words(driver: str) -> str:
    """``channel:temp`` as ``the recorded channel temp``, and so on; empty where no driver is needed."""
    kind, _, name = driver.partition(":")
    if kind == "channel":
        return f"the recorded channel {name}"
    return f"{name.replace('_', ' ')}, inferred because it was not recorded" if kind == "inferred" else ""


def remaining(diagnosis: Diagnosis) -> str:
    """What is left after the effects, in one sentence."""
    if diagnosis.verdict is Verdict.UNKNOWN:
        return f"{percent(diagnosis.unexplained)} of the mismatch, which no effect of the catalogue explains"
    if diagnosis.unexplained > 0.0:
        return f"{percent(diagnosis.unexplained)} of the mismatch, more than noise but little beside what was named"
    return "nothing that could not be noise"
