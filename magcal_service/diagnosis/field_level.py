"""How large the field model's errors are in a recording: as usual, unless the likelihood asks for more.

A search first takes them as small as they ever are.  Where what it left, or what it named, is likelier under larger
ones, it is made again at those: a name has to be likelier than nine errors under the errors that suit them best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from magcal_service.diagnosis.field_error import SCALES, FieldError, Scale
from magcal_service.diagnosis.problem import Fit, Problem, Term
from magcal_service.diagnosis.screen import ACCEPTED_NATS
from magcal_service.diagnosis.signals import Followed
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array

_KNOWN_TO: Final = 0.1
"""Of a field model's usual errors, what the way they hang together is known to along a common orbit, where no places
are known: a clean craft's turn over nadir left 1.7 nT of 14 that fitted a late clock.  Choice: a tenth, 2.2 nT."""

_SMOOTH: Final = 0.25
"""Of a signal's square, what whitening by the largest errors leaves at the most of one that is as smooth as they."""


def at_scale(problem: Problem, usual: FieldError, scale: Scale) -> Problem:
    """A problem with errors of the field beside the usual ones."""
    return replace(problem, field_error=usual.scaled(scale))


def log_likelihood(fit: Fit) -> float:
    """Of a fit's residual under white noise and the field model's errors [nats], but for a constant.

    The noise is the sensor's own: errors that shrink the field shrink it along, and would be likelier for that alone.
    """
    error = fit.problem.field_error
    assert error is not None
    return -0.5 * float((fit.white_residual**2).sum()) / (fit.noise_gain * error.noise_nt) ** 2 - error.log_volume()


def likeliest(problem: Problem, usual: FieldError, x: Array, terms: Sequence[Term] = ()) -> tuple[Scale, float]:
    """The scale at which unknowns fitted from ``x`` (9,) are likeliest, and the log-likelihood there [nats].

    Nonlinear numbers stay, as at every scale they hardly move: all others arrive in two or three steps.
    """
    held = [replace(term, hypothesis=term.hypothesis.holding(*range(len(term.theta)))) for term in terms]
    found = [
        (log_likelihood(solve(at_scale(problem, usual, scale), x, held)) + odds, scale)
        for scale, odds in SCALES.items()
    ]
    nats, scale = max(found)
    return scale, nats


def needed_scale(
    usual: FieldError, of_alone: tuple[Scale, float], named: Fit, followed: Followed | None = None
) -> tuple[Scale, bool]:
    """The scale that suits the nine errors alone, or the names where those are likelier still; and whether they are.

    Parameters
    ----------
    of_alone: what ``likeliest`` says of the nine errors alone, which is the same whatever a search has named.
    followed: a signal of a channel beside the names; what is left may follow it, and be no error of a field model.
    """
    alone, nats_alone = of_alone
    terms, cost = list(named.terms), ACCEPTED_NATS
    if followed is not None:
        terms, cost = [*terms, followed.term], cost + followed.cost
    if not terms:
        return alone, False
    scale, nats = likeliest(named.problem, usual, named.x, terms)
    return (scale, True) if nats > nats_alone + cost else (alone, False)


def likelier_by(fit: Fit, most: Scale) -> float:
    """Nats by which errors as large as a fit's are likelier than with neither scale beyond ``most``."""
    error = fit.problem.field_error
    assert error is not None
    within = Scale(min(error.scale.coarse, most.coarse), min(error.scale.fine, most.fine))
    return log_likelihood(fit) - log_likelihood(solve(at_scale(fit.problem, error, within), fit.x, fit.terms))


def is_trifle(problem: Problem, square_nt2: float) -> bool:
    """Whether a signal, of which so much per row is left by whitening [nT^2], holds too little to be told from a field
    model's errors if it is as smooth, where no places are known."""
    error = problem.field_error
    if error is None or problem.scene.position_ecef_km is not None:
        return False
    return float(np.sqrt(square_nt2)) < _KNOWN_TO * error.usual_nt


def is_as_smooth(problem: Problem, signal_nt: Array) -> bool:
    """Whether a signal (m,) in the residual, before it is whitened, is as smooth as a field model's errors."""
    error = problem.field_error
    assert error is not None
    left = at_scale(problem, error, max(SCALES)).white(signal_nt)
    return float(left @ left) < _SMOOTH * float(signal_nt @ signal_nt)
