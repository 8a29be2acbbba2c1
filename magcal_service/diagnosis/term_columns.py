"""Which columns of a fit belong to which of its terms."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.problem import Fit, free_numbers


def amplitude_columns(fit: Fit, index: int) -> slice:
    """Numbers of the columns of a term's amplitudes."""
    first = fit.problem.size + sum(term.hypothesis.size for term in fit.terms[:index])
    return slice(first, first + fit.terms[index].hypothesis.size)


def columns_of(fit: Fit, index: int) -> NDArray[np.intp]:
    """Numbers of the columns that belong to a term: amplitudes, then nonlinear numbers."""
    linear = amplitude_columns(fit, index)
    free = fit.linear_size + sum(len(free_numbers(term)) for term in fit.terms[:index])
    moving = np.arange(free, free + len(free_numbers(fit.terms[index])))
    return np.concatenate([np.arange(linear.start, linear.stop), moving]).astype(np.intp)
