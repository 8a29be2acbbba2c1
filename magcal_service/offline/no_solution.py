"""Why no sound solution fits arrays: the value that was refused, what is accepted, and what to do."""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.base.errors import MagcalError
from magcal_service.estimators.interface import StartGate
from magcal_service.estimators.parts.start import BatchSolution
from magcal_service.estimators.parts.start_gates import (
    BAD_FIT,
    LARGEST_EIGENVALUE,
    SMALLEST_EIGENVALUE,
    handover_sigma,
    vector_sigma,
)
from magcal_service.model import Array, d_matrix

_SAME_INSTANTS: Final = "check that rows of B and H are of the same instants"
_MORE_DIRECTIONS: Final = "take samples with the sensor turned in more directions, about two axes at least"

_NEXT_STEP: Final = {
    StartGate.NOT_POSITIVE: f"{_SAME_INSTANTS}, and that both are in nT",
    StartGate.NO_CONVERGENCE: f"{_SAME_INSTANTS}, and that no axis of B is stuck; if that is right, {_MORE_DIRECTIONS}",
    StartGate.COLLAPSED: f"{_SAME_INSTANTS}, and the unit of B; if that is right, {_MORE_DIRECTIONS}",
    StartGate.POOR_COVERAGE: f"{_MORE_DIRECTIONS}, or give the sensor's noise as noise_nt where it is known",
    StartGate.BAD_FIT: f"{_SAME_INSTANTS}, and noise_nt; if that is right, the errors change or something disturbs the "
    "sensor: calibrate() and diagnose() of a Recording look for that",
}
"""What to do about arrays that a condition has stopped."""

_NO_NUMBERS: Final = {
    StartGate.NOT_POSITIVE: "the squares of |B| and |H| lead to no sensor, and an I + D with positive eigenvalues is "
    "needed",
    StartGate.NO_CONVERGENCE: "the iteration has come to no end, and a solution in finite numbers is needed",
    StartGate.COLLAPSED: "every solution shrinks an axis",
    StartGate.POOR_COVERAGE: "two different solutions fit equally well, and one has to fit better by far",
    StartGate.BAD_FIT: "more than half of the samples contradict the rest, and most have to agree",
}
"""What was refused where there is no solution whose numbers could be told."""


class NoSolutionError(MagcalError):
    """No sound solution fits the arrays: the value that was not accepted, what is, and what to do about it.

    Parameters
    ----------
    gate: the condition that was not met (``collapsed``, ``poor_coverage``, ...).
    text: all of it in words.
    """

    exit_code = 3

    def __init__(self, gate: StartGate, text: str) -> None:
        self.gate = gate
        super().__init__(text)


def no_solution(gate: StartGate, field_nt: Array, magnitude_nt: Array) -> NoSolutionError:
    """The error where nothing was found that could be put to the conditions.

    Parameters
    ----------
    field_nt, magnitude_nt: B (n, 3) and |H| (n,) that were to be fitted [nT].
    """
    return _error(gate, field_nt, magnitude_nt, _NO_NUMBERS[gate])


def stopped(
    gate: StartGate, solution: BatchSolution, field_nt: Array, magnitude_nt: Array, noise_nt: float | None
) -> NoSolutionError:
    """The error where a condition has stopped a solution, with the number that it was stopped for.

    Parameters
    ----------
    solution: that was found.
    field_nt, magnitude_nt: B (n, 3) and |H| (n,) that were fitted [nT].
    noise_nt: as stated, 1 sigma per axis [nT]; None: not stated.
    """
    refused = _NO_NUMBERS[gate]
    if gate is StartGate.COLLAPSED:
        low, *_, high = np.linalg.eigvalsh(np.eye(3) + d_matrix(solution.x)).tolist()
        accepted = f"{SMALLEST_EIGENVALUE:g} to {LARGEST_EIGENVALUE:g}"
        refused = f"eigenvalues of I + D from {low:.3g} to {high:.3g}, and {accepted} is accepted"
    elif gate is StartGate.BAD_FIT and noise_nt is not None:
        limit = BAD_FIT * noise_nt
        refused = f"the residual is {solution.residual_rms_nt:.1f} nT rms, and at most {limit:.1f} nT is accepted"
    elif gate is StartGate.POOR_COVERAGE:
        sigma = vector_sigma(solution.covariance, field_nt)
        limit = handover_sigma(solution.sigma_nt, float(magnitude_nt.mean()))
        refused = f"a calibrated vector is known to {sigma:.0f} nT (1 sigma), and at most {limit:.0f} nT is accepted"
    return _error(gate, field_nt, magnitude_nt, refused)


def _error(gate: StartGate, field_nt: Array, magnitude_nt: Array, refused: str) -> NoSolutionError:
    seen = f"{_sizes(field_nt, magnitude_nt)}; {_spread(field_nt, magnitude_nt)}"
    head = f"no sound solution fits {len(field_nt)} samples"
    return NoSolutionError(gate, f"{head}: {gate}: {refused}; {_NEXT_STEP[gate]} ({seen})")


def _sizes(field_nt: Array, magnitude_nt: Array) -> str:
    measured, reference = float(np.linalg.norm(field_nt, axis=1).mean()), float(magnitude_nt.mean())
    return f"mean |B| {measured:.0f} nT, mean |H| {reference:.0f} nT, a ratio of {measured / reference:.3g}"


def _spread(field_nt: Array, magnitude_nt: Array) -> str:
    """How far B varies along the axis along which it varies least, and how far if turned in all directions."""
    least = float(np.sqrt(max(np.linalg.eigvalsh(np.cov(field_nt.T))[0], 0.0)))
    full = float(magnitude_nt.mean()) / np.sqrt(3.0)
    return f"B varies by {least:.0f} nT (1 sigma) where it varies least, by {full:.0f} nT if turned in all directions"
