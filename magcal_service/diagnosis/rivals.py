"""Candidates in a term's place, as far from the term's own as the blocks bear out, the nearest ones by their own fit.

To first order a rival is judged where the name has led: one that takes part of what belongs to the nine errors moves
them, and the rival's columns, made there, are the wrong ones.  On a craft that looks down a true step was 39 nats
behind a drift so, and 30 before it once it was fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from numpy.typing import NDArray

from magcal_service.diagnosis.blocks import gain_over
from magcal_service.diagnosis.instants import timed
from magcal_service.diagnosis.linear import Workspace
from magcal_service.diagnosis.plausible import all_within_physics
from magcal_service.diagnosis.problem import Fit, Term
from magcal_service.diagnosis.solution import exchanged
from magcal_service.diagnosis.squares import with_noise_of
from magcal_service.model import Array
from magcal_service.physics.interface import Hypothesis

if TYPE_CHECKING:
    import numpy as np

    from magcal_service.diagnosis.screen import Candidate, Screen

RECORDED_NATS: Final = 5.0
"""Nats for what was recorded against a driver that is inferred and against a free shape: odds of 150 to 1.  A record
was there before the residual was looked at; steps, courses and guesses take whatever form the residual has."""

_WORTH_TEMPERING: Final = 5000.0
"""Nats behind the best from which on no scatter that was ever seen would bring a rival back; choice: saves time."""

_WORTH_FITTING: Final = 0.7
"""Of a name's evidence, what a rival has to hold to be fitted: a fit was seen to make up a shortfall of 0.22."""

_MOST_FITTED: Final = 3  # other effects, the nearest first: each costs a joint solution or two


def is_recorded(hypothesis: Hypothesis) -> bool:
    """Whether a recorded channel drives it."""
    return hypothesis.driver.startswith("channel")


def tempered(
    search: Screen,
    ranked: Sequence[Candidate],
    fit: Fit,
    index: int,
    space: Workspace,
    blocks: NDArray[np.intp],
    sigma_nt: float,
    most_fitted: int = _MOST_FITTED,
) -> list[Candidate]:
    """Candidates in a term's place, best first, each as far from the term's own as the blocks bear out.

    Parameters
    ----------
    search: whose forms and noise they are.
    ranked: candidates, the term's own among them.
    fit: with the term; ``index``: its number; ``space``: the residual as if it had never been fitted.
    blocks: (m,) number of each row's block, over which the scatter of a difference is taken.
    sigma_nt: noise that evidence is counted in [nT].
    most_fitted: rivals of other effects that are fitted in its place; a change that takes a while is held against every
        sudden one besides.
    """
    mine = fit.terms[index].hypothesis
    sought = next((c for c in ranked if c.hypothesis is mine), None)
    if sought is None:
        return list(ranked)
    own = _as_fitted(search, sought, fit, index, space, sigma_nt)
    best = _left(search, own, fit, space)
    found, fitted = [], {mine.effect}
    for candidate in ranked:
        one = own if candidate is sought else candidate
        if one is not own and one.nats > own.nats - _WORTH_TEMPERING:
            by_fit = None
            is_sudden = is_as_sudden(one.hypothesis, mine)
            # several instants follow a course to first order better than the one that is true: each form is fitted
            kind = one.hypothesis.label if is_sudden else one.hypothesis.effect
            has_turn = most_fitted > 0 and (is_sudden or len(fitted) <= most_fitted)
            if has_turn and one.nats > _WORTH_FITTING * own.nats and kind not in fitted:
                fitted.add(kind)
                trial = _trial(search, one, fit, index)
                if not all_within_physics(trial):  # beyond its size it does what it does to first order
                    fitted.discard(kind)
                    continue
                by_fit = _by_fit(search, one, own, fit, trial, index, sigma_nt) if trial.converged else None
            if by_fit is None:
                beside = _left(search, one, fit, space), best
            else:
                one, beside = by_fit[0], (by_fit[1], search.white(fit.residual))
            dispersion = gain_over(*beside, blocks, sigma_nt**2).dispersion
            one = replace(one, nats=own.nats + _beyond(one, own, dispersion))
        if is_recorded(mine) != is_recorded(one.hypothesis):
            one = replace(one, nats=one.nats + (RECORDED_NATS if is_recorded(one.hypothesis) else -RECORDED_NATS))
        found.append(one)
    return sorted(found, key=lambda candidate: -candidate.nats)


def best_of_each(ranked: Sequence[Candidate], key: Callable[[Hypothesis], str]) -> tuple[Candidate, ...]:
    """The best form of each effect or driver, best first."""
    best: dict[str, Candidate] = {}
    for candidate in ranked:
        best.setdefault(key(candidate.hypothesis), candidate)
    return tuple(best.values())


def is_as_sudden(rival: Hypothesis, mine: Hypothesis) -> bool:
    """Whether a rival is a sudden change in place of one that takes a while."""
    return mine.in_place and any(number.role == "instant" for number in rival.nonlinear)


def _as_fitted(search: Screen, sought: Candidate, fit: Fit, index: int, space: Workspace, sigma_nt: float) -> Candidate:
    """A term's own candidate with the numbers that its fit has, not those that are best to first order."""
    rows = search.rows_of(sought.hypothesis, fit.terms[index].theta, fit)
    assert rows is not None
    gain = space.gain(rows, sigma_nt)
    return replace(sought, theta=fit.terms[index].theta, gain=gain, nats=sought.nats - sought.gain.nats + gain.nats)


def _left(search: Screen, candidate: Candidate, fit: Fit, space: Workspace) -> Array:
    """(m,) what a candidate leaves, to first order [nT]."""
    rows = search.rows_of(candidate.hypothesis, candidate.theta, fit)
    assert rows is not None
    found: Array = space.residual - space.projected(rows @ candidate.gain.amplitudes)
    return found


def _trial(search: Screen, rival: Candidate, fit: Fit, index: int) -> Fit:
    """The joint solution with a rival in a term's place."""
    term = Term(rival.hypothesis, rival.theta, rival.gain.amplitudes)
    return timed(search, exchanged(fit.problem, fit, index, term), index)


def _by_fit(
    search: Screen, rival: Candidate, own: Candidate, fit: Fit, trial: Fit, index: int, sigma_nt: float
) -> tuple[Candidate, Array]:
    """A rival by its own fit in a term's place, and what that leaves.

    Both fits are zeros of the score, which leave more than the least sum of squares does; and what is left is counted
    as the sensor's own noise, which errors that shrink the field shrink along.
    """
    before, left = search.white(fit.residual), search.white(with_noise_of(fit, trial))
    gained = float(before @ before - left @ left) / (2.0 * sigma_nt**2)
    nats = own.nats + gained + _cost(own, sigma_nt) - _cost(rival, sigma_nt)
    term = trial.terms[index]
    found = replace(rival, theta=term.theta, gain=replace(rival.gain, amplitudes=term.amplitudes), nats=nats)
    return found, left


def _beyond(candidate: Candidate, own: Candidate, dispersion: float) -> float:
    """Evidence beyond that of a term's own [nats]: by its scatter what the data say, and fully what odds there are."""
    odds = own.hypothesis.odds - candidate.hypothesis.odds
    return (candidate.nats - own.nats - odds) / dispersion + odds


def _cost(candidate: Candidate, sigma_nt: float) -> float:
    """What a candidate's evidence is less than its drop of the squares, for its amplitudes and its search [nats]."""
    return candidate.gain.squares / (2.0 * sigma_nt**2) - candidate.nats
