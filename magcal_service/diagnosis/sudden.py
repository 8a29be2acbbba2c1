"""A change at one instant, held against the same change over minutes: what is not seen to be sudden is hardly a jump.

Forms that take a while pay for when they begin and end as a search does, and never come near a faint jump so.  Here
both are summed over all the times at which they may happen, and the slow one over every length that slow causes have.

Where the nine errors move far with the change, that is true to first order only: of a gain's jump seen along few
directions a slow change held 16 nats more so, and 9 less by a joint solution.  So a slow change that comes near is
fitted in the jump's place, and its likelihood is that of the solution.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.linear import Workspace
from magcal_service.diagnosis.problem import Term
from magcal_service.diagnosis.solution import exchanged
from magcal_service.diagnosis.squares import with_noise_of
from magcal_service.model import Array
from magcal_service.physics.interface import Hypothesis

if TYPE_CHECKING:
    from magcal_service.diagnosis.problem import Fit
    from magcal_service.diagnosis.screen import Screen

_SHORTEST_S: Final = 600.0
"""Shortest change that is held against a jump [s]: what fills or warms takes ten minutes and more, a relay or a
deployment seconds.  Each further one is twice as long, as far as the recording goes."""

_STRETCHES: Final = 400
"""Stretches that a recording is summed over, at whose edges changes happen, and as many near the jump; choice: 0.25 %
of it each, and down to a sample of 40 000."""

_MOST_NATS: Final = 50.0
"""Nats by which a slow change is counted as likelier at the most; beyond, it has long been the likelier one."""


_LIKELY: Final = 0.05
"""Likelihood, as ``slower`` gives it, from which on slow changes are fitted in the jump's place, the likeliest length
first; choice: less moves no probability by more than a fortieth."""

_NEARER: Final = 2
"""Times that the way is halved by which the middle of a slow change is moved to find where its solution leaves least:
half of its length, then a quarter."""


@dataclass(eq=False)
class Slower:
    """Likelihoods of changes over minutes over the jumps of a fit, worked out once they are asked for: of most fits on
    the way they are not.

    Parameters
    ----------
    search: where it stood at the fit, of its own; ``fit``: with the jumps.
    sigmas_nt: for each term, the noise that evidence is counted in [nT].
    """

    search: Screen
    fit: Fit
    sigmas_nt: Sequence[float]

    @cached_property
    def likelihoods(self) -> tuple[float, ...]:
        """For each term, as ``slower`` has it."""
        search = replace(self.search)  # what it makes for this is not kept
        return tuple(
            slower(search, self.fit, index, search.workspace(self.fit, index), sigma_nt)
            for index, sigma_nt in enumerate(self.sigmas_nt)
        )


def slower(search: Screen, fit: Fit, index: int, space: Workspace, sigma_nt: float) -> float:
    """Likelihood of a change that takes minutes over that of a term's jump; 0 where the term is none at one instant.

    Parameters
    ----------
    search: whose forms and noise they are.
    fit: with the term; ``index``: its number; ``space``: the residual as if it had never been fitted.
    sigma_nt: noise that evidence is counted in [nT].
    """
    hypothesis = fit.terms[index].hypothesis
    time_s = fit.problem.scene.time_s
    if [number.role for number in hypothesis.nonlinear] != ["instant"] or np.ptp(time_s) <= _SHORTEST_S:
        return 0.0
    rows = search.rows_of(hypothesis, np.array([-np.inf]), fit)  # there from the beginning
    if rows is None:
        return 0.0
    firsts = _stretches(time_s, float(fit.terms[index].theta[0]))
    segments = space.segments(rows, fit.problem.rows_per_sample * firsts)
    at, middle = time_s[firsts[1:], None], 0.5 * (time_s[firsts] + time_s[np.append(firsts[1:], len(time_s)) - 1])
    often = np.gradient(at[:, 0]) / np.ptp(time_s)  # share of the recording that each edge stands for

    def nats(levels: Array) -> Array:
        """(k,) by changes at each edge, of which so much has come about in every stretch (k, g)."""
        return np.asarray(segments.weighted(levels).drops / (2.0 * sigma_nt**2))

    jumps = nats((middle >= at).astype(np.float64))
    lengths = _SHORTEST_S * 2.0 ** np.arange(32)
    lengths = lengths[lengths < np.ptp(time_s)]
    slow = np.array([nats(_come_about(middle, at, length)) for length in lengths]) - jumps.max()
    shares = often / (np.exp(jumps - jumps.max()) @ often)

    def likelihood() -> float:
        return float(np.mean(np.exp(np.minimum(slow, _MOST_NATS)) @ shares))

    open_ = list(range(len(lengths))) if type(hypothesis) is Hypothesis else []  # several recordings': to first order
    while open_ and likelihood() > _LIKELY:
        likeliest = max(open_, key=lambda each: float(slow[each].max()))
        each, length_s = slow[likeliest], float(lengths[likeliest])
        if each.max() < math.log(_LIKELY):
            break
        open_.remove(likeliest)
        jointly = _jointly(search, fit, index, float(at[np.argmax(each), 0]), length_s)
        each += min(jointly / sigma_nt**2 - each.max(), 0.0)
    return likelihood()


def _jointly(search: Screen, fit: Fit, index: int, at_s: float, length_s: float) -> float:
    """By how much a change that takes so long holds more than a jump, all unknowns fitted anew [nats nT^2].

    The change is sought from a place to first order, and from the term's own; the jump is the term, or one in the
    middle of the change.
    """
    jump, time_s = fit.terms[index], fit.problem.scene.time_s

    def squares(one: Fit) -> float:
        white = search.white(with_noise_of(fit, one))
        return 0.5 * float(white @ white) if one.converged else math.inf

    def held(middle_s: float) -> float:
        return before - squares(exchanged(fit.problem, fit, index, _over_a_while(jump, time_s, middle_s, length_s)))

    before = squares(replace(fit, converged=True))
    tried = {place: held(place) for place in (at_s, float(jump.theta[0]))}
    step_s = 0.5 * length_s
    for _ in range(_NEARER):
        best = max(tried, key=tried.__getitem__)
        tried |= {place: held(place) for place in (best - step_s, best + step_s) if place not in tried}
        step_s *= 0.5
    most = max(tried.values())
    sudden = exchanged(fit.problem, fit, index, replace(jump, theta=np.array([max(tried, key=tried.__getitem__)])))
    return most - max(before - squares(sudden), 0.0)


def _over_a_while(jump: Term, time_s: Array, middle_s: float, length_s: float) -> Term:
    """A jump's term as the same change over so long about an instant."""
    form = jump.hypothesis
    there = form.columns(np.array([-np.inf])).times(_come_about(time_s, middle_s, length_s))
    return Term(replace(form, columns=lambda _: there, nonlinear=()), np.zeros(0), jump.amplitudes)


def _come_about(time_s: Array, middle_s: Array | float, length_s: float) -> Array:
    """How much of a change has come about: from 0 to 1, evenly, so long about its middle."""
    return np.asarray(np.clip((time_s - middle_s) / length_s + 0.5, 0.0, 1.0))


def _stretches(time_s: Array, near_s: float) -> NDArray[np.intp]:
    """First rows (g,), rising from 0, of stretches that are finer near an instant, down to a sample."""
    count = len(time_s)
    coarse = np.linspace(0, count, _STRETCHES, endpoint=False)
    reach = 2.0 * count / _STRETCHES
    fine = np.searchsorted(time_s, near_s) + np.linspace(-reach, reach, _STRETCHES + 1)
    rows = np.rint(np.concatenate([coarse, fine])).astype(np.intp)
    return np.unique(rows[(rows >= 0) & (rows < count)])
