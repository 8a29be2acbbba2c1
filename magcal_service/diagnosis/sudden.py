"""A change at one instant, held against the same change over minutes: what is not seen to be sudden is hardly a jump.

Forms that take a while pay for when they begin and end as a search does, and never come near a faint jump so.  Here
both are summed over all the times at which they may happen, and the slow one over every length that slow causes have.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.linear import Workspace
from magcal_service.model import Array

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
    slow = [nats(np.clip((middle - at) / length + 0.5, 0.0, 1.0)) for length in lengths]
    beside = np.exp(np.minimum(np.array(slow) - jumps.max(), _MOST_NATS))
    return float(np.mean(beside @ often) / (np.exp(jumps - jumps.max()) @ often))


def _stretches(time_s: Array, near_s: float) -> NDArray[np.intp]:
    """First rows (g,), rising from 0, of stretches that are finer near an instant, down to a sample."""
    count = len(time_s)
    coarse = np.linspace(0, count, _STRETCHES, endpoint=False)
    reach = 2.0 * count / _STRETCHES
    fine = np.searchsorted(time_s, near_s) + np.linspace(-reach, reach, _STRETCHES + 1)
    rows = np.rint(np.concatenate([coarse, fine])).astype(np.intp)
    return np.unique(rows[(rows >= 0) & (rows < count)])
