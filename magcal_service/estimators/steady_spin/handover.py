"""Whether the filter may take over from a batch fit: sound, certain enough, and in agreement with the scalar filter."""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.estimators.interface import StateEstimate
from magcal_service.estimators.parts.start_gates import is_collapsed, vector_sigma
from magcal_service.estimators.steady_spin.fit import Samples, SpinFit
from magcal_service.estimators.steady_spin.state import ERRORS
from magcal_service.estimators.steady_spin.watch import SpinGate
from magcal_service.model import scalar_residual
from magcal_service.residuals import rms

_HANDOVER_SHARE: Final = 0.01
"""1 sigma of a calibrated vector over |H| below which the filter may take over: second order is noise then."""

_CONTRADICTION: Final = 1.15
"""Scalar residual (rms) by the spin's calibration over that by the scalar filter's: beyond it they contradict."""


def failed_gate(fit: SpinFit, samples: Samples, scalar: StateEstimate) -> SpinGate | None:
    """The gate that a batch fit fails beside the scalar estimate of the same samples; None where it passes all."""
    state = fit.state
    if is_collapsed(state.x):
        return SpinGate.COLLAPSED
    sigma_nt = vector_sigma(state.covariance[ERRORS, ERRORS], samples.field_nt)
    magnitude_nt = np.linalg.norm(samples.reference_eci_nt, axis=1)
    if sigma_nt > min(_HANDOVER_SHARE * magnitude_nt[-1], vector_sigma(scalar.covariance, samples.field_nt)):
        return SpinGate.POOR_COVERAGE
    by_spin = rms(scalar_residual(state.x, samples.field_nt, magnitude_nt))
    by_scalar = rms(scalar_residual(scalar.x, samples.field_nt, magnitude_nt))
    return SpinGate.CONTRADICTS_SCALAR if by_spin > _CONTRADICTION * by_scalar else None
