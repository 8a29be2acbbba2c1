"""The covariance over a long run; ``python -m tests.benchmarks.bench_covariance`` is the same for 10^7 ticks."""

from __future__ import annotations

import pytest

from tests.benchmarks.bench_covariance import run


@pytest.mark.parametrize("walk_nt", [0.0, 1.0])
def test_it_stays_symmetric_to_the_last_bit_and_positive_definite(walk_nt: float) -> None:
    """6000 ticks; the smallest eigenvalue of the correlation keeps ten digits away from rounding."""
    (figures,) = run(6000, walk_nt)
    assert (figures["asymmetry"], figures["restarts"]) == (0.0, 0)
    assert figures["smallest_eigenvalue"] > 1e-5
    assert figures["worst_error_in_sigma"] < 4.5
