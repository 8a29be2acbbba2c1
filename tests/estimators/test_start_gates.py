"""The table of start gates: each stops on its own side of its limit, and the first that does is reported."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.estimators.interface import StartGate
from magcal_service.estimators.parts.start_gates import (
    LARGEST_EIGENVALUE,
    SMALLEST_EIGENVALUE,
    Proposal,
    handover_sigma,
    is_collapsed,
    stopped_by,
    vector_sigma,
)

GOOD = Proposal(np.zeros(9), np.eye(9), residual_rms_nt=449.0, largest_rms_nt=450.0, is_unsure=lambda: False)


def of_scale(first: float) -> np.ndarray:
    """A state whose I + D has the eigenvalues (first, 1, 1)."""
    return np.array([0.0, 0.0, 0.0, first - 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("proposal", "gate"),
    [
        (GOOD, None),
        (replace(GOOD, x=np.full(9, math.nan)), StartGate.NO_CONVERGENCE),
        (replace(GOOD, covariance=np.full((9, 9), math.inf)), StartGate.NO_CONVERGENCE),
        (replace(GOOD, x=of_scale(0.39)), StartGate.COLLAPSED),
        (replace(GOOD, x=of_scale(0.41)), None),
        (replace(GOOD, x=of_scale(2.51)), StartGate.COLLAPSED),
        (replace(GOOD, x=of_scale(2.49)), None),
        (replace(GOOD, x=of_scale(SMALLEST_EIGENVALUE)), None),  # the limits themselves pass
        (replace(GOOD, x=of_scale(LARGEST_EIGENVALUE)), None),
        (replace(GOOD, residual_rms_nt=450.0), None),
        (replace(GOOD, residual_rms_nt=451.0), StartGate.BAD_FIT),
        (replace(GOOD, residual_rms_nt=1e9, largest_rms_nt=math.inf), None),
        (replace(GOOD, is_unsure=lambda: True), StartGate.POOR_COVERAGE),
    ],
)
def test_a_gate_stops_beyond_its_limit(proposal: Proposal, gate: StartGate | None) -> None:
    assert stopped_by(proposal) is gate


def test_the_first_gate_that_stops_is_reported_and_those_after_it_are_not_asked() -> None:
    def never() -> bool:
        raise AssertionError("the samples are gone through only for a solution that passed the rest")

    worst = Proposal(np.full(9, math.nan), np.eye(9), residual_rms_nt=451.0, largest_rms_nt=450.0, is_unsure=never)
    assert stopped_by(worst) is StartGate.NO_CONVERGENCE
    assert stopped_by(replace(worst, x=of_scale(0.1))) is StartGate.COLLAPSED
    assert stopped_by(replace(worst, x=np.zeros(9))) is StartGate.BAD_FIT


def test_a_mirrored_axis_is_collapsed() -> None:
    assert is_collapsed(of_scale(-1.0))


@pytest.mark.parametrize(
    ("sigma_nt", "share"),
    [
        (1.0, 0.005),  # 0.005 * 1 / 40000 is (3.5e-4)^2: the lower bound holds
        (300.0, (0.005 * 300.0 / 40_000.0) ** 0.5),  # 0.00612, between the bounds
        (40_000.0, 0.03),  # 0.07: the upper bound holds
    ],
)
def test_the_filter_takes_over_at_a_share_of_the_field_that_goes_with_the_residual(
    sigma_nt: float, share: float
) -> None:
    assert handover_sigma(sigma_nt, 40_000.0) == pytest.approx(share * 40_000.0, rel=1e-12)


@pytest.mark.parametrize(("count", "is_seen"), [(2, True), (99, True), (100, False)])
def test_up_to_99_vectors_are_all_looked_at_and_of_more_some_fifty(count: int, is_seen: bool) -> None:
    """The second of them is the longest: with D alone unknown, 1 sigma of its vector is 1e-3 of its length."""
    field = np.tile([10_000.0, 0.0, 0.0], (count, 1))
    field[1] *= 3.0
    covariance = np.zeros((9, 9))
    covariance[3, 3] = 1e-6
    assert vector_sigma(covariance, field) == pytest.approx(30.0 if is_seen else 10.0, rel=1e-12)
