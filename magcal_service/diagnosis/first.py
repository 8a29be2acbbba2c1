"""Why a name stands where a rival of its class is likelier: its numbers are those that were fitted."""

from __future__ import annotations

from typing import Final

from magcal_service.diagnosis.belief import posterior
from magcal_service.diagnosis.explain import LIKELIER, OF_BLOCKS, Explained
from magcal_service.diagnosis.plausible import all_within_physics
from magcal_service.diagnosis.problem import Term
from magcal_service.diagnosis.solution import exchanged
from magcal_service.diagnosis.squares import held_out_nt2
from magcal_service.physics.interface import UNLISTED

_NO_NUMBERS: Final = "a cause in no catalogue, which is likelier, has none"


def why_first(explained: Explained, index: int) -> str:
    """Why what is likelier than a term did not take its place, in words; empty where nothing is.

    A cause in no catalogue has no numbers, and takes no place.
    """
    fit = explained.fit
    believed, own = posterior(explained, index), explained.own_nats(index)
    mine = fit.terms[index].hypothesis.effect
    probability = dict(believed.rivals)
    rivals = [c for c in explained.rivals[index] if c.hypothesis.effect in set(believed.members) - {mine}]
    best = max(rivals, key=lambda c: probability.get(c.hypothesis.effect, 0.0), default=None)
    if best is None or probability.get(best.hypothesis.effect, 0.0) <= believed.own:
        return _NO_NUMBERS if probability.get(UNLISTED, 0.0) > believed.own else ""
    name = best.hypothesis.effect
    if best.nats < own + LIKELIER:
        return f"{name} is likelier by less than 3 to 1, and {mine} was found first"
    trial = exchanged(fit.problem, fit, index, Term(best.hypothesis, best.theta, best.gain.amplitudes))
    if best.hypothesis.is_quickest(trial.terms[index].theta):
        return f"{name} would be quicker there than any that is tried"
    if not all_within_physics(trial):
        return f"{name} would be beyond what its physics allows"
    noise = fit.white_rms_nt / fit.noise_gain
    if held_out_nt2(trial) > held_out_nt2(fit) + 2.0 * noise**2 * OF_BLOCKS:
        return f"held-out blocks speak for {mine} against {name}"
    return f"{name} had that place before, and gave it up"
