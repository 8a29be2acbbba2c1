"""Whether a fitted effect is one that its physics allows: asked after every refit, for terms trade what they hold."""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.diagnosis.problem import Fit
from magcal_service.model import Array
from magcal_service.physics.interface import WHOLE, Hypothesis

_CANCELLING: Final = 3.0
"""Times an effect's largest size, what its field may be where parts of it cancel in the residual: a field has three
components, of which the residual sees one."""


def within_physics(fit: Fit, index: int) -> bool:
    """Whether a term's part in the residual, its field and its numbers are no larger than its physics ever makes them.

    What its parts in the field cancel in the residual could be of any size, so both are held.
    """
    term, problem = fit.terms[index], fit.problem
    columns = term.hypothesis.columns(term.theta)
    rows = problem.rows(columns, fit.unit)
    largest = problem.largest(term.hypothesis)
    if rows is None or float(np.sqrt(np.mean((rows @ term.amplitudes) ** 2))) > largest:
        return False
    if term.hypothesis.is_whole and abs(float(term.amplitudes[0]) - 1.0) > WHOLE:
        return False
    field_nt, growth_nt = columns.field(term.amplitudes), columns.growth(term.amplitudes)
    squares = float((field_nt**2).sum()) + float(np.sum(np.square(growth_nt)))
    if float(np.sqrt(squares / len(field_nt))) > _CANCELLING * largest:
        return False
    sizes = [block.size for block in term.hypothesis.blocks]
    most = np.repeat([block.most for block in term.hypothesis.blocks], sizes)
    return bool((np.abs(term.amplitudes) <= most).all()) and has_its_sign(term.hypothesis, term.amplitudes)


def all_within_physics(fit: Fit) -> bool:
    """Whether every term is, refitted with the nine errors and the others."""
    return all(within_physics(fit, index) for index in range(len(fit.terms)))


def has_its_sign(hypothesis: Hypothesis, amplitudes: Array) -> bool:
    """Whether amplitudes (k,) are within what the physics of their blocks has at least and at the most."""
    sizes = [block.size for block in hypothesis.blocks]
    least, highest = (
        np.repeat(values, sizes)
        for values in ([block.least for block in hypothesis.blocks], [block.highest for block in hypothesis.blocks])
    )
    return bool(((amplitudes >= least) & (amplitudes <= highest)).all())
