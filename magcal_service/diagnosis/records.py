"""Recorded drivers before inferred ones: a record takes the place of a computed course, and is begun with beside it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from magcal_service.diagnosis.problem import Fit, Term
from magcal_service.diagnosis.rivals import is_recorded
from magcal_service.diagnosis.screen import ACCEPTED_NATS
from magcal_service.diagnosis.solution import exchanged
from magcal_service.diagnosis.stages import Progress

if TYPE_CHECKING:
    from magcal_service.diagnosis.explain import Explained, Search

_NEARLY: Final = 0.95  # of an inferred driver's evidence, what its record has to hold to replace it
_TO_BEGIN_WITH: Final = 0.7
"""The same, for another selection to begin with the record: two true ones, each beside a second cause that the computed
course had taken up, held 0.88 and 0.94."""


def by_channel(search: Search, fit: Fit, floor_nt: float) -> Fit:
    """Terms with an inferred driver as the same effect by a recorded one, where that holds nearly as much.

    An inferred driver has no sensor noise, and so fits a little better than its record.

    Parameters
    ----------
    search: which continues at what comes out.
    fit: with the terms.
    floor_nt: least noise that evidence is counted in [nT].
    """
    for index, term in enumerate(fit.terms):
        if not term.hypothesis.is_inferred:
            continue
        recorded = [
            hypothesis
            for hypothesis in search.hypotheses
            if hypothesis.effect == term.hypothesis.effect and is_recorded(hypothesis)
        ]
        space, sigma = search.workspace(fit, index), max(fit.white_rms_nt, floor_nt)
        ranked = search.screen(space, fit, sigma, among=[*recorded, term.hypothesis])
        own = next((c.nats for c in ranked if c.hypothesis is term.hypothesis), math.inf)
        best = next((c for c in ranked if c.hypothesis is not term.hypothesis), None)
        if best is None or best.nats < _NEARLY * own:
            continue
        trial = exchanged(search.problem, fit, index, Term(best.hypothesis, best.theta, best.gain.amplitudes))
        if search.is_sized(trial):
            fit = search.refreshed(trial)
    return fit


def from_records(search: Search, found: Explained, floor_nt: float, progress: Progress) -> Explained:
    """What was found, or another selection that begins with the record of a driver where it was computed.

    A computed course has free numbers, which may take up a second cause, and then nothing is left to find that by.  The
    other selection stands if it brings further effects and foretells blocks clearly better.

    Parameters
    ----------
    search: which has found it; it continues at what comes out.
    found: with its drivers.
    floor_nt: least noise that evidence is counted in [nT].
    progress: told of each stage.
    """
    for index, term in enumerate(found.fit.terms):
        record = next((one for one in found.drivers[index] if is_recorded(one.hypothesis)), None)
        if record is None or not term.hypothesis.is_inferred:
            continue
        if record.nats < _TO_BEGIN_WITH * found.own_nats(index):
            continue
        other = replace(search, close=set(search.close))
        own = Term(record.hypothesis, record.theta, record.gain.amplitudes)
        began = other.refreshed(exchanged(search.problem, found.fit, index, own))
        more = other.selected(began, floor_nt, progress)
        if len(more.terms) <= len(found.fit.terms):
            continue
        trial = other.settled(more, floor_nt)
        if len(trial.fit.terms) > len(found.fit.terms) and _gained(found.fit, trial.fit, floor_nt) > ACCEPTED_NATS:
            search.look_at(other.problem, other.hypotheses)
            search.close |= other.close
            return trial
    return found


def held_out(fit: Fit) -> float:
    """Sum of squares on rows that took no part, as the sensor's own noise [nT^2]."""
    return float((fit.sensor_held_out**2).sum())


def _gained(before: Fit, after: Fit, floor_nt: float) -> float:
    """What a fit foretells better than another [nats]."""
    noise_nt = max(after.white_rms_nt, floor_nt) / after.noise_gain
    return (held_out(before) - held_out(after)) / (2.0 * noise_nt**2)
