"""The conditions that a batch solution has to meet before a filter starts from it, in one table: ``START_GATES``.

Which start gate a failed attempt reports says what it wants: ``trust.monitor`` has the reason and the remedy of each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.estimators.interface import StartGate
from magcal_service.model import Array, d_matrix, field_jacobian

SMALLEST_EIGENVALUE: Final = 0.4
"""Least accepted eigenvalue of I + D: the half-collapsed minimum has one near 0.25, real sensors stay above 0.7."""

LARGEST_EIGENVALUE: Final = 2.5
"""Largest accepted eigenvalue of I + D, the inverse of the smallest; real sensors stay below 1.4."""

HANDOVER_SHARE: Final = (0.005, 0.03)
"""The filter may take over when a calibrated vector is known to this share of |H| (1 sigma), by the residual's level.

What the filter leaves out is of second order, |H| share^2.  It has to be small against the residual: half a percent of
its sigma, within these bounds.  At a share of 0.03 it is 30 nT, more than the noise of a spin window's mean, and the
filter was sure of the wrong place (5 to 17 sigma off in 3 of 60 random flights; none of them at 0.005).
"""

BAD_FIT: Final = 1.5
"""Residual rms over the given noise beyond which a solution is not accepted; 120 samples give 1 +- 0.065."""


@dataclass(frozen=True, slots=True)
class Proposal:
    """A batch solution as it is put to the gates.

    Parameters
    ----------
    x, covariance: state (9,) and covariance (9, 9) [nT, -].
    residual_rms_nt: rms of the scalar residual that it leaves [nT].
    largest_rms_nt: the rms up to which it is accepted [nT]; inf where the noise is not stated.
    is_unsure: whether a calibrated vector is known too badly, by the covariance alone, for the filter to take over;
        called last, since it has to go through the samples.
    """

    x: Array
    covariance: Array
    residual_rms_nt: float
    largest_rms_nt: float
    is_unsure: Callable[[], bool]

    @property
    def is_finite(self) -> bool:
        """Whether arithmetic has given numbers at all."""
        return bool(np.isfinite(self.x).all() and np.isfinite(self.covariance).all())


START_GATES: Final[tuple[tuple[StartGate, Callable[[Proposal], bool]], ...]] = (
    (StartGate.NO_CONVERGENCE, lambda it: not it.is_finite),
    (StartGate.COLLAPSED, lambda it: is_collapsed(it.x)),
    (StartGate.BAD_FIT, lambda it: it.residual_rms_nt > it.largest_rms_nt),
    (StartGate.POOR_COVERAGE, lambda it: it.is_unsure()),
)
"""Each gate with what makes it stop a solution, in the order in which they are asked: each presumes those above it.

The solvers report four cases before there is a solution (``start``, ``two_step``): ``NOT_POSITIVE`` where the
linear step finds no I + D, ``NO_CONVERGENCE`` where no iteration settles, ``BAD_FIT`` where too many samples contradict
the rest, ``POOR_COVERAGE`` where two minima fit as well.
"""


def stopped_by(proposal: Proposal) -> StartGate | None:
    """The first gate that stops a solution; None where it passes all."""
    return next((gate for gate, stops in START_GATES if stops(proposal)), None)


def is_collapsed(x: Array) -> bool:
    """Whether an eigenvalue of I + D of a finite state (9,) lies outside the accepted ones."""
    eigenvalues = np.linalg.eigvalsh(np.eye(3) + d_matrix(x))
    return bool(eigenvalues[0] < SMALLEST_EIGENVALUE or eigenvalues[-1] > LARGEST_EIGENVALUE)


def handover_sigma(residual_sigma_nt: float, magnitude_nt: float) -> float:
    """Largest 1 sigma of a calibrated vector [nT] at which the filter may take over, by ``HANDOVER_SHARE``.

    Parameters
    ----------
    residual_sigma_nt: the residual's level, 1 sigma [nT].
    magnitude_nt: mean of |H| [nT].
    """
    share = float(np.clip((0.005 * residual_sigma_nt / magnitude_nt) ** 0.5, *HANDOVER_SHARE))
    return share * magnitude_nt


def vector_sigma(covariance: Array, field_nt: Array) -> float:
    """Largest 1 sigma of the calibrated vector over the measured ones [nT], from the state's covariance alone."""
    sample = field_nt[:: max(1, len(field_nt) // 50)]
    jacobian = field_jacobian(sample)
    variance = np.einsum("nij,jk,nik->n", jacobian, covariance, jacobian)
    return float(np.sqrt(variance.max()))
