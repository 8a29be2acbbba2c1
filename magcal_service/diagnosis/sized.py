"""Whether the numbers of a name say something: one of what it says of itself stands out, and none is at an end."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from magcal_service.diagnosis.problem import Fit, Term
from magcal_service.diagnosis.term_columns import amplitude_columns
from magcal_service.model import Array
from magcal_service.physics.drivers.loads import jumps_along

_OF_ITS_SIGMA: Final = 3.0
"""Times its own sigma that one number of what an effect says of itself has to be."""

_END: Final = 0.999  # of the largest number that is searched: rounding

_CUT_OFF: Final = 0.05
"""Share of a recording beside its ends in which a change is not seen to begin or end: four that went on after the last
sample were said to have ended in the last 3 %."""


def has_size(fit: Fit, index: int) -> bool:
    """Whether one amplitude of what a term says of itself stands out of its own sigma, and no number is at an end.

    A block that only completes the form does not count: what of a field of the Sun's direction is of second degree, or
    alike in every direction, is met of other causes too.

    A time constant that ended where the search did is only a bound, and what follows so slowly may be any drift; a
    change that ends beside the last sample may be going on.  An amplitude beside the most that its physics has may be
    another cause, which has more.
    """
    if _at_an_end(fit.terms[index]) or _is_cut_off(fit, index) or _at_its_most(fit, index):
        return False
    return _stands_out(fit, index)


def may_as_well_be(fit: Fit, index: int) -> tuple[str, ...]:
    """Effects that a term may as well be, by its form: those that act exactly so, and those that are met by what
    completes its form, where nothing else of it stands out, where a recorded current jumps along, or where what would
    tell them apart is not seen."""
    hypothesis = fit.terms[index].hypothesis
    completed = hypothesis.if_completed and not _stands_out(fit, index)
    each = fit.problem.acting(fit.terms[index])
    along = hypothesis.if_along and any(jumps_along(part.scene, own.theta) for part, own in each)
    alike = [effect for effect, weights in hypothesis.if_none if _are_none(fit, index, weights)]
    others = (*(hypothesis.if_completed if completed else ()), *(hypothesis.if_along if along else ()), *alike)
    return tuple(dict.fromkeys((*hypothesis.exactly_alike, *others)))


def _stands_out(fit: Fit, index: int) -> bool:
    """Whether one amplitude of what a term says of itself is some times its own sigma."""
    blocks = fit.terms[index].hypothesis.blocks
    own = np.repeat([not block.completes for block in blocks], [block.size for block in blocks])
    sigma = np.sqrt(np.maximum(np.diagonal(fit.covariance)[amplitude_columns(fit, index)], 1e-300))
    return bool(np.max((np.abs(fit.terms[index].amplitudes) / sigma)[own]) >= _OF_ITS_SIGMA)


def _are_none(fit: Fit, index: int, weights: Array) -> bool:
    """Whether sums (c,) of a term's amplitudes hold less evidence than so many numbers cost; not of a form that each of
    several recordings has its own amplitudes of."""
    own = amplitude_columns(fit, index)
    if weights.shape[1] != own.stop - own.start:
        return False
    sums = weights @ fit.terms[index].amplitudes
    chi2 = float(sums @ np.linalg.pinv(weights @ fit.covariance[own, own] @ weights.T) @ sums)
    return chi2 <= len(sums) * math.log(len(fit.residual))


def _at_an_end(term: Term) -> bool:
    """Whether a number of a term that a fit moves is the largest that was searched; the smallest may be none at all."""
    numbers = zip(term.hypothesis.nonlinear, term.theta, strict=True)
    return any(not n.role and len(n.grid) > 1 and value >= _END * float(n.grid.max()) for n, value in numbers)


def _at_its_most(fit: Fit, index: int) -> bool:
    """Whether an amplitude is within its own sigma of the most that its physics has with that sign."""
    blocks = fit.terms[index].hypothesis.blocks
    highest = np.repeat([block.highest for block in blocks], [block.size for block in blocks])
    sigma = np.sqrt(np.maximum(np.diagonal(fit.covariance)[amplitude_columns(fit, index)], 0.0))
    return bool((fit.terms[index].amplitudes + sigma > highest).any())


def _is_cut_off(fit: Fit, index: int) -> bool:
    """Whether a change that takes a while begins or ends beside an end of its recording."""
    edges = [value for number, value in numbers_of(fit, "edge") if number == index]
    ends = [(edge, *fit.problem.scene.course_at(edge)[[0, -1]].tolist()) for edge in edges]
    return any(min(edge - first, last - edge) < _CUT_OFF * (last - first) for edge, first, last in ends)


def numbers_of(fit: Fit, role: str) -> list[tuple[int, float]]:
    """The nonlinear numbers of a role, with the number of their term."""
    return [
        (index, float(value))
        for index, term in enumerate(fit.terms)
        for number, value in zip(term.hypothesis.nonlinear, term.theta, strict=True)
        if number.role == role
    ]
