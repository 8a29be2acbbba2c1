"""Recorded drivers before inferred ones, once more: a selection that begins with the record of a computed course."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from magcal_service.diagnosis.explain import Explained, Search
from magcal_service.diagnosis.problem import Fit, Term
from magcal_service.diagnosis.rivals import is_recorded
from magcal_service.diagnosis.screen import ACCEPTED_NATS
from magcal_service.diagnosis.solution import exchanged
from magcal_service.diagnosis.squares import held_out_nt2
from magcal_service.diagnosis.stages import Progress

_TO_BEGIN_WITH: Final = 0.7
"""Of an inferred driver's evidence, what its record has to hold to be begun with in its place: two true ones, each
beside a second cause that the computed course had taken up, held 0.88 and 0.94."""


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
            search.follow(other)
            search.close |= other.close
            return trial
    return found


def _gained(before: Fit, after: Fit, floor_nt: float) -> float:
    """What a fit foretells better than another [nats]."""
    noise_nt = max(after.white_rms_nt, floor_nt) / after.noise_gain
    return (held_out_nt2(before) - held_out_nt2(after)) / (2.0 * noise_nt**2)
